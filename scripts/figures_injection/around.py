"""The largest event of meshes/injection_cycle once more, with inertia all along from shortly before it to well after it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from sheets import ROOT, Check, write_csv

import fracflow
from fracflow.api import Run

LEAD, WAIT = 2.0, 4.0  # of the run with inertia all along, before the event begins and after it ends [s]
APART = 5e-3  # of the largest slip in the event on the same fault
JOLTED = 0.1  # of the largest slip of all: a fault that slips less is shaken by the event; its slip counts over that
COMMAND = "scripts/figures injection"


def compare(run: Run, folder: Path, found: Path | None = None) -> list[Check]:
    """Slip in the event at every probe against that of the other run, made in ``folder`` unless it is ``found``."""
    events = run.events[(run.events["kind"] == "event") & np.isfinite(run.events["end"])]
    event = events[events["moment"].argmax()]
    begin = float(run.times[run.times <= event["start"] - LEAD][-1])  # of which both runs have a record
    end = float(event["end"]) + WAIT
    other = fracflow.open(found) if found is not None else _with_inertia(folder, begin, end)
    names = sorted(run.probes)
    slip = np.array([[_slip(each, name, begin, end) for name in names] for each in (run, other)])
    faults = np.array([name[0] for name in names])
    largest = np.array([np.abs(slip[:, faults == fault]).max() for fault in faults])
    apart = np.abs(slip[0] - slip[1]) / np.maximum(largest, JOLTED * largest.max())
    table = {"slip": slip[0], "slip_with_inertia_all_along": slip[1], "apart_of_largest_on_fault": apart}
    when = f"event from {event['start']:.9g} to {event['end']:.9g} s"
    write_csv(folder, "around", table, [COMMAND], when, f"rows: probes {', '.join(names)}")
    worst = int(apart.argmax())
    what = f"{apart[worst]:.2%} ({names[worst]})"
    return [
        Check(
            "slip in the largest event off that with inertia all along", what, f"<= {APART:.1%}", apart[worst] <= APART
        )
    ]


def _with_inertia(folder: Path, begin: float, end: float) -> Run:
    path = ROOT / "meshes" / "injection_cycle" / "scene.toml"
    (stage,) = fracflow.load(path).stage
    kept = stage.model_dump(include={"kind", "time_step", "dynamic_time_step", "at_rest", "rest_periods"})
    before = kept | {"name": "before", "end": begin}
    during = {"name": "event", "kind": "dynamic", "time_step": stage.dynamic_time_step, "end": end}
    stages = ", ".join(
        "{" + ", ".join(f"{key}={value!r}" for key, value in each.items()) + "}" for each in (before, during)
    )
    return fracflow.run(fracflow.load(path, ["output.pictures=false", f"stage=[{stages}]"]), folder / "with_inertia")


def _slip(run: Run, name: str, begin: float, end: float) -> float:
    """Change of the slip at a probe from the last record before one time to the last before the other."""
    first, last = np.searchsorted(run.times, (begin, end), side="right") - 1
    slip = run.probe(name)["plastic_slip"]
    return float(slip[last] - slip[first])
