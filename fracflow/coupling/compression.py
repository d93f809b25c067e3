"""How fast a compressible fluid is taken up, by the rule of a step, and what of it a closed part must keep."""

from __future__ import annotations

import numpy as np

from fracflow.assembly.components import Closure
from fracflow.assembly.flow import Compression
from fracflow.assembly.operators import Operators
from fracflow.mesh.data import Floats
from fracflow.state import State
from fracflow.stepping import Alphas, first_rate


def uptake_rate(state: State, alphas: Alphas, taken: Floats) -> Floats | None:
    """Rates (n,) of what was ``taken`` (n,) since ``state``, by the rule of the walls; None in a step without storage."""
    if alphas.b1 == alphas.b4 == 0.0:
        return None
    old, mean = (0.0 if each is None else each.getArray(readonly=True) for each in (state.uptake, state.memory.uptake))
    rate: Floats = first_rate(alphas, taken, 0.0, old, mean)
    return rate


def taken_by(operators: Operators, closure: Closure, before: Compression | None, after: Compression | None) -> float:
    """Fluid that compression has taken up in a part that must keep it [volume per thickness]. Collective."""
    if closure.by != "fluid" or before is None or after is None:
        return 0.0
    inside = np.isin(operators.blocks.joints.flow, closure.nodes)
    return float(operators.layout.comm.allreduce(float((after.held - before.held)[inside].sum())))
