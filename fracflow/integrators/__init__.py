"""Rules for stepping in time."""

from dataclasses import fields
from typing import Any

from fracflow.integrators.explicit import Explicit
from fracflow.integrators.first_order import BDF2, BackwardEuler, FlowRule, Rates, Trapezoid, first, storage_error
from fracflow.integrators.generalised_alpha import GeneralisedAlpha
from fracflow.integrators.hht import HHT
from fracflow.integrators.implicit_euler import ImplicitEuler
from fracflow.integrators.newmark import (
    Alphas,
    HasMotion,
    Newmark,
    Steady,
    Stepper,
    acceleration,
    driven_acceleration,
    first_rate,
    velocity,
)
from fracflow.integrators.parameters import keys_of

# a rule from outside the package is registered here, STEPPERS["name"] = Rule, before any scene is read
STEPPERS: dict[str, type[Stepper]] = {
    "newmark": Newmark,
    "hht": HHT,
    "generalised-alpha": GeneralisedAlpha,
    "implicit-euler": ImplicitEuler,
    "steady": Steady,
    "backward-euler": BackwardEuler,
    "bdf2": BDF2,
    "trapezoid": Trapezoid,
}
"""Rules by name; ``method.stepper`` names one with inertia, ``method.flow_integrator`` one with storage and without inertia."""

EXPLICIT: dict[str, type[Stepper]] = {"explicit": Explicit}
"""Rules with a protocol of their own: see ``solve.explicit``."""


def with_inertia() -> dict[str, type[Stepper]]:
    """The rules that ``method.stepper`` may name."""
    return {name: kind for name, kind in STEPPERS.items() if kind.inertia} | EXPLICIT


def flow_integrators() -> dict[str, type[Stepper]]:
    """The rules that ``method.flow_integrator`` may name."""
    return {name: kind for name, kind in STEPPERS.items() if kind.storage and not kind.inertia}


def stepper_from(name: str, method: Any) -> Stepper:
    """The rule of that name, with its parameters from the attributes of ``method`` that their keys name."""
    kind: type[Any] = (STEPPERS | EXPLICIT)[name]
    made: Stepper = kind(**{each.name: getattr(method, each.metadata["key"]) for each in fields(kind)})
    return made


__all__ = [
    "BDF2", "EXPLICIT", "HHT", "STEPPERS", "Alphas", "BackwardEuler", "Explicit", "FlowRule", "GeneralisedAlpha",
    "HasMotion", "ImplicitEuler", "Newmark", "Rates", "Steady", "Stepper", "Trapezoid", "acceleration",
    "driven_acceleration", "first", "first_rate", "flow_integrators", "keys_of", "stepper_from", "storage_error",
    "velocity", "with_inertia",
]  # fmt: skip
