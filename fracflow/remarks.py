"""Notes and warnings: lines of ``check``, of a run and of its log. A reader is to act on a warning, not on a note.

A note is marked where it is written. In a list of remarks a line without a mark is a warning; in a log it is one that every
run has.
"""

from __future__ import annotations

from collections.abc import Iterable

ACT, NOTE = "! ", "note: "
GIVEN_UP = "step given up: "  # before the error of a step in a log


def note(line: str) -> str:
    """A line about which nothing is to be done: results are those of the scene as it is stated."""
    return NOTE + line


def marked(line: str) -> str:
    """A remark with its mark, as a terminal and a log show it: that of a warning unless it is a note."""
    return line if has_mark(line) else ACT + line


def has_mark(line: str) -> bool:
    """Whether a line of a log is a note or a warning."""
    return line.startswith((ACT, NOTE))


def bare(line: str) -> str:
    """A line without the mark before it."""
    return line.removeprefix(NOTE).removeprefix(ACT)


def parted(lines: Iterable[str]) -> tuple[list[str], list[str]]:
    """Warnings and notes of a list of remarks, without their marks."""
    found: tuple[list[str], list[str]] = ([], [])
    for line in lines:
        found[line.startswith(NOTE)].append(bare(line))
    return found


def counted(count: int, what: str) -> str:
    """So many things: "1 rank", "2 ranks"."""
    return f"{count} {what}{'' if count == 1 else 's'}"


def digits(value: float, count: int = 2) -> str:
    """A number of so many significant digits, without an exponent below 1e10: "530"."""
    return f"{float(f'{value:.{count}g}'):.10g}"
