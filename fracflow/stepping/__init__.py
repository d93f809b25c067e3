"""Rules for stepping in time."""

from typing import Any

from .newmark import Alphas, BackwardEuler, HasMotion, Newmark, Steady, Stepper, acceleration, velocity

STEPPERS: dict[str, type[Any]] = {"newmark": Newmark, "steady": Steady, "backward-euler": BackwardEuler}
"""Rules by name; ``method.stepper`` names one with inertia."""

__all__ = [
    "STEPPERS",
    "Alphas",
    "BackwardEuler",
    "HasMotion",
    "Newmark",
    "Steady",
    "Stepper",
    "acceleration",
    "velocity",
]
