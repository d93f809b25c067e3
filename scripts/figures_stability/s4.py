"""S4: from where, and to which load, Newton finds the equilibrium of one joint, and what it does where there is none.

The block of F6a on its joint, k_n0 = |f_n0| = 1: f_n(e) - f_n0 + k_r e = P, from an opening e_0 that need not balance.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, LinearSegmentedColormap, ListedColormap
from matplotlib.patches import Patch
from sheets import BLUE, GREEN, HALO, INK, ORANGE, PINK, ROOT, Check, Floats, save, sheet, write_csv

from fracflow._petsc import MPI
from fracflow.advance.initial_state import equilibrium_state, refuse_imbalance
from fracflow.advance.step import Stepping
from fracflow.errors import SolveError
from fracflow.integrators import Steady
from fracflow.laws.base import HELD
from fracflow.laws.hyperbolic_coulomb import HyperbolicCoulomb
from fracflow.model.joints import LawGroup
from fracflow.model.setup import Model
from fracflow.reduction.prepare import prepare
from fracflow.scene.scene import Scene
from fracflow.scene.toml import read_toml
from fracflow.solve.request import StepRequest

FOLDER = ROOT / "meshes" / "failures" / "closing_joint"
D0 = 0.1
SPRINGS = (0.0, 0.1)  # k_r
WAYS = ("plain", "barrier", "default", "residual")
RIGHT, NAMED, CRUSHED, WRONG, LOST = range(5)
CLASSES = (
    ("the root (darker: more iterations, 0 to 18)", BLUE),
    ("no equilibrium, and says so", GREEN),
    ("past -d0", ORANGE),
    ("another state accepted", INK),
    ("not classified", PINK),
)
MOST = 18  # iterations
SHADES = LinearSegmentedColormap.from_list("shades", ["#d6e8f4", BLUE])
NEAR = 1e-8  # of the gap that is left: same root


class Unguarded(HyperbolicCoulomb):
    """The law without the fraction to the boundary, as plain Newton has it."""

    def step_limit(self, strain: Floats, increment: Floats) -> Floats:
        """No limit."""
        return np.full(len(strain), np.inf)


class Outcome(NamedTuple):
    """Class of a solve, its iterations, and the opening that was accepted (NaN where none was)."""

    kind: int
    iterations: int
    opening: float


def root(force: float, spring: float) -> float:
    """The opening that balances, in closed form; NaN where there is none."""
    if force < 0.0:
        b = 1.0 + spring - force / D0
        return 2.0 * force / (b + np.sqrt(b**2 + 4.0 * spring / D0 * force)) if spring else force / b
    if force <= 1.0 + spring:
        return force / (1.0 + spring)
    return (force - 1.0) / spring if spring else np.nan


def first_landing(force: Floats, start: Floats, spring: float) -> Floats:
    """Where one whole step of Newton leads to (n, m), for loads (n,) from openings (m,), in closed form."""
    squeeze = 1.0 + np.minimum(start, 0.0) / D0
    change = np.where(start > 1.0, 1.0, start / squeeze)
    slope = np.where(start > 1.0, 0.0, 1.0 / squeeze**2) + spring
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(start - (change + spring * start - force[:, None]) / slope)


def make(spring: float, way: str) -> Model:
    """The scene of F6a with the load as a control, on springs or on none."""
    data: dict[str, Any] = read_toml(FOLDER / "scene.toml")
    data["load"][1] |= {"force": [0, 1], "control": "push"}
    data["control"] = {"push": {}}
    data["method"] = {"line_search": {"default": "energy", "residual": "residual"}.get(way, "none")}
    if spring:
        data["rock"]["spring"]["youngs_modulus"] = spring
    else:
        data["mesh"]["file"] = "loose.geo"
        del data["rock"]["spring"]
        data["support"] = [part for part in data["support"] if part["on"] != "ends"]
    model = prepare(Scene.from_data(data, FOLDER / "scene.toml"), MPI.COMM_SELF)
    refuse_imbalance(model)
    if way != "plain":
        return model
    joints = model.operators.joints
    laws = tuple(LawGroup(group.sections, Unguarded(**vars(group.law))) for group in joints.laws)
    return replace(model, operators=replace(model.operators, joints=replace(joints, laws=laws)))


@contextmanager
def solver(model: Model, spring: float) -> Iterator[Callable[[float, float], Outcome]]:
    """Function (load, start opening) -> outcome of one steady step."""
    stepping, state, joints = Stepping(model), equilibrium_state(model), model.operators.joints
    block = model.operators.blocks.solid
    unknown = block.body_unknown[block.rocks.index("block") == block.body_rock, 1]

    def once(force: float, start: float) -> Outcome:
        displacement = state.motion.displacement.copy()
        displacement.getArray()[unknown] = start
        begun = replace(
            state,
            motion=replace(state.motion, displacement=displacement),
            sections=joints.evaluate(joints.strain(displacement), joints.initial_history(), HELD),
        )
        right = root(force, spring)
        try:
            new, report = stepping.step(begun, StepRequest(1.0, 1.0, {"push": force}, stepping.model.loads), Steady())
        except SolveError as error:
            displacement.destroy()
            if "closed beyond its aperture" in str(error):
                return Outcome(CRUSHED, 0, np.nan)
            named = re.search(r"block \d+ .* has no support in y.*net force \S+ in \+y", str(error))
            return Outcome(NAMED if named and np.isnan(right) else LOST, 0, np.nan)
        opening = float(new.sections.strain[0, -1])
        new.destroy()
        displacement.destroy()
        if opening <= -D0:
            return Outcome(CRUSHED, report.newton, opening)
        close = abs(opening - right) <= NEAR * (right + D0)
        return Outcome(RIGHT if close else WRONG, report.newton, opening)

    yield once
    stepping.destroy()
    state.destroy()


def measure(forces: Floats, starts: Floats, ways: Sequence[str]) -> dict[tuple[str, float], Any]:
    """(way, k_r) -> array (loads, starts) of outcomes, fields kind, iterations, opening."""
    kinds = np.dtype([("kind", int), ("iterations", int), ("opening", float)])
    found = {}
    for way in ways:
        for spring in SPRINGS:
            with solver(make(spring, way), spring) as once:
                found[way, spring] = np.array([[tuple(once(p, e)) for e in starts] for p in forces], dtype=kinds)
    return found


def draw(folder: Path, small: bool = False) -> list[Check]:
    """Measure and draw the map; the bars."""
    decades = np.logspace(-2, 3, 4 if small else 16)
    forces = np.concatenate([-decades[::-1], decades * 1.07])  # off P = 1, where every opening beyond 1 balances
    relative = np.array([-0.999, -0.5, 0.0, 5.0, 15.0, 50.0])
    if not small:
        relative = np.array(
            [-0.999, -0.99, -0.9, -0.7, -0.5, -0.2, 0.0, 1.0, 3.0, 5.0, 9.0, 9.99, 10.1, 15.0, 25.0, 50.0]
        )
    found = measure(forces, relative * D0, WAYS)

    def share(way: str, *kinds: int) -> float:
        return 100.0 * float(np.mean([np.isin(found[way, spring]["kind"], kinds) for spring in SPRINGS]))

    def most(way: str) -> int:
        return int(max(part["iterations"].max() for (name, _), part in found.items() if name == way))

    labels = {
        "plain": "plain Newton", "barrier": "fraction to the boundary", "default": "the default: with energy search",
        "residual": "with residual search",
    }  # fmt: skip
    mosaic = [[f"{way} {spring:g}" for way in WAYS] for spring in SPRINGS]
    title = f"S4  Newton on one joint: outcome by load and start, d0 = {D0:g} |f_n0|/k_n0"
    subtitle = (
        "below: on springs of 0.1 k_n0; above: on nothing, where P > |f_n0| has no equilibrium. Start not in balance."
    )
    figure, axes = sheet(title, subtitle, mosaic, (12.0, 7.0), sharex=True, sharey=True)
    for way in WAYS:
        for spring in SPRINGS:
            _panel(axes[f"{way} {spring:g}"], forces, relative, found[way, spring], way, spring)
        axes[f"{way} 0"].set_title(f"{labels[way]}\n{share(way, CRUSHED):.3g} % past -d0, up to {most(way)} iterations")
        axes[f"{way} {SPRINGS[1]:g}"].set_xlabel("load $P/|f_{n0}|$")
    for spring in SPRINGS:
        axes[f"plain {spring:g}"].set_ylabel(f"$k_r = {spring:g}\\,k_{{n0}}$:  start $\\epsilon_0/d_0$")
    figure.legend(
        handles=[Patch(color=colour, label=name) for name, colour in CLASSES],
        loc="outside upper right",
        ncols=3,
        fontsize=8,
    )
    note = "line: one whole step of plain Newton, in closed form, ends past -d0 on the hatched side; dashes: P = |f_n0|"
    save(figure, folder, "s4_newton", note)
    _write(folder, forces, relative, found)
    classified = {way: share(way, WRONG, LOST) for way in WAYS}
    crushed = {way: share(way, CRUSHED) for way in WAYS}
    accepted = [part["opening"] for (way, _), part in found.items() if way != "plain"]
    closest = float(min(np.nanmin(part) for part in accepted)) / D0
    return [
        Check("S4 default: not classified [%]", classified["default"], "0", classified["default"] == 0.0),
        Check("S4 default: past -d0 [%]", crushed["default"], "0", crushed["default"] == 0.0),
        Check("S4 barrier alone: not classified [%]", classified["barrier"], "0", classified["barrier"] == 0.0),
        Check("S4 residual search: not classified [%]", classified["residual"], "0", classified["residual"] == 0.0),
        Check("S4 smallest opening accepted, in d0", closest, "> -1", closest > -1.0),
        Check("S4 default: most iterations", most("default"), "<= 18", most("default") <= MOST),
        Check("S4 plain: past -d0 [%]", crushed["plain"], ">= 18, as measured before", crushed["plain"] >= 18.0),
    ]


def _panel(axes: Axes, forces: Floats, relative: Floats, found: Any, way: str, spring: float) -> None:
    """One map: classes as colours, the root paler the fewer iterations, with the predicted boundaries."""
    colours, kind = ListedColormap([colour for _, colour in CLASSES]), found["kind"]
    columns, rows = np.arange(len(forces)), np.arange(len(relative))
    axes.pcolormesh(columns, rows, kind.T, cmap=colours, norm=BoundaryNorm(np.arange(-0.5, 5.5), 5), alpha=0.8)
    count = np.ma.masked_where(kind.T != RIGHT, found["iterations"].T)
    axes.pcolormesh(columns, rows, count, cmap=SHADES, vmin=0, vmax=MOST)
    if way == "plain":
        landing = first_landing(forces, relative * D0, spring) + D0
        past = np.where(np.isfinite(landing), landing, np.where(forces[:, None] > 1.0, 1.0, -1.0)) <= 0.0
        axes.contour(columns, rows, past.T.astype(float), [0.5], colors=INK, linewidths=1.5)
        axes.contourf(columns, rows, past.T.astype(float), [0.5, 1.5], colors="none", hatches=["////"])
    if not spring:
        limit = np.interp(1.0, forces, columns)
        axes.axvline(limit, color=INK, ls="--", lw=1.2, path_effects=HALO)
    wanted = [-1e3, -10.0, -0.1, 0.1, 10.0, 1e3]
    axes.set_xticks(np.interp(wanted, forces, columns), [f"{v:g}" for v in wanted], fontsize=7.5)
    shown = rows if len(rows) < 8 else rows[::3]
    axes.set_yticks(shown, [f"{relative[r]:g}" for r in shown], fontsize=7.5)
    axes.grid(False)


def _write(folder: Path, forces: Floats, relative: Floats, found: dict[tuple[str, float], Any]) -> None:
    columns: dict[str, Any] = {"P": np.repeat(forces, len(relative)), "e_0/d_0": np.tile(relative, len(forces))}
    for (way, spring), part in found.items():
        for field in part.dtype.names:
            columns[f"{way} k_r={spring:g} {field}"] = part[field].ravel().astype(float)
    kinds = ", ".join(f"{number} {name}" for number, (name, _) in enumerate(CLASSES))
    write_csv(folder, "s4_newton", columns, ["scripts/figures stability --only S4"], f"kind: {kinds}")
