"""Meshes of other programs, read by meshio in the worker: Abaqus, VTU, Exodus, and XDMF with its HDF5 file.

Sets of cells name rocks, fractures and sides, sets of one node places. So do blocks and side sets of Exodus, and sets of sets
of Abaqus. In a format without sets whole numbers on the cells do: tags, whose names the file may have, or else the numbers
are the names.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.parsers import expat

import numpy as np

from fracflow.mesh.files.abaqus import abaqus_sets, check_abaqus, read_abaqus
from fracflow.mesh.files.exodus import exodus_sets
from fracflow.mesh.files.gmsh import FORMATS
from fracflow.mesh.files.sets import CORNERS, DIMS, FileFault, Found, Rows, Set
from fracflow.storage.files import shown_plain
from fracflow.storage.worker import check_leads_nowhere

PREFERRED = ("gmsh:physical", "medit:ref", "cell_tags")  # of several data of cells
MESHIO_KINDS = {"vertex": "point", "line": "line", "triangle": "triangle", "quad": "quad"}
NO_NAMES = (
    "its cells have no names: give rocks, fractures and sides sets of cells, or one array of whole numbers on them"
)


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
        mesh = read_abaqus(path) if form == "abaqus" else meshio.read(path, form)
        own = {"exodus": exodus_sets, "abaqus": abaqus_sets}.get(form)
        sets = own(path, mesh) if own else []
    except (FileFault, MemoryError):
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
