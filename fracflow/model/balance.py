"""The balance of the rock but for inertia."""

from __future__ import annotations

from collections.abc import Iterable

from fracflow._petsc import PETSc
from fracflow.mesh.data import Floats
from fracflow.model.operators import Operators
from fracflow.model.state import State


def static_balance(
    ops: Operators,
    displacement: PETSc.Vec,
    traction: Floats,
    pressure: PETSc.Vec,
    load: PETSc.Vec,
    of_terms: Iterable[PETSc.Vec] = (),
) -> PETSc.Vec:
    """S = K u + F_s(sigma_0) + G' W f - B p + forces of terms - R, tractions f (s, dim), in a new vector. Collective."""
    result = ops.prestress.copy()
    ops.rock_force(displacement, result, result)
    ops.joints.force(traction, result)
    if ops.flow is not None:
        term = result.duplicate()
        ops.flow.pressure_load.mult(pressure, term)
        result.axpy(-1.0, term)
        term.destroy()
    for force in of_terms:
        result.axpy(1.0, force)
    result.axpy(-1.0, load)
    return result


def static_balance_of(ops: Operators, state: State) -> PETSc.Vec:
    """The same at a state. It follows from the state alone, so a restarted run computes the same bits."""
    displacement, traction, forces = state.motion.displacement, state.sections.traction, state.forces
    return static_balance(ops, displacement, traction, state.pressure, forces.load, forces.of_terms.values())
