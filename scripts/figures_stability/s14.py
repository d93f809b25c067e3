"""S14: where dilation holds slip that weakens: a layer sheared over a joint whose fluid is shut in.

By the hardening of dilation and by the fall of strength, each over the stiffness k of layer and joint. Slip opens the walls.
The fluid that is shut in loses pressure. The strength rises by f K_f tan psi/w_0 a slip, less what the closure gives.
Predicted: slip is stable where that and k exceed the fall of strength (as in Rudnicki and Chen 1988). Past it a
stage without inertia ends: at a limit point, or since no balance is near.
"""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from sheets import BLUE, INK, NODE_COLOURS, ORANGE, Check, Floats, save, sheet, write_csv

from fracflow.advance.instability import LimitPoint
from fracflow.errors import NotConverged
from fracflow.output import read_history
from fracflow.scene.scene import load
from fracflow.simulation.run import run

K_N, K_S, ROCK, D_0, SIGMA = 1e12, 20e9, 2.5e9, 1e-3, 10e6  # joint; G over the height of the layer [Pa/m]; [m]; [Pa]
PEAK, LOW, FLUID, PULL = 0.6, 0.5, 1e8, 1e-6  # coefficients of friction; K_f [Pa]; past the strength [m]
AROUND = 1.0 / (1.0 / K_S + 1.0 / ROCK)
SCENE = f"""
output = {{pictures = false}}
geometry = {{domain = [0, 0, 1, 2], size = 1, cells = "quads", fracture = [{{name = "seam", points = [[0, 1], [1, 1]]}}]}}
rock.rock = {{youngs_modulus = "10 GPa", poissons_ratio = 0, density = 2700}}
initial_stress = {{yy = {-SIGMA - 5e6}}}
fluid = {{viscosity = 1e-3, initial_pressure = "5 MPa", compressibility = {1.0 / FLUID}}}
tie = [{{on = ["west", "east"]}}]
load = [{{on = "north", traction = "initial-stress"}}]
probe = [{{name = "middle", at = [0.5, 1], on = "seam"}}]
[fracture.seam]
law = "slip-weakening"
normal_stiffness = {K_N}
shear_stiffness = {K_S}
aperture = {D_0}
friction_coefficient = {PEAK}
dynamic_friction_coefficient = {LOW}
slip_weakening_distance = 1
dilation_distance = 1
[[support]]
on = "south"
[[support]]
on = "north"
components = ["x"]
displacement = {{x = [[0, 0], [1, {PEAK * SIGMA / AROUND}], [2, {PEAK * SIGMA / AROUND + PULL}]]}}
[[stage]]
kind = "quasi-static"
time_step = 1
steps = 1
[[stage]]
kind = "quasi-static"
time_step = 0.05
steps = 20
"""


def hardens(angle: float) -> float:
    """Rise of strength by slip that begins, of fluid shut in: f tan psi/(d/K_f + 1/k_n), f = mu_p [stress/length]."""
    return float(PEAK * np.tan(np.radians(angle)) / (D_0 / FLUID + 1.0 / K_N))


def angle_of(hardening: float) -> float:
    """The angle whose hardening that is [degree]."""
    return float(np.degrees(np.arctan(hardening * (D_0 / FLUID + 1.0 / K_N) / PEAK)))


@cache
def slipped(hardening: float, fall: float) -> float:
    """Slip after a pull of 1 um past the strength, over what it would be at a constant strength; inf where it ran away."""
    distance = (PEAK - LOW) * SIGMA / fall
    sets = {
        "dilation_angle_deg": angle_of(hardening),
        "slip_weakening_distance": distance,
        "dilation_distance": 10 * distance,
    }
    with tempfile.TemporaryDirectory() as name:
        (Path(name) / "scene.toml").write_text(SCENE, encoding="utf-8")
        scene = load(Path(name) / "scene.toml", [f"fracture.seam.{key}={value}" for key, value in sets.items()])
        try:
            run(scene, Path(name) / "run")
        except (LimitPoint, NotConverged):
            return np.inf
        return float(np.abs(read_history(Path(name) / "run" / "history.h5")["probe/middle/plastic_slip"]).max() / PULL)


def draw(folder: Path, small: bool = False) -> list[Check]:
    """Measure, draw ``s14`` into ``folder`` and return the bars."""
    hardening = np.array([0.0, 1.0] if small else [0.0, 0.25, 0.5, 1.0, 1.5, 2.0])
    fall = np.array([0.5, 1.75] if small else [0.25, 0.5, 0.9, 1.15, 1.4, 1.75, 2.3, 2.8, 3.3])
    grid = np.meshgrid(hardening, fall)
    found = np.array([slipped(float(h) * AROUND, float(w) * AROUND) for h, w in zip(*map(np.ravel, grid), strict=True)])
    found, margin = found.reshape(grid[0].shape), 1.0 + grid[0] - grid[1]
    figure, axes = sheet(
        "S14  Where dilation holds slip that weakens",
        "A layer sheared over a joint with its fluid shut in, slip weakening, no inertia; $k$ is the stiffness of layer and"
        " joint.",
        [["map", "slip"]], (10.2, 4.6),
    )  # fmt: skip
    _map(axes["map"], grid, found)
    _curves(axes["slip"], hardening, fall, found)
    save(figure, folder, "s14", "Predicted: 1 + (dilation) = fall of strength, from the parameters alone.")
    columns = {
        "hardening_over_k": grid[0].ravel(),
        "fall_over_k": grid[1].ravel(),
        "slip_over_that_of_constant": found.ravel(),
    }
    write_csv(folder, "s14", columns, ["scripts/figures stability --only S14"])
    clear = np.abs(margin) > 0.05
    wrong = int(np.sum((np.isfinite(found) != (margin > 0.0)) & clear))
    stable = np.isfinite(found) & (margin > 0.0)
    off = float(np.abs(found[stable] * margin[stable] - 1.0).max())
    return [
        Check("S14 runs on the other side of the boundary", wrong, "= 0", wrong == 0),
        Check("S14 stable and unstable runs, fewest of one kind", float(min(stable.sum(), (~stable).sum())), ">= 1",
              bool(0 < stable.sum() < stable.size)),
        Check("S14 slip that is held, off that of the prediction", off, "<= 0.1", off <= 0.1),
    ]  # fmt: skip


def _map(axis: Axes, grid: list[Floats], found: Floats) -> None:
    """Mark each run by how it ended; draw the boundary."""
    for chosen, mark, colour, label in (
        (np.isfinite(found), "o", BLUE, "held"),
        (np.isinf(found), "X", ORANGE, "runs away"),
    ):
        axis.plot(grid[0][chosen], grid[1][chosen], mark, color=colour, ms=8, label=label, ls="")
    ends = np.array([-0.1, grid[0].max() + 0.1])
    axis.plot(ends, 1.0 + ends, "--", color=INK, label="predicted boundary")
    axis.set(xlabel=r"dilation $f\,\tan\psi\,/\,(d/K_f + 1/k_n)\,/\,k$", ylabel=r"fall of strength with slip$\,/\,k$")
    axis.set(xlim=ends, ylim=(0.0, grid[1].max() + 1.4), title="What runs do")
    axis.legend(loc="upper left", framealpha=1.0)


def _curves(axis: Axes, hardening: Floats, fall: Floats, found: Floats) -> None:
    """Slip that is held, beside 1/(1 + dilation - fall)."""
    for number, each in enumerate(hardening):
        colour = NODE_COLOURS[number % len(NODE_COLOURS)]
        held = np.isfinite(found[:, number])
        fine = np.linspace(0.0, 0.97 * (1.0 + each), 200)
        axis.plot(fine, 1.0 / (1.0 + each - fine), "-", color=colour, lw=0.8)
        axis.plot(fall[held], found[held, number], "os^Dv<"[number % 6], color=colour, ms=5, label=f"{each:g}")
    axis.set(xlabel=r"fall of strength with slip$\,/\,k$", ylabel="slip over that at a constant strength", yscale="log")
    axis.set(title="Slip that is held; lines: predicted", ylim=(0.2, 40.0))
    axis.legend(title=r"dilation$\,/\,k$", loc="upper left", ncols=1, framealpha=1.0)
