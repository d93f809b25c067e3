"""W4: steady flow through a taper 5 to 1 (R04): the exact mean of an element, or (3.14f)."""

from __future__ import annotations

import numpy as np
from figures_verification.cases.r04 import ENDS, FRACTURE, HEAD
from figures_verification.runs import solve
from grids import tensor

from figures_work_precision.problem import Answer, Method, Problem, nodes_of

PIECES = (1, 2, 4, 8, 16, 32, 64)


def run(mean: str, pieces: float) -> Answer:
    """Of the flow, int ds/d^3 = (a + b)/(2 a^2 b^2)."""
    scene = HEAD + FRACTURE.format(name="slot", along=[0, 1], value=[1.0, 0.2]) + ENDS.format(name="slot", pressure=1)
    grid = tensor(np.linspace(0, 1, int(pieces) + 1), np.array([-1.0, 0.0, 1.0]), {"slot": (0.0, 0.0, 1.0)})
    found = solve(scene, f"method.conductance={mean}", mesh=grid)
    flow = found.fractures[-1].point["flow_rate"]
    return Answer(float(np.abs(flow / (2 * 0.2**2 / 1.2) - 1).max()), found.seconds, nodes_of(grid))


PROBLEM = Problem(
    "W4", "Flow through a taper: the mean of an element", "elements", "flow",
    (
        Method("exact", lambda pieces: run("exact", pieces), PIECES, default=True),
        Method("(3.14f)", lambda pieces: run("report", pieces), PIECES, most=1.1),
    ),
    1e-12,
)  # fmt: skip
