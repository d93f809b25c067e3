"""meshes/injection_cycle: pressure and slip along the faults against time, and moment released against volume injected."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from sheets import BLUE, INK, ORANGE, ROOT, Check, save, sheet, write_csv

import fracflow
from fracflow.api import Run

DAY, MPA, MM = 86400.0, 1e6, 1e-3
CLOSED = 1e-6  # of an event's energy
LEAST_EVENTS, FELT = 3, 2.0  # so many of that magnitude; what comes to nothing is an event too


def ran(folder: Path, found: Path | None = None) -> Run:
    """Run the scene, in ``folder``, unless a run is ``found``."""
    if found is not None:
        return fracflow.open(found)
    scene = fracflow.load(ROOT / "meshes" / "injection_cycle" / "scene.toml", ["output.pictures=false"])
    return fracflow.run(scene, folder / "run")


def draw(run: Run, folder: Path) -> list[Check]:
    """Draw ``cycle`` into ``folder`` and return the bars."""
    events = run.events[run.events["kind"] == "event"]
    days = run.times / DAY
    names = sorted(run.probes)
    figure, axes = sheet(
        "Thirty days of a well in six faults",
        "Pressure and slip at probes along the faults, A to F, each from its start; events dashed.",
        [["pressure", "pressure"], ["slip", "slip"], ["moment", "steps"]], (10.0, 9.0), height_ratios=[1.2, 1.2, 1.0],
    )  # fmt: skip
    start = [run.probe(name)["pressure"][0] for name in names]
    pressure = np.array([run.probe(name)["pressure"] - first for name, first in zip(names, start, strict=True)]) / MPA
    slip = np.array([np.abs(run.probe(name)["plastic_slip"]) for name in names]) / MM
    even = np.linspace(days[0], days[-1], 1200)
    last = np.searchsorted(days, even, side="right") - 1
    for key, values, label, colours in (
        ("pressure", pressure, "pressure above the initial one [MPa]", "RdBu_r"), ("slip", slip, "slip [mm]", "viridis"),
    ):  # fmt: skip
        most = float(np.abs(values).max())
        least = -most if key == "pressure" else 0.0
        image = axes[key].pcolormesh(even, np.arange(len(names)), values[:, last], cmap=colours, vmin=least, vmax=most)
        figure.colorbar(image, ax=axes[key], label=label)
        axes[key].set(yticks=np.arange(len(names)), yticklabels=names, xlabel="time [d]")
        axes[key].tick_params(axis="y", labelsize=6)
        axes[key].grid(visible=False)
        for event in events:
            axes[key].axvline(event["start"] / DAY, color=INK, linestyle="--", linewidth=0.8)
    released = np.cumsum(events["moment"])
    axes["moment"].step(events["injected"], released, where="post", marker="o", color=ORANGE)
    axes["moment"].set(xlabel="net volume injected [m³]", ylabel="moment released per thickness [N m/m]")
    length = np.maximum(run.steps["dt"], 1e-4)
    axes["steps"].semilogy(days, length, ".", markersize=2, color=BLUE)
    axes["steps"].set(xlabel="time [d]", ylabel="time step [s]")
    save(figure, folder, "cycle", "fracflow run meshes/injection_cycle/scene.toml")
    keys = (
        "start", "end", "length", "mean_slip", "slip", "stress_drop", "moment", "magnitude", "radiated", "dissipated",
        "dropped", "unclosed", "injected",
    )  # fmt: skip
    write_csv(folder, "cycle", {key: events[key] for key in keys}, ["scripts/figures injection"])
    return _bars(run, events)


def _bars(run: Run, events: np.ndarray) -> list[Check]:
    unclosed = float(np.max(events["unclosed"], initial=0.0))
    large = int((events["magnitude"] > FELT).sum())
    energy = events["radiated"] + events["dissipated"]
    dropped = float(np.max(np.abs(events["dropped"]) / energy, initial=0.0))
    faults = len({*run.events["fracture"][run.events["kind"] == "slip"]})
    return [
        Check(f"events above magnitude {FELT:g}, of {len(events)}", large, f">= {LEAST_EVENTS}", large >= LEAST_EVENTS),
        Check("faults that slipped", faults, ">= 5", faults >= 5),
        Check("books not closed over an event, of its energy", unclosed, f"<= {CLOSED:g}", unclosed <= CLOSED),
        Check("kinetic energy dropped after an event, of its energy", dropped, "<= 0.001", dropped <= 1e-3),
        Check("days", run.times[-1] / DAY, "30", abs(run.times[-1] / DAY - 30.0) < 1e-6),
    ]
