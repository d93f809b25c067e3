"""Moment released against the largest event of each schedule, the front of the best, and what a finer mesh makes of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from rich.console import Console
from rich.table import Table
from sheets import BLUE, GREEN, INK, ORANGE, PALE, Check, save, sheet, write_csv

from figures_schedules.study import WELLS, Found, Schedule, follow
from fracflow import SolveError

CLOSED, DROPPED = 1e-6, 1e-3  # of an event's energy
COLUMNS = 3
BILLION = 1e9


def front(found: Sequence[Found]) -> list[int]:
    """Those that none beats: no other releases as much by a smaller largest event; in the order of their largest events."""
    order = sorted(range(len(found)), key=lambda i: (found[i].largest, -found[i].total))
    best = [max((found[j].total for j in order[:place]), default=0.0) for place in range(len(order))]
    return [i for i, before in zip(order, best, strict=True) if found[i].total > before]


def draw(folder: Path, schedules: Sequence[Schedule], read: bool = False) -> list[Check]:
    """Run the schedules, the worst twice, and both ends on a mesh twice as fine, or ``read`` these runs; return the bars."""
    failures: list[str] = []

    def attempt(schedule: Schedule, refine: int = 0, again: str = "") -> Found | None:
        try:
            name = f"{schedule.name}-{refine}{again}".replace(" ", "_")
            return follow(schedule, folder / "runs" / name, refine, read)
        except SolveError as failure:
            failures.append(f"{schedule.name}: {failure}")
            return None

    ran = {schedule: found for schedule in schedules if (found := attempt(schedule))}
    best, worst = (choose(ran, key=lambda each: ran[each].ratio) for choose in (max, min))
    fine = {each: found for each in (best, worst) if (found := attempt(each, refine=1))}
    again = attempt(worst, again="-again")
    _table(ran, fine)
    _picture(folder, ran, fine)
    _numbers(folder, ran, fine)
    runs = [*ran.values(), *fine.values(), *([again] if again else [])]
    unclosed, dropped = (max(float(np.max(part, initial=0.0)) for part in parts) for parts in (
        [each.unclosed for each in runs], [each.dropped for each in runs],
    ))  # fmt: skip
    same = again is not None and np.array_equal(again.moment, ran[worst].moment)
    rank = len(fine) == 2 and fine[best].ratio > fine[worst].ratio
    return [
        Check("runs that failed", "; ".join(failures) or "none", "none", not failures),
        Check("runs that end in an event", sum(not each.is_over for each in runs), "0", all(e.is_over for e in runs)),
        Check("books not closed over an event, of its energy", unclosed, f"<= {CLOSED:g}", unclosed <= CLOSED),
        Check("kinetic energy dropped after an event, of its energy", dropped, f"<= {DROPPED:g}", dropped <= DROPPED),
        Check("the same run gives the same events", str(same), "True", same),
        Check(f"moment over largest event: {best.name}", ran[best].ratio, "> 2 and on the front",
              ran[best].ratio > 2.0 and list(ran).index(best) in front([*ran.values()])),
        Check(f"on a finer mesh too above {worst.name}", str(rank), "True", rank),
    ]  # fmt: skip


def _table(ran: Mapping[Schedule, Found], fine: Mapping[Schedule, Found]) -> None:
    table = Table("", "schedule", "events", "moment [1e9 lbf]", "largest event", "moment/largest", "on 12 joints")
    on_front = front([*ran.values()])
    for number, (schedule, found) in enumerate(ran.items()):
        name = schedule.name + (" (front)" if number in on_front else "")
        other = fine.get(schedule)
        finer = f"{other.total / BILLION:.0f}, {other.largest / BILLION:.0f}, {other.ratio:.2f}" if other else ""
        values = f"{found.total / BILLION:.0f}", f"{found.largest / BILLION:.0f}", f"{found.ratio:.2f}"
        table.add_row(str(number + 1), name, str(len(found.moment)), *values, finer)
    Console(highlight=False, width=120).print(table)


def _picture(folder: Path, ran: Mapping[Schedule, Found], fine: Mapping[Schedule, Found]) -> None:
    keys = [str(number) for number in range(len(ran))]
    rows = [keys[first : first + COLUMNS] for first in range(0, len(keys), COLUMNS)]
    mosaic = [["front"] * COLUMNS + row + ["."] * (COLUMNS - len(row)) for row in rows]
    figure, axes = sheet(
        "Moment that wells release along a prestressed fault, against the largest event",
        "Application 5.5, twenty minutes; each number is a schedule; hollow: the same on a mesh twice as fine.",
        mosaic, (11.0, 5.0),
    )  # fmt: skip
    axis, values = axes["front"], list(ran.values())
    best = front(values)
    axis.plot(*_points([values[i] for i in best]), "-", color=GREEN, label="front")
    axis.plot(*_points(values), "o", color=BLUE)
    for number, (schedule, found) in enumerate(ran.items()):
        x, y = found.largest / BILLION, found.total / BILLION
        beside = any(0 < other.largest / BILLION - x < 8 and abs(other.total / BILLION - y) < 20 for other in values)
        axis.annotate(
            str(number + 1),
            (x, y),
            (-4 if beside else 4, 4),
            textcoords="offset points",
            ha="right" if beside else "left",
        )
        if other := fine.get(schedule):
            axis.plot(*_points([found, other]), ":", color=PALE)
            axis.plot(*_points([other]), "o", color=BLUE, markerfacecolor="white")
    axis.axline((0.0, 0.0), slope=1.0, color=INK, linewidth=0.8, linestyle="--", label="all in one event")
    axis.set(
        xlabel="largest event [10⁹ lbf]",
        ylabel="moment released per thickness [10⁹ lbf]",
        xlim=(0, None),
        ylim=(0, None),
    )
    axis.legend(loc="lower right")
    for number, (schedule, found) in enumerate(ran.items()):
        _shape(axes[str(number)], schedule, found, f"{number + 1} {schedule.name}")
    axes["0"].legend(fontsize=5.5, ncols=3, handlelength=0.8, columnspacing=0.8, borderpad=0.0)
    save(
        figure,
        folder,
        "schedules",
        "Small: rates of the three wells [ft³/s] against time, and events (bars, as large as their moments).",
    )


def _points(found: Sequence[Found]) -> tuple[list[float], list[float]]:
    return [each.largest / BILLION for each in found], [each.total / BILLION for each in found]


def _shape(axis: Axes, schedule: Schedule, found: Found, title: str) -> None:
    for name, rates, colour in zip(WELLS, zip(*schedule.rates, strict=True), (BLUE, ORANGE, GREEN), strict=True):
        axis.plot(schedule.times, rates, color=colour, linewidth=1.0, label=name)
    size = axis.twinx()
    size.vlines(found.start, 0.0, found.moment / BILLION, color=INK, linewidth=1.2)
    size.set(ylim=(0.0, 150.0), yticks=[])
    axis.set(ylim=(-26.0, 34.0), xticks=[])
    axis.set_title(title, fontsize=7)
    axis.tick_params(labelsize=6)


def _numbers(folder: Path, ran: Mapping[Schedule, Found], fine: Mapping[Schedule, Found]) -> None:
    numbers = {schedule: number + 1 for number, schedule in enumerate(ran)}
    rows = [(numbers[each], joints, found) for joints, runs in ((6, ran), (12, fine)) for each, found in runs.items()]
    columns = {"schedule": [row[0] for row in rows], "joints": [row[1] for row in rows]}
    columns["events"] = [len(row[2].moment) for row in rows]
    for name in ("total", "largest", "ratio", "pressure"):
        columns[name] = [getattr(row[2], name) for row in rows]
    notes = [
        f"schedule {number}: {each.name}; rates of {', '.join(WELLS)}: {each.rates}" for each, number in numbers.items()
    ]
    events = [
        (row[0], row[1], start, moment)
        for row in rows
        for start, moment in zip(row[2].start, row[2].moment, strict=True)
    ]
    columns |= dict(zip(("of", "of_joints", "start", "moment"), map(list, zip(*events, strict=True)), strict=True))
    write_csv(
        folder,
        "schedules",
        {name: np.array(values) for name, values in columns.items()},
        ["scripts/figures schedules"],
        *notes,
    )
