"""What the figures share: runs, checks, style, PNG and CSV."""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
import matplotlib.patheffects as effects
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

import fracflow
from fracflow.output import read_events, read_history

ROOT = Path(__file__).parents[2]
INK, PALE, GRID = "#222222", "#8a8a8a", "#e8e8e8"
BLUE, ORANGE, GREEN, PINK, AMBER, SKY = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9"
NODE_COLOURS = (BLUE, ORANGE, GREEN, PINK, AMBER, SKY, INK)
STYLE = {
    "font.size": 9,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.formatter.use_mathtext": True,
    "axes.formatter.limits": (-3, 4),
    "grid.color": GRID,
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.5,
    "lines.solid_capstyle": "round",
    "legend.frameon": False,
    "savefig.dpi": 160,
}
HALO = [effects.withStroke(linewidth=2.5, foreground="white")]
RECONSTRUCTED = "(R): reconstructed, the report's figure is lost."

Floats = NDArray[np.float64]


class Check(NamedTuple):
    """One bar of a figure: what it is about, the value found, what it should be, and whether it is."""

    name: str
    value: float | str
    bar: str
    ok: bool


@dataclass(frozen=True)
class Run:
    """What the figures need of a run."""

    history: Mapping[str, NDArray[Any]]
    events: Sequence[Mapping[str, Any]]


Runner = Callable[..., Any]
"""(scene, *overrides) -> something with ``history`` and ``events``, such as Run."""


def runner(folder: Path) -> Runner:
    """A Runner that runs each scene of meshes/ once, into ``folder``."""

    @cache
    def once(scene: str, *overrides: str) -> Run:
        from fracflow.run import run
        from fracflow.scene import load

        target = folder / "-".join([scene, *(item.rsplit("=", 1)[-1] for item in overrides)])
        run(load(ROOT / "meshes" / scene / "scene.toml", ["output.pictures=false", *overrides]), target)
        return Run(read_history(target / "history.h5"), read_events(target / "events.csv"))

    return once


def command(scene: str, *overrides: str) -> str:
    """What a user types for the same run."""
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
    """Sum of entries of the energy books."""
    return np.sum([run.history[f"energy/{name}"] for name in names], axis=0)


def sheet(
    title: str, subtitle: str, mosaic: Any, size: tuple[float, float], **layout: Any
) -> tuple[Figure, dict[str, Axes]]:
    """A figure with a title, a line that says what to see, and the named axes of a mosaic."""
    figure = Figure(figsize=size, layout="constrained")
    head, body = figure.subfigures(2, 1, height_ratios=[0.62, size[1] - 0.62], hspace=0.0)
    head.text(0.012, 0.66, title, fontsize=12.5, fontweight="bold", color=INK, va="center")
    head.text(0.012, 0.18, subtitle, fontsize=9, color="#555555", va="center")
    return figure, body.subplot_mosaic(mosaic, **layout)


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


def save(figure: Figure, folder: Path, name: str, note: str = "") -> None:
    """Write ``name``.png with a note below it."""
    if note:
        figure.supxlabel(note, fontsize=7.5, color=PALE, x=0.012, ha="left")
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / f"{name}.png")


def plain(text: str) -> str:
    """Text without the marks of mathematics, for files."""
    return "".join(letter for letter in text if letter not in "${}\\")


def write_csv(
    folder: Path, name: str, columns: Mapping[str, NDArray[Any]], commands: Sequence[str], *notes: str
) -> None:
    """Write the numbers of a figure, columns of any length, under the machine, versions and commands they came from."""
    lines = [f"# {line}" for line in (*made_with(), *(f"command: {item}" for item in commands), *map(plain, notes))]
    lines.append(",".join(columns))
    for row in range(max(len(values) for values in columns.values())):
        lines.append(",".join(f"{values[row]:.9g}" if row < len(values) else "" for values in columns.values()))
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{name}.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")


def made_with() -> tuple[str, str]:
    """The machine and the versions, a line each."""
    from fracflow._petsc import PETSc

    model = platform.processor() or platform.machine()
    cpu = Path("/proc/cpuinfo")
    if cpu.exists():
        names = [
            line.partition(":")[2].strip() for line in cpu.read_text().splitlines() if line.startswith("model name")
        ]
        model = names[0] if names else model
    petsc = ".".join(map(str, PETSc.Sys.getVersion()))
    versions = {
        "fracflow": fracflow.__version__, "PETSc": petsc, "NumPy": np.__version__, "Matplotlib": matplotlib.__version__,
        "Python": platform.python_version(),
    }  # fmt: skip
    machine = f"machine: {model}, {os.cpu_count()} cores, {platform.system()} {platform.release()}"
    return machine, "versions: " + ", ".join(f"{key} {value}" for key, value in versions.items())
