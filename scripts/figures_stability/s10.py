"""S10: Newton iterations for one tight joint between two elastic bars, by k_n0 d_0 and by a jump of its pressure.

Both over the effective load. The balance after a jump dp is f_n(e) - f_n0 + k_r e = dp, with e the opening and k_r the
stiffness of the bars. A rise is linear up to lift-off, e = load/k_n0. After a fall the closure is hyperbolic: the first
iterate of Newton's method alone passes -d_0 where |dp| > d_0 (k_n0 + k_r). Newton takes 0.9 of the gap there at most, so a
decade of the gap an iteration; where that goes too far, the gap doubles in each of at most log2(10) more. Wells prescribe the
pressure at both ends: a front of pressure, which costs more, is not on this map.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm
from sheets import HALO, INK, Check, Floats, save, sheet, write_csv

from fracflow._petsc import MPI
from fracflow.errors import SolveError
from fracflow.laws.closure import STEP_FRACTION
from fracflow.output import read_history
from fracflow.scene.scene import Scene
from fracflow.scene.toml import tomllib
from fracflow.simulation.run import run

LOAD, APERTURE, MODULUS, POISSON = 5e6, 10e-6, 6.1e9, 0.33
BARS = 0.5 * MODULUS * (1.0 - POISSON) / ((1.0 + POISSON) * (1.0 - 2.0 * POISSON))  # k_r of two bars of 1 m
MOST = 12  # iterations
BALANCED = 1e-11  # of the load: agrees best of 1e-8 to 1e-13, which all give counts within 1 of those measured
NEAR = 1e-8  # error of the aperture
COMMAND = "scripts/figures stability --only S10"
SCENE = """
output = {pictures = false}
rock.shale = {youngs_modulus = 6.1e9, poissons_ratio = 0.33, density = 2450}
initial_stress = {xx = -10e6, yy = -10e6, zz = -10e6}
fluid = {viscosity = 1e-3, specific_weight = 9810, initial_pressure = 5e6}
support = [{on = ["west", "east"], components = ["x"]}, {on = ["south", "north"]}]
geometry = {domain = [0, 0, 1, 2], size = 1, fracture = [{name = "joint", points = [[0, 1], [1, 1]]}]}
stage = [{kind = "quasi-static", time_step = 3, steps = 1}]
probe = [{name = "middle", at = [0.5, 1], on = "joint"}]
fracture.joint = {aperture = 10e-6, friction_coefficient = 0.6}
"""


class Found(NamedTuple):
    """Newton iterations, NaN where the step failed; trials that were rejected; error of the aperture, of itself."""

    iterations: float
    rejected: int
    error: float


def scene(closure: float, jump: float) -> Scene:
    """The joint with k_n0 d_0 of ``closure`` times the load, whose pressure jumps by ``jump`` times the load."""
    data, after = tomllib.loads(SCENE), 5e6 + jump * LOAD
    stiffness = closure * LOAD / APERTURE
    data["fracture"]["joint"] |= {"normal_stiffness": stiffness, "shear_stiffness": stiffness}
    table = [[0.0, 5e6], [1e-3, after], [3.0, after]]
    ends = ("start", "end")
    data["well"] = [{"name": end, "at": {"fracture": "joint", "end": end}, "pressure": table} for end in ends]
    return Scene.from_data(data)


def measured(closure: float, jump: float) -> Found:
    """The step, as the program takes it."""
    with tempfile.TemporaryDirectory() as name:
        try:
            run(scene(closure, jump), Path(name) / "run", MPI.COMM_SELF)
        except SolveError:
            return Found(np.nan, 0, np.nan)
        history = read_history(Path(name) / "run" / "history.h5")
    right = APERTURE * (1.0 + opening(closure, jump))
    error = abs(float(history["probe/middle/aperture"][-1]) / right - 1.0)
    return Found(float(history["step/newton"].max()), int(history["step/rejected"].sum()), error)


def opening(closure: float, jump: float) -> float:
    """The opening over d_0 that balances, in closed form."""
    bars = BARS * APERTURE / LOAD
    if jump >= 0.0:
        e = jump / (closure + bars)
        return e if closure * e <= 1.0 else (jump - 1.0) / bars
    b = closure + bars - jump
    return 2.0 * jump / (b + np.sqrt(b**2 + 4.0 * bars * jump))


def predicted(closure: float, jump: float) -> int:
    """Iterations of Newton's method on the balance of one opening e/d_0, with the law and its limit of the step alone."""
    bars, e = BARS * APERTURE / LOAD, 0.0
    for iteration in range(100):
        is_open = closure * e > 1.0
        traction = 1.0 if is_open else closure * (e if e >= 0.0 else e / (1.0 + e))
        out = jump - traction - bars * e
        if abs(out) <= BALANCED:
            return iteration
        tangent = 0.0 if is_open else closure / (1.0 + min(e, 0.0)) ** 2
        e = max(e + out / (tangent + bars), e - STEP_FRACTION * (1.0 + e))
    return 100


def draw(folder: Path, small: bool = False) -> list[Check]:
    """The map, its CSV and its bars; ``small`` at twelve points."""
    closures = np.geomspace(1e-3, 10.0, 3 if small else 9)
    sizes = {
        "rises": np.geomspace(0.12, 12.0, 2 if small else 8),
        "falls": np.geomspace(0.0095, 0.95, 2 if small else 8),
    }
    jumps = np.concatenate([sizes["rises"], -sizes["falls"]])
    found = [[measured(float(x), float(y)) for x in closures] for y in jumps]
    count, rejected, error = (
        np.array([[getattr(each, name) for each in row] for row in found]) for name in Found._fields
    )
    guess = np.array([[predicted(float(x), float(y)) for x in closures] for y in jumps])
    figure, axes = sheet(
        "S10  Newton iterations for one tight joint between two bars",
        "its pressure jumps in one step; in brackets: Newton's method on one opening, where that differs",
        [["rises"], ["falls"]], (8.0, 7.2), sharex=True,
    )  # fmt: skip
    norm, rows, fine = LogNorm(1, MOST), len(sizes["rises"]), np.geomspace(3e-4, 30.0, 200)
    bars = BARS * APERTURE / LOAD
    for name, part in (("rises", slice(0, rows)), ("falls", slice(rows, None))):
        shades = _cells(axes[name], closures, sizes[name], count[part], rejected[part], guess[part], norm)
        axes[name].set_ylabel(f"pressure {name} by, over the load")
    axes["rises"].plot(fine, 1.0 + bars / fine, color=INK, lw=1.6)
    axes["falls"].plot(fine, fine + bars, color=INK, lw=1.6)
    axes["falls"].plot(fine, STEP_FRACTION * (fine + bars), color=INK, lw=1.2, ls="--")
    axes["falls"].set_xlabel("$k_{n0} d_0$ / load")
    axes["falls"].invert_yaxis()
    figure.colorbar(
        shades, ax=list(axes.values()), label="Newton iterations", ticks=[1, 2, 3, 5, 8, 12], format="%g", pad=0.01
    )
    save(
        figure, folder, "s10",
        "solid, predicted: above, the walls lift off, $\\Delta p > \\mathrm{load}\\,(1 + k_r/k_{n0})$; below, Newton's first"
        " iterate passes $-d_0$, $|\\Delta p| > d_0(k_{n0} + k_r)$; dashed: it closes 0.9 of $d_0$",
    )  # fmt: skip
    across = np.array([[x, y] for y in jumps for x in closures])
    columns = {"iterations": count, "predicted": guess, "rejected": rejected, "error of aperture": error}
    table = {"closure": across[:, 0], "jump": across[:, 1]} | {name: value.ravel() for name, value in columns.items()}
    write_csv(folder, "s10", table, [COMMAND])
    lifts = jumps[:, None] > 1.0 + bars / closures
    off, most, worst = float(np.abs(count - guess).max()), float(count.max()), float(error.max())
    linear = count[(jumps[:, None] > 0.0) & ~lifts]
    return [
        Check("S10 steps that fail", int(np.isnan(count).sum()), "0", not np.isnan(count).any()),
        Check("S10 rejected trials", int(rejected.sum()), "0", not rejected.any()),
        Check("S10 iterations off the prediction", off, "<= 1", off <= 1.0),
        Check("S10 iterations, at most", most, f"<= {MOST}", most <= MOST),
        Check("S10 iterations of a rise below lift-off", float(linear.max()), "1", bool(np.all(linear == 1.0))),
        Check(
            "S10 iterations of a rise past lift-off", float(count[lifts].max()), "2", bool(np.all(count[lifts] == 2.0))
        ),
        Check("S10 error of the aperture", worst, f"<= {NEAR:g}", worst <= NEAR),
    ]


def _cells(
    axis: Axes, x: Floats, y: Floats, count: Floats, rejected: Floats, guess: Floats, norm: LogNorm
) -> ScalarMappable:
    """Shaded cells with their numbers, on logarithmic axes: a cross where halved, ``failed`` where no state was found."""
    left, low = (_edges(values) for values in (x, y))
    shades = axis.pcolormesh(left, low, count, norm=norm, cmap="YlOrRd")
    for (row, column), value in np.ndenumerate(count):
        mark = "failed" if np.isnan(value) else f"{value:g}" + "\u00d7" * bool(rejected[row, column])
        mark += f" ({guess[row, column]})" if value != guess[row, column] else ""
        axis.text(x[column], y[row], mark, ha="center", va="center", fontsize=9, color=INK, path_effects=HALO)
    axis.set(xscale="log", yscale="log", xlim=(left[0], left[-1]), ylim=(low[0], low[-1]))
    axis.grid(False)
    return shades


def _edges(values: Floats) -> Floats:
    """Edges (n + 1,) of cells around values (n,) that rise by one factor."""
    root = np.sqrt(values[1] / values[0])
    return np.append(values / root, values[-1] * root)
