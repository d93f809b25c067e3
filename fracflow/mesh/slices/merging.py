"""Slices without some fractures, of blocks that ranks have: the walls of these are one, as of ``split.merged_faces``."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fracflow.mesh.agreement import on_root
from fracflow.mesh.blocks import Blocks
from fracflow.mesh.data import Bools, SplitMesh
from fracflow.mesh.slices.directory import Directory
from fracflow.mesh.slices.near_first import Slices, at_joints
from fracflow.mesh.slices.reading import Facets
from fracflow.mesh.split import merged_faces, merged_nodes


def merged_slices(mesh: SplitMesh | None, blocks: Blocks, chosen: Bools) -> tuple[SplitMesh | None, Slices]:
    """The near cells, on rank 0, and slices of all, without the fractures chosen (f,). Collective.

    mesh  the near cells of the blocks, with all joints, on rank 0, else None
    """
    comm, solid, sizes = blocks.comm, blocks.solid, blocks.sizes
    merged = on_root(comm, lambda: None if mesh is None else replace(merged_faces(mesh, chosen), sums=None))
    counts = None if mesh is None or merged is None else (len(mesh.points), len(merged.points), mesh.near)
    before, after, near = comm.bcast(counts, root=0)
    old = Directory(comm, before)
    table = np.zeros((old.last - old.first, 2), dtype=np.int64)  # new number of each near node, and whether it stays
    new = np.column_stack(merged_nodes(mesh, chosen)).astype(np.int64) if mesh is not None else table[:0]
    old.put(table, np.arange(len(new)), new)

    numbers, is_near = solid.node_ids + (after - before), solid.node_ids < before
    stays = np.ones(len(numbers), dtype=bool)
    found = old.look_up(table, solid.node_ids[is_near])
    numbers[is_near], stays[is_near] = found[:, 0], found[:, 1] > 0
    nodes = Directory(comm, sizes.nodes + after - before)
    points, origin = np.empty((nodes.last - nodes.first, 2)), np.empty(nodes.last - nodes.first, dtype=np.int64)
    own = np.flatnonzero(stays[: solid.owned])
    first = solid.origin[own] + (after - before)
    is_near = solid.origin[own] < before
    first[is_near] = old.look_up(table, solid.origin[own][is_near])[:, 0]
    nodes.put(points, numbers[own], solid.points[own])
    nodes.put(origin, numbers[own], first)

    is_corner = solid.cells >= 0
    corners = solid.points[np.where(is_corner, solid.cells, solid.cells[:, :1])]
    middle = (corners * is_corner[..., None]).sum(axis=1) / np.maximum(is_corner.sum(axis=1), 1)[:, None]
    facets = Facets.from_rank_0(comm, merged)
    at_joints(middle, solid.cell_ids, near, nodes, points, facets)
    cells = np.append(numbers, -1)[solid.cells]
    return merged, Slices(
        nodes, sizes.cells, near, solid.cell_ids, cells, solid.cell_rock, middle, points, origin, facets
    )
