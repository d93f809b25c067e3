"""What a compressible fluid holds beyond the room between the walls, from state to state."""

from __future__ import annotations

from fracflow._petsc import PETSc
from fracflow.assembly.flow import Compression
from fracflow.assembly.operators import Operators
from fracflow.state import State


def compression_of(operators: Operators, state: State) -> Compression | None:
    """What a compressible fluid holds at a state; None of one that is not. Collective."""
    network = operators.flow
    if network is None or network.compressibility == 0.0:
        return None
    opening = operators.joints.openings(state.sections.strain)
    aperture = network.apertures(state.motion.displacement, opening)
    return network.compress(aperture, network.driving(state.pressure))


def taken_up(operators: Operators, before: Compression, after: Compression) -> PETSc.Vec:
    """What the fluid has taken up in between at the flow nodes, in a new vector [volume per thickness]. Collective."""
    assert operators.flow is not None
    result = operators.layout.flow_vector()
    operators.flow.taken_up(after.held - before.held, result)
    return result


def taken_between(operators: Operators, old: State, new: State) -> PETSc.Vec:
    """The same between two states. Collective."""
    before, after = compression_of(operators, old), compression_of(operators, new)
    assert before is not None and after is not None
    return taken_up(operators, before, after)
