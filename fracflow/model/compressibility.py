"""What changes in the fractures from state to state: the fluid that compression takes up, and the way that is left for it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fracflow._petsc import MPI, PETSc
from fracflow.model.flow import Compression
from fracflow.model.operators import Operators
from fracflow.model.state import State


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


def narrowing(operators: Operators, old: State, new: State) -> float:
    """Least share that is left of an aperture which the flow goes by; 1 or more where none narrows. Collective."""
    if operators.flow is None:
        return 1.0
    return float(operators.layout.comm.allreduce(float(_left(operators, old, new).min(initial=1.0)), op=MPI.MIN))


def widening(operators: Operators, old: State, new: State) -> tuple[float, str]:
    """Largest factor by which an aperture that the flow goes by has grown, at least 1, and where that is. Collective."""
    if operators.flow is None:
        return 1.0, ""
    joints, found = operators.blocks.joints, (1.0, "")
    grown = _left(operators, old, new)
    if grown.size and grown.max() > 1.0:
        joint, end = np.unravel_index(grown.argmax(), grown.shape)
        x, y = operators.blocks.solid.points[joints.bottom[joint, end]][:2]
        found = float(grown[joint, end]), f"{joints.fractures[joints.fracture[joint]]} at ({x:.6g}, {y:.6g})"
    return max(operators.layout.comm.allgather(found))


def _left(operators: Operators, old: State, new: State) -> NDArray[np.float64]:
    """Share that is left of each aperture (j, 2) by which the flow goes; 1 where it is given. Collective."""
    network = operators.flow
    assert network is not None
    before, after = (
        np.maximum(
            network.apertures(state.motion.displacement, operators.joints.openings(state.sections.strain)), least
        )
        for state, least in ((old, network.least), (new, network.least))
    )
    wide = (before > 0.0) & np.isnan(network.given)[:, None]
    return np.divide(after, before, out=np.ones_like(before), where=wide)
