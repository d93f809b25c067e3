"""The result of a check of a .geo, and how deep its blocks, macros and included files lie in each other.

Gmsh keeps them in tables of fixed size.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from fracflow.errors import MOST_NAMED, InputError
from fracflow.remarks import note

DEEPEST = 40  # Gmsh has room for 100
REMEDY = "remove it, or give --trust (trust=True in Python) if you trust whoever wrote the file"


@dataclass
class Unit:
    """A file or a macro: how deep its blocks lie in each other, and what it goes on to at which depth."""

    deepest: int = 0
    goes_to: list[tuple[int, str]] = field(default_factory=list)


@dataclass
class Checked:
    """Input of Gmsh: the text of each file by its name there, the first one first, and where each came from.

    passed      options that Gmsh is not given, for they only say what its window looks like
    remainders  places of %, which divides
    """

    texts: dict[str, str] = field(default_factory=dict)
    sources: dict[str, Path] = field(default_factory=dict)
    units: dict[str, Unit] = field(default_factory=dict)
    passed: list[str] = field(default_factory=list)
    remainders: list[str] = field(default_factory=list)

    @property
    def notes(self) -> tuple[str, ...]:
        """A line about options that were passed over, if there were any."""
        names = list(dict.fromkeys(self.passed))
        more = f" and {len(names) - MOST_NAMED} more" if len(names) > MOST_NAMED else ""
        path = next(iter(self.sources.values()))
        line = f"{path}: options of Gmsh's window are passed over: {', '.join(names[:MOST_NAMED])}{more}"
        return (note(line),) if names else ()


def check_depths(units: Mapping[str, Unit], path: Path) -> None:
    """Raise InputError, naming the geometry's ``path``, for units too deep in each other, or that go on to themselves."""
    known: dict[str, int] = {}
    for name in units:
        _depth(units, name, path, (), known)


def _depth(units: Mapping[str, Unit], name: str, path: Path, above: tuple[str, ...], known: dict[str, int]) -> int:
    """How deep blocks lie in each other where a unit is gone through. Raises InputError for too deep, or without end."""
    if name in known:
        return known[name]
    where = f"{path}: {name.replace(':', ' ')}"
    if name in above:
        raise InputError(f"{where}: calls itself, so that it may never end; {REMEDY}")
    unit = units.get(name, Unit())  # Gmsh reports a macro that there is not
    deepest = DEEPEST + 1
    if len(above) <= DEEPEST:
        below = (at + 1 + _depth(units, to, path, (*above, name), known) for at, to in unit.goes_to)
        deepest = max([unit.deepest, *below])
    if deepest > DEEPEST:
        raise InputError(f"{where}: more than {DEEPEST} blocks in each other; {REMEDY}")
    known[name] = deepest
    return deepest
