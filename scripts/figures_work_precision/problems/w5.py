"""W5: a crack in a periodic row (R07), blown up by a pressure or slipping with friction; cells, meshes, quadratures, Newton.

Graded meshes have cells of size^2 at the tip that grow away from it, uniform ones the same number of joints along the crack.
"""

from __future__ import annotations

import numpy as np
from figures_verification.cases import r07
from figures_verification.runs import solve
from grids import graded, mirrored, tensor

from figures_work_precision.problem import Answer, Method, Problem, nodes_of

PERIOD = 10.0
SIZES = (0.4, 0.2, 0.1, 0.05)
EVEN = (4, 8, 16, 32)
BEFORE = 0.9999 * r07.FRICTION * r07.STRESS
SHEARED = (
    r07.SHEARED.replace("shear_stiffness = 1e15", "shear_stiffness = 2e10")
    .replace("initial_stress.yy", f"initial_stress.xy = {BEFORE}\ninitial_stress.yy")
    .replace(f"[1, {r07.SHEAR}]", f"[1, {r07.SHEAR - BEFORE}]")
)
"""The shear traction is near the strength from the start: sliding, the jump does not depend on the stiffness of the joint, by
which Newton's methods differ."""
MANY = "accuracy.max_iterations=400"


def uniform(joints: float, triangles: bool) -> str:
    """Squares along the half crack and beyond its tip, growing only above and beside."""
    h = r07.HALF / joints
    x = np.concatenate(
        [np.arange(0, 2 * r07.HALF - h / 2, h), 2 * r07.HALF + graded(h, PERIOD / 2 - 2 * r07.HALF, 1.2)]
    )
    near = np.arange(0, r07.HALF - h / 2, h)
    y = np.concatenate([near, r07.HALF + graded(h, 1.5 * PERIOD - r07.HALF, 1.2)])
    return tensor(x, mirrored(y), {"crack": (0.0, 0.0, r07.HALF)}, triangles)


def run(mesh: str, sheared: bool, *settings: str) -> Answer:
    """Root mean square of the error of the jump along the crack, over that of the jump."""
    load = r07.SHEAR - r07.FRICTION * r07.STRESS if sheared else r07.PRESSURE
    scene = r07.SCENE + (SHEARED if sheared else r07.BLOWN.format(law='law = "linear"', stiffness=1.0, pressure=load))
    found = solve(scene, *settings, mesh=mesh)
    state = found.fractures[-1]
    x, jump = np.abs(state.points[:, 0]), state.point["slip" if sheared else "opening"]
    right = r07.opening(x, PERIOD, load)
    weights = np.zeros(len(x))
    np.add.at(weights, state.pieces, np.abs(np.diff(x[state.pieces], axis=1)) / 2)
    return Answer(float(np.sqrt(weights @ (jump - right) ** 2 / (weights @ right**2))), found.seconds, nodes_of(mesh))


def method(name: str, *settings: str, t3: bool = False, even: bool = False, sheared: bool = False) -> Method:
    """Settings under [method], on a mesh and with a load."""
    given = (MANY, *(f"method.{setting}" for setting in settings))

    def at(level: float) -> Answer:
        return run(uniform(level, t3) if even else r07.cells(level, PERIOD, t3), sheared, *given)

    return Method(name, at, EVEN if even else SIZES, default=not (settings or t3 or even))


PRESSED = Problem(
    "W5A", "A crack under pressure: cells, meshes, quadratures", "size or joints", "opening",
    (
        method("Q4 graded"),
        method("Q4 uniform", even=True),
        method("T3 graded", t3=True),
        method("T3 uniform", t3=True, even=True),
        *(method(f"Q4 graded, {rule}", f"quadrature={rule}") for rule in ("gauss2", "one-point")),
        method("T3 graded, one-point", "quadrature=one-point", t3=True),
    ),
    0.085,
)  # fmt: skip
SLIPS = Problem(
    "W5B", "A crack that slips: cells and Newton's methods", "size or joints", "slip",
    (
        method("Q4 graded", sheared=True),
        method("T3 graded", t3=True, sheared=True),
        method("Q4 uniform", even=True, sheared=True),
        *(method(f"Q4 graded, newton = {way}", f"newton={way}", sheared=True) for way in ("modified", "secant")),
        method("Q4 graded, condensed", "coupling=condensed", sheared=True),
        method("Q4 graded, one change", "overshoot=one-change", sheared=True),
        method("Q4 graded, decoupled tangent", "tangent=decoupled", sheared=True),
        method("Q4 graded, gauss2", "quadrature=gauss2", sheared=True),
    ),
    0.085,
)  # fmt: skip
PROBLEMS = (PRESSED, SLIPS)
