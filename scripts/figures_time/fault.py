"""Application 5.5, pumping raised at 1 % per 0.01 s until it fails: its slips by ever shorter steps, implicit and explicit."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from sheets import BLUE, ORANGE, ROOT, Check, save, sheet, write_csv

from fracflow.output import read_events
from fracflow.scene.scene import load
from fracflow.simulation.run import run

STEPS, LASTS = (0.01, 0.005, 0.0025), 0.6
STEPPERS = ("newmark", "explicit")
SLIP, START = 0.01, 0.01  # relative; [s]
First = dict[str, tuple[float, float]]
"""Node -> start and slip of its first slip."""


def first_slips(stepper: str, step: float, folder: Path) -> First:
    """Of each node that slips within ``LASTS``."""
    given = [
        f"method.stepper={stepper}",
        f"stage.failure.time_step={step}",
        f"stage.failure.steps={round(LASTS / step)}",
    ]
    given += [f"stage.failure.increment_per_step={step}", "output.pictures=false"]
    run(load(ROOT / "meshes" / "report_5_5" / "scene.toml", given), folder)
    found: First = {}
    for event in read_events(folder / "events.csv"):
        if event["kind"] == "slip" and event["end"] is not None:
            found.setdefault(event["probe"], (event["start"], abs(event["slip"])))
    return found


def draw(folder: Path) -> list[Check]:
    """Measure, draw ``fault`` into ``folder`` and return the bars."""
    with tempfile.TemporaryDirectory() as work:
        found = {(s, dt): first_slips(s, dt, Path(work) / f"{s}{dt}") for s in STEPPERS for dt in STEPS}
    finest = found[STEPPERS[0], STEPS[-1]]
    nodes = sorted(finest)
    figure, axes = sheet(
        "Application 5.5 by shorter steps", "First slips; events located, explicit steps at their ends.",
        [["start", "slip"]], (9.0, 4.0),
    )  # fmt: skip
    checks = []
    for stepper, colour in zip(STEPPERS, (BLUE, ORANGE), strict=True):
        for node in nodes:
            runs = [found[stepper, dt] for dt in STEPS if node in found[stepper, dt]]
            starts, slips = (np.array([each[node][part] for each in runs]) for part in (0, 1))
            for name, values in (("start", starts), ("slip", slips)):
                axes[name].plot(STEPS[: len(values)], values, "o-", color=colour, label=f"{node}, {stepper}")
    for (stepper, dt), slips_of in found.items():
        where = f"{stepper}, {dt:g} s"
        same = sorted(slips_of) == nodes
        checks.append(Check(f"{where}: nodes that slip", ", ".join(sorted(slips_of)), ", ".join(nodes), same))
        if same:
            late = max(abs(slips_of[node][0] - finest[node][0]) for node in nodes)
            off = max(abs(slips_of[node][1] / finest[node][1] - 1.0) for node in nodes)
            checks.append(Check(f"{where}: starts off [s]", late, f"<= {START:g}", late <= START + 1e-9))
            checks.append(Check(f"{where}: slips off", off, f"<= {SLIP:g}", off <= SLIP))
    for name, label in (("start", "start of slip [s]"), ("slip", "slip [ft]")):
        axes[name].set(xlabel="time step [s]", ylabel=label, xscale="log")
        axes[name].legend(fontsize=7)
    save(figure, folder, "fault", "Held against the implicit run with the shortest step.")
    rows = [
        (
            float(stepper == "explicit"),
            dt,
            float(node.removeprefix("node")),
            *found[stepper, dt].get(node, (np.nan, np.nan)),
        )
        for stepper in STEPPERS
        for dt in STEPS
        for node in nodes
    ]
    names = ("is_explicit", "time_step", "node", "start", "slip")
    columns = {name: np.array(values) for name, values in zip(names, zip(*rows, strict=True), strict=True)}
    write_csv(folder, "fault", columns, ["scripts/figures time --only fault"])
    return checks
