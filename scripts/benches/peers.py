"""fracflow beside OpenGeoSys on H1, H2 and H3: error, CPU time, memory: peers.py [CASE...] [--repeats N] [--out DIR].

Both run from the inputs in peers/, on the same grids, by turns, on one thread; what counts is CPU time, user and system, of
the whole process, start included, without meshing. OpenGeoSys comes from its wheel, in an environment of its own. The curves
of a program are its choices of elements, grading and solver; at an error a program counts with its fastest.
"""

from __future__ import annotations

import argparse
import csv
import shlex
import shutil
import statistics
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from subprocess import CalledProcessError
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from _peers_cases import Problem, h1, h2, h3
from _peers_run import Cost, Failed, environment, measured, prepare_fracflow, prepare_ogs, read_fracflow, read_ogs
from sheets import BLUE, ORANGE, ROOT, STYLE, Check, judge, made_with, save, sheet

OURS, THEIRS = "fracflow", "OpenGeoSys"
TITLES = {
    "h1": "H1: a crack that slides",
    "h2": "H2: Wijesinghe",
    "h3": "H3: a joint through a specimen",
}
SHOWN = {"h1": ("slip", 0.016), "h2": ("pressure", 0.002)}
"""Case -> observable, and an error at which all curves are shown beside each other."""
SHARES = ((1.0, 1.0), (4.0, 0.5))
"""CPU [s] that OpenGeoSys at its best needs at an error, and the share of it that fracflow may need from there on."""
EXACT = 1e-5  # error of slip that H3 may have
ILUT = {"solver": "BiCGSTAB", "preconditioner": "ILUT"}
FILM = {"flow_integrator": "bdf2", "storage": "lumped", "conductance": "exact"}


@dataclass(frozen=True)
class Curve:
    """A way of running a case: the program, what is chosen, the grids it takes and a marker."""

    case: str
    program: str
    name: str
    problems: Callable[..., Problem]
    sizes: Sequence[tuple[Any, ...]]
    mark: str
    options: Mapping[str, object] = field(default_factory=dict)


def _sizes(kind: str, *cells: int) -> list[tuple[Any, ...]]:
    return [(n, kind) for n in cells]


UNIFORM, GRADED = _sizes("uniform", 10, 20, 40, 100), _sizes("graded", 4, 12, 20, 28, 40, 56, 88)
FEW = [(n, steps, "graded") for n, steps in ((30, 10), (50, 16), (70, 25), (100, 40), (160, 60))]
MANY = [(n, steps, "graded") for n, steps in ((25, 20), (40, 50), (60, 100), (100, 200))]
SQUARE = [(n, n, "uniform") for n in (25, 50, 100)]
CURVES = (
    Curve("h1", OURS, "uniform", h1, UNIFORM, "s"),
    Curve("h1", OURS, "graded to the tips", h1, [*GRADED, (96, "graded")], "o"),
    Curve("h1", THEIRS, "uniform", h1, UNIFORM, "s"),
    Curve("h1", THEIRS, "uniform, 8-node", h1, UNIFORM, "D", {"order": 2}),
    Curve("h1", THEIRS, "graded, ILUT", h1, GRADED, "v", ILUT),
    Curve("h1", THEIRS, "graded, 8-node", h1, _sizes("graded", 8, 12, 16, 24, 32), "^", {"order": 2}),
    Curve("h2", OURS, "BDF2, monolithic", h2, FEW, "s", FILM | {"coupling": "monolithic"}),
    Curve("h2", OURS, "BDF2", h2, FEW, "o", FILM | {"coupling": "auto"}),
    Curve("h2", THEIRS, "as its own test: 8-node, wet rock", h2, SQUARE, "D", {"order": 2, "dry_rock": "false"}),
    Curve("h2", THEIRS, "4-node, dry rock, graded", h2, MANY, "o"),
    Curve("h3", OURS, "", h3, [(8,), (16,), (32,), (64,), (128,)], "o"),
    Curve("h3", THEIRS, "", h3, [(8,), (16,), (32,), (64,), (128,)], "o"),
)  # fmt: skip


def at_error(points: Sequence[tuple[float, float]], error: float) -> float | None:
    """CPU time of a curve of (error, seconds) at an error, log-log along its front; None beyond its points."""
    best: list[tuple[float, float]] = []  # from cheap to exact, without what others beat in both
    for wrong, cost in sorted(points, key=lambda point: (point[1], point[0])):
        if not best or wrong < best[-1][0]:
            best.append((wrong, cost))
    errors, seconds = np.log(np.array(best[::-1])).T
    if len(points) < 2 or not min(errors) <= np.log(error) <= np.log(max(wrong for wrong, _ in points)):
        return None
    return float(np.exp(np.interp(np.log(error), errors, seconds)))


def times(rows: Sequence[Mapping[str, Any]], case: str, program: str, error: float) -> dict[str, float]:
    """CPU time of each curve of a program at an error, the fastest first; without those that do not reach it."""
    observable, _ = SHOWN[case]
    mine = [row for row in rows if (row["case"], row["program"]) == (case, program) and not row["failure"]]
    found = {
        name: at_error([(row[observable], row["cpu_s"]) for row in mine if row["choice"] == name], error)
        for name in dict.fromkeys(row["choice"] for row in mine)
    }
    known = {name: seconds for name, seconds in found.items() if seconds is not None}
    return dict(sorted(known.items(), key=lambda item: item[1]))


def start(rows: Sequence[Mapping[str, Any]], program: str) -> float:
    """CPU time of a program on the smallest grid of all, where there is next to nothing to solve."""
    return min((row["cpu_s"] for row in rows if row["program"] == program and not row["failure"]), default=0.0)


def once(curve: Curve, size: tuple[Any, ...], folder: Path, program: Path) -> tuple[Cost, dict[str, float], int]:
    """Run a program on one grid: what it took, its errors, the nodes. Raises Failed."""
    problem = curve.problems(*size)
    shutil.rmtree(folder, ignore_errors=True)
    if curve.program == OURS:
        cost = measured(prepare_fracflow(problem, curve.options, folder), folder)
        found = read_fracflow(folder)
    else:
        cost = measured(prepare_ogs(problem, curve.options, folder, program), folder)
        found = read_ogs(folder, int(problem.values["steps"]))
    return cost, problem.errors(found), len(problem.made.points)


def measure(cases: Sequence[str], repeats: int, out: Path, program: Path) -> list[dict[str, Any]]:
    """All curves of the cases, the programs by turns; medians. A run that failed has no second try."""
    tasks = [
        (curve, size)
        for level in range(max(len(curve.sizes) for curve in CURVES))
        for curve in sorted(CURVES, key=lambda c: (c.case, [c.name for c in CURVES].index(c.name), c.program))
        if curve.case in cases
        for size in curve.sizes[level : level + 1]
    ]
    rows: dict[int, dict[str, Any]] = {}
    costs: dict[int, list[Cost]] = {number: [] for number in range(len(tasks))}
    for turn in range(repeats):
        for number, (curve, size) in enumerate(tasks):
            row = rows.setdefault(number, {
                "case": curve.case, "program": curve.program, "choice": curve.name, "size": " ".join(map(str, size)),
                "nodes": 0, "slip": "", "pressure": "", "aperture": "", "failure": "",
            })  # fmt: skip
            if row["failure"]:
                continue
            try:
                cost, errors, nodes = once(curve, size, out / curve.case / curve.program, program)
            except Failed as error:
                row["failure"] = str(error)
                print(f"{curve.case} {curve.program} {curve.name} {size}: {error}", flush=True)
                continue
            costs[number].append(cost)
            row |= {"nodes": nodes, **errors}
            said = ", ".join(f"{name} {value:.4g}" for name, value in errors.items())
            print(
                f"{turn + 1}/{repeats} {curve.case} {curve.program:10} {curve.name:34} {nodes:6} nodes"
                f" {cost.seconds:8.2f} s {cost.memory:6.0f} MB  {said}", flush=True,
            )  # fmt: skip
    for number, taken in costs.items():
        for key, values in (("cpu_s", [c.seconds for c in taken]), ("memory_MB", [c.memory for c in taken])):
            rows[number][key] = statistics.median(values) if values else ""
    return list(rows.values())


def front(rows: Sequence[Mapping[str, Any]], case: str) -> list[Mapping[str, Any]]:
    """The runs of OpenGeoSys that SHARES speaks of: long ones that no other curve of it beats at their error."""
    long = [row for row in rows if (row["case"], row["program"]) == (case, THEIRS) and not row["failure"]]
    long = [row for row in long if row["cpu_s"] >= SHARES[0][0]]
    if case not in SHOWN:
        return long
    observable, _ = SHOWN[case]
    best = [min(times(rows, case, THEIRS, row[observable]).values(), default=np.inf) for row in long]
    return [row for row, least in zip(long, best, strict=True) if row["cpu_s"] <= least * (1.0 + 1e-9)]


def beside(rows: Sequence[Mapping[str, Any]], row: Mapping[str, Any]) -> tuple[str, float | None]:
    """Where fracflow is as exact as a run of OpenGeoSys, in words, and its CPU time there; None where it is not."""
    case = row["case"]
    if case in SHOWN:
        observable, _ = SHOWN[case]
        ours = times(rows, case, OURS, row[observable])
        return f"{observable} error {row[observable]:.2g}", min(ours.values(), default=None)
    mine = [each for each in rows if (each["case"], each["program"], each["nodes"]) == (case, OURS, row["nodes"])]
    exact = [each["cpu_s"] for each in mine if not each["failure"] and each["slip"] < EXACT]
    return f"{row['nodes']} nodes, slip error < {EXACT:g}", min(exact, default=None)


def checks_of(rows: Sequence[Mapping[str, Any]]) -> list[Check]:
    """CPU times over those of OpenGeoSys at its best, where that takes long; all curves at one error are printed."""
    checks = []
    for case in dict.fromkeys(row["case"] for row in rows):
        if case in SHOWN:
            observable, error = SHOWN[case]
            print(f"{case.upper()}, {observable} error {error:g}")
            for program in (OURS, THEIRS):
                for choice, seconds in times(rows, case, program, error).items():
                    print(f"  {program} {choice}: {seconds:.2f} s, of which {start(rows, program):.2f} s to start")
        if not any(row["case"] == case and row["program"] == THEIRS and not row["failure"] for row in rows):
            checks.append(Check(f"{case.upper()}: {THEIRS}", "no run that ended", "runs", False))
        for row in front(rows, case):
            where, seconds = beside(rows, row)
            share = max((least, share) for least, share in SHARES if row["cpu_s"] >= least)[1]
            name = f"{case.upper()}, {where}: CPU over {row['cpu_s']:.1f} s of {THEIRS} {row['choice']}".rstrip()
            found = "not reached" if seconds is None else seconds / row["cpu_s"]
            checks.append(Check(name, found, f"<= {share:g}", seconds is not None and seconds <= share * row["cpu_s"]))
    return checks


def draw(rows: Sequence[Mapping[str, Any]], out: Path) -> None:
    """peers.png: error against CPU time of H1 and H2, CPU time against nodes of H3."""
    import matplotlib

    cases = [case for case in TITLES if any(row["case"] == case and not row["failure"] for row in rows)]
    with matplotlib.rc_context(STYLE):
        figure, axes = sheet(
            "fracflow and OpenGeoSys 6.5.9",
            "CPU time of the whole process, start included; the same grids; dotted: the errors at which they are compared",
            [cases], (1.0 + 4.2 * len(cases), 5.0),
        )  # fmt: skip
        for case, axis in axes.items():
            observable = SHOWN[case][0] if case in SHOWN else "nodes"
            for curve in CURVES:
                mine = [
                    row for row in rows
                    if (row["case"], row["program"], row["choice"]) == (case, curve.program, curve.name) and not row["failure"]
                ]  # fmt: skip
                if curve.case != case or not mine:
                    continue
                axis.loglog(
                    [row[observable] for row in mine], [row["cpu_s"] for row in mine], marker=curve.mark, ms=4.5,
                    color=BLUE if curve.program == OURS else ORANGE, label=f"{curve.program} {curve.name}".strip(),
                )  # fmt: skip
            if case in SHOWN:
                axis.axvline(SHOWN[case][1], color="0.4", ls=":", lw=1.0)
            axis.set(
                title=TITLES[case], xlabel=f"error of {observable}" if case in SHOWN else "nodes", ylabel="CPU time [s]"
            )
            axis.legend(fontsize=7.5)
        save(figure, out, "peers", "scripts/bench peers")


def write(rows: Sequence[Mapping[str, Any]], out: Path) -> None:
    """peers.csv, with machine, versions and command above its columns."""
    notes = (*made_with(), "command: " + shlex.join(["scripts/bench", "peers", *sys.argv[1:]]))
    with (out / "peers.csv").open("w", encoding="utf-8", newline="") as file:
        file.writelines(f"# {note}\n" for note in notes)
        table = csv.DictWriter(file, list(rows[0]))
        table.writeheader()
        table.writerows(rows)


def main() -> int:
    """Measure, print, draw; 1 where a bar is missed."""
    parser = argparse.ArgumentParser(prog="scripts/bench peers", description=__doc__.splitlines()[0])
    parser.add_argument("cases", nargs="*", type=str.lower, help="of H1, H2, H3; default all")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--out", type=Path, default=ROOT / "runs" / "bench" / "peers", help="folder of the results")
    given = parser.parse_args()
    unknown = [case for case in given.cases if case not in TITLES]
    if unknown or given.repeats < 1:
        parser.error(f"cases are H1, H2, H3, and repeats at least 1; not {' '.join(unknown) or given.repeats}")
    out = given.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    try:
        program = environment(out / "ogs")
    except CalledProcessError as error:
        print(f"scripts/bench peers: OpenGeoSys cannot be installed ({error}), so nothing is shown", file=sys.stderr)
        return 1
    rows = measure(given.cases or list(TITLES), given.repeats, out, program)
    write(rows, out)
    draw(rows, out)
    return judge(checks_of(rows), out)


if __name__ == "__main__":
    raise SystemExit(main())
