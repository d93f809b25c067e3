"""W7: fluid is pumped into a prestressed fault, which slips as its pressure spreads: what the plan leaves out, and rules.

Slip is stable and has no inertia. Nothing closed is known: the reference is ``model = "full"`` with BDF2, coupled in one
matrix, in steps a sixteenth as long as those of the second level. On the same mesh, so that all of the error is of the steps
and of what is left out.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
from figures_verification.runs import Found, solve
from grids import Floats, tensor

from figures_work_precision.problem import Answer, Method, Problem

REACH, END = 200.0, 600.0
CELLS, STEPS = 32, (4, 8, 16, 32)
FULL = ("model=full", "method.coupling=whole-lu")
SCENE = f"""
rock.rock = {{youngs_modulus = "30 GPa", poissons_ratio = 0.25}}
initial_stress = {{xx = "-25 MPa", yy = "-20 MPa", zz = "-22 MPa", xy = "8 MPa"}}
fluid = {{viscosity = "1e-3 Pa s", initial_pressure = "5 MPa"}}
support = [{{on = ["west", "east", "south", "north"]}}]
well = [{{name = "well", at = [0, 0], flow_rate = [[0, 0], [200, 4e-5], [300, 4e-5], [{END}, 0]]}}]
probe = [{{name = "well", at = [0, 0], on = "fault"}}, {{name = "quarter", at = [{REACH / 2}, 0], on = "fault"}}]
fracture.fault = {{normal_stiffness = 5e10, shear_stiffness = 2e10, aperture = 1.4e-4, friction_coefficient = 0.6}}
"""


def mesh(cells: int) -> str:
    """A square twice as wide as the fault in its middle, ``cells`` a side, a multiple of 4."""
    line = np.linspace(-2 * REACH, 2 * REACH, cells + 1)
    return tensor(line, line, {"fault": (0.0, -REACH, REACH)})


def stage(steps: float) -> str:
    """The setting of so many steps."""
    return f"stage=[{{kind = 'quasi-static', time_step = {END / steps}, steps = {int(steps)}}}]"


def written(folder: Path, cells: int, steps: int) -> Path:
    """The scene as a file with its mesh in a folder, of any size."""
    (folder / "w7.msh").write_text(mesh(cells), encoding="utf-8")
    text = f'output.pictures = false\nmesh.file = "w7.msh"\n{stage(steps)}\n{SCENE}'
    (folder / "w7.toml").write_text(text, encoding="utf-8")
    return folder / "w7.toml"


def ends(found: Found) -> tuple[Floats, Floats]:
    """Pressure above the initial one and slip, at the end."""
    last = found.fractures[-1].point
    return last["pressure"] - found.fractures[0].point["pressure"], last["plastic_slip"]


def run(steps: float, *settings: str) -> Found:
    """All steps."""
    return solve(SCENE, stage(steps), *settings, mesh=mesh(CELLS))


@cache
def reference() -> tuple[Floats, Floats]:
    """Pressure and slip of the reference."""
    return ends(run(16 * STEPS[1], *FULL, "method.flow_integrator=bdf2"))


def answer(steps: float, *settings: str) -> Answer:
    """The larger of the relative errors of pressure and slip, root mean squares along the fault."""
    found = run(steps, *settings)
    errors = [
        np.linalg.norm(value - right) / np.linalg.norm(right)
        for value, right in zip(ends(found), reference(), strict=True)
    ]
    return Answer(float(max(errors)), found.seconds)


def method(name: str, *settings: str) -> Method:
    """Of settings; without any, as the program does of its own accord."""
    return Method(name, lambda steps: answer(steps, *settings), STEPS, default=not settings)


BDF2 = "method.flow_integrator=bdf2"
PROBLEM = Problem(
    "W7", "Injection until a fault slips: all in it, and as planned", "steps", "pressure or slip at the end",
    (
        method("as planned, backward-euler"),
        method("as planned, bdf2", BDF2),
        method("full, backward-euler", *FULL),
        method("full, bdf2", *FULL, BDF2),
        method("condensed, bdf2", "method.coupling=condensed", BDF2),
    ),
    0.06, reference,
)  # fmt: skip
