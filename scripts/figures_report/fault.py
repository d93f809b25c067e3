"""Fig. 15: application 5.3, injection and withdrawal along a prestressed fault."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
from sheets import NODE_COLOURS, STYLE, Check, save, sheet, write_csv

from figures_report.common import RECONSTRUCTED, Run, Runner, command, name_ends, phases, probe, slipped, thick
from figures_report.setup_panel import draw_setup

SCENE = "report_5_3"
NODES = tuple(f"node{i}" for i in range(1, 6))
SLIP = {"node1", "node2", "node3"}
NOTE = f"{RECONSTRUCTED} Mesh, supports, wells and their raise (R). model = report, time step 0.01."


def draw(folder: Path, run: Runner) -> list[Check]:
    """Draw the figure into ``folder`` and return its checks, of both models."""
    both = {model: run(SCENE, f"model={model}") for model in ("report", "default")}
    with matplotlib.rc_context(STYLE):
        figure, axes = sheet(
            "Fig. 15  Injection and withdrawal along a fault, stick-slip ratio 0.98",
            "Node 2 fails under the injected pressure and takes 1 and 3 with it; 4 and 5 are locked by the withdrawal.",
            [["mesh", "pressure", "u"]], (11.4, 4.9), width_ratios=[1.5, 0.8, 3.2],
        )  # fmt: skip
        shown = both["report"]
        draw_setup(axes["mesh"], axes["pressure"], SCENE, shown, {"node2": 1.0, "node4": -1.0})
        time = shown.history["time"]
        columns = {"time": time}
        ends = []
        for name, colour in zip(NODES, NODE_COLOURS, strict=False):
            u = probe(shown, name, "displacement")[:, 1]
            thick(axes["u"], time, u, phases(shown, name), colour)
            columns[f"u_y {name}"] = u
            ends.append((name.removeprefix("node"), float(u[-1]), colour))
        axes["u"].set(title="displacement along the fault; thick: slipping", xlabel="time [s]", ylabel="$u_y$ [ft]")
        axes["u"].margins(x=0)
        name_ends(axes["u"], ends)
        save(figure, folder, "fig_15", NOTE)
    write_csv(folder, "fig_15", columns, [command(SCENE, "model=report")], NOTE)
    return [check for model, of_model in both.items() for check in bars(model, of_model)]


def bars(model: str, run: Run) -> list[Check]:
    """The text states: 1, 2 and 3 slip to new rest positions, 4 and 5 stay."""
    found = slipped(run)
    over = max(event["end"] or np.inf for event in run.events)
    still = run.history["time"] >= over - 1e-9
    creep = max(float(np.ptp(probe(run, name, "plastic_slip")[still])) for name in NODES) if still.any() else np.inf
    rests = min(abs(float(probe(run, name, "plastic_slip")[-1])) for name in SLIP)
    return [
        Check(f"15 nodes that slip, {model}", " ".join(sorted(found)), "1 2 3", found == SLIP),
        Check(f"15 smallest permanent slip of the three [ft], {model}", rests, "> 0.01", rests > 0.01),
        Check(f"15 slip after the last event, {model}", creep, "none: < 1e-12", creep < 1e-12),
    ]
