"""Rates of the pressures of a compressible fluid, by the rule of a step."""

from __future__ import annotations

from fracflow._petsc import PETSc
from fracflow.assembly.flow import Flow
from fracflow.state import State
from fracflow.stepping import Alphas, first_rate


def pressure_rate(network: Flow | None, state: State, alphas: Alphas, pressure: PETSc.Vec) -> PETSc.Vec | None:
    """Rates of trial pressures after ``state``, in a new vector; None where the fluid stores nothing by compression."""
    if network is None or network.compressibility == 0.0 or alphas.b1 == alphas.b4 == 0.0:
        return None
    before, mean = (
        0.0 if each is None else each.getArray(readonly=True) for each in (state.pressure_rate, state.memory.pressure)
    )
    trial, old, result = pressure.getArray(readonly=True), state.pressure.getArray(readonly=True), pressure.duplicate()
    result.setArray(first_rate(alphas, trial, old, before, mean))
    return result
