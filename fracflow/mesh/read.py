"""A RawMesh from a geometry or mesh file, or from a polygon and fracture traces."""

from __future__ import annotations

import csv
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import meshio
import numpy as np

from fracflow.errors import InputError
from fracflow.mesh.data import Floats, RawMesh
from fracflow.mesh.gmsh import KINDS, Elements, open_in_gmsh, run_worker
from fracflow.mesh.interpret import interpret

SUFFIXES = (".geo", ".msh")
MESHIO_KINDS = {"vertex": "point", "line": "line", "triangle": "triangle", "quad": "quad"}
DIMS = {"point": 0, "line": 1, "triangle": 2, "quad": 2}
CORNERS = {"point": 1, "line": 2, "triangle": 3, "quad": 4}
ON_BOUNDARY = 1e-9  # of the domain's extent: a point this near to a side is on it
LAYOUTS = (("name", "x", "y"), ("name", "x1", "y1", "x2", "y2"))

Trace = tuple[str, Floats]
"""Name and points (m, 2) of a fracture, from its start to its end."""


@dataclass(frozen=True)
class GeometrySpec:
    """A domain cut by fracture traces.

    domain             (k, 2) corners of a polygon, either way round [length]
    traces             name and points (m, 2) of each fracture; they may cross and reach the boundary [length]
    size               mesh size away from the fractures [length]
    size_at_fractures  mesh size on them; as ``size`` if None [length]
    cells              shape of the cells
    rock               name of the rock
    """

    domain: Floats
    traces: tuple[Trace, ...]
    size: float
    size_at_fractures: float | None = None
    cells: Literal["triangles", "quads"] = "triangles"
    rock: str = "rock"


def read_mesh(path: str | Path, fractures: Collection[str]) -> RawMesh:
    """Read a Gmsh geometry (.geo) or mesh (.msh 2.2 or 4.1).

    A physical curve is a fracture if ``fractures`` has its name, or has "default" and the curve lies inside
    the mesh; else it is a side. Raises InputError, naming the file, for what cannot be read or has no
    meaning.
    """
    path = Path(path)
    if path.suffix not in SUFFIXES:
        raise InputError(f'{path}: unknown kind of file "{path.suffix}"; give a Gmsh .geo or .msh')
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    if path.suffix == ".geo" and path.read_bytes().rpartition(b"\n")[2].strip():
        # Gmsh says nothing and leaves the line out.
        raise InputError(f"{path}: Gmsh would ignore the last line, which has no line end; add one")
    elements = _read_msh2(path) if path.suffix == ".msh" and _version(path) == 2 else open_in_gmsh(path)
    return interpret(elements, fractures, str(path))


def build_mesh(geometry: GeometrySpec) -> RawMesh:
    """Mesh a domain so that its fractures are edges of cells, each facet running along its trace.

    The sides of a rectangle along the axes are south, east, north, west; those of another polygon side1,
    side2, ... in the order of its corners. Raises InputError for traces that are outside the domain, of no
    length, or given twice.
    """
    domain = np.asarray(geometry.domain, dtype=float)
    traces = [(name, np.asarray(points, dtype=float)) for name, points in geometry.traces]
    sides = side_names(domain)
    _check_traces(domain, traces, (geometry.rock, *sides))
    job = {
        "domain": domain.tolist(),
        "sides": sides,
        "traces": [points.tolist() for _, points in traces],
        "names": [name for name, _ in traces],
        "size": float(geometry.size),
        "size_at_fractures": float(geometry.size_at_fractures or geometry.size),
        "cells": geometry.cells,
        "rock": geometry.rock,
    }
    return interpret(run_worker(job, "geometry"), [name for name, _ in traces], "geometry")


def side_names(domain: Floats) -> list[str]:
    """Name the sides of a polygon (k, 2), from each corner to the next."""
    steps = np.roll(domain, -1, axis=0) - domain
    extent = np.ptp(domain, axis=0)
    is_corner = np.all(np.minimum(domain - domain.min(axis=0), domain.max(axis=0) - domain) <= 1e-12 * extent)
    if len(domain) != 4 or not is_corner or np.any(np.count_nonzero(np.abs(steps) > 1e-12 * extent, axis=1) != 1):
        return [f"side{number}" for number in range(1, len(domain) + 1)]
    middle = domain + steps / 2 - (domain.min(axis=0) + extent / 2)
    places = {(0, -1): "south", (1, 0): "east", (0, 1): "north", (-1, 0): "west"}
    return [places[tuple(np.sign(np.round(place / extent, 6)).astype(int).tolist())] for place in middle]


def _check_traces(domain: Floats, traces: list[Trace], taken: Iterable[str]) -> None:
    """Raise InputError for the first trace that cannot be meshed."""
    seen: dict[bytes, str] = {}
    names = set(taken)
    for name, points in traces:
        what = f'geometry: fracture "{name}"'
        if name in names:
            raise InputError(f"{what}: the name is taken by another fracture, a side or the rock; choose another")
        names.add(name)
        if points.ndim != 2 or points.shape[1] != 2 or len(points) < 2 or not np.all(np.isfinite(points)):
            raise InputError(f"{what}: points must be two or more pairs [x, y] of finite numbers")
        if np.any(is_still := np.all(points[1:] == points[:-1], axis=1)):
            raise InputError(f"{what}: two points in a row are {points[np.argmax(is_still)].tolist()}; remove one")
        backwards = points[::-1].tobytes()
        if other := seen.get(points.tobytes()) or seen.get(backwards):
            raise InputError(f'{what}: has the points of fracture "{other}"; remove one')
        seen[points.tobytes()] = name
        if np.any(is_out := ~_is_within(points, domain)):
            raise InputError(
                f"{what}: the point {points[np.argmax(is_out)].tolist()} is outside the domain; cut it off"
            )


def _is_within(points: Floats, domain: Floats) -> np.ndarray:
    """Whether each point (m, 2) is in or on the polygon (k, 2)."""
    start, end = domain, np.roll(domain, -1, axis=0)
    step, reach = end - start, points[:, None] - start
    along = np.clip(np.sum(reach * step, axis=2) / np.sum(step * step, axis=1), 0, 1)
    distance = np.linalg.norm(reach - along[..., None] * step, axis=2).min(axis=1)
    is_across = (start[:, 1] > points[:, None, 1]) != (end[:, 1] > points[:, None, 1])
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = start[:, 0] + (points[:, None, 1] - start[:, 1]) / step[:, 1] * step[:, 0]
    is_inside = np.sum(is_across & (points[:, None, 0] < crossing), axis=1) % 2 == 1
    return is_inside | (distance <= ON_BOUNDARY * np.ptp(domain, axis=0).max())


def read_traces_csv(path: str | Path) -> list[Trace]:
    """Read traces from a table: columns name, x, y (a row a point) or name, x1, y1, x2, y2 (a row a segment).

    The delimiter is a comma, a semicolon or a tab. Rows of one name follow each other along the trace, and
    segments of one name must join. Raises InputError naming file and line.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read: {error}; give a UTF-8 text file") from error
    head = text.split("\n", 1)[0]
    delimiter = max(",;\t", key=head.count)
    rows = [
        (number, [word.strip() for word in row])
        for number, row in enumerate(csv.reader(text.splitlines(), delimiter=delimiter, skipinitialspace=True), 1)
        if any(word.strip() for word in row)
    ]
    header = tuple(word.lower() for word in rows[0][1]) if rows else ()
    if header not in LAYOUTS:
        raise InputError(f'{path}: the first line is "{head.strip()}"; it must be name,x,y or name,x1,y1,x2,y2')
    traces: dict[str, list[list[float]]] = {}
    last = None
    for number, words in rows[1:]:
        where = f"{path}: line {number}"
        name, values = words[0], _numbers(words[1:], len(header) - 1, where)
        if not name:
            raise InputError(f"{where}: the name is empty; give each fracture one")
        if name in traces and name != last:
            raise InputError(f'{where}: "{name}" was given before; the rows of one fracture must follow each other')
        points = traces.setdefault(name, [])
        if len(values) == 4 and points and points[-1] != values[:2]:
            raise InputError(f'{where}: "{name}" goes on at {values[:2]}, but its last segment ended at {points[-1]}')
        points += [values] if len(values) == 2 else [values[2:]] if points else [values[:2], values[2:]]
        last = name
    for name, points in traces.items():
        if len(points) < 2:
            raise InputError(f'{path}: fracture "{name}" has one point; a trace needs two or more')
    if not traces:
        raise InputError(f"{path}: has no rows below its header")
    return [(name, np.array(points)) for name, points in traces.items()]


def _numbers(words: list[str], count: int, where: str) -> list[float]:
    if len(words) != count:
        raise InputError(f"{where}: has {len(words)} numbers, the header says {count}")
    values = []
    for word in words:
        try:
            values.append(float(word))
        except ValueError:
            raise InputError(f'{where}: "{word}" is no number; decimals take a point') from None
    if not np.all(np.isfinite(values)):
        raise InputError(f"{where}: {values} must be finite")
    return values


def _version(path: Path) -> int:
    """Major version of a .msh file."""
    with path.open("rb") as file:
        for line in file:
            if line.strip() == b"$MeshFormat":
                word = next(file, b"").split(b".")[0].strip().split(b" ")[0]
                if word in (b"2", b"4"):
                    return int(word)
                break
    raise InputError(f"{path}: is no Gmsh mesh of version 2 or 4; save it with Mesh.MshFileVersion = 4.1")


def _groups_msh2(path: Path) -> list[tuple[int, int, str]]:
    """Tag, dimension and name of the groups; meshio keeps only one of two that share a name."""
    text = path.read_bytes().partition(b"$PhysicalNames")[2].partition(b"$EndPhysicalNames")[0]
    rows = [line.split(None, 2) for line in text.decode("utf-8", "replace").splitlines()]
    return [(int(row[1]), int(row[0]), row[2].strip().strip('"')) for row in rows if len(row) == 3]


def _read_msh2(path: Path) -> Elements:
    """Version 2 has one physical tag an element; one in two groups stands twice."""
    try:
        mesh = meshio.gmsh.read(path)
    except Exception as error:  # meshio raises whatever its parser meets
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: cannot be read as a Gmsh mesh: {reason}") from error
    groups = _groups_msh2(path)
    tags = mesh.cell_data.get("gmsh:physical", [np.zeros(len(block.data), np.int64) for block in mesh.cells])
    nodes = {kind: [np.zeros((0, CORNERS[kind]), np.int64)] for kind in KINDS}
    members = {kind: [np.zeros((0, 2), np.int64)] for kind in KINDS}
    number = {(dim, tag): index for index, (tag, dim, _) in enumerate(groups)}
    others = sorted({block.type for block in mesh.cells} - MESHIO_KINDS.keys())
    for block, tag in zip(mesh.cells, tags, strict=True):
        if block.type in others:
            continue
        kind = MESHIO_KINDS[block.type]
        first = sum(len(rows) for rows in nodes[kind])
        nodes[kind].append(np.asarray(block.data, dtype=np.int64))
        for value in np.unique(tag[tag > 0]):
            key = (DIMS[kind], int(value))
            if key not in number:
                number[key] = len(groups)
                groups.append((key[1], key[0], ""))
            rows = first + np.flatnonzero(tag == value)
            members[kind].append(np.stack([rows, np.full(len(rows), number[key])], axis=1))
    return Elements(
        points=np.asarray(mesh.points, dtype=float),
        nodes={kind: np.concatenate(rows) for kind, rows in nodes.items()},
        members={kind: np.concatenate(rows) for kind, rows in members.items()},
        others=tuple(others),
        group_dims=np.array([dim for _, dim, _ in groups], dtype=np.int64),
        group_tags=np.array([tag for tag, _, _ in groups], dtype=np.int64),
        group_names=tuple(name for _, _, name in groups),
    )
