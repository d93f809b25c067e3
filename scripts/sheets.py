"""Common parts of all figures: style, sheets with a title, PNG and CSV, bars and their table."""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
import matplotlib.patheffects as effects
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from rich.console import Console
from rich.markup import escape
from rich.table import Table

import fracflow

ROOT = Path(__file__).parents[1]
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
Floats = NDArray[np.float64]


class Check(NamedTuple):
    """One bar of a figure: what it is about, the value found, what it should be, and whether it is."""

    name: str
    value: float | str
    bar: str
    ok: bool


def sheet(
    title: str, subtitle: str, mosaic: Any, size: tuple[float, float], **layout: Any
) -> tuple[Figure, dict[str, Axes]]:
    """A figure with a title, a line that says what to see, and the named axes of a mosaic."""
    figure = Figure(figsize=size, layout="constrained")
    head, body = figure.subfigures(2, 1, height_ratios=[0.62, size[1] - 0.62], hspace=0.0)
    head.text(0.012, 0.66, title, fontsize=12.5, fontweight="bold", color=INK, va="center")
    head.text(0.012, 0.18, subtitle, fontsize=9, color="#555555", va="center")
    return figure, body.subplot_mosaic(mosaic, **layout)


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


def judge(checks: Sequence[Check], folder: Path) -> int:
    """Print the bars; exit code 1 if one is missed, or if there is none."""
    table = Table("figure", "found", "bar", "")
    for check in checks:
        value = check.value if isinstance(check.value, str) else f"{check.value:.4g}"
        table.add_row(escape(check.name), value, escape(check.bar), "ok" if check.ok else "[red]missed[/red]")
    Console(highlight=False, width=None if sys.stdout.isatty() else 140).print(table)
    print(f"{len(list(folder.glob('*.png')))} figures, PNG and CSV, in {folder}")
    return 0 if checks and all(check.ok for check in checks) else 1
