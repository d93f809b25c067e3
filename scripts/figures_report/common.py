"""Common parts of the figures of the report: runs and their results."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray
from sheets import ROOT, Floats

from fracflow.output import read_events, read_history

RECONSTRUCTED = "(R): reconstructed, the report's figure is lost."


@dataclass(frozen=True)
class Run:
    """The results of a run for the figures."""

    history: Mapping[str, NDArray[Any]]
    events: Sequence[Mapping[str, Any]]


Runner = Callable[..., Any]
"""(scene, *overrides) -> something with ``history`` and ``events``, such as Run."""


def runner(folder: Path) -> Runner:
    """A Runner that runs each scene of meshes/ once, into ``folder``."""

    @cache
    def once(scene: str, *overrides: str) -> Run:
        from fracflow.scene.scene import load
        from fracflow.simulation.run import run

        target = folder / "-".join([scene, *(item.rsplit("=", 1)[-1] for item in overrides)])
        run(load(ROOT / "meshes" / scene / "scene.toml", ["output.pictures=false", *overrides]), target)
        return Run(read_history(target / "history.h5"), read_events(target / "events.csv"))

    return once


def command(scene: str, *overrides: str) -> str:
    """The command of a user for the same run."""
    return " ".join(["fracflow run", f"meshes/{scene}/scene.toml", *(f"--set {item}" for item in overrides)])


def probe(run: Run, name: str, quantity: str) -> Floats:
    """History of a probe."""
    return run.history[f"probe/{name}/{quantity}"]


def slipped(run: Run) -> set[str]:
    """Names of the probes that have slipped."""
    return {str(event["probe"]) for event in run.events if event["kind"] == "slip"}


def phases(run: Run, name: str) -> list[tuple[float, float]]:
    """Start and end of each slip at a probe; one under way lasts to the end of the run."""
    last = float(run.history["time"][-1])
    found = [event for event in run.events if event["kind"] == "slip" and event["probe"] == name]
    return [(event["start"], last if event["end"] is None else event["end"]) for event in found]


def dynamic(run: Run) -> NDArray[np.bool_]:
    """Rows from the state in which the dynamics start."""
    rows = run.history["step/kind"] == 2
    rows[max(int(np.argmax(rows)) - 1, 0)] = True
    return rows


def held(run: Run) -> int:
    """First row after which the pumping is not raised any more."""
    return int(np.flatnonzero(np.diff(run.history["step/control/pumping"]))[-1]) + 1


def energy(run: Run, *names: str) -> Floats:
    """Sum of entries of the energy balance."""
    return np.sum([run.history[f"energy/{name}"] for name in names], axis=0)


def shade(axes: Axes, spans: Sequence[tuple[float, float]], label: str = "slip") -> None:
    """Mark slip phases by a pale band, the first one named."""
    for number, (start, end) in enumerate(spans):
        axes.axvspan(start, end, color="#f3e3d3", lw=0, zorder=0, label=label if number == 0 else None)


def thick(axes: Axes, time: Floats, values: Floats, spans: Sequence[tuple[float, float]], colour: str) -> None:
    """Draw a history, thick while it slips."""
    axes.plot(time, values, color=colour)
    for start, end in spans:
        inside = (time >= start - 1e-9) & (time <= end + 1e-9)
        axes.plot(time[inside], values[inside], color=colour, lw=4.5, alpha=0.45, solid_capstyle="butt")


def name_ends(axes: Axes, ends: Sequence[tuple[str, float, str]], gap: float = 0.075) -> None:
    """Name lines (name, last value, colour) beside their right ends, moved apart where they are close."""
    low, high = axes.get_ylim()
    order = sorted(ends, key=lambda end: end[1])
    true = np.array([(value - low) / (high - low) for _, value, _ in order])
    place = true.copy()
    for _ in range(50):
        for i in range(1, len(place)):
            short = gap - (place[i] - place[i - 1])
            if short > 0.0:
                place[i - 1 : i + 1] += [-0.5 * short, 0.5 * short]
    for (name, _, colour), at, y in zip(order, true, place, strict=True):
        axes.annotate(
            name, (1.0, at), (1.025, y), "axes fraction", "axes fraction", color=colour, fontsize=8, va="center",
            arrowprops=dict(arrowstyle="-", color=colour, lw=0.6, shrinkA=0, shrinkB=0), annotation_clip=False,
        )  # fmt: skip
