"""From a saved mesh to a range of rows of each of its arrays on every rank, which opens the file and reads its own rows.

HDF5 lets any number of processes read a file at once: none needs MPI for it, and no rank passes rows on. The seal shows whether
all have opened the same file. Of a file that rank 0 alone may see, it passes rows on, those of one rank at a time.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from fracflow._petsc import MPI
from fracflow.errors import InputError
from fracflow.mesh.agreement import on_each, on_root
from fracflow.mesh.data import Floats, Ints, SplitMesh
from fracflow.mesh.slices.directory import Directory, Route, Values
from fracflow.mesh.store import (
    ARRAYS,
    NOT_BESIDE,
    SLICED,
    WRITE_ONE,
    SlicedFile,
    are_beside,
    cells_of,
    dtype_of,
    no_plane_rock,
    refuse_flow_elsewhere,
    refuse_joined_ends,
    walls_of,
)
from fracflow.storage.reader import Layout, end_reading
from fracflow.storage.sealed import AGAIN

NONE = np.zeros(0, dtype=np.int64)
FEWEST = 200_000  # cells from which on slices pay: of fewer, all take rank 0 less memory than the start of the program
OF_JOINTS = ("joint_bottom", "joint_top", "joint_cells", "joint_flow", "joint_fracture", "joint_along")
OF_SIDES = ("side_facets", "side_cell", "side_of")


@dataclass(frozen=True)
class SavedMesh:
    """A file that ranks read in slices.

    root  of its seal, where that is known
    near  how many cells come first in a run that goes on; -1 of a new run, which says so itself
    is_passed_on  whether rank 0 reads it for all: others may not see its folder
    """

    path: Path
    root: str = ""
    near: int = -1
    is_passed_on: bool = False

    @property
    def remedy(self) -> str:
        """The words on a file that is damaged."""
        return AGAIN if self.near >= 0 else WRITE_ONE


def is_large(cells: float) -> bool:
    """Whether ranks take slices of a mesh with so many cells."""
    return cells >= FEWEST


def slices_of(path: Path, root: str | None = None) -> SavedMesh | None:
    """The file of a saved mesh, if ranks take slices of it. Else rank 0 reads it, and sends each its share: None.

    So does one rank: numbers, and the order of fields and files, are those of any number of ranks.

    root  of the mesh of a run that goes on, empty where it is not known: its numbers stay. None of a new run

    On one rank. Raises InputError where it is no saved mesh.
    """
    cells, near = cells_of(path, WRITE_ONE if root is None else AGAIN)
    if not is_large(cells) or (root is not None and near < 0):
        return None
    return SavedMesh(path, root or "", -1 if root is None else near)


@dataclass(frozen=True)
class Facets:
    """Joints, sides and flow nodes of this rank's ranges.

    joints, sides, flow  who keeps which numbers of each
    rows                 a mesh with those of this rank, and without a node or a cell; it has the names of all
    """

    joints: Directory
    sides: Directory
    flow: Directory
    rows: SplitMesh

    @classmethod
    def from_rank_0(cls, comm: MPI.Comm, mesh: SplitMesh | None) -> Facets:
        """Those of a mesh that rank 0 has. Collective."""
        empty = None if mesh is None else replace(mesh, **{name: getattr(mesh, name)[:0] for name in ARRAYS})
        names: SplitMesh = comm.bcast(empty, root=0)
        found: dict[str, Any] = {}
        parts = []
        for group in (OF_JOINTS, OF_SIDES, ("flow_origin",)):
            count = comm.bcast(None if mesh is None else len(getattr(mesh, group[0])), root=0)
            directory = Directory(comm, count)
            for name in group:
                kept = getattr(names, name)
                values = kept if mesh is None else getattr(mesh, name)
                found[name] = np.empty((directory.last - directory.first, *kept.shape[1:]), dtype=kept.dtype)
                directory.put(found[name], np.arange(len(values)), values)
            parts.append(directory)
        joints, sides, flow = parts
        return cls(joints, sides, flow, replace(names, **found))

    def on_rank_0(self) -> dict[str, Any]:
        """The arrays of all ranks (n, ...), by name, on rank 0; on others without a row. Collective."""
        parts = [(self.joints, OF_JOINTS), (self.sides, OF_SIDES), (self.flow, ("flow_origin",))]
        found: dict[str, Any] = {}
        for directory, names in parts:
            to_first = Route(directory.comm, np.zeros_like(directory.numbers))
            found |= {name: to_first.send(getattr(self.rows, name)) for name in names}
        return found


@dataclass(frozen=True)
class Raw:
    """The part of a mesh that a rank has read, in the numbers of the file.

    saved          where it was read from
    cells          who keeps which numbers of cells
    nodes          the same of nodes
    cell           (m, c) nodes of the cells of this rank's range, -1 pads
    rock           (m,) of each
    points         (s, dim) of the nodes of its range [length]
    origin         (s,) of each
    corner         (u,) nodes of its cells, ascending
    local          (m, c) places of the cells' nodes among these, -1 pads
    corner_points  (u, dim) [length]
    facets         joints and sides of its ranges
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
    facets: Facets


def read(comm: MPI.Comm, saved: SavedMesh) -> Raw:
    """Read a saved mesh of plane rock. Raises InputError, on every rank. Collective."""
    names, layout, file = _opened_by_one(comm, saved) if saved.is_passed_on else _opened_by_all(comm, saved)
    ranges = {name: Directory(comm, shape[0]) for name, (_, shape) in layout.items()}
    if saved.is_passed_on:
        found = {name: _passed_on(comm, file, name, ranges[name], layout[name][1][1:]) for name in ARRAYS}
    else:
        assert file is not None
        here = file
        found = on_each(comm, lambda: {name: here.rows(name, ranges[name].first, ranges[name].last) for name in ARRAYS})
        if comm.rank:  # rank 0 reads other files
            end_reading()
    of_facets: dict[str, Any] = {name: found[name] for name in ARRAYS if name not in SLICED}
    rows = replace(names, **of_facets)
    cells, nodes, cell = ranges["cells"], ranges["points"], found["cells"]
    corner = np.unique(cell)
    corner = corner[np.searchsorted(corner, 0) :]
    local = np.where(cell >= 0, np.searchsorted(corner, cell), -1)
    corner_points = nodes.look_up(found["points"], corner)
    facets = Facets(ranges["joint_bottom"], ranges["side_facets"], ranges["flow_origin"], rows)
    raw = Raw(saved, cells, nodes, cell, found["cell_rock"], found["points"], found["origin"], corner, local,
        corner_points, facets)  # fmt: skip
    return _checked(raw)


def _opened_by_all(comm: MPI.Comm, saved: SavedMesh) -> tuple[SplitMesh, Layout, SlicedFile | None]:
    """Names, layout and file of a mesh, which each rank opens. Raises InputError, on every rank. Collective."""
    file = on_each(comm, lambda: _opened(saved))
    _refuse_others(comm, file)
    return file.names, file.layout, file


def _opened_by_one(comm: MPI.Comm, saved: SavedMesh) -> tuple[SplitMesh, Layout, SlicedFile | None]:
    """The same of one that rank 0 opens, None elsewhere. Raises InputError, on every rank. Collective."""
    file = on_root(comm, lambda: _opened(saved))
    names, layout = comm.bcast(None if file is None else (file.names, file.layout), root=0)
    return names, layout, file


def _passed_on(comm: MPI.Comm, file: SlicedFile | None, name: str, of: Directory, width: tuple[int, ...]) -> Values:
    """Rows (s, ...) of this rank's range of an array in numbers of 8 bytes, which rank 0 reads. Collective.

    width  shape of a row

    Raises InputError, on every rank.
    """
    mine: Values | None = None
    for rank in reversed(range(comm.size)):  # its own the last: never more than those of one other
        first, last = int(of.starts[rank]), int(of.starts[rank + 1])
        part = _read_on_root(comm, file, name, first, last)
        if rank and part is not None:
            comm.Send([np.ascontiguousarray(part).view(np.int64), MPI.INT64_T], rank)
        elif rank and rank == comm.rank:
            mine = np.empty((last - first, *width), dtype=dtype_of(name))
            comm.Recv([mine.view(np.int64), MPI.INT64_T], 0)
        elif rank == 0 and part is not None:
            mine = part
    assert mine is not None
    return mine


def _read_on_root(comm: MPI.Comm, file: SlicedFile | None, name: str, first: int, last: int) -> Values | None:
    return on_root(comm, lambda: None if file is None else file.rows(name, first, last))


def _opened(saved: SavedMesh) -> SlicedFile:
    file = SlicedFile(saved.path, saved.root, saved.remedy)
    if file.layout["cells"][1][1] < 3 or file.layout["points"][1][1] != 2:
        raise no_plane_rock(saved.path)
    return file


def _refuse_others(comm: MPI.Comm, file: SlicedFile) -> None:
    """Raise InputError, on every rank, where one has opened another file than rank 0. Collective."""
    mine = file.root, file.layout, file.names.near
    is_other = mine != comm.bcast(mine, root=0)
    rank = comm.allreduce(comm.rank if is_other else comm.size, op=MPI.MIN)
    if rank < comm.size:
        why = f"rank {rank} finds another file there than rank 0; put it where all ranks see the same"
        raise InputError(f"{file.path}: {why}")


def _checked(raw: Raw) -> Raw:
    """The part that was read, of a mesh that a scene can take. Raises InputError, on every rank. Collective."""
    nodes, rows, comm = raw.nodes, raw.facets.rows, raw.nodes.comm
    copies = raw.origin[raw.origin != nodes.numbers]
    is_wrong = bool((nodes.look_up(raw.origin, copies) != copies).any())
    cells, walls = raw.cells, walls_of(rows)
    of_joints = cells.look_up(raw.cell, rows.joint_cells.ravel()).reshape(*rows.joint_cells.shape, raw.cell.shape[1])
    of_sides = cells.look_up(raw.cell, rows.side_cell)
    first = nodes.look_up(raw.origin, walls.ravel()).reshape(walls.shape)
    is_apart = not are_beside(rows, of_joints, of_sides, first)
    for is_so, why in ((is_wrong, "origin has copies of copies"), (is_apart, NOT_BESIDE)):
        if comm.allreduce(is_so, op=MPI.LOR):
            raise InputError(f"{raw.saved.path}: is no saved mesh ({why}); {raw.saved.remedy}")
    if raw.saved.near >= 0:
        return raw
    ends = np.zeros(len(raw.points), dtype=np.int64)
    on = nodes.look_up(raw.origin, np.unique(rows.joint_bottom))
    nodes.put(ends, on, np.ones_like(on))
    refuse_joined_ends(raw.facets.flow.total, comm.allreduce(int(ends.sum())), raw.saved.path)
    flow = raw.facets.flow.look_up(rows.flow_origin, rows.joint_flow.ravel()).reshape(rows.joint_flow.shape)
    refuse_flow_elsewhere(comm.allreduce(np.array_equal(flow, first[:, 0]), op=MPI.LAND), raw.saved.path)
    return replace(raw, facets=replace(raw.facets, rows=replace(rows, cuts=0, near=-1)))


def frame_of(raw: Raw, fractures: Collection[str]) -> SplitMesh | None:
    """Named points and joints of some fractures, to find places on: a mesh without a cell, on rank 0; else None. Collective."""
    nodes, rows = raw.nodes, raw.facets.rows
    chosen = [number for number, name in enumerate(rows.fractures) if name in fractures]
    here = np.flatnonzero(np.isin(rows.joint_fracture, chosen))
    to_first = Route(nodes.comm, np.zeros_like(here))
    bottom, fracture = (to_first.send(each[here]) for each in (rows.joint_bottom, rows.joint_fracture))
    along = to_first.send(rows.joint_along[here])
    asked = np.array(list(rows.named_points.values()) if nodes.comm.rank == 0 else [], dtype=np.int64)
    asked = np.union1d(asked, bottom)
    node = np.union1d(asked, nodes.look_up(raw.origin, asked))
    points, origin = (nodes.look_up(each, node) for each in (raw.points, raw.origin))
    if nodes.comm.rank:
        return None
    named = {name: int(np.searchsorted(node, at)) for name, at in rows.named_points.items()}
    none: dict[str, Any] = {name: getattr(rows, name)[:0] for name in ARRAYS}
    first, faces = np.searchsorted(node, origin), np.searchsorted(node, bottom)
    joints = {"joint_bottom": faces, "joint_fracture": fracture, "joint_along": along}
    return replace(rows, **none | joints | {"points": points, "origin": first}, named_points=named)


_OF_NODES = ("joint_bottom", "joint_top", "side_facets", "flow_origin")


def moved(mesh: SplitMesh, number: Callable[[Ints], Ints]) -> SplitMesh:
    """The mesh with other numbers (n,) of nodes (n,) in its joints, sides, flow nodes and names."""
    tables = [np.asarray(getattr(mesh, name), dtype=np.int64) for name in _OF_NODES]
    names = np.array(list(mesh.named_points.values()), dtype=np.int64)
    found = number(np.concatenate([names, *(table.ravel() for table in tables)]))
    ends = np.cumsum([len(names), *(table.size for table in tables)])
    new: dict[str, Any] = {
        name: part.reshape(table.shape)
        for name, table, part in zip(_OF_NODES, tables, np.split(found[ends[0] :], ends[1:-1] - ends[0]), strict=True)
    }
    return replace(mesh, named_points=dict(zip(mesh.named_points, found[: ends[0]].tolist(), strict=True)), **new)
