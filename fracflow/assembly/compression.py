"""What changes in the fractures from state to state: the fluid that compression takes up, and the way that is left for it."""

from __future__ import annotations

import numpy as np

from fracflow._petsc import MPI, PETSc
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


def narrowing(operators: Operators, old: State, new: State) -> float:
    """Least share that is left of an aperture which the flow goes by; 1 or more where none narrows. Collective."""
    network = operators.flow
    if network is None:
        return 1.0
    before, after = (
        np.maximum(
            network.apertures(state.motion.displacement, operators.joints.openings(state.sections.strain)), least
        )
        for state, least in ((old, network.least), (new, network.least))
    )
    wide = (before > 0.0) & np.isnan(network.given)[:, None]
    share = np.divide(after, before, out=np.ones_like(before), where=wide)
    return float(operators.layout.comm.allreduce(float(share.min(initial=1.0)), op=MPI.MIN))
