"""S8: digits of a traction known from a balance, after a motion that both walls of the joint share."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from sheets import BLUE, HALO, INK, ORANGE, PALE, ROOT, Check, Floats, save, sheet, write_csv

from fracflow._petsc import MPI
from fracflow.advance.initial_state import equilibrium_state, refuse_imbalance
from fracflow.advance.stage import run_stage
from fracflow.advance.step import Stepping
from fracflow.errors import SolveError
from fracflow.reduction.prepare import prepare
from fracflow.scene.scene import load

SCENE = ROOT / "meshes" / "failures" / "rigid_motion" / "scene.toml"
EPS = float(np.finfo(float).eps)
TRACTION = 1e6  # Pa, what the roof carries
SOFT = "rock.rock.youngs_modulus=2.5e8"  # E/h = 1e9 Pa/m, so that from k_n = 1e9 on it is the joint that loses digits
WORST = 10.0  # of eps k_n U
DIGITS = 6
NEAR = 0.1
MANY = 50


@dataclass(frozen=True)
class Case:
    """One push: largest error of a traction [Pa], the digits the program tells, and eps k_n max|u| [Pa]."""

    stiffness: float
    motion: float
    steps: int
    error: float
    digits: float
    predicted: float

    @property
    def share(self) -> float:
        """Error over the prediction; what a double cannot tell of the traction itself is none."""
        return max(self.error - EPS * TRACTION, 0.0) / self.predicted


def push(stiffness: float, motion: float, steps: int = 1, digits: int = 1) -> Case:
    """Push the two blocks by ``motion`` in equal steps. Raises SolveError where fewer than ``digits`` are left."""
    settings = [f"fracture.seam.{part}_stiffness={stiffness}" for part in ("normal", "shear")]
    table = f"support.0.displacement={{y = [[0, 0], [1, {motion}]]}}"
    scene = load(SCENE, [*settings, table, SOFT, f"stage.push.time_step={1.0 / steps}", f"accuracy.digits={digits}"])
    model = prepare(scene, MPI.COMM_SELF)
    refuse_imbalance(model)
    state, stepping = equilibrium_state(model), Stepping(model)
    fewest = np.inf
    try:
        for step in run_stage(stepping, state, 0, lambda line: None, {}):
            state.destroy()
            state, fewest = step.state, min(fewest, step.report.digits)
        error = float(np.abs(state.sections.traction - [0.0, -TRACTION]).max())
        largest = float(state.motion.displacement.norm(3))
    finally:
        stepping.destroy()
        state.destroy()
    return Case(stiffness, motion, steps, error, fewest, EPS * stiffness * largest)


def is_refused(stiffness: float, motion: float) -> bool:
    """Whether the default, six digits, stops the push, naming the joint."""
    try:
        push(stiffness, motion, digits=DIGITS)
    except SolveError as error:
        if "seam" not in str(error) or "digits" not in str(error):
            raise
        return True
    return False


def draw(folder: Path, small: bool = False) -> list[Check]:
    """Measure, draw ``s8`` into ``folder`` and return the bars."""
    stiffness = np.logspace(9, 15, 4 if small else 13)
    motion = np.logspace(-3, 3, 4 if small else 13)
    cases = [push(k, u) for k in stiffness for u in motion]
    refused = np.array([is_refused(case.stiffness, case.motion) for case in cases])
    some = [(1e13, 1e3)] if small else [(k, u) for k in stiffness[::3] for u in motion[::3] if u >= 0.1]
    stepped = [push(k, u, MANY) for k, u in some]
    figure, axes = sheet(
        "S8  Digits of a traction after a motion that both walls share",
        f"Two blocks pushed by U, {TRACTION:.0e} Pa on the roof: so the joint's traction is known.",
        [["map", "error"]], (9.6, 4.6), width_ratios=[1.0, 1.1],
    )  # fmt: skip
    _map(axes["map"], stiffness, motion, cases, refused)
    _errors(axes["error"], cases, stepped)
    save(
        figure,
        folder,
        "s8",
        f"One step unless {MANY} are named. Crosses: refused by accuracy.digits = {DIGITS}, the default.",
    )
    both = [*cases, *stepped]
    columns = {
        name: np.array([getattr(case, name) for case in both])
        for name in ("stiffness", "motion", "steps", "error", "predicted", "digits")
    }
    write_csv(folder, "s8", columns | {"refused": refused.astype(float)}, ["scripts/figures stability --only S8"])
    return _checks(cases, stepped, refused)


def _checks(cases: list[Case], stepped: list[Case], refused: np.ndarray) -> list[Check]:
    worst = max(case.share for case in [*cases, *stepped])
    wanted = np.array([case.predicted / (10.0**-DIGITS * TRACTION) for case in cases])
    judged = np.abs(wanted - 1.0) > NEAR
    agrees = float((refused == (wanted > 1.0))[judged].mean())
    promised = max(case.error / (10.0**-case.digits * TRACTION) for case in [*cases, *stepped] if case.digits < 15)
    return [
        Check("S8 error over eps k_n max|u|", worst, f"<= {WORST:g}", worst <= WORST),
        Check("S8 refused where eps k_n max|u| > 1e-6 of the traction", agrees, ">= 0.98", agrees >= 0.98),
        Check("S8 error over that of the digits told", promised, f"<= {WORST:g}", promised <= WORST),
    ]


def _edges(values: Floats) -> Floats:
    step = np.sqrt(values[1] / values[0])
    return np.concatenate([values / step, values[-1:] * step])


def _map(axis: Axes, stiffness: Floats, motion: Floats, cases: list[Case], refused: np.ndarray) -> None:
    shape = (len(stiffness), len(motion))
    kept = -np.log10(np.maximum([case.error / TRACTION for case in cases], EPS)).reshape(shape)
    mesh = axis.pcolormesh(_edges(stiffness), _edges(motion), kept.T, cmap="viridis", vmin=2, vmax=16)
    k, u = np.meshgrid(stiffness, motion, indexing="ij")
    axis.plot(k.ravel()[refused], u.ravel()[refused], "x", color="white", ms=4.0)
    line = np.logspace(8.7, 15.3, 2)
    axis.plot(line, 10.0**-DIGITS * TRACTION / (EPS * line), color="white", ls="--", lw=2.0)
    axis.set(
        xscale="log", yscale="log", xlabel="$k_n$ [Pa/m]", ylabel="$U$ [m]", title="Digits of the traction, measured"
    )
    axis.set(xlim=_edges(stiffness)[[0, -1]], ylim=_edges(motion)[[0, -1]])
    axis.text(
        0.03,
        0.04,
        f"dashed: predicted, $\\epsilon k_n U$ = 1e-{DIGITS} of it",
        transform=axis.transAxes,
        color=INK,
        path_effects=HALO,
        fontsize=8,
    )
    axis.grid(False)
    axis.figure.colorbar(mesh, ax=axis, label="digits", pad=0.02)


def _errors(axis: Axes, cases: list[Case], stepped: list[Case]) -> None:
    line = np.logspace(5.5, 18.5, 2)
    axis.plot(line, EPS * line, color=INK, lw=1.2, label="$\\epsilon\\, k_n U$, predicted")
    axis.plot(line, WORST * EPS * line, color=PALE, ls="--", lw=1.2, label=f"{WORST:g} times it, the bar")
    for chosen, colour, mark, label in ((cases, BLUE, "o", "in one step"), (stepped, ORANGE, "s", f"in {MANY} steps")):
        product = [case.predicted / EPS for case in chosen]
        axis.plot(
            product, [max(case.error, 1e-11) for case in chosen], mark, ms=3.5, color=colour, label=label, alpha=0.8
        )
    axis.axhline(10.0**-DIGITS * TRACTION, color=PALE, lw=0.8)
    axis.text(3e6, 1.5, f"1e-{DIGITS} of the traction: refused above", fontsize=7.5, color="#555555")
    axis.set(
        xscale="log",
        yscale="log",
        xlabel="$k_n U$ [Pa]",
        ylabel="error of the traction [Pa]",
        title="Error against $k_n U$",
    )
    axis.legend(loc="lower right", fontsize=8)
