"""Figs. 9 and 10: application 5.1, a block on springs that slides between two joints, by three methods."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from sheets import BLUE, GREEN, HALO, INK, ORANGE, PALE, ROOT, STYLE, Check, Floats, save, sheet, write_csv

from figures_report.common import RECONSTRUCTED, Runner, command, probe, runner
from fracflow._petsc import MPI
from fracflow.advance.initial_state import equilibrium_state
from fracflow.advance.step import Stepping
from fracflow.errors import SolveError
from fracflow.integrators import Steady
from fracflow.reduction.prepare import prepare
from fracflow.scene.scene import load
from fracflow.solve.request import StepRequest

SCENE = "report_5_1"
SPRINGS = 0.1  # (R) two of E = 0.05
LOADS = np.array([1, 2, 2.5, 2, 1, -0.5, -1.5])  # (R), the scene's
BY_HAND = np.array([10 / 11, 20 / 11, 15, 160 / 11, 150 / 11, 135 / 11, -5])
# the block led from 0 to 15 and on to -5, so that the drop of strength is seen
LED = (
    'support.1={on="block",components=["x","y","rotation"],displacement={x=[[0,0],[15,15],[35,-5]]}}',
    "load.0.force=[0,0]", "stage.states.time_step=0.1", "stage.states.end=35",
)  # fmt: skip
MANY = "accuracy.max_iterations=300"
BILINEAR = ("fracture.default.stick_slip_ratio=1", "load.0.force=[2.5,0]", "stage.states.end=1", MANY)
TOLERANCE = 1e-6
STRENGTH, ELASTIC, LOAD, ANSWER = 2.0, 1.1, 2.5, 5.0  # of the bilinear problem: P = 2.5 past 2.2 at u = 2
METHODS = {
    "secant": ("(a) secant", ORANGE, "o"),
    "modified": ("(b) constant stiffness (4.10)", BLUE, "s"),
    "newton": ("(c) Newton (4.7)", GREEN, "D"),
}
NOTE_9 = f"{RECONSTRUCTED} Springs, C = 1, phi = 0, alpha = 1/2 and P(t) (R)."
NOTE_10 = f"{RECONSTRUCTED} Springs, C = 1, phi = 0 and P = 2.5 (R); alpha = 1, as the text says."


def draw(folder: Path, run: Runner | None = None) -> list[Check]:
    """Draw both figures into ``folder`` and return their checks."""
    run = run or runner(folder / "runs")
    with matplotlib.rc_context(STYLE):
        return [*path(folder, run), *residuals(folder), *unloading(folder)]


def path(folder: Path, run: Runner) -> list[Check]:
    """Fig. 9: the seven states on the path that a led block takes."""
    states, led = run(SCENE), run(SCENE, *LED)
    u = probe(states, "block", "displacement")[1:, 0]
    counts = states.history["step/newton"][1:]
    along = probe(led, "block", "displacement")[:, 0]
    force = SPRINGS * along + probe(led, "lower", "shear_traction") - probe(led, "upper", "shear_traction")
    figure, axes = sheet(
        "Fig. 9  Equilibrium states of a block on springs between two joints",
        "Two events: the joints give way on the way to 3 and, the other way, on the way to 7. Between them all is elastic.",
        [["f"]], (8.4, 4.8),
    )  # fmt: skip
    main = axes["f"]
    main.axhline(0, color=PALE, lw=0.8)
    main.axvline(0, color=PALE, lw=0.8)
    main.plot(along, force, color=INK, lw=1.2, label="internal force of a block led along, step 0.1")
    main.plot(u, LOADS, "o", color=ORANGE, ms=6, zorder=4, label="states under P(t)")
    for number, (x, y, count) in enumerate(zip(u, LOADS, counts, strict=True), start=1):
        place = (-10, 4) if number < 3 else (9, -3) if number < 7 else (0, 7)
        main.annotate(
            f"{number}", (x, y), place, textcoords="offset points", color=ORANGE, fontweight="bold",
            ha="center", path_effects=HALO,
        )  # fmt: skip
        if number > 3:
            text = f"{count} iteration{'s' if count > 1 else ''} to {number}"
            main.annotate(
                text,
                (x, y),
                (22 if number < 7 else 10, -3 if number < 7 else -9),
                textcoords="offset points",
                fontsize=7.5,
                color="#555555",
            )
    main.set(xlabel="displacement of the block", ylabel="force", xlim=(-7, 20), ylim=(-2, 3.1))
    main.legend(loc="upper left")
    save(figure, folder, "fig_9", NOTE_9)
    columns = {"displacement led": along, "force led": force, "displacement": u, "P": LOADS, "iterations": counts}
    write_csv(folder, "fig_9", columns, [command(SCENE), command(SCENE, *LED)], NOTE_9)
    error = float(np.abs(u - BY_HAND).max())
    off = float(np.abs(on_path(u, along, force) - LOADS).max())
    return [
        Check("9 states 1 to 7 against the hand solution", error, "< 1e-12", error < 1e-12),
        Check("9 states on the path of the led block", off, "< 1e-12", off < 1e-12),
        Check("9 iterations from state 4 to 5", float(counts[4]), "1, as printed", counts[4] == 1),
        Check("9 iterations from state 6 to 7", float(counts[6]), "2, as printed", counts[6] == 2),
    ]


def on_path(u: Floats, along: Floats, force: Floats) -> Floats:
    """Force of the led block at the states: the first three lie on its way out, the others on its way back."""
    turn = int(np.argmax(along))
    out = np.interp(u[:3], along[: turn + 1], force[: turn + 1])
    return np.concatenate([out, np.interp(u[3:], along[:turn:-1], force[:turn:-1])])


def one_step(method: str) -> Floats:
    """(4.9a) at the start of the step and after each iteration, until it is below the tolerance."""
    overrides = [*BILINEAR, f"method.newton={method}", f"accuracy.out_of_balance={TOLERANCE}"]
    model = prepare(load(ROOT / "meshes" / SCENE / "scene.toml", overrides), MPI.COMM_SELF)
    stepping = Stepping(model)
    state, report = stepping.step(equilibrium_state(model), StepRequest(1.0, 1.0, {}, stepping.model.loads), Steady())
    state.destroy()
    stepping.destroy()
    return np.array(report.out_of_balance)


def residuals(folder: Path) -> list[Check]:
    """Fig. 10: one load step past yield."""
    found = {method: one_step(method) for method in METHODS}
    counts = {method: len(norms) - 1 for method, norms in found.items()}
    counted = ", ".join(f"{METHODS[name][0][4:]} {count}" for name, count in counts.items())
    figure, axes = sheet(
        "Fig. 10  One load step past yield by three methods",
        f"To a residual of {TOLERANCE:.0e}: {counted} iterations.",
        [["secant", "modified", "newton"], ["residual"] * 3], (9.6, 6.4), height_ratios=[1, 1.25],
    )  # fmt: skip
    for method, (label, colour, mark) in METHODS.items():
        zigzag(axes[method], method, found[method], label, colour)
        norms = np.maximum(found[method], 1e-17)  # an exact balance has no logarithm
        every = max(1, counts[method] // 20)
        axes["residual"].semilogy(norms, color=colour, marker=mark, ms=4, markevery=every, label=label)
    axes["residual"].axhline(TOLERANCE, color=INK, lw=0.8, ls=(0, (4, 3)))
    axes["residual"].set(xlabel="iteration", ylabel="out-of-balance force (4.9a)", ylim=(1e-8, 10), xlim=(-1, None))
    axes["residual"].annotate(
        "Newton: exact after the second", (2, 1e-8), (9, 3.5e-8), fontsize=7.5, color=GREEN,
        arrowprops=dict(arrowstyle="-", color=GREEN, lw=0.6),
    )  # fmt: skip
    axes["residual"].legend(loc="upper right")
    save(figure, folder, "fig_10", NOTE_10)
    columns = {
        "iteration": np.arange(1 + max(counts.values())),
        **{f"residual {name}": r for name, r in found.items()},
    }
    tolerance = f"accuracy.out_of_balance={TOLERANCE}"
    commands = [command(SCENE, *BILINEAR, f"method.newton={name}", tolerance) for name in METHODS]
    write_csv(folder, "fig_10", columns, commands, NOTE_10)
    checks = [Check("10 iterations, newton", float(counts["newton"]), "2, as printed", counts["newton"] == 2)]
    for name in ("modified", "secant"):
        least = 20 * counts["newton"]
        checks.append(
            Check(f"10 iterations, {name}", float(counts[name]), f">= {least}: 20 x Newton", counts[name] >= least)
        )
    return checks


def zigzag(axes: Axes, method: str, norms: Floats, label: str, colour: str) -> None:
    """Iterates on the bilinear path; F = P - R is the force at each, and gives its displacement."""
    force = LOAD - norms
    u = np.where(force <= STRENGTH * ELASTIC, force / ELASTIC, 0.0)
    slid = np.arange(len(u)) > 0  # the first iteration takes every method past yield
    u[slid] = (force[slid] - STRENGTH) / SPRINGS
    axes.plot([0, 2, 5.6], [0, 2.2, 2.56], color=INK, lw=1.2)
    axes.axhline(LOAD, color=PALE, lw=0.8, ls=(0, (4, 3)))
    for i in range(min(len(u) - 1, 12)):
        start = (0.0, 0.0) if method == "secant" else (u[i], force[i])
        axes.plot([start[0], u[i + 1], u[i + 1]], [start[1], LOAD, force[i + 1]], color=colour, lw=0.9)
    axes.plot(u[1:], force[1:], ".", color=colour, ms=5)
    axes.plot(ANSWER, LOAD, "o", mfc="none", mec=INK, ms=7)
    axes.set(title=f"{label}: {len(norms) - 1}", xlim=(0, 5.8), ylim=(0, 2.9), xlabel="displacement")
    if method == "secant":
        axes.set_ylabel("force")


def unloading(folder: Path) -> list[Check]:
    """The other methods on the seven states: at state 4, the first that unloads, they stop and say so."""
    from fracflow.simulation.run import run

    checks = []
    for method in ("modified", "secant"):
        settings = [f"method.newton={method}", MANY, "output.pictures=false"]
        try:
            run(
                load(ROOT / "meshes" / SCENE / "scene.toml", settings),
                folder / "runs" / f"{SCENE}-{method}",
                MPI.COMM_SELF,
            )
            said = "went through"
        except SolveError as error:
            said = str(error)
        fails = said.startswith(f'time 4: method.newton = "{method}" did not converge')
        checks.append(
            Check(f"10 {method} on unloading", "stops at state 4" if fails else said, "fails, and says so", fails)
        )
    return checks
