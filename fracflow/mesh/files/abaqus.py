"""Meshes of Abaqus: plane elements that meshio has no types for, and the sets of elements, which it reads wrongly."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from fracflow.mesh.files.sets import FileFault, Set
from fracflow.storage.files import shown_plain

PLANE = {"CPE3": "triangle", "CPE3H": "triangle", "CPE4": "quad", "CPE4H": "quad", "CPE4R": "quad", "CPE4I": "quad"}


def check_abaqus(path: Path) -> None:
    """Raise ValueError for a file that includes another."""
    with path.open("rb") as file:
        for line in file:
            if line.partition(b",")[0].replace(b"*", b"").strip().upper() == b"INCLUDE":
                raise ValueError("includes another file (*INCLUDE); put all into one")


def read_abaqus(path: Path) -> Any:
    """The mesh without its sets of elements. Meshio gives some to a wrong block, and takes one of several sets in a set."""
    import meshio

    types = vars(vars(meshio.abaqus).get("_abaqus", meshio)).get("abaqus_to_meshio_type")
    if types is None:
        raise FileFault(
            "cannot be read: this version of meshio keeps types of elements elsewhere; save it in another format"
        )
    types.update(PLANE)
    parts = re.split(r"^(?=\*[^*])", path.read_text(encoding="utf-8", errors="replace"), flags=re.MULTILINE)
    with tempfile.TemporaryDirectory(prefix="fracflow-abaqus-") as folder:
        copy = Path(folder) / "mesh.inp"
        copy.write_text("".join(part for part in parts if not re.match(r"\*\s*ELSET\b", part, re.IGNORECASE)), "utf-8")
        return meshio.read(copy, "abaqus")


def abaqus_sets(path: Path, mesh: Any) -> list[Set]:
    """Sets of elements in the file's own lines: of numbers, of ranges, of other sets, and those stated with elements."""
    place: dict[str, tuple[int, int]] = {}
    named: dict[str, tuple[str, dict[tuple[int, int], None]]] = {}
    block = -1
    for keyword, options, lines in _abaqus_parts(path):
        name = options.get("ELSET", "").strip('"')
        _, members = named.setdefault(name.upper(), (name, {}))
        if keyword == "ELEMENT":
            block += 1
            count = len(mesh.cells[block].data)
            numbers = [word for line in lines for word in line]
            for row, number in enumerate(numbers[:: len(numbers) // max(count, 1) or 1]):
                if number in place:
                    raise FileFault(shown_plain(f"has two elements {number[:50]}: give the whole mesh in one part"))
                place[number] = (block, row)
            members |= dict.fromkeys((block, row) for row in range(count))
        elif "GENERATE" in options:
            for first, last, *step in lines:
                each = range(int(first), int(last) + 1, int(step[0]) if step else 1)
                members |= dict.fromkeys(place[str(number)] for number in each if str(number) in place)
        else:
            for word in (word for line in lines for word in line):
                if word not in place and word.upper() not in named:
                    raise FileFault(shown_plain(f'the set "{name}" has "{word[:50]}", which stands nowhere before it'))
                members |= {place[word]: None} if word in place else named[word.upper()][1]
    return [
        (name, block, np.unique([row for of, row in members if of == block]))
        for name, members in named.values()
        for block in sorted({of for of, _ in members} if name else ())
    ]


def _abaqus_parts(path: Path) -> Iterator[tuple[str, dict[str, str], list[list[str]]]]:
    """Keyword, options and lines of words of each *ELEMENT and *ELSET, the elements first."""
    parts: list[tuple[str, dict[str, str], list[list[str]]]] = [("", {}, [])]
    for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
        words = [word.strip() for word in line.split(",")]
        if line.startswith("*") and not line.startswith("**"):
            pairs = (word.partition("=") for word in words[1:])
            options = {key.strip().upper(): value.strip() for key, _, value in pairs}
            parts.append((words[0][1:].strip().upper(), options, []))
        elif not line.startswith("**") and parts[-1][0] in ("ELEMENT", "ELSET"):
            parts[-1][2].append([word for word in words if word])
    yield from (part for part in parts if part[0] == "ELEMENT")
    yield from ((key, options, [*filter(None, lines)]) for key, options, lines in parts if key == "ELSET")
