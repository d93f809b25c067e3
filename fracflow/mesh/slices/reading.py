"""From a saved mesh to a slab of cells and one of nodes on each rank; rank 0 reads in turns, and passes on slab by slab.

Joints, sides and names are on rank 0 alone, with the nodes that they are on: there are few beside cells.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from fracflow._petsc import MPI
from fracflow.errors import InputError
from fracflow.mesh.agreement import on_root
from fracflow.mesh.blocks import owner_of
from fracflow.mesh.data import Floats, Ints, SplitMesh
from fracflow.mesh.slices.directory import Directory, Values
from fracflow.mesh.store import SLICED, WRITE_ONE, SlicedFile, cells_of, no_plane_rock, refuse_joined_ends
from fracflow.storage.sealed import AGAIN, slabs_of

NONE = np.zeros(0, dtype=np.int64)
FEWEST = 200_000  # cells from which on slices pay: of fewer, all take rank 0 less memory than the start of the program


@dataclass(frozen=True)
class SavedMesh:
    """A file that ranks read in slices.

    root  of its seal, where that is known
    near  how many cells come first in a run that goes on; -1 of a new run, which says so itself
    """

    path: Path
    root: str = ""
    near: int = -1


def slices_of(path: Path, root: str | None = None) -> SavedMesh | None:
    """The file of a saved mesh, if ranks take slices of it. Else rank 0 reads it, and sends each its share: None.

    So does one rank: numbers, and the order of fields and files, are those of any number of ranks.

    root  of the mesh of a run that goes on, empty where it is not known: its numbers stay. None of a new run

    On one rank. Raises InputError where it is no saved mesh.
    """
    cells, near = cells_of(path, WRITE_ONE if root is None else AGAIN)
    if cells < FEWEST or (root is not None and near < 0):
        return None
    return SavedMesh(path, root or "", -1 if root is None else near)


@dataclass(frozen=True)
class Raw:
    """The part of a mesh that a rank has read, in the numbers of the file.

    saved          where it was read from
    cells          who keeps which numbers of cells
    nodes          the same of nodes
    cell           (m, c) nodes of the cells of this rank's slab, -1 pads
    rock           (m,) of each
    points         (s, dim) of the nodes of its slab [length]
    origin         (s,) of each
    corner         (u,) nodes of its cells, ascending
    local          (m, c) places of the cells' nodes among these, -1 pads
    corner_points  (u, dim) [length]
    frame          on rank 0, a mesh without cells: joints, sides and places, on the nodes that these need
    frame_node     (f,) their numbers, ascending; none on other ranks. Numbers of cells are those of the file
    """

    saved: SavedMesh
    cells: Directory
    nodes: Directory
    cell: Ints
    rock: Ints
    points: Floats
    origin: Ints
    corner: Ints
    local: Ints
    corner_points: Floats
    frame: SplitMesh | None
    frame_node: Ints


def read(comm: MPI.Comm, saved: SavedMesh) -> Raw:
    """Read a saved mesh of plane rock. Raises InputError, on every rank. Collective."""
    file = on_root(comm, lambda: _opened(saved))
    layout = comm.bcast(None if file is None else file.layout, root=0)
    found = {name: _slab(comm, file, name, *layout[name]) for name in SLICED}
    cells, nodes = Directory(comm, layout["cells"][1][0]), Directory(comm, layout["points"][1][0])
    cell = found["cells"]
    corner = np.unique(cell)
    corner = corner[np.searchsorted(corner, 0) :]
    local = np.where(cell >= 0, np.searchsorted(corner, cell), -1)
    tables = None if file is None else file.tables
    asked = NONE if tables is None else _nodes_of(tables)
    origin = nodes.look_up(found["origin"], asked)
    frame_node = np.union1d(asked, origin)
    frame_points, frame_origin = (nodes.look_up(found[name], frame_node) for name in ("points", "origin"))

    def framed() -> SplitMesh:
        assert tables is not None
        return _frame(saved, tables, frame_node, frame_points, frame_origin)

    frame = on_root(comm, framed)
    corner_points = nodes.look_up(found["points"], corner)
    return Raw(saved, cells, nodes, cell, found["cell_rock"], found["points"], found["origin"], corner, local,
        corner_points, frame, frame_node)  # fmt: skip


def _opened(saved: SavedMesh) -> SlicedFile:
    file = SlicedFile(saved.path, saved.root, AGAIN if saved.near >= 0 else WRITE_ONE)
    if file.layout["cells"][1][1] < 3 or file.layout["points"][1][1] != 2:
        raise no_plane_rock(saved.path)
    return file


def _rows(file: SlicedFile | None, name: str, first: int, last: int) -> Values:
    assert file is not None
    return file.rows(name, first, last)


def _slab(comm: MPI.Comm, file: SlicedFile | None, name: str, kind: str, shape: tuple[int, ...]) -> Values:
    """Rows (s, ...) of this rank of a part of the file, which rank 0 reads. Collective."""
    part = Directory(comm, shape[0])
    found = np.empty((part.last - part.first, *shape[1:]), dtype=np.float64 if name == "points" else np.int64)
    for first, last in slabs_of(np.dtype(kind), shape):
        rows = on_root(comm, partial(_rows, file, name, first, last))
        lowest, highest = owner_of(part.starts, np.array([first, last - 1])).tolist()
        for rank in range(lowest, highest + 1):
            start, end = (int(each) for each in part.starts[rank : rank + 2])
            low, high = max(first, start), min(last, end)
            if low >= high:
                continue
            if rows is not None and rank == 0:
                found[low - start : high - start] = rows[low - first : high - first]
            elif rows is not None:
                comm.Send(np.ascontiguousarray(rows[low - first : high - first]), rank)
            elif rank == comm.rank:
                comm.Recv(found[low - start : high - start], 0)
    return found


_OF_NODES = ("joint_bottom", "joint_top", "side_facets", "flow_origin")


def _nodes_of(tables: SplitMesh) -> Ints:
    """Nodes (f,) that joints, sides, flow nodes and names are on, ascending."""
    named = np.array(list(tables.named_points.values()), dtype=np.int64)
    return np.unique(np.concatenate([named, *(getattr(tables, name).ravel() for name in _OF_NODES)]))


def moved(mesh: SplitMesh, number: Callable[[Ints], Ints]) -> SplitMesh:
    """The mesh with other numbers (n,) of nodes (n,) in its joints, sides, flow nodes and names."""
    named = {name: int(number(np.array([node]))[0]) for name, node in mesh.named_points.items()}
    tables: dict[str, Any] = {name: number(np.asarray(getattr(mesh, name), dtype=np.int64)) for name in _OF_NODES}
    return replace(mesh, named_points=named, **tables)


def _frame(saved: SavedMesh, tables: SplitMesh, node: Ints, points: Floats, origin: Ints) -> SplitMesh:
    """The mesh without cells on nodes (f,). Raises InputError where another scene cannot take it."""
    place = np.searchsorted(node, origin)
    if not np.array_equal(node[np.minimum(place, len(node) - 1)], origin):
        raise InputError(f"{saved.path}: is no saved mesh (origin has copies of copies); {WRITE_ONE}")
    frame = moved(replace(tables, points=points, origin=place), lambda numbers: np.searchsorted(node, numbers))
    if saved.near >= 0:
        return frame
    refuse_joined_ends(frame, saved.path)
    return replace(frame, cuts=0, near=-1)
