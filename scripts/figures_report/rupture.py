"""Figs. 20 to 23: application 5.5, a fault that fails at its middle between two places of withdrawal."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
from sheets import AMBER, BLUE, GREEN, HALO, NODE_COLOURS, ORANGE, PALE, STYLE, Check, save, sheet, write_csv

from figures_report.common import (
    RECONSTRUCTED,
    Run,
    Runner,
    command,
    dynamic,
    energy,
    held,
    name_ends,
    phases,
    probe,
    shade,
    slipped,
    thick,
)
from figures_report.setup_panel import draw_setup

SCENE = "report_5_5"
NODES = tuple(f"node{i}" for i in range(1, 8))
SLIP = {"node3", "node4", "node5"}
STORED = ("rock_strain", "joint_normal", "joint_shear")
NOTE = (
    f"{RECONSTRUCTED} Mesh, supports, end pressures and the raise of the pumping (R). model = report, time step 0.01."
)


def draw(folder: Path, run: Runner) -> list[Check]:
    """Draw the four figures into ``folder`` and return their checks; nodes and energies of both models."""
    both = {model: run(SCENE, f"model={model}") for model in ("report", "default")}
    shown = both["report"]
    with matplotlib.rc_context(STYLE):
        checks = [*problem(folder, shown), *along_the_fault(folder, shown), *acceleration(folder, shown)]
        checks += energies(folder, shown)
    found = slipped(both["default"])
    return [
        *checks,
        Check("20 nodes that slip, default", " ".join(sorted(found)), "3 4 5", found == SLIP),
        _constant(both["default"], "default"),
    ]


def problem(folder: Path, run: Run) -> list[Check]:
    """Fig. 20: set-up, pressure profile, u_y of the nodes about the middle."""
    figure, axes = sheet(
        "Fig. 20  A rigidly supported mass of rock with a fault, stick-slip ratio 0.94",
        "Injection in the middle, withdrawal on both sides: only nodes 3, 4, 5 fail; the withdrawal locks the rest.",
        [["mesh", "pressure", "u"]], (11.4, 5.2), width_ratios=[1.35, 0.8, 3.2],
    )  # fmt: skip
    draw_setup(axes["mesh"], axes["pressure"], SCENE, run, {"node4": 1.0, "node2": -0.75, "node6": -0.75})
    time, rows = run.history["time"], dynamic(run)
    ends = []
    # 3 and 5, 2 and 6 move alike: the half turn about node 4 leaves the problem as it is
    for name, said, colour in (("node4", "4", ORANGE), ("node3", "3, 5", BLUE), ("node2", "2, 6", GREEN)):
        u = probe(run, name, "displacement")[rows, 1]
        thick(axes["u"], time[rows], u, phases(run, name), colour)
        ends.append((said, float(u[-1]), colour))
    axes["u"].set(title="displacement along the fault; thick: slipping", xlabel="time [s]", ylabel="$u_y$ [ft]")
    axes["u"].margins(x=0)
    name_ends(axes["u"], ends)
    _save(figure, folder, "fig_20", run)
    found = slipped(run)
    flows = {name: probe(run, name, "plastic_slip")[-1] for name in ("node3", "node5")}
    alike = abs(flows["node3"] / flows["node5"] - 1.0)
    return [
        Check("20 nodes that slip, report", " ".join(sorted(found)), "3 4 5", found == SLIP),
        Check("20 slip at 3 against 5, apart by", alike, "< 1e-6: half turn", alike < 1e-6),
    ]


def along_the_fault(folder: Path, run: Run) -> list[Check]:
    """Fig. 21: u_y of all nodes, each drawn at its place."""
    figure, axes = sheet(
        "Fig. 21  Displacements along the fault",
        "Each node at its place. The slip starts in the middle, spreads to both neighbours, and stops there.",
        [["u"]], (8.4, 5.4),
    )  # fmt: skip
    main = axes["u"]
    time, rows = run.history["time"], dynamic(run)
    largest = max(float(np.abs(probe(run, name, "displacement")[rows, 1]).max()) for name in NODES)
    for number, (name, colour) in enumerate(zip(NODES, NODE_COLOURS, strict=True), start=1):
        u = probe(run, name, "displacement")[rows, 1]
        lifted = number + 0.72 * u / largest
        main.axhline(number, color=PALE, lw=0.6)
        main.fill_between(time[rows], number, lifted, color=colour, alpha=0.16, lw=0)
        thick(main, time[rows], lifted, phases(run, name), colour)
        main.text(2.97, lifted[-1] + 0.07, f"{u[-1]:.4f} ft", ha="right", color=colour, fontsize=8, path_effects=HALO)
    main.set(xlabel="time [s]", ylabel="node, from the start of the fault", yticks=range(1, 8), ylim=(0.6, 7.7))
    main.margins(x=0)
    main.set_title("$u_y$ above each node's line; thick: slipping")
    _save(figure, folder, "fig_21", run)
    stays = max(abs(float(probe(run, name, "plastic_slip")[-1])) for name in NODES if name not in SLIP)
    moves = min(abs(float(probe(run, name, "plastic_slip")[-1])) for name in SLIP)
    return [
        Check("21 permanent slip of 1, 2, 6, 7 [ft]", stays, "0", stays == 0.0),
        Check("21 smallest permanent slip of 3, 4, 5 [ft]", moves, "> 0.01", moves > 0.01),
    ]


def acceleration(folder: Path, run: Run) -> list[Check]:
    """Fig. 22: acceleration of node 4 along the fault."""
    time, rows = run.history["time"], dynamic(run)
    a = probe(run, "node4", "acceleration")[:, 1]
    spans = phases(run, "node4")
    sliding = np.any([(time >= start - 1e-9) & (time < end - 1e-9) for start, end in spans], axis=0)
    figure, axes = sheet(
        "Fig. 22  Acceleration of node 4 along the fault",
        "Smooth and slow while it slips; a fast elastic vibration about the new place when it is locked.",
        [["a"]], (8.4, 4.4),
    )  # fmt: skip
    main = axes["a"]
    shade(main, spans, "node 4 slips")
    main.plot(time[rows], a[rows], color=BLUE, lw=1.0)
    main.plot(time[rows], np.where(sliding, a, np.nan)[rows], color=ORANGE, lw=2.2)
    main.axhline(0, color=PALE, lw=0.8)
    main.set(xlabel="time [s]", ylabel="$\\ddot u_y$ [ft/s²]")
    main.margins(x=0)
    main.legend(loc="upper right")
    save(figure, folder, "fig_22", NOTE)
    columns = {"time": time, "acceleration node4": a, "slipping": sliding.astype(float)}
    write_csv(folder, "fig_22", columns, [command(SCENE, "model=report")], NOTE)
    begin, end = (int(np.argmin(np.abs(time - when))) for when in spans[0])
    slow = int((np.diff(np.sign(np.diff(a[begin:end]))) != 0).sum()) / max(end - begin, 1)
    quiet = a[time > max(last for _, last in spans) + 1e-9]
    fast = int((np.diff(np.sign(np.diff(quiet))) != 0).sum()) / len(quiet)
    return [
        Check(
            "22 turns a step, locked; in the first slip",
            f"{fast:.2f}; {slow:.2f}",
            "locked > 3 x slip",
            fast > 3.0 * slow,
        )
    ]


def energies(folder: Path, run: Run) -> list[Check]:
    """Fig. 23: kinetic and dissipated energy; and what the state at failure says of (5.2)."""
    time, rows = run.history["time"], dynamic(run)
    dissipated, kinetic = energy(run, "friction"), energy(run, "kinetic")
    strain = energy(run, *STORED)
    first = int(np.argmax(dissipated > 0.0))
    figure, axes = sheet(
        "Fig. 23  Kinetic energy of the rock and energy dissipated during slip",
        "What the rock's strain gives up goes into friction; one part in a hundred or so shakes the rock.",
        [["d"], ["k"]], (8.4, 5.4), sharex=True, height_ratios=[1, 1],
    )  # fmt: skip
    t = time[rows]
    axes["d"].plot(t, dissipated[rows], color=AMBER, lw=2)
    axes["d"].plot(t, (strain - strain[first - 1])[rows], color=GREEN, lw=1.2, ls=(0, (5, 2)))
    axes["d"].axhline(0, color=PALE, lw=0.8)
    axes["d"].set_ylabel("energy [ft lbf/ft]")
    axes["k"].fill_between(t, kinetic[rows], color=BLUE, alpha=0.18, lw=0)
    axes["k"].plot(t, kinetic[rows], color=BLUE)
    axes["k"].set(xlabel="time [s]", ylabel="energy [ft lbf/ft]", ylim=(0, None))
    axes["d"].set_title("dissipated $E_D$ (full), change of strain $\\Delta U$ (dashed)")
    axes["k"].set_title("kinetic $E_K$")
    for panel in axes.values():
        panel.margins(x=0)
        shade(
            panel, [(min(s for n in SLIP for s, _ in phases(run, n)), max(e for n in SLIP for _, e in phases(run, n)))]
        )
    save(figure, folder, "fig_23", NOTE)
    # Delta U counts from the initial state, so before the drop it is what the pumping has done
    before, after = (float(kinetic[row] + strain[row] - strain[0]) for row in (first - 1, first))
    stated = (
        f"E_K + dU since the start: {before:.6g} before, {after:.6g} after the first strength drop; printed: -0.5e4"
    )
    columns = {"time": time, "E_D": dissipated, "E_K": kinetic, "dU": strain - strain[0]}
    write_csv(folder, "fig_23", columns, [command(SCENE, "model=report")], NOTE, stated)
    growth = float(np.diff(dissipated).min() / dissipated[-1])
    return [
        _constant(run, "report"),
        Check("23 smallest step of E_D, of its end", growth, ">= 0 (to 1e-12)", growth > -1e-12),
        Check("23 E_K + dU before; after the first drop", f"{before:.4g}; {after:.4g}", "stated, no bar", True),
    ]


def _constant(run: Run, model: str) -> Check:
    """(5.2) from the step after which the pumping is held."""
    total = energy(run, "friction", "kinetic", *STORED)[held(run) :]
    drift = float(np.ptp(total) / energy(run, "friction")[-1])
    return Check(f"23 E_D + E_K + dU varies by, of E_D, {model}", drift, "< 1e-6", drift < 1e-6)


def _save(figure: matplotlib.figure.Figure, folder: Path, name: str, run: Run) -> None:
    save(figure, folder, name, NOTE)
    columns = {"time": run.history["time"], **{f"u_y {n}": probe(run, n, "displacement")[:, 1] for n in NODES}}
    write_csv(folder, name, columns, [command(SCENE, "model=report")], NOTE)
