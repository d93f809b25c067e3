"""Rules for stepping in time."""

from .newmark import Alphas, BackwardEuler, Newmark, Steady, Stepper, acceleration, velocity

STEPPERS: dict[str, type[Stepper]] = {
    "newmark": Newmark,
    "steady": Steady,
    "backward-euler": BackwardEuler,
}

__all__ = ["STEPPERS", "Alphas", "BackwardEuler", "Newmark", "Steady", "Stepper", "acceleration", "velocity"]
