"""The answer of ``fracflow check``: can the scene be run, what is to be done first, and the numbers that matter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from fracflow.cli.report import WIDTH
from fracflow.mesh.plane.near import LINE, near_ones
from fracflow.output.remarks import alike, part_of, saved
from fracflow.remarks import ACT, NOTE, parted

SIZES = ("cells", "displacement unknowns", "pressure unknowns", "steps")
"""Sizes that the short answer has; those of which no more than the cost follows."""
TIMES = ("mesh of the first event", "memory", "explicit steps", "each event", "slow slip", "time of")
"""Beginnings of the lines on cost."""
BAD = ("cells under", "cells over")  # of an angle: shown where there are any
VERDICTS = ("left out", "added", "not in the scene", "kept")
MOST_NOTES, LONGEST_NOTE = 8, 180  # lines and letters of the notes in the short answer
Records = Sequence[Mapping[str, Any]]


def short_answer(
    title: str, sizes: Mapping[str, Any], lines: Sequence[str], numbers: Records, plan: Records, console: Console
) -> None:
    """Print whether a scene can be run, what is to be done first, its size and cost, and the numbers that are bounded.

    sizes  as ``set_up`` finds them
    lines  warnings and notes
    """
    warnings, notes = parted(lines)
    acts = [f"{each['name']}: {each['remedy']}" for each in numbers if each["out_of_range"]]
    near = near_ones(warnings)
    passed = [line for line in warnings if line.startswith(LINE) and line not in near]
    acts += near + alike(line for line in warnings if line not in near and line not in passed)
    notes = alike(notes)

    def say(line: str) -> None:
        console.print(line, soft_wrap=True, markup=False)

    found = f"{len(acts)} thing{'s' * (len(acts) > 1)} to look at first" if acts else "nothing needs to be changed"
    say(f"{title}: can be run; {found}")
    for line in acts:
        say(ACT + line)
    for key, value in sizes.items():
        is_count = key in SIZES or (key == "joints" and not sizes.get("cells", 1))
        if is_count or key.startswith(TIMES) or (key.startswith(BAD) and value):
            say(size_line(key, value))
    bounded = [each for each in numbers if each["out_of_range"] or each["limit_text"]]
    if bounded:
        report_checks(bounded, console, "Pre-run checks that have a limit", remedies=False)
    parts = {verdict: [each for each in plan if each["verdict"] == verdict] for verdict in VERDICTS}
    exact = [each for each in parts["left out"] if each["error"].startswith("none")]
    listed = [("left out, exact", exact), *((verdict, parts[verdict]) for verdict in VERDICTS[1:])]
    for each in (each for each in parts["left out"] if each not in exact):
        say(f"left out: {part_of(each)}; may err by: {each['error']}")
    for word, those in listed:
        if those:
            say(f"{word}: {'; '.join(map(part_of, those))}")
    for line in notes[:MOST_NOTES]:
        say(NOTE + _first_words(line))
    rest = [f"{len(numbers)} numbers, criteria, all sizes"]
    more = (len(passed), "near misses"), (len(notes) - MOST_NOTES, "notes")
    rest += [f"{many} more {what}" for many, what in more if many > 0]
    say(f"with --all: {', '.join(rest)}")


def whole_answer(
    sizes: Mapping[str, Any], lines: Sequence[str], numbers: Records, plan: Records, console: Console
) -> None:
    """Print all of it: the pre-run checks, the plan with its criteria, sizes and cost, warnings, then notes."""
    report_checks(numbers, console)
    report_plan(plan, console)
    warnings, notes = parted(lines)
    for line in (*(size_line(key, value) for key, value in sizes.items()), *(ACT + each for each in warnings)):
        console.print(line, soft_wrap=True, markup=False)
    for line in notes:
        console.print(NOTE + line, soft_wrap=True, markup=False)


def size_line(key: str, value: Any) -> str:
    """One of the sizes that ``set_up`` finds, in words where there are no cells."""
    return "cells: none, the rock is not meshed" if key == "cells" and not value else f"{key}: {shown(value)}"


def shown(value: Any) -> str:
    """A count, a number or a table of numbers as the terminal shows it."""
    if isinstance(value, dict):
        return ", ".join(f"{name} {shown(each)}" for name, each in value.items())
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _first_words(line: str) -> str:
    """A line, or as much of it as ends at a stop."""
    if len(line) <= LONGEST_NOTE:
        return line
    cut = max(line.rfind(stop, 0, LONGEST_NOTE) for stop in ("; ", ", ", ": "))
    return f"{line[: cut if cut > 0 else LONGEST_NOTE]} ..."


def report_checks(numbers: Records, console: Console, title: str = "Pre-run checks", remedies: bool = True) -> None:
    """Print the records of the pre-run checks: a line each, and a remedy for each number out of range."""
    table = Table(title=title, title_style="bold", box=None, pad_edge=False)
    for head in ("", "number", "value", "limit", "where"):
        table.add_column(head, overflow="fold", no_wrap=head in ("", "value"))
    for number in numbers:
        value = number["value_text"] or "-"
        limit = _bound(number) or (f"({number['note']})" if number["note"] else "-")
        mark = "!" if number["out_of_range"] else ""
        cells = (mark, f"{number['name']} {number['formula'].partition(' = ')[0]}", value, limit, number["where"])
        table.add_row(*map(escape, cells), style="bold" if mark else "")
    console.print(table)
    for number in numbers:
        if remedies and number["out_of_range"]:
            console.print(f"{ACT}{number['name']}: {number['remedy']}", soft_wrap=True, markup=False)


def _bound(number: Mapping[str, Any]) -> str:
    """The limit of a number, with the side on which values are in range; empty without one."""
    value, limit = number["value"], number["limit"]
    if value is None or limit is None:
        return str(number["limit_text"] or "")
    return f"{'<' if (value > limit) == number['out_of_range'] else '>'} {number['limit_text']}"


def report_plan(decisions: Records, console: Console) -> None:
    """Print the records of a plan, a table for each verdict: what is left out first."""
    verdicts = dict.fromkeys(each["verdict"] for each in sorted(decisions, key=lambda each: not each["left_out"]))
    for verdict in verdicts:
        table = Table(title=f"Plan: {verdict}", title_style="bold", box=None, pad_edge=False, padding=(0, 2, 0, 0))
        table.width = min(console.width, WIDTH)
        heads = ("part", 5), ("criterion: value (limit)", 10), ("saves" if verdict == "left out" else "why", 8)
        for head, share in heads:
            table.add_column(head, ratio=share, overflow="fold")
        for each in (each for each in decisions if each["verdict"] == verdict):
            value, limit = (f"{x:.3g}" if isinstance(x, float) else str(x) for x in (each["value"], each["limit"]))
            error = "" if verdict == "kept" or not each["error"] else f"; may err by: {each['error']}"
            why = f"{each['criterion']}: {value} (limit: {limit})"
            table.add_row(*map(escape, (part_of(each), why, saved(each) + error)))
        console.print(table)
