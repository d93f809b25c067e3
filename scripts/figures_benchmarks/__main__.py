"""``scripts/figures benchmarks [-o DIR] [--only NAME ...] [--alone]``: run public problems, print their table, draw them.

Exit code 1 where an error or an order is off its bar.
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Sequence
from pathlib import Path

import matplotlib
from sheets import ROOT, STYLE, made_with

from figures_benchmarks.benchmark import Result, front, measure, start
from figures_benchmarks.cases import BENCHMARKS
from figures_benchmarks.pictures import chart, curves

COMMAND = "scripts/figures benchmarks"


def main() -> int:
    """Exit code 1 if a bar is missed."""
    parser = argparse.ArgumentParser(prog=COMMAND, description=__doc__)
    folder = ROOT / "runs" / "figures" / "benchmarks"
    parser.add_argument("-o", "--output", type=Path, default=folder, metavar="DIR")
    parser.add_argument("--only", nargs="+", default=[""], metavar="NAME", help="beginnings of names, as on the chart")
    parser.add_argument("--alone", action="store_true", help="without other programs: installs nothing")
    given = parser.parse_args()
    named = tuple(name.lower() for name in given.only)
    chosen = [each for each in BENCHMARKS if each.short.lower().startswith(named)]
    if not chosen:
        parser.error(
            f"no name begins with {' '.join(given.only)}; they are {', '.join(each.short for each in BENCHMARKS)}"
        )
    given.output.mkdir(parents=True, exist_ok=True)
    print(f"a process that runs next to nothing takes {start():.2f} CPU s, counted in all below", flush=True)
    results = []
    for benchmark in chosen:
        results.append(measure(benchmark, None if given.alone else ROOT / "runs" / "bench" / "peers" / "ogs"))
        print(row(results[-1]), flush=True)
    write(results, given.output)
    with matplotlib.rc_context(STYLE):
        chart(results, given.output, COMMAND)
        curves(results, given.output, COMMAND)
    print(table(results))
    return 0 if all(result.ok for result in results) else 1


def table(results: Sequence[Result]) -> str:
    """All of it as Markdown, with the sources below."""
    head = [
        "| problem | errors of | error | order | bar | CPU s | another program at that error | |",
        "|---|---|---|---|---|---|---|---|",
    ]
    about = [
        f"- **{one.name}.** {one.source[0].upper()}{one.source[1:]}. Not verified: {one.open}."
        for one in (result.benchmark for result in results)
    ]
    return "\n".join([*head, *map(row, results), "", *about])


def row(result: Result) -> str:
    """A line of the table: errors at the smallest size, and the CPU of each size."""
    found = result.outcomes
    orders = [f"{each.order:.1f}" if each.order is not None else "-" for each in found]
    short = [f"{each.bar.asked:g}" for each in found if not each.reaches and each.bar.asked]
    cells = (
        result.benchmark.name,
        ", ".join(each.observable for each in found),
        ", ".join(f"{each.errors[-1]:.1e}" for each in found),
        ", ".join(orders) if set(orders) != {"-"} else "",
        ", ".join(f"{each.most:.2g}" for each in found),
        ", ".join(f"{ran.seconds:.1f}" for ran in result.runs),
        "; ".join(beside(result)),
        "**missed**" if not result.ok else f"{max(short)} asked for, not reached" if short else "ok",
    )
    return "| " + " | ".join(cells) + " |"


def beside(result: Result) -> list[str]:
    """CPU seconds of other programs at the error of the finest run, or at their own least error if that is larger."""
    said = []
    for name in dict.fromkeys((each.program, each.here) for each in result.others):
        best = front([each for each in result.others if (each.program, each.here) == name])
        error = float(result.outcomes[0].errors[-1])
        enough = [each for each in best if each.error <= 1.05 * error]
        shown = min(enough, key=lambda each: each.seconds) if enough else best[-1]
        at = "" if enough else f" ({shown.error:.1e})"
        said.append(f"{name[0]} {shown.seconds:.2g}{at}{'' if name[1] else ', not run here'}")
    return said


def write(results: Sequence[Result], folder: Path) -> None:
    """All errors and CPU seconds, under the machine and the versions."""
    with (folder / "benchmarks.csv").open("w", encoding="utf-8", newline="") as file:
        file.writelines(
            f"# {line}\n" for line in (*made_with(), f"command: {COMMAND}", f"start: {start():.2f} CPU s, counted")
        )
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(["benchmark", "program", "by", "size", "observable", "error", "cpu_s", "bar", "ran_here"])
        for benchmark, runs, outcomes, others in results:
            for outcome in outcomes:
                for size, error, ran in zip(outcome.sizes, outcome.errors, runs, strict=True):
                    values = (
                        f"{size:.6g}",
                        outcome.observable,
                        f"{error:.6g}",
                        f"{ran.seconds:.3f}",
                        outcome.most,
                        True,
                    )
                    rows.writerow([benchmark.name, "fracflow", benchmark.by, *values])
            for other in others:
                values = (outcomes[0].observable, f"{other.error:.6g}", f"{other.seconds:.3f}", "", other.here)
                rows.writerow([benchmark.name, other.program, "", "", *values])


if __name__ == "__main__":
    raise SystemExit(main())
