"""Slices in new numbers, by which near cells and nodes come first: as ``near_cells.with_near_first``, by all ranks together."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fracflow._petsc import MPI
from fracflow.errors import InputError
from fracflow.mesh.data import Bools, Floats, Ints, SplitMesh
from fracflow.mesh.locate import all_covering
from fracflow.mesh.slices.directory import Directory, Route
from fracflow.mesh.slices.reading import NONE, Facets, Raw, moved
from fracflow.mesh.store import NOT_FIRST


@dataclass(frozen=True)
class Slices:
    """Cells, joints and sides of this rank and a range of nodes, in numbers by which the near ones come first.

    nodes      who keeps which numbers of nodes
    total      how many cells there are
    near       how many of them come first
    number     (m,) of each cell here
    cells      (m, c) their nodes, -1 pads
    cell_rock  (m,) of each
    middle     (m, dim) mean of the corners; of a cell at a joint, the middle of the joint [length]
    points     (s, dim) of the nodes of the range [length]
    origin     (s,) of each
    facets     joints and sides of its ranges, all of them on near cells
    """

    nodes: Directory
    total: int
    near: int
    number: Ints
    cells: Ints
    cell_rock: Ints
    middle: Floats
    points: Floats
    origin: Ints
    facets: Facets

    @property
    def comm(self) -> MPI.Comm:
        """Of all ranks."""
        return self.nodes.comm


def with_near_first(raw: Raw, places: Floats) -> tuple[SplitMesh | None, Slices] | None:
    """The mesh of near cells, on rank 0, and slices of all. Raises InputError, on every rank. Collective.

    Near cells are those of ``near_cells``, at places (p, dim) too. In a run that goes on they are those that came first in
    it. There is none where a place lies in others: None.
    """
    comm, near = raw.cells.comm, raw.saved.near
    is_near = _near_cells(raw, places)
    if near >= 0:
        is_first = raw.cells.numbers < near
        if comm.allreduce(bool((is_near & ~is_first).any()), op=MPI.LOR):
            return None
        is_near = is_first
    cell, near = _first(comm, is_near)
    has = np.zeros(len(raw.points), dtype=np.int64)
    on_near = np.unique(raw.local[is_near])
    on_near = on_near[np.searchsorted(on_near, 0) :]
    raw.nodes.put(has, raw.corner[on_near], np.ones(len(on_near), dtype=np.int64))
    node, near_nodes = _first(comm, has > 0)
    if raw.saved.near >= 0:
        stays = np.array_equal(cell, raw.cells.numbers) and np.array_equal(node, raw.nodes.numbers)
        _refuse(raw, not comm.allreduce(stays, op=MPI.LAND))
    slices = _renumbered(raw, cell, near, node)
    rows, copies = slices.facets.rows, slices.origin[slices.nodes.numbers < near_nodes]
    of_nodes = (rows.joint_bottom, rows.joint_top, rows.side_facets, rows.flow_origin, copies)
    is_wrong = any((each >= near_nodes).any() for each in of_nodes)
    is_wrong = is_wrong or any((each >= near).any() for each in (rows.joint_cells, rows.side_cell))
    _refuse(raw, comm.allreduce(bool(is_wrong), op=MPI.LOR))
    return _near_mesh(slices, near_nodes), slices


def _near_cells(raw: Raw, places: Floats) -> Bools:
    """Which cells (m,) of this rank's range are near. Collective."""
    rows = raw.facets.rows
    named = [each for each in rows.named_points.values() if raw.nodes.comm.rank == 0]
    low, high, farthest = _extremes(raw)
    of_places = [_covering(raw, place, float((high - low).max())) for place in places]
    on = np.unique(np.concatenate([rows.joint_bottom.ravel(), rows.side_facets.ravel(), farthest, *of_places]))
    on = raw.nodes.look_up(raw.origin, on[np.searchsorted(on, 0) :])
    flags = np.zeros(len(raw.points), dtype=np.int64)
    numbers = np.concatenate([on, np.array(named, dtype=np.int64)])
    raw.nodes.put(flags, numbers, np.ones(len(numbers), dtype=np.int64))
    copies = np.flatnonzero(raw.origin != raw.nodes.numbers)
    of_copies = raw.nodes.look_up(flags, raw.origin[copies])
    flags[copies] = of_copies
    is_on = raw.nodes.look_up(flags, raw.corner) > 0
    first = np.where(raw.local >= 0, raw.local, raw.local[:, :1])
    return np.asarray(is_on[first].any(axis=1))


def _extremes(raw: Raw) -> tuple[Floats, Floats, Ints]:
    """Lowest and highest coordinates (dim,) of all nodes, and on rank 0 the first nodes (2 dim,) that have them. Collective."""
    signed = np.concatenate([raw.points, -raw.points], axis=1)
    at = signed.argmin(axis=0) if len(signed) else NONE
    mine = [(float(signed[row, column]), raw.nodes.first + int(row)) for column, row in enumerate(at)]
    found = zip(*(each for each in raw.nodes.comm.allgather(mine) if each), strict=True)
    least = [min(each) for each in found]
    values, dim = np.array([value for value, _ in least]), raw.points.shape[1]
    nodes = np.array([node for _, node in least if raw.nodes.comm.rank == 0], dtype=np.int64)
    return values[:dim], -values[dim:], nodes


def _covering(raw: Raw, place: Floats, extent: float) -> Ints:
    """Nodes (c,) of the cell that a place (dim,) lies in, on the rank that has the cell; none elsewhere. Collective."""
    rows, depth = all_covering(raw.corner_points, raw.local, place, extent)
    best = int(rows[np.argmax(depth)]) if len(rows) else -1
    mine = (float(depth.max(initial=-np.inf)), -raw.cells.first - best)
    return raw.cell[best] if max(raw.cells.comm.allgather(mine)) == mine and best >= 0 else NONE


def _first(comm: MPI.Comm, chosen: Bools) -> tuple[Ints, int]:
    """New numbers (n,) of this rank's part of a list: the chosen ones of all ranks first, and their count. Collective."""
    counts = np.array(comm.allgather((int(chosen.sum()), int((~chosen).sum()))))
    total, (before, others) = int(counts[:, 0].sum()), counts[: comm.rank].sum(axis=0)
    number = np.where(chosen, before + np.cumsum(chosen), total + others + np.cumsum(~chosen)) - 1
    return number.astype(np.int64), total


def _refuse(raw: Raw, is_wrong: bool) -> None:
    if is_wrong:
        raise InputError(f"{raw.saved.path}: is no saved mesh ({NOT_FIRST}); {raw.saved.remedy}")


def _renumbered(raw: Raw, cell: Ints, near: int, node: Ints) -> Slices:
    """The slices by the new numbers of this rank's cells and nodes. Collective."""
    nodes, corners = raw.nodes, raw.corner_points[np.where(raw.local >= 0, raw.local, raw.local[:, :1])]
    is_corner = raw.local >= 0
    middle = (corners * is_corner[..., None]).sum(axis=1) / np.maximum(is_corner.sum(axis=1), 1)[:, None]
    rows = raw.facets.rows
    points, origin = np.empty_like(raw.points), np.empty_like(raw.origin)
    nodes.put(points, node, raw.points)
    nodes.put(origin, node, nodes.look_up(node, raw.origin))
    cells = np.append(nodes.look_up(node, raw.corner), -1)[raw.local]
    rows = replace(
        moved(rows, lambda numbers: nodes.look_up(node, numbers)),
        joint_cells=raw.cells.look_up(cell, rows.joint_cells.ravel()).reshape(-1, 2),
        side_cell=raw.cells.look_up(cell, rows.side_cell),
        near=near,
    )
    facets = replace(raw.facets, rows=rows)
    at_joints(middle, cell, near, nodes, points, facets)
    return Slices(nodes, raw.cells.total, near, cell, cells, raw.rock, middle, points, origin, facets)


def at_joints(middle: Floats, number: Ints, near: int, nodes: Directory, points: Floats, facets: Facets) -> None:
    """Let the middles (m, dim) of cells at a joint be that of the joint; of a cell at several the first counts. Collective.

    number  (m,) of each cell here, of which the first ``near`` may be at joints
    points  (s, dim) of the nodes of the range [length]
    """
    rows, joints, of_cells = facets.rows, facets.joints, Directory(nodes.comm, near)
    first = of_cells.lowest(rows.joint_cells.ravel(), np.repeat(joints.numbers, 2), joints.total)
    here = np.flatnonzero(number < near)
    joint = of_cells.look_up(first, number[here])
    has_any = joint < joints.total
    where = nodes.look_up(points, rows.joint_bottom.ravel()).reshape(-1, 2, points.shape[1]).mean(axis=1)
    middle[here[has_any]] = joints.look_up(where, joint[has_any])


def _near_mesh(slices: Slices, near_nodes: int) -> SplitMesh | None:
    """The near cells with all joints and sides, on rank 0. Collective."""
    comm, of_nodes = slices.comm, slices.nodes.numbers
    here = np.flatnonzero(slices.number < slices.near)
    to_first = Route(comm, np.zeros_like(here))
    number, cells, rock = (to_first.send(each[here]) for each in (slices.number, slices.cells, slices.cell_rock))
    here = np.flatnonzero(of_nodes < near_nodes)
    to_first = Route(comm, np.zeros_like(here))
    points, origin = to_first.send(slices.points[here]), to_first.send(slices.origin[here])
    facets, order = slices.facets.on_rank_0(), np.argsort(number)
    if comm.rank:
        return None
    return replace(
        slices.facets.rows, **facets, points=points, origin=origin, cells=cells[order], cell_rock=rock[order]
    )
