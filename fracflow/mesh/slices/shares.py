"""From slices to the blocks of every rank, as ``mesh.distribute`` makes them of a mesh that rank 0 has.

Cells go to ranks by where they are, and joints and sides go with theirs. Who else has a node, and which piece it is of, is
known where its number is kept.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from fracflow._petsc import MPI
from fracflow.mesh.blocks import Blocks, Sizes
from fracflow.mesh.data import Bools, Floats, Ints, SplitMesh
from fracflow.mesh.numbering import Common, blocks_of
from fracflow.mesh.share import Share
from fracflow.mesh.slices.bisection import bisected
from fracflow.mesh.slices.directory import Directory, Route
from fracflow.mesh.slices.near_first import Slices
from fracflow.mesh.slices.pieces import joined, owners
from fracflow.mesh.slices.reading import Facets


def distribute_slices(
    mesh: SplitMesh | None, slices: Slices, rigid_rocks: Collection[str] = (), ties: Ints | None = None
) -> Blocks:
    """Send each rank its cells with all that is on them, and number all. Collective.

    mesh  the near cells on rank 0, else None: wells may have joined its flow nodes
    ties  (m, 2) pairs of node * dim + component that move alike, on rank 0; none of a rigid rock
    """
    comm, nodes = slices.comm, slices.nodes
    cell_rank = bisected(slices.middle, comm)
    facets = _with_flow_of(mesh, slices)
    rows, cut = _sent(slices, facets, cell_rank)
    there = Route(comm, cell_rank)
    cell = there.send(slices.number)
    order = np.argsort(cell)
    cell, cells, cell_rock = cell[order], there.send(slices.cells)[order], there.send(slices.cell_rock)[order]
    corner = np.unique(cells)
    corner = corner[np.searchsorted(corner, 0) :]
    node = np.union1d(corner, rows.faces)
    rocks, sides, fractures = facets.rows.rocks, facets.rows.sides, facets.rows.fractures
    rigid = np.isin(cell_rock, [i for i, rock in enumerate(rocks) if rock in rigid_rocks])

    first, last = owners(nodes, corner)
    is_shared = nodes.look_up((first != last).astype(np.int64), corner) > 0
    at_corner = np.where(cells >= 0, np.searchsorted(corner, cells), -1)
    pieces = joined(nodes, corner, is_shared, at_corner)
    bodies = joined(nodes, corner, is_shared, at_corner[rigid])
    local = np.where(cells >= 0, np.searchsorted(node, cells), -1)
    flow_node, one_end, local_flow = np.unique(rows.flow, return_index=True, return_inverse=True)
    flow_first = facets.flow.lowest(flow_node, np.full(len(flow_node), comm.rank, dtype=np.int64), comm.size)
    share = Share(
        rank=comm.rank,
        node=node,
        points=nodes.look_up(slices.points, node),
        origin=nodes.look_up(slices.origin, node),
        owner=nodes.look_up(first, node),
        body=bodies.of(node),
        piece=pieces.of(node),
        cell=cell,
        cells=local,
        cell_rock=cell_rock,
        joint=rows.joint,
        faces=np.searchsorted(node, rows.faces),
        fracture=rows.fracture,
        along=rows.along,
        flow=local_flow.reshape(-1, 2),
        flow_node=flow_node,
        flow_points=rows.flow_points.reshape(-1, 2)[one_end],
        flow_owner=facets.flow.look_up(flow_first, flow_node),
        side_facets=np.searchsorted(node, rows.side_facets),
        side_of=rows.side_of,
        side_cell=np.searchsorted(cell, rows.side_cell),
    )
    sizes = Sizes(2, nodes.total, slices.total, facets.joints.total, facets.flow.total, cut)
    none = np.zeros((0, 2), dtype=np.int64)
    tied = comm.bcast(none if ties is None else ties, root=0)
    count = len(rocks)
    common = Common(
        sizes, rocks, sides, fractures, tied,
        *_of_bodies(share, rigid, len(bodies.roots), count, comm), *_of_pieces(share, len(pieces.roots), count, comm),
    )  # fmt: skip
    return blocks_of(share, common, comm)


@dataclass(frozen=True)
class _Rows:
    """Joints (j,) and named facets (s,) of a rank, in numbers of the mesh; see ``Share``.

    flow         (j, 2)
    flow_points  (j, 2, dim) of each end [length]
    side_cell    (s,)
    """

    joint: Ints
    faces: Ints
    flow: Ints
    fracture: Ints
    along: Floats
    flow_points: Floats
    side_facets: Ints
    side_of: Ints
    side_cell: Ints


def _with_flow_of(mesh: SplitMesh | None, slices: Slices) -> Facets:
    """Joints and sides with the flow nodes of ``mesh``, where wells have joined some. Collective."""
    comm, facets = slices.comm, slices.facets
    count = comm.bcast(0 if mesh is None else len(mesh.flow_origin), root=0)
    if count == facets.flow.total:
        return facets
    flow, joints = Directory(comm, count), np.empty_like(facets.rows.joint_flow)
    origin = np.empty(flow.last - flow.first, dtype=np.int64)
    for directory, kept, values in (
        (flow, origin, None if mesh is None else mesh.flow_origin),
        (facets.joints, joints, None if mesh is None else mesh.joint_flow),
    ):
        values = kept[:0] if values is None else values
        directory.put(kept, np.arange(len(values)), values)
    return replace(facets, flow=flow, rows=replace(facets.rows, joint_flow=joints, flow_origin=origin))


def _sent(slices: Slices, facets: Facets, cell_rank: Ints) -> tuple[_Rows, int]:
    """The joints and sides of this rank, and how many joints of all are cut, by the rank (m,) of each cell here. Collective."""
    comm, nodes, table = slices.comm, slices.nodes, facets.rows
    near, here = Directory(comm, slices.near), np.flatnonzero(slices.number < slices.near)
    rank = np.empty(near.last - near.first, dtype=np.int64)
    near.put(rank, slices.number[here], cell_rank[here])
    below, above = near.look_up(rank, table.joint_cells.ravel()).reshape(-1, 2).T
    ends = facets.flow.look_up(table.flow_origin, table.joint_flow.ravel())
    places = nodes.look_up(slices.points, ends).reshape(-1, 4)
    joints = np.column_stack([
        facets.joints.numbers, table.joint_bottom, table.joint_top, table.joint_flow, table.joint_fracture
    ])  # fmt: skip
    along, sides = np.column_stack([table.joint_along, places]), [table.side_facets, table.side_of, table.side_cell]
    to_joints, to_sides = Route(comm, below), Route(comm, near.look_up(rank, table.side_cell))
    joints, along, side = to_joints.send(joints), to_joints.send(along), to_sides.send(np.column_stack(sides))
    rows = _Rows(
        joint=joints[:, 0].copy(),
        faces=joints[:, 1:5].reshape(-1, 2, 2),
        flow=joints[:, 5:7],
        fracture=joints[:, 7].copy(),
        along=along[:, :2].copy(),
        flow_points=along[:, 2:].reshape(-1, 2, 2),
        side_facets=side[:, :2],
        side_of=side[:, 2].copy(),
        side_cell=side[:, 3],
    )
    return rows, int(comm.allreduce(int(np.count_nonzero(below != above)), op=MPI.SUM))


def _of_bodies(share: Share, rigid: Bools, count: int, rocks: int, comm: MPI.Comm) -> tuple[Floats, Ints, Ints]:
    """Center (b, dim), rock and lowest owner (b,) of each rigid body, of cells that are ``rigid`` (m,). Collective."""
    on = np.flatnonzero(share.body >= 0)
    owner = np.full(count, comm.size, dtype=np.int64)
    np.minimum.at(owner, share.body[on], share.owner[on])
    cell = np.full(count, -1, dtype=np.int64)
    np.maximum.at(cell, share.body[share.cells[rigid, 0]], share.cell[rigid] * rocks + share.cell_rock[rigid])
    comm.Allreduce(MPI.IN_PLACE, owner, MPI.MIN)
    comm.Allreduce(MPI.IN_PLACE, cell, MPI.MAX)
    mine = on[share.owner[on] == comm.rank]
    sums = np.zeros((count, 3))  # coordinates, and how many
    np.add.at(sums, share.body[mine], np.column_stack([share.points[mine], np.ones(len(mine))]))
    comm.Allreduce(MPI.IN_PLACE, sums, MPI.SUM)
    return sums[:, :2] / sums[:, 2:], cell % rocks, owner


def _of_pieces(share: Share, count: int, rocks: int, comm: MPI.Comm) -> tuple[Ints, Floats]:
    """Rock (p,) of the first cell of each block of rock, and its box (p, 2, dim). Collective."""
    cell = np.full(count, np.iinfo(np.int64).max)
    np.minimum.at(cell, share.piece[share.cells[:, 0]], share.cell * rocks + share.cell_rock)
    comm.Allreduce(MPI.IN_PLACE, cell, MPI.MIN)
    on = np.flatnonzero(share.piece >= 0)
    low, high = np.full((count, 2), np.inf), np.full((count, 2), -np.inf)
    np.minimum.at(low, share.piece[on], share.points[on])
    np.maximum.at(high, share.piece[on], share.points[on])
    comm.Allreduce(MPI.IN_PLACE, low, MPI.MIN)
    comm.Allreduce(MPI.IN_PLACE, high, MPI.MAX)
    return cell % rocks, np.stack([low, high], axis=1)
