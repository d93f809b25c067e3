"""``scripts/figures work-precision [-o DIR] [--only W1 ...] [--repeats N]``: run all methods, draw error against their cost.

Exit code 1 where what the program does by default takes over twice the CPU seconds of the Pareto front at its error.
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Iterable, Sequence
from itertools import groupby
from pathlib import Path

import matplotlib
import numpy as np
from sheets import GRID, INK, NODE_COLOURS, ROOT, STYLE, Check, judge, made_with, save, sheet

from figures_work_precision.problem import WORK, Point, Problem, cheapest, front, measure, over_front
from figures_work_precision.problems import PROBLEMS

COMMAND = "scripts/figures work-precision"
MOST = 2.0
MARKS = "osv^DPX"
AXES = {
    "seconds": "CPU seconds", "factorisations": "factorisations", "solves": "solves with factors", "products": "products",
    "nodes": "nodes",
}  # fmt: skip
TELLING = 2.0  # counts that differ by less between runs say nothing


def main() -> int:
    """Exit code 1 if a bar is missed."""
    parser = argparse.ArgumentParser(prog=COMMAND, description=__doc__)
    folder = ROOT / "runs" / "figures" / "work-precision"
    parser.add_argument("-o", "--output", type=Path, default=folder, metavar="DIR")
    names = [problem.name for problem in PROBLEMS]
    parser.add_argument("--only", nargs="+", default=names, choices=names, type=str.upper, metavar="PROBLEM")
    parser.add_argument("--repeats", type=int, default=5, help="runs whose median CPU seconds count (5)")
    given = parser.parse_args()
    given.output.mkdir(parents=True, exist_ok=True)
    checks = []
    for problem in PROBLEMS:
        if problem.name in given.only:
            points = measure(problem, given.repeats)
            write(problem, points, given.output, given.repeats)
            with matplotlib.rc_context(STYLE):
                draw(problem, points, given.output, given.repeats)
            checks += check(problem, points)
    return judge(checks, given.output)


def check(problem: Problem, points: Sequence[Point]) -> list[Check]:
    """The default against the front, and methods that ought to fail or to succeed."""
    ratio, worst, best = over_front(points)
    found = f"{ratio:.2f} at {worst.error:.1e}" + (f", front: {best}" if ratio > MOST else "")
    odd = sorted({point.method.name for point in points if point.method.fails != bool(point.reason)})
    orders = [(f"{problem.name}: order from {o.coarse} to {o.fine}", o.of(points), o.least) for o in problem.orders]
    return [
        *(Check(what, order, f">= {least:g}", order >= least) for what, order, least in orders),
        Check(f"{problem.name}: CPU of the default over the front's", found, f"<= {MOST:g}", ratio <= MOST),
        Check(f"{problem.name}: methods not as expected", ", ".join(odd) or "none", "none", not odd),
    ]


def write(problem: Problem, points: Sequence[Point], folder: Path, repeats: int) -> None:
    """A row a method and level, under the machine and the versions."""
    with (folder / f"{problem.name.lower()}.csv").open("w", encoding="utf-8", newline="") as file:
        about = (*made_with(), f"command: {COMMAND} --only {problem.name} --repeats {repeats}", problem.title)
        file.writelines(f"# {line}\n" for line in about)
        rows = csv.writer(file, lineterminator="\n")
        costs = (*WORK, "nodes")
        about_errors = (problem.level, f"error: {problem.error}", "cpu_s")
        rows.writerow(["method", "default", *about_errors, *costs, "on_front", "failure"])
        best = front(points)
        for each in points:
            numbers = [f"{value:.6g}" for value in (each.level, each.error, each.seconds)]
            work = [each.work.get(name, "") for name in costs]
            rows.writerow([each.method.name, each.method.default, *numbers, *work, each in best, each.reason])


def draw(problem: Problem, points: Sequence[Point], folder: Path, repeats: int) -> None:
    """Error against CPU seconds, with the front, and against each count of work."""
    work = [name for name in (*WORK, "nodes") if spread(point.work.get(name, 0) for point in points) > TELLING]
    work = work or list(WORK)[:1]
    figure, axes = sheet(
        f"{problem.name}  {problem.title}",
        f"Relative error ({problem.error}) by {problem.level}. Black is the default, the grey line the Pareto front;"
        " counts of 0 are not drawn.",
        [["seconds", name] for name in work], (12.5, 6.6),
        width_ratios=[2.2, 1.0],
    )  # fmt: skip
    ends = [point.error for point in front(points)]
    errors = np.geomspace(ends[0], ends[-1], 300)
    axes["seconds"].plot([cheapest(points, e)[0] for e in errors], errors, "-", color=GRID, lw=9, zorder=0)
    for number, (method, group) in enumerate(groupby(points, key=lambda point: point.method)):
        there = [point for point in group if not point.reason]
        paint = INK if method.default else NODE_COLOURS[number % (len(NODE_COLOURS) - 1)]
        style = {
            "color": paint, "marker": MARKS[number % len(MARKS)], "ms": 4, "lw": 2 if method.default else 1,
            "ls": "-" if number < len(NODE_COLOURS) - 1 else "--", "zorder": 3 if method.default else 2,
        }  # fmt: skip
        label = method.name + (", default" if method.default else "" if there else ": refused at each level")
        for name, axis in axes.items():
            cost = [point.seconds if name == "seconds" else point.work[name] for point in there]
            axis.plot(cost, [point.error for point in there], label=label, **style)
    for name, axis in axes.items():
        axis.set(xscale="log", yscale="log", xlabel=AXES[name])
    axes["seconds"].legend(fontsize=7, loc="upper left", bbox_to_anchor=(0.0, -0.09), ncols=3)
    axes["seconds"].set_ylabel("relative error")
    save(figure, folder, problem.name.lower(), f"CPU seconds: median of {repeats} runs in one process. {COMMAND}")


def spread(values: Iterable[int]) -> float:
    """Largest over smallest of those that are not 0."""
    there = [value for value in values if value]
    return max(there, default=1) / min(there, default=1)


if __name__ == "__main__":
    raise SystemExit(main())
