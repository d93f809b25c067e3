"""Lines of a log and records of a plan, as a page or a terminal shows them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from math import isfinite
from typing import Any

MESH_OF_EVENTS = "mesh of events"  # the part of a plan that a run adds once an event has meshed its rock
FROZEN = "which is frozen"  # in a line that states how much a change of rock leaves frozen
MOST_RESULTS = 6
_COORDINATE = r"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?"
_LIMIT = re.compile(
    r"limit point: (?:.* is near: )?"
    rf"(?P<words>fracture .*? at \((?P<x>{_COORDINATE}), (?P<y>{_COORDINATE})\), slipping patch [^;]*)"
)
_DIFFERS = re.compile(r"^(probe|well)\.\S+|^absorbing [^:]+|\bof \S+ is\b|[-+.\d]+(e[-+]?\d+)?")


def alike(lines: Iterable[str]) -> list[str]:
    """The first of the lines that differ by their numbers and names alone, with how many more there are.

    Lines whose numbers are results stand each for itself, the first MOST_RESULTS of them.
    """
    found: dict[str, list[str]] = {}
    results = 0
    for line in lines:
        is_result = FROZEN in line and results < MOST_RESULTS and line not in found
        results += is_result
        found.setdefault(line if is_result or line in found else _DIFFERS.sub("#", line)[:120], []).append(line)
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
