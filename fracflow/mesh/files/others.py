"""Meshes of other programs, read by meshio in the worker: Abaqus, VTU, Exodus, and XDMF with its HDF5 file.

Sets of cells name rocks, fractures and sides, sets of one node places. So do blocks and side sets of Exodus, and sets of sets
of Abaqus. In a format without sets whole numbers on the cells do: tags, whose names the file may have, or else the numbers
are the names.
"""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from fracflow.storage.files import shown_plain
from fracflow.storage.worker import check_leads_nowhere

FORMATS = {".inp": "abaqus", ".vtu": "vtu", ".e": "exodus", ".exo": "exodus", ".xdmf": "xdmf"}
PREFERRED = ("gmsh:physical", "medit:ref", "cell_tags")  # of several data of cells
MESHIO_KINDS = {"vertex": "point", "line": "line", "triangle": "triangle", "quad": "quad"}
DIMS = {"point": 0, "line": 1, "triangle": 2, "quad": 2}
CORNERS = {"point": 1, "line": 2, "triangle": 3, "quad": 4}
NO_NAMES = (
    "its cells have no names: give rocks, fractures and sides sets of cells, or one array of whole numbers on them"
)

PLANE = {"CPE3": "triangle", "CPE3H": "triangle", "CPE4": "quad", "CPE4H": "quad", "CPE4R": "quad", "CPE4I": "quad"}
Set = tuple[str, int, NDArray[Any]]  # name, block, rows of its cells
Rows = NDArray[np.int64]
Found = tuple[NDArray[Any], dict[str, list[Rows]], dict[str, list[Rows]], list[str], list[tuple[int, int, str]]]


def read_other(path: Path) -> Found:
    """Points, nodes and members of each kind, other types, and tag, dimension and name of the groups.

    Raises ValueError of one line.
    """
    form = FORMATS[path.suffix]
    if form in ("vtu", "xdmf"):
        check_xml(path)
    if form == "xdmf":
        for beside in heavy_files(path):
            check_leads_nowhere(beside)
    elif form == "abaqus":
        check_abaqus(path)
    elif form == "exodus" and path.open("rb").read(4) == b"\x89HDF":
        check_leads_nowhere(path)
    import meshio  # imports much

    try:
        mesh = _read_abaqus(path) if form == "abaqus" else meshio.read(path, form)
        own = {"exodus": _exodus_sets, "abaqus": _abaqus_sets}.get(form)
        sets = own(path, mesh) if own else []
    except _Fault:
        raise
    except MemoryError:
        raise
    except ImportError as error:
        raise ValueError(f"to read it the package {error.name} is needed") from None
    except (Exception, SystemExit) as error:  # meshio raises whatever its parser meets
        reason = " ".join(str(error).split())[:200] if isinstance(error, meshio.ReadError) else ""
        raise ValueError(shown_plain(f"cannot be read as {form}: {reason or 'it is cut off or damaged'}")) from error
    sets = sets or [*_sets(mesh)] or [*_tagged(mesh)]
    if not sets:
        raise ValueError(NO_NAMES)
    return _elements(mesh, sets)


class _Fault(ValueError):
    """A fault of a file, in a line of our own."""


def _sets(mesh: Any) -> Iterator[Set]:
    """The sets of cells of a file."""
    for name, members in mesh.cell_sets.items():
        for block, rows in enumerate(members):
            if rows is not None and len(rows) and not name.startswith("gmsh:"):
                yield name, block, np.asarray(rows, dtype=np.int64)


def _tagged(mesh: Any) -> Iterator[Set]:
    """Cells by the whole numbers on them."""
    whole = {
        key: [np.asarray(each, dtype=np.int64) for each in data]
        for key, data in mesh.cell_data.items()
        if all(np.ndim(each) == 1 and np.isfinite(each).all() and (each == np.floor(each)).all() for each in data)
    }
    if not whole:
        return
    key = next((each for each in PREFERRED if each in whole), next(iter(whole)))
    if len(whole) > 1 and key not in PREFERRED:
        names = ", ".join(sorted(whole)[:5])
        raise ValueError(
            shown_plain(f"its cells have several arrays of whole numbers ({names}): keep one, for their names")
        )
    named = {(int(tag), int(dim)): name for name, (tag, dim) in mesh.field_data.items()}
    words = key.split("-")  # meshio makes an array of sets under their names in a row, and -1 is none of them
    joined = len(words) == 1 + max((int(tags.max(initial=-1)) for tags in whole[key]), default=0)
    for block, tags in enumerate(whole[key]):
        dim = DIMS.get(MESHIO_KINDS.get(mesh.cells[block].type, ""), -1)
        for tag in np.unique(tags[tags >= (0 if joined or dim == 2 else 1)]).tolist():
            name = words[tag] if joined else named.get((tag, dim), str(tag))
            yield name, block, np.flatnonzero(tags == tag)


def _read_abaqus(path: Path) -> Any:
    """The mesh without its sets of elements. Meshio gives some to a wrong block, and takes one of several sets in a set."""
    import meshio

    vars(vars(meshio.abaqus).get("_abaqus", meshio)).get("abaqus_to_meshio_type", {}).update(PLANE)
    parts = re.split(r"^(?=\*[^*])", path.read_text(encoding="utf-8", errors="replace"), flags=re.MULTILINE)
    with tempfile.TemporaryDirectory(prefix="fracflow-abaqus-") as folder:
        copy = Path(folder) / "mesh.inp"
        copy.write_text("".join(part for part in parts if not re.match(r"\*\s*ELSET\b", part, re.IGNORECASE)), "utf-8")
        return meshio.read(copy, "abaqus")


def _abaqus_sets(path: Path, mesh: Any) -> list[Set]:
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
                    raise _Fault(shown_plain(f"has two elements {number[:50]}: give the whole mesh in one part"))
                place[number] = (block, row)
            members |= dict.fromkeys((block, row) for row in range(count))
        elif "GENERATE" in options:
            for first, last, *step in lines:
                each = range(int(first), int(last) + 1, int(step[0]) if step else 1)
                members |= dict.fromkeys(place[str(number)] for number in each if str(number) in place)
        else:
            for word in (word for line in lines for word in line):
                if word not in place and word.upper() not in named:
                    raise _Fault(shown_plain(f'the set "{name}" has "{word[:50]}", which stands nowhere before it'))
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


def _exodus_sets(path: Path, mesh: Any) -> list[Set]:
    """Blocks of cells and side sets by their names, or their numbers; edges of side sets join the mesh as a block each."""
    import meshio
    import netCDF4

    with netCDF4.Dataset(path) as file:
        file.set_auto_mask(False)
        keys = [key for key in file.variables if key.startswith("connect")]
        numbers = [int(key[7:] or 1) for key in keys]
        found = [
            (name, block, np.arange(len(mesh.cells[block].data)))
            for block, name in enumerate(_exodus_names(file, "eb", numbers))
        ]
        kinds = [str(getattr(file.variables[key], "elem_type", "")).upper() for key in keys]
        is_space = "num_dim" in file.dimensions and len(file.dimensions["num_dim"]) == 3
        faces = [2 if kind.startswith("SHELL") or (is_space and kind.startswith("TRI")) else 0 for kind in kinds]
        order = sorted(range(len(numbers)), key=numbers.__getitem__)  # elements are numbered through the blocks
        ends = np.cumsum([len(mesh.cells[block].data) for block in order])
        sides = sorted(int(key[7:]) for key in file.variables if key.startswith("elem_ss"))
        for name, side in zip(_exodus_names(file, "ss", sides), sides, strict=True):
            element, edge = (file.variables[f"{key}_ss{side}"][:].astype(np.int64) - 1 for key in ("elem", "side"))
            edges = []
            for at, number, length in zip(np.searchsorted(ends, element, "right"), element, edge, strict=True):
                cells = mesh.cells[order[at]].data if number >= 0 and at < len(order) else np.zeros((0, 2))
                start, corners = length - faces[order[at]] if len(cells) else -1, cells.shape[1]
                if not 0 <= start < corners or corners not in (3, 4):
                    raise _Fault(shown_plain(f'the side set "{name}" has a side that no triangle or quadrilateral has'))
                cell = cells[number - ends[at]]  # from the end of its block
                edges.append((cell[start], cell[(start + 1) % corners]))
            if edges:
                mesh.cells.append(meshio.CellBlock("line", np.array(edges)))
                found.append((name, len(mesh.cells) - 1, np.arange(len(edges))))
    return found


def _exodus_names(file: Any, kind: str, numbers: list[int]) -> list[str]:
    """Names of the blocks ("eb") or side sets ("ss") of these places in the file, or else their numbers."""
    names = [b"".join(row).decode("utf-8", "replace").strip("\0 ") for row in file.variables.get(f"{kind}_names", [])]
    marks = [str(each) for each in file.variables.get(f"{kind}_prop1", [])]
    return [
        next((each[number - 1] for each in (names, marks) if number <= len(each) and each[number - 1]), str(number))
        for number in numbers
    ]


def _elements(mesh: Any, sets: list[Set]) -> Found:
    others = sorted({block.type for block in mesh.cells} - MESHIO_KINDS.keys())
    nodes: dict[str, list[Rows]] = {kind: [] for kind in CORNERS}
    members: dict[str, list[Rows]] = {kind: [] for kind in CORNERS}
    first, groups = {}, dict[tuple[int, str], int]()

    def add(kind: str, name: str, rows: Rows) -> None:
        group = groups.setdefault((DIMS[kind], name), len(groups))
        members[kind].append(np.stack([rows, np.full(len(rows), group)], axis=1))

    for number, block in enumerate(mesh.cells):
        if block.type in others:
            continue
        kind, rows = MESHIO_KINDS[block.type], np.asarray(block.data, dtype=np.int64)
        if np.any((rows < 0) | (rows >= len(mesh.points))):
            raise ValueError("an element has a node that the file does not have")
        first[number] = sum(map(len, nodes[kind]))
        nodes[kind].append(rows.reshape(-1, CORNERS[kind]))
    for name, number, rows in sets:
        if number in first:
            if np.any((rows < 0) | (rows >= len(mesh.cells[number].data))):
                raise ValueError(shown_plain(f'the set "{name}" has a cell that the file does not have'))
            add(MESHIO_KINDS[mesh.cells[number].type], name, first[number] + rows)
    for name, places in mesh.point_sets.items():
        if np.size(places) == 1:  # sets of more nodes say nothing that sets of cells do not
            place = np.asarray(places, dtype=np.int64).reshape(1, 1)
            if not 0 <= place[0, 0] < len(mesh.points):
                raise ValueError(shown_plain(f'the set "{name}" has a node that the file does not have'))
            add("point", name, np.array([sum(map(len, nodes["point"]))]))
            nodes["point"].append(place)
    named = [(tag, dim, name) for tag, (dim, name) in enumerate(groups, start=1)]
    return np.asarray(mesh.points, dtype=float), nodes, members, others, named


def check_xml(path: Path) -> None:
    """Raise ValueError for XML with a document type, which may hold entities; one stands before the first element."""
    parser, begun = expat.ParserCreate(), []

    def refuse(*_: object) -> None:
        raise ValueError("has a document type or entities (<!DOCTYPE), which no mesh needs")

    parser.StartDoctypeDeclHandler = parser.EntityDeclHandler = refuse
    parser.StartElementHandler = lambda name, _: begun.append(name)
    with path.open("rb") as file:
        try:
            while not begun and (part := file.read(1 << 16)):
                parser.Parse(part)
        except expat.ExpatError:  # also of raw bytes behind the first element
            pass
    if not begun:
        raise ValueError("is no XML file")


def heavy_files(path: Path) -> list[Path]:
    """The HDF5 files of an XDMF file. Raises ValueError for one that does not lie beside it, and for other formats."""
    try:
        items = [*ElementTree.parse(path).iter("DataItem")]
    except ElementTree.ParseError:
        raise ValueError("cannot be read as xdmf: it is cut off or damaged") from None
    found, folder = set(), path.resolve().parent
    for item in items:
        form = item.get("Format", "XML")
        if form == "HDF":
            name = (item.text or "").partition(":")[0].strip()
            beside = folder / name
            if os.path.basename(name) != name or os.path.realpath(beside) != str(beside) or not beside.is_file():
                raise ValueError(shown_plain(f'its data file "{name[:200]}" must be a file beside it, and no link'))
            found.add(beside)
        elif form != "XML":
            raise ValueError("has data in binary files; save it with HDF5")
    return sorted(found)


def check_abaqus(path: Path) -> None:
    """Raise ValueError for a file that includes another."""
    with path.open("rb") as file:
        for line in file:
            if line.partition(b",")[0].replace(b"*", b"").strip().upper() == b"INCLUDE":
                raise ValueError("includes another file (*INCLUDE); put all into one")


def beside(path: Path) -> Mapping[str, int]:
    """Sizes [bytes] of a mesh file and of HDF5 files that may be its data."""
    names = [path, *path.parent.glob("*.h5"), *path.parent.glob("*.hdf5")] if path.suffix == ".xdmf" else [path]
    return {each.name: each.stat().st_size for each in names if each.is_file()}
