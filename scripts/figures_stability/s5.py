"""S5: where the tractions of a joint oscillate, by stiffness against the rock and by quadrature."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from sheets import BLUE, GREEN, HALO, INK, ORANGE, PALE, ROOT, Check, Floats, save, sheet, write_csv

from fracflow._petsc import MPI
from fracflow.advance.initial_state import equilibrium_state, refuse_imbalance
from fracflow.advance.step import Stepping
from fracflow.diagnostics.slip import STIFF
from fracflow.integrators import Steady
from fracflow.model.joints import jump_matrix
from fracflow.reduction.prepare import prepare
from fracflow.scene.scene import load
from fracflow.solve.request import StepRequest

SCENE = ROOT / "meshes" / "failures" / "half_open_joint" / "scene.toml"
RULES = {"nodal": GREEN, "gauss2": BLUE, "one-point": ORANGE}
SIZE = 1.0 / 24.0
MODULUS = 1.0 / (1.0 - 0.25**2)  # E' of the scene
EDGE = 2  # nodes at the free side, where the traction turns of itself
NEAR = 0.1  # of k_n h/E': so near to a predicted boundary nothing is judged
SHOWN = 100.0


def tractions(stiffness: float, rule: str) -> tuple[Floats, Floats]:
    """Places (n,) and normal tractions k_n times opening (n,) at the nodes of the closed half, for k_n h/E'."""
    each = stiffness * MODULUS / SIZE
    settings = [f"fracture.closed.{part}_stiffness={each}" for part in ("normal", "shear")]
    scene = load(SCENE, [f"method.quadrature={rule}", *settings])
    model = prepare(scene, MPI.COMM_SELF)
    refuse_imbalance(model)
    start, stepping, ops = equilibrium_state(model), Stepping(model), model.operators
    state, _ = stepping.step(start, StepRequest(1.0, 1.0, {}, stepping.model.loads), Steady())
    jump = jump_matrix(ops.blocks, np.array([-1.0, 1.0]), ops.expand)
    openings = jump.createVecLeft()
    jump.mult(state.motion.displacement, openings)
    block = ops.blocks.joints
    at_ends = each * openings.getArray().reshape(-1, 2, ops.joints.dim)[:, :, -1]
    closed = block.fracture == block.fractures.index("closed")
    x = ops.blocks.solid.points[block.bottom][closed, :, 0]
    place, first = np.unique(np.round(x.ravel(), 9), return_index=True)
    found = at_ends[closed].ravel()[first]
    stepping.destroy()
    for thing in (start, state, jump, openings):
        thing.destroy()
    return place, found


def turns(traction: Floats) -> int:
    """How often the traction turns from falling to rising or back along the closed half, away from the free side."""
    change = np.sign(np.diff(traction[:-EDGE]))
    return int((np.diff(change) != 0).sum())


def draw(folder: Path, small: bool = False) -> list[Check]:
    """Measure, draw ``s5`` into ``folder`` and return the bars."""
    ratios = np.logspace(-2, 5, 8 if small else 43)
    counts = {rule: np.array([turns(tractions(ratio, rule)[1]) for ratio in ratios], dtype=float) for rule in RULES}
    profiles = {rule: tractions(SHOWN, rule) for rule in RULES}
    figure, axes = sheet(
        "S5  Tractions ahead of an open half of a joint: which quadrature oscillates",
        "Block 1 x (0.5 + 0.5), 24 x 24 cells, left half of the joint open, roof pulled; dashed: from where the card warns.",
        [["map", "map"], ["profile", "profile"]], (8.6, 5.6), height_ratios=[1.0, 1.15],
    )  # fmt: skip
    _map(axes["map"], ratios, counts)
    _profiles(axes["profile"], profiles)
    save(
        figure,
        folder,
        "s5",
        "Measured with fracflow's own steps; colour and numbers: direction changes of k_n times opening.",
    )
    columns = {"kn_h_over_E_prime": ratios, **{f"turns_{rule}": counts[rule] for rule in RULES}}
    shapes = {f"traction_{rule}_at_{SHOWN:g}": value for rule, (_, value) in profiles.items()}
    place = profiles["nodal"][0]
    write_csv(folder, "s5", columns | {"x": place} | shapes, ["scripts/figures stability --only S5"])
    return _checks(ratios, counts, profiles)


def _checks(ratios: Floats, counts: dict[str, Floats], profiles: dict[str, tuple[Floats, Floats]]) -> list[Check]:
    nodal = int(counts["nodal"].max())
    checks = [Check("S5 nodal, turns to k_n h/E' = 1e5", nodal, "0", nodal == 0)]
    for rule, limit in STIFF.items():
        judged = np.abs(ratios / limit - 1.0) > NEAR
        agrees = ((counts[rule] > 0) == (ratios > limit))[judged].mean()
        checks.append(
            Check(f"S5 {rule}, oscillates above k_n h/E' = {limit:g}", float(agrees), ">= 0.98", bool(agrees >= 0.98))
        )
    least = float(profiles["nodal"][1].min() / profiles["nodal"][1].max())
    checks.append(Check(f"S5 nodal, least over largest traction at {SHOWN:g}", least, "> 0", least > 0.0))
    return checks


def _map(axis: Axes, ratios: Floats, counts: dict[str, Floats]) -> None:
    edges = np.sqrt(ratios[1:] * ratios[:-1])
    edges = np.concatenate([[ratios[0] ** 2 / edges[0]], edges, [ratios[-1] ** 2 / edges[-1]]])
    table = np.array([counts[rule] for rule in reversed(RULES)])
    mesh = axis.pcolormesh(edges, np.arange(len(RULES) + 1), table, cmap="YlOrRd", vmin=0, vmax=max(table.max(), 1.0))
    for row, rule in enumerate(reversed(RULES)):
        if rule in STIFF:
            axis.plot([STIFF[rule]] * 2, [row, row + 1], color=INK, ls="--", lw=2.0)
        seen = np.flatnonzero(np.diff(counts[rule], prepend=-1.0))
        for n in seen:
            axis.text(
                ratios[n],
                row + 0.5,
                f"{counts[rule][n]:.0f}",
                ha="center",
                va="center",
                fontsize=7.5,
                path_effects=HALO,
            )
    axis.set(xscale="log", xlabel="$k_n h/E'$", title="Direction changes along the closed half")
    axis.set_yticks(np.arange(len(RULES)) + 0.5, [*reversed(RULES)])
    axis.grid(False)
    axis.figure.colorbar(mesh, ax=axis, label="changes", pad=0.01)


def _profiles(axis: Axes, profiles: dict[str, tuple[Floats, Floats]]) -> None:
    axis.axhline(0.0, color=PALE, lw=0.8)
    for rule, (place, traction) in profiles.items():
        axis.plot(place, traction / traction.max(), "o-", ms=3.0, color=RULES[rule], label=rule)
    axis.set(xlabel="$x$, the tip of the open half is at 0.5", ylabel="traction / largest")
    axis.set_title(f"Tractions at $k_n h/E'$ = {SHOWN:g}")
    axis.legend(loc="upper right", ncols=3)
