"""Displacements of the intact rock, and strips of rock along its fractures, as parts of the unknowns of a step."""

from __future__ import annotations

import numpy as np

from fracflow._petsc import PETSc
from fracflow.mesh.blocks import Blocks, petsc_ints
from fracflow.mesh.data import Bools, Floats, Ints
from fracflow.mesh.shared import Shared
from fracflow.model.layout import Layout, add_blocks, create_matrix


def walls(blocks: Blocks, nodes: Shared) -> Floats:
    """The flow node (n,) that each local node is a wall of; -1 for none. Collective."""
    found = np.full(len(blocks.solid.points), -1.0)
    for side in (blocks.joints.bottom, blocks.joints.top):
        np.maximum.at(found, side.ravel(), blocks.joints.flow.ravel().astype(float))
    return nodes.largest(found)


def intact(blocks: Blocks, layout: Layout, wall: Floats) -> PETSc.Mat:
    """E: unknowns of a step from displacements that all walls of a flow node share; without pressures and rigid bodies.

    wall  (n,) flow node of each local node, -1 for none

    No joint resists such displacements: E' A E is the rock without its fractures. The caller destroys E. Collective.
    """
    block, dim, comm = blocks.solid, blocks.sizes.dim, blocks.comm
    first, last = block.unknown_starts[comm.rank : comm.rank + 2]
    free = np.flatnonzero(block.body < 0)
    numbers = block.unknown[free]
    unknowns = Shared(comm, int(last - first), int(block.unknown_starts[-1]), numbers.ravel())
    flow = unknowns.largest(np.repeat(wall[free], dim)).astype(np.int64).reshape(numbers.shape)
    unknowns.destroy()
    is_mine = (numbers >= first) & (numbers < last)
    rows, once = np.unique(numbers[is_mine], return_index=True)
    flow, axis = flow[is_mine][once], np.broadcast_to(np.arange(dim), numbers.shape)[is_mine][once]
    is_whole = flow < 0
    whole = np.array(comm.allgather(int(is_whole.sum())))
    sizes = whole + dim * np.diff(blocks.flow.starts)
    starts = np.concatenate([[0], np.cumsum(sizes)])
    cols = np.zeros(len(rows), dtype=np.int64)
    cols[is_whole] = starts[comm.rank] + np.arange(whole[comm.rank])
    owner = np.searchsorted(blocks.flow.starts, flow[~is_whole], side="right") - 1
    cols[~is_whole] = (
        starts[owner] + whole[owner] + dim * (flow[~is_whole] - blocks.flow.starts[owner]) + axis[~is_whole]
    )
    here = layout.solid_count + layout.flow_count, layout.total
    result = create_matrix((here, (int(sizes[comm.rank]), int(starts[-1]))), 1, comm)
    add_blocks(result, layout.solid_numbers(rows)[:, None], cols[:, None], np.ones((len(rows), 1, 1)))
    result.assemble()
    return result


def grown(blocks: Blocks, nodes: Shared, marked: Bools, layers: int) -> Bools:
    """Marked local nodes (n,) and those within so many cells of one. Collective."""
    cells = blocks.solid.cells
    for _ in range(layers):
        touched = cells[(marked[cells] & (cells >= 0)).any(axis=1)].ravel()
        marked = marked.copy()
        marked[touched[touched >= 0]] = True
        marked = nodes.largest(marked.astype(float)) > 0.0
    return marked


def strips(blocks: Blocks, layout: Layout, marked: Bools) -> PETSc.IS:
    """Unknowns of marked local nodes (n,), of rigid bodies, and all pressures. The caller destroys them. Not collective."""
    block, rank = blocks.solid, blocks.comm.rank
    first, last = block.unknown_starts[rank : rank + 2]
    some = np.concatenate([block.unknown[marked & (block.body < 0)].ravel(), block.body_unknown.ravel()])
    some = np.unique(some[(some >= first) & (some < last)])
    pressures = layout.start + layout.solid_count + np.arange(layout.flow_count)
    chosen: Ints = np.concatenate([layout.solid_numbers(some), pressures])
    return PETSc.IS().createGeneral(petsc_ints(chosen), comm=blocks.comm)
