"""Rules for stepping in time."""

from typing import Any

from .error import local_error
from .film import BDF2, BackwardEuler, Trapezoid, first
from .newmark import Alphas, HasMotion, Newmark, Steady, Stepper, acceleration, first_rate, velocity

STEPPERS: dict[str, type[Any]] = {
    "newmark": Newmark,
    "steady": Steady,
    "backward-euler": BackwardEuler,
    "bdf2": BDF2,
    "trapezoid": Trapezoid,
}
"""Rules by name; ``method.stepper`` names one with inertia, ``method.film`` one with storage and without inertia."""

__all__ = [
    "BDF2",
    "STEPPERS",
    "Alphas",
    "BackwardEuler",
    "HasMotion",
    "Newmark",
    "Steady",
    "Stepper",
    "Trapezoid",
    "acceleration",
    "first",
    "first_rate",
    "local_error",
    "velocity",
]
