"""Lines of ``check``, of a run and of its log, by what a reader is to do with them: nothing, know it, or act on it."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from math import isfinite
from typing import Any

ACT, MARK = "! ", "note: "  # before a warning, and before a note
_ROUTINE = re.compile(
    r"^well\..* is on (?!.* from where it was asked)|"
    r"^(check|card|plan|stopped:|probe\.(?!.*read slip)|fracflow |stage \d|stage .*: longest period|geometry\.(snap|size))"
    r"|^absorbing |^geometry\.growth = \S+: rock far"
    r"|^(incipient failure|work in all:|\d+ steps,)|an event begins|limit point:|at rest|trials rejected|first failure"
)
"""Lines of a log that every run has, or that its histories show."""
_TOLD = (
    r"^\S+\.\S+: this key is now called ",
    r"^well\..* is on ",
    r", \S+( \S+)? from where it was asked$",
    r"^geometry\.(snap|size\w*) = ",
    r"^geometry\.growth = \S+: (rock far|beside fractures that weaken)",
    r"^rock condensed to its joints, ",
    r": cut at .*, where it leaves the domain",
    r": shares \S+ from .*, which keeps it$",
    r" moved by \S+ to ",
    r": bent by \S+ to ",
    r"^cells of \S+, \S+ of size_at_fractures, at ",
    r": options of Gmsh's window are passed over: ",
    r"^absorbing .*(: of an? [PS] wave |: the wave leaves by this side)",
    r"^cells at faults are damped",
    r": behind sharp fronts slip_rate rings ",
    r"(no pressure is prescribed in .* settled by|^time \S+.*: nor in \d+ more parts)",
    r": spurious power is watched$",
    r"^resumed after ",
    r"^explicit: ",
    r"^leak_off: by the end pressure goes ",
    r": multigrid \(BoomerAMG\)",
    r"^equilibrium: ",
    r"a plain cycle of the fixed point ",
    r": handed over to ",
    r"^step halved: ",
    r"this step goes by backward Euler$",
    r"^no state found at control\.",
    r": already at incipient failure$",
    r"; the network has \d+ parts$",
    r": parts of steps by ",
    r"^the run that was in .* is replaced$",
    r"^slip that begins where another fracture slides: ",
    r": time steps made an error of (?!.*more than asked)",
    r"^spurious work of the coupling: ",
    r" joint ends conducted by minimum_hydraulic_aperture, ",
)
"""Patterns of lines on what was done, about which nothing is to be done; any other line is a warning."""
_NOTE = re.compile("|".join(_TOLD))
_COORDINATE = r"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?"
_LIMIT = re.compile(
    r"limit point: (?:.* is near: )?"
    rf"(?P<words>fracture .*? at \((?P<x>{_COORDINATE}), (?P<y>{_COORDINATE})\), slipping patch [^;]*)"
)
_DIFFERS = re.compile(r"^(probe|well)\.\S+|\bof \S+ is\b|[-+.\d]+(e[-+]?\d+)?")


def bare(line: str) -> str:
    """A line without the mark before it."""
    return line.removeprefix(MARK).removeprefix(ACT)


def is_note(line: str) -> bool:
    """Whether nothing is to be done about a line: results are those of the scene as it is stated."""
    return _NOTE.search(bare(line)) is not None


def is_routine(line: str) -> bool:
    """Whether a line of a log stands in that of every run."""
    return not line.strip() or _ROUTINE.search(bare(line)) is not None


def marked(line: str) -> str:
    """A line as a terminal shows it: a warning after "! ", another one after "note: "."""
    return f"{MARK if is_note(line) else ACT}{line}"


def parted(lines: Iterable[str]) -> tuple[list[str], list[str]]:
    """Warnings and notes of a list of lines."""
    found: tuple[list[str], list[str]] = ([], [])
    for line in lines:
        found[is_note(line)].append(line)
    return found


def alike(lines: Iterable[str]) -> list[str]:
    """The first of the lines that differ by their numbers and names alone, with how many more there are."""
    found: dict[str, list[str]] = {}
    for line in lines:
        found.setdefault(_DIFFERS.sub("#", line)[:120], []).append(line)
    return [group[0] + (f" (and {len(group) - 1} more like it)" if len(group) > 1 else "") for group in found.values()]


def last_limit(lines: Iterable[str]) -> tuple[str, tuple[float, float]] | None:
    """The last limit point of a log, in words and its place in the plane [length]; None where there is none."""
    found = [match for line in lines if (match := _LIMIT.search(line))]
    places = [(float(match["x"]), float(match["y"])) for match in found[-1:]]
    return (found[-1]["words"], places[0]) if places and all(map(isfinite, places[0])) else None


def part_of(decision: Mapping[str, Any]) -> str:
    """The part of the model that a decision's record is about, with its stage where it is of one."""
    part, stage = str(decision.get("part", "")), decision.get("stage")
    return f"{part}, stage {stage}" if stage else part


def saved(decision: Mapping[str, Any]) -> str:
    """The saving of a part left out, or why it is kept, of a decision's record, without the words that its verdict says."""
    text = str(decision.get("saves", ""))
    return text if decision.get("verdict") == "left out" else text.removeprefix("nothing: ").removeprefix("kept, ")
