"""S3: how far the pressure of a loaded film overshoots, by time step, pair of matrices and rule in time.

The fracture of meshes/failures/loaded_fracture_on_springs drains at one end and is loaded at once: 0 <= p <= load.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from sheets import HALO, INK, ROOT, Check, Floats, save, sheet, write_csv

from fracflow._petsc import MPI
from fracflow.advance.initial_state import equilibrium_state, refuse_imbalance
from fracflow.advance.step import Stepping
from fracflow.integrators import STEPPERS
from fracflow.model.setup import Model
from fracflow.reduction.prepare import prepare
from fracflow.scene.scene import load
from fracflow.solve.request import StepRequest

SCENE = ROOT / "meshes" / "failures" / "loaded_fracture_on_springs" / "scene.toml"
PAIRS = {
    "lumped": "lumped, lumped\n(default)",
    "consistent-lumped": "$e$, lumped",
    "consistent": "$e$, $e$",
    "averaging": "$e_F$, $e_F$",
    "report": "$e$, $e_F$\n(report)",
}
RULES = {"backward-euler": "backward Euler (default)", "bdf2": "BDF2", "trapezoid": "trapezoid"}
STEPS = 10
NONE = 1e-10
COMMAND = "scripts/figures stability --only S3"


def overshoots(model: Model, rule: str, dt: float) -> tuple[float, float]:
    """How far the pressure leaves [0, load] in the first step; and 0 <= p(t + dt) <= p(t) in the first ten."""
    stepping, state = Stepping(model), equilibrium_state(model)
    found, before = [], state.pressure.getArray().copy()
    for n in range(1, STEPS + 1):
        new, _ = stepping.step(state, StepRequest(n * dt, dt, {}, stepping.model.loads), STEPPERS[rule]())
        state.destroy()
        state = new
        pressure = state.pressure.getArray().copy()
        found.append(max((pressure - before).max(), -pressure.min(), 0.0))
        before = pressure
    state.destroy()
    stepping.destroy()
    return found[0], max(found)


def measure(steps: Floats) -> dict[tuple[str, str], Floats]:
    """Overshoots (n, 2) over the time steps, by pair and rule."""
    found = {}
    for pair in PAIRS:
        model = prepare(load(SCENE, [f"method.storage={pair}"]), MPI.COMM_SELF)
        refuse_imbalance(model)
        for rule in RULES:
            found[pair, rule] = np.array([overshoots(model, rule, float(dt)) for dt in steps])
    return found


def draw(folder: Path, small: bool = False) -> list[Check]:
    """The map, its CSV and its bars; ``small`` at a seventh of the time steps."""
    steps = np.logspace(-6, 1, 8 if small else 57)
    found = measure(steps)
    figure, axes = sheet(
        "S3  Pressure overshoot of a film that is loaded at once and drains at one end",
        f"measured in the first {STEPS} steps: how far $0 \\leq p(t+\\Delta t) \\leq p(t) \\leq$ load is violated;"
        f" white: by no more than {NONE:g} of the load",
        [list(RULES)], (11.5, 4.2), sharey=True, width_ratios=[1, 1, 1],
    )  # fmt: skip
    edges = np.sqrt(np.concatenate([[steps[0] ** 2 / steps[1]], steps]) * np.append(steps, steps[-1] ** 2 / steps[-2]))
    for rule, title in RULES.items():
        values = np.array([found[pair, rule][:, 1] for pair in PAIRS])
        shades = axes[rule].pcolormesh(
            edges, np.arange(len(PAIRS) + 1) - 0.5, np.ma.masked_less_equal(values, NONE),
            norm=LogNorm(1e-4, 1.0), cmap="YlOrRd",
        )  # fmt: skip
        _percent(axes[rule], rule, found, steps)
        axes[rule].set(xscale="log", xlabel=r"$c_f\,\Delta t/h^2$", xlim=(edges[0], edges[-1]))
        axes[rule].set_title(title, pad=14)
        axes[rule].set_yticks(range(len(PAIRS)), list(PAIRS.values()))
        axes[rule].grid(False)
    _boundaries(axes)
    figure.colorbar(shades, ax=list(axes.values()), label="violation / load", extend="min", pad=0.01)
    save(
        figure, folder, "s3_pressure",
        "lines: predicted.  1/6: $h^2/(6c_f)$, $e$, lumped becomes an M-matrix;  1/2: $h^2/(2c_f)$, from where the others stay"
        " below 2 %, and twice the shortest drainage time;\n1: up to there the trapezoid keeps lumped matrices monotone."
        "  $c_f = d^3k_n/12\\mu$; every rule begins with a step of backward Euler, from which its own ringing starts.",
    )  # fmt: skip
    columns = {"c_f dt/h^2": steps}
    for (pair, rule), values in found.items():
        columns |= {f"{pair} {rule} first": values[:, 0], f"{pair} {rule} of {STEPS}": values[:, 1]}
    write_csv(
        folder,
        "s3_pressure",
        columns,
        [COMMAND],
        f"first: overshoot over load; of {STEPS}: violation of 0 <= p(t + dt) <= p(t) <= load in so many steps",
    )
    return _bars(steps, found)


def _percent(axis: Axes, rule: str, found: dict[tuple[str, str], Floats], steps: Floats) -> None:
    """Write some of the measured values into the map."""
    for row, pair in enumerate(PAIRS):
        for dt in (1e-5, 1e-3, 1e-2, 10.0):  # time steps of the small map too
            value = found[pair, rule][np.argmin(np.abs(np.log(steps / dt))), 1]
            text = "0" if value <= NONE else f"{100 * value:.0f} %" if value > 0.1 else f"{100 * value:.2g} %"
            align = "right" if dt == 10.0 else "center"
            axis.text(dt, row, text, ha=align, va="center", fontsize=7.5, color=INK, path_effects=HALO)


def _boundaries(axes: dict[str, Axes]) -> None:
    sixth, half, whole = (1 / 6, "1/6", "--"), (1 / 2, "1/2", "-"), (1.0, "1", "-")
    lines = {"backward-euler": (sixth, half), "bdf2": (sixth, half), "trapezoid": ((1 / 2, "1/2", "--"), whole)}
    for rule, values in lines.items():
        for at, label, style in values:
            axes[rule].axvline(at, color=INK, lw=1.3, ls=style)
            align = "right" if style == "--" else "left"
            axes[rule].text(at, len(PAIRS) - 0.52, label, fontsize=7.5, ha=align, va="bottom", color=INK)


def _bars(steps: Floats, found: dict[tuple[str, str], Floats]) -> list[Check]:
    default = found["lumped", "backward-euler"].max()
    checks = [
        Check("S3 default pair, backward Euler, any step: overshoot", float(default), f"<= {NONE:g}", default <= NONE)
    ]
    half = found["consistent-lumped", "backward-euler"][:, 1]
    wrong = int(np.sum((half <= NONE) != (steps >= 1 / 6)))
    checks.append(Check("S3 e, lumped: boundary 1/6, steps on the wrong side", wrong, "0", wrong == 0))
    for pair in ("consistent", "report", "averaging"):
        beyond = float(found[pair, "backward-euler"][steps >= 0.5, 1].max())
        checks.append(Check(f"S3 {pair}, backward Euler, from 1/2 on", beyond, "<= 0.02", beyond <= 0.02))
    rings = found["lumped", "trapezoid"][:, 1]
    below = float(rings[steps <= 1.0].max())
    checks.append(Check("S3 default pair, trapezoid, up to 1", below, f"<= {NONE:g}", below <= NONE))
    return checks
