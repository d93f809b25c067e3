"""Pictures of all public problems: error against CPU on one sheet, and results over published numbers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.transforms import Bbox
from sheets import BLUE, GREEN, HALO, INK, ORANGE, PALE, PINK, save, sheet

from figures_benchmarks.benchmark import Result, front

KINDS = {
    "cracks": (BLUE, ("T junction", "Sneddon", "friction crack")),
    "flow that opens fractures": (GREEN, ("KGD", "Task B", "Wijesinghe", "Sotra network")),
    "slip that fluid drives": (ORANGE, ("Viesca", "BP6, constant friction", "BP6, rate and state", "BP6, a well")),
    "waves": (PINK, ("rupture", "absorbing side")),
}
"""Kind -> colour and the problems of it, each with a marker of its own."""
MARKS = "os^D"
STARRED = "*: against its own limit"
LEAST = 5e-5  # errors below are drawn at the foot, with their number
AROUND = (
    (9, 0, "left", "center"), (0, -9, "center", "top"), (0, 9, "center", "bottom"), (8, -7, "left", "top"),
    (8, 7, "left", "bottom"), (-9, 0, "right", "center"), (-8, -7, "right", "top"), (-8, 7, "right", "bottom"),
)  # fmt: skip
"""Offsets of a name from a point, in points, and its alignment."""
Points = Sequence[tuple[float, float]]
WRITTEN = {"fontsize": 8.5, "path_effects": HALO}
OTHERS = {"OpenGeoSys": "s", "PorePy": "^", "boundary elements": "D"}


def look(short: str) -> tuple[str, str]:
    """Colour and marker of a problem."""
    for colour, names in KINDS.values():
        if short in names:
            return colour, MARKS[names.index(short)]
    return INK, "P"


def called(result: Result) -> str:
    """Name on a picture."""
    return result.benchmark.short + ("*" if result.benchmark.own_limit else "")


def chart(results: Sequence[Result], folder: Path, command: str) -> None:
    """Error of the first observable against CPU seconds: ours filled, others hollow."""
    figure = Figure(figsize=(8.8, 5.6), layout="constrained")
    axis = figure.subplots()
    axis.set(xscale="log", yscale="log", xlabel="CPU seconds of the whole process", ylabel="relative error")
    drawn, labels = [], []
    for result in results:
        colour, mark = look(result.benchmark.short)
        errors = np.maximum(result.outcomes[0].errors, LEAST)
        seconds = np.array([ran.seconds for ran in result.runs])
        axis.plot(seconds, errors, "-", marker=mark, ms=6, lw=1.4, color=colour, zorder=3)
        drawn.append(list(zip(seconds, errors, strict=True)))
        told = result.outcomes[0].errors[-1]
        name = called(result) + (f": {told:.0e} ↓" if told < LEAST else "")
        labels.append((name, colour, list(zip(seconds, errors, strict=True))[::-1]))
        for program, sign in OTHERS.items():
            for here in (True, False):
                best = front([each for each in result.others if each.program.startswith(program) and each.here == here])
                if best:
                    there = [(each.seconds, max(each.error, LEAST)) for each in best]
                    axis.plot(
                        *np.array(there).T,
                        "--" if here else ":",
                        marker=sign,
                        ms=6,
                        lw=0.9,
                        mfc="white",
                        color=colour,
                        zorder=2,
                    )
                    drawn.append(there)
    axis.set_ylim(LEAST * 0.7, None)
    legend = axis.legend(handles=keys(results), fontsize=8, loc="lower left", labelspacing=0.3)
    note = f"Each problem's first error, over sizes of cells or steps; {STARRED}. {command}"
    figure.supxlabel(note, fontsize=7.5, color=PALE, x=0.012, ha="left")
    figure.draw_without_rendering()
    place(axis, labels, drawn, [legend.get_window_extent()])
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / "benchmarks.png")


def keys(results: Sequence[Result]) -> list[Line2D]:
    """The meaning of colours and shapes."""
    style = {"ls": "-", "marker": "o", "ms": 5, "lw": 1.4}
    shown = [Line2D([], [], color=colour, label=kind, **style) for kind, (colour, _) in KINDS.items()]
    shown.append(Line2D([], [], color=INK, label="fracflow", **style))
    for program, sign in OTHERS.items():
        ran = {each.here for result in results for each in result.others if each.program.startswith(program)}
        for here in ran:
            label = program + ("" if here else " (not run here)")
            shown.append(
                Line2D([], [], color=INK, ls="--" if here else ":", marker=sign, ms=5, lw=0.9, mfc="white", label=label)
            )
    return shown


def place(
    axis: Axes, labels: Sequence[tuple[str, str, Points]], drawn: Sequence[Points], filled: Sequence[Bbox] = ()
) -> None:
    """Put each name beside a point of its curve where it covers no curve and no other name, the last point if it can."""
    taken = [(20.0, box) for box in filled]  # boxes, and how much it matters that they stay free
    for curve in drawn:
        corners = axis.transData.transform(curve)
        at = np.linspace(0, len(curve) - 1, 24 * len(curve))
        steps = np.stack([np.interp(at, np.arange(len(curve)), column) for column in corners.T], axis=1)
        taken += [(0.4, Bbox.from_bounds(x - 2, y - 2, 4, 4)) for x, y in steps]
        taken += [(4.0, Bbox.from_bounds(x - 11, y - 11, 22, 22)) for x, y in corners]
    frame = axis.get_window_extent()
    for name, colour, curve in labels:
        tried = []
        for far, end in enumerate(curve):
            for dx, dy, across, up in AROUND:
                where = {"xytext": (dx, dy), "textcoords": "offset points", "ha": across, "va": up}
                text = axis.annotate(name, end, **where, **WRITTEN, color=colour)
                box = text.get_window_extent()
                outside = box.x0 < frame.x0 or box.x1 > frame.x1 + 2 or box.y0 < frame.y0 or box.y1 > frame.y1
                tried.append(
                    (
                        3 * far + 100 * outside + sum(weight * box.overlaps(other) for weight, other in taken),
                        len(tried),
                        text,
                        box,
                    )
                )
                text.set_visible(False)
        _, _, text, box = min(tried, key=lambda each: each[:2])
        text.set_visible(True)
        taken.append((20.0, box))


def curves(results: Sequence[Result], folder: Path, command: str) -> None:
    """Lines of the finest runs, over circles of published or exact numbers."""
    shown = [(result, line) for result in results for line in result.runs[-1].lines]
    wide = min(4, len(shown))
    rows = [
        [f"{k}" if k < len(shown) else "." for k in range(begin, begin + wide)] for begin in range(0, len(shown), wide)
    ]
    figure, axes = sheet(
        "Public problems", f"Lines: the finest run of fracflow. Circles: published numbers, exact solutions; {STARRED}.", rows,
        (3.3 * wide, 2.5 * len(rows) + 0.9),
    )  # fmt: skip
    for number, (result, line) in enumerate(shown):
        axis, colour = axes[str(number)], look(result.benchmark.short)[0]
        scattered = line.title.startswith(("rupture times", "pressure at ends"))
        axis.plot(*line.found, "x" if scattered else "-", color=colour, lw=1.3, ms=5, zorder=3)
        axis.plot(*line.right, "o", ms=4, mfc="none", color=INK, mew=0.7)
        axis.set_title(called(result), fontsize=9)
        axis.set_xlabel(line.x_label, fontsize=8)
        axis.set_ylabel(line.y_label, fontsize=8)
        axis.tick_params(labelsize=7.5)
    save(figure, folder, "curves", command)
