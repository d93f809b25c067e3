"""``scripts/figures verification [-o DIR] [--only R01 ...]``: run the cases, print their table, draw their errors."""

from __future__ import annotations

import argparse
import csv
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from sheets import INK, NODE_COLOURS, PALE, ROOT, STYLE, made_with, save, sheet

from figures_verification.case import Outcome, measure
from figures_verification.cases import CASES

EXACT = 1e-9  # bars up to this are of round-off
BOOKS = "energy balance"
PANELS = {
    "R02": "R02 stick-slip oscillator", "R03": "R03 waves through a joint", "R05": "R05 diffusion in a joint that opens",
    "R06": "R06 Wijesinghe", "R07": "R07 cracks", "R08": "R08 slip by injection (Viesca)",
    "R": "R04, R11, R16 KGD, R17 T, R19 slider", "exact": "To round-off",
}  # fmt: skip
MARKS = "osv^D"
SIGNS = dict(zip(MARKS, "●■▼▲◆", strict=True))
COMMAND = "scripts/figures verification"


def main() -> int:
    """Exit code 1 if a bar is missed."""
    parser = argparse.ArgumentParser(prog=COMMAND, description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "runs" / "figures" / "verification", metavar="DIR")
    parser.add_argument("--only", nargs="+", default=["R"], metavar="REFERENCE", help="R01 ..., or beginnings of names")
    given = parser.parse_args()
    chosen = [case for case in CASES if case.name.startswith(tuple(given.only))]
    if not chosen:
        parser.error(f"no case begins with {' '.join(given.only)}; they are R01 to R19")
    outcomes = [outcome for case in chosen for outcome in measure(case)]
    given.output.mkdir(parents=True, exist_ok=True)
    write(outcomes, given.output / "verification.csv")
    with matplotlib.rc_context(STYLE):
        draw(outcomes, given.output)
    print(table(outcomes))
    return 0 if all(outcome.ok for outcome in outcomes) else 1


def table(outcomes: Sequence[Outcome]) -> str:
    """All of it as Markdown, a line a case; variants that are all exact share one, and so do the books."""
    books = [outcome._replace(case=BOOKS.capitalize()) for outcome in outcomes if outcome.observable == BOOKS]
    rest = [outcome for outcome in outcomes if outcome.observable != BOOKS]
    lines = ["| case | observable | error | order | asked | bar | |", "|---|---|---|---|---|---|---|"]
    return "\n".join([*lines, *(row(name, list(group)) for name, group in groupby([*rest, *books], key=title))])


def title(outcome: Outcome) -> str:
    """The case, without its variant if it is exact."""
    return outcome.case.partition(", ")[0] if outcome.most <= EXACT else outcome.case


def share(outcome: Outcome) -> float:
    """Error over its bar."""
    return float(outcome.errors[-1] / outcome.most)


def row(name: str, group: Sequence[Outcome]) -> str:
    """A line of the table: the worst of each observable."""
    worst = [
        max((o for o in group if o.observable == name), key=share)
        for name in dict.fromkeys(o.observable for o in group)
    ]
    variants = len({outcome.case for outcome in group})
    orders = [f"{o.order:.2f}" for o in worst if o.order is not None]
    bars = [f"{o.most:.2g}" for o in worst]
    least = {f"{o.bar.order:g}" for o in worst if o.bar.order is not None}
    cells = (
        f"{name} ({variants} variants)" if variants > 1 else name,
        ", ".join(o.observable for o in worst),
        ", ".join(f"{o.errors[-1]:.1e}" for o in worst),
        ", ".join(orders),
        ", ".join(asked(worst)),
        ", ".join(bars if len(set(bars)) > 1 else bars[:1]) + (f"; order {min(least)}" if least else ""),
        "**missed**" if not all(o.ok for o in group) else "ok" if all(o.reaches for o in group) else "not reached",
    )
    return "| " + " | ".join(cells) + " |"


def asked(outcomes: Sequence[Outcome]) -> list[str]:
    """The demands of theory or of a benchmark: exactness, orders, errors of observables."""
    exact = ["exact"] if all(o.most <= EXACT for o in outcomes) else []
    orders = sorted({f"order {o.bar.theory}" for o in outcomes if o.bar.theory})
    return exact + orders + [f"{o.observable} to {o.bar.asked:g}" for o in outcomes if o.bar.asked is not None]


def write(outcomes: Sequence[Outcome], path: Path) -> None:
    """All errors by size, under the machine and the versions."""
    with path.open("w", encoding="utf-8", newline="") as file:
        file.writelines(f"# {line}\n" for line in (*made_with(), f"command: {COMMAND}"))
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(["case", "observable", "by", "size", "error", "order", "asked", "bar", "least_order", "ok"])
        for outcome in outcomes:
            for size, error in zip(outcome.sizes, outcome.errors, strict=True):
                held_to = ("; ".join(asked([outcome])), outcome.most, outcome.bar.order, outcome.ok)
                values = (f"{size:.9g}", f"{error:.9g}", outcome.order)
                rows.writerow([outcome.case, outcome.observable, outcome.by, *values, *held_to])


def draw(outcomes: Sequence[Outcome], folder: Path) -> None:
    """Errors against sizes, a panel a reference; what is exact in one."""
    figure, axes = sheet(
        "Held against closed forms",
        "Error against the size of cells or time steps, relative; short lines are the bars, dotted ones slopes 1 and 2.",
        [list(PANELS)[:4], list(PANELS)[4:]],
        (20.0, 8.5),
    )
    inexact = [outcome for outcome in outcomes if outcome.most > EXACT]
    for key, axis in axes.items():
        axis.set_title(PANELS[key])
        if key == "exact":
            strips(axis, [outcome for outcome in outcomes if outcome.most <= EXACT])
        else:
            chosen = [o for o in inexact if (o.case[:3] if o.case[:3] in PANELS else "R") == key]
            curves(axis, chosen)
    note = f"Sizes in the units of each case; sources in scripts/figures_verification/cases. {COMMAND}"
    save(figure, folder, "verification", note)


def curves(axis: Axes, outcomes: Sequence[Outcome]) -> None:
    """Errors of each case in a colour and of each observable with a mark, over the smallest size; the bars there."""
    observables = list(dict.fromkeys(outcome.observable for outcome in outcomes))
    for number, (name, group) in enumerate(groupby(outcomes, key=lambda outcome: outcome.case)):
        paint, line = NODE_COLOURS[number % len(NODE_COLOURS)], "-" if number < len(NODE_COLOURS) else "--"
        label = name[4:].removeprefix("Viesca, ").removeprefix("Wijesinghe, ").removeprefix("Wijesinghe ")
        for outcome in group:
            mark = MARKS[observables.index(outcome.observable) % len(MARKS)]
            refined = outcome.sizes / outcome.sizes[-1]
            axis.loglog(refined, outcome.errors, line, marker=mark, ms=4, lw=1, color=paint, label=label)
            axis.plot(0.93, outcome.most, "_", color=paint, ms=8)
            label = ""
    if not outcomes:
        return
    least, refined = min(float(outcome.errors.min()) for outcome in outcomes), np.array([1.0, 4.0])
    for slope in (1, 2):
        axis.plot(refined, 0.5 * least * refined**slope, ":", color=INK, lw=0.8)
    axis.set_xticks([1, 2, 4], ["1", "2", "4"])
    axis.minorticks_off()
    marks = ", ".join(f"{SIGNS[MARKS[i % len(MARKS)]]} {name}" for i, name in enumerate(observables))
    axis.set_xlabel(f"size over the smallest: {marks}", fontsize=7.5)
    axis.legend(fontsize=6.5, loc="upper left", bbox_to_anchor=(1.0, 1.0), labelspacing=0.3)


def strips(axis: Axes, outcomes: Sequence[Outcome]) -> None:
    """The exact cases, a row a reference: the errors of all sizes, and the bars."""
    names = sorted({outcome.case[:3] for outcome in outcomes}, reverse=True)
    for height, name in enumerate(names):
        group = [outcome for outcome in outcomes if outcome.case.startswith(name)]
        errors = np.maximum(np.concatenate([outcome.errors for outcome in group]), 1e-17)
        spread = height + np.linspace(-0.25, 0.25, len(errors))
        axis.semilogx(errors, spread, "o", ms=3, color=NODE_COLOURS[0])
        for most in {outcome.most for outcome in group}:
            axis.plot([most, most], [height - 0.35, height + 0.35], color=PALE, lw=2)
    axis.set(yticks=range(len(names)), yticklabels=names, xlabel="error")


if __name__ == "__main__":
    raise SystemExit(main())
