"""The order of nodes in a sweep through the rock, and which of them wait for other ranks."""

from __future__ import annotations

import numpy as np

from fracflow._petsc import PETSc, destroy
from fracflow.mesh.blocks import Blocks, petsc_ints
from fracflow.mesh.data import Bools, Floats, Ints

NEAR = 4096  # mean distance in memory of the nodes of a cell, from which on they are put into another order


def late_nodes(blocks: Blocks, cells: Ints) -> tuple[Bools, Bools]:
    """Nodes (n,) of cells with ghosts, or that other ranks have as ghosts; and those cells (m,). Collective."""
    block, count = blocks.solid, len(blocks.solid.points)
    late, beside = np.zeros(count, dtype=bool), np.zeros(len(cells), dtype=bool)
    if blocks.comm.size > 1:
        numbers = petsc_ints(block.node_global)
        whole = PETSc.Vec().createMPI((block.owned, blocks.sizes.nodes), comm=blocks.comm)
        whole.setValues(numbers[block.owned :], np.ones(count - block.owned), addv=PETSc.InsertMode.ADD)
        whole.assemble()
        late[: block.owned] = whole.getArray() > 0.0
        whole.destroy()
        late[block.owned :] = True
        beside = ((cells >= block.owned) & (cells >= 0)).any(axis=1)
        late[cells[beside][cells[beside] >= 0]] = True
    late[block.owned :] = False
    return late, beside


def at_ghosts(blocks: Blocks, values: Floats) -> Floats:
    """Values (g,) of this rank's ghosts by their owners, of values (n,) at owned nodes. Collective."""
    block = blocks.solid
    whole = PETSc.Vec().createMPI((block.owned, blocks.sizes.nodes), comm=blocks.comm)
    whole.setArray(values)
    chosen = PETSc.IS().createGeneral(petsc_ints(block.node_global[block.owned :]), comm=PETSc.COMM_SELF)
    found, scatter = _gathered(whole, chosen)
    result: Floats = found.getArray().copy()
    destroy(whole, chosen, found, scatter)
    return result


def _gathered(whole: PETSc.Vec, chosen: PETSc.IS) -> tuple[PETSc.Vec, PETSc.Scatter]:
    found = PETSc.Vec().createSeq(chosen.getLocalSize())
    scatter = PETSc.Scatter().create(whole, chosen, found, None)
    scatter.scatter(whole, found)
    return found, scatter


def order_of_sweep(cells: Ints, owned: int, late: Bools) -> Ints:
    """Local nodes (n,) in the order of a sweep: those that come late behind the others, ghosts last.

    As they are numbered, where nodes of a cell are near each other in memory; else by reverse Cuthill and McKee.
    """
    count = len(late)
    lowest = np.where(cells >= 0, cells, count).min(axis=1, initial=count)
    order = np.arange(owned)
    if len(cells) and float((cells.max(axis=1) - lowest).mean()) > NEAR:
        from scipy import sparse  # imports much
        from scipy.sparse.csgraph import reverse_cuthill_mckee

        width = cells.shape[1]
        pairs = [np.stack([cells[:, i], cells[:, j]], 1) for i in range(width) for j in range(width) if i != j]
        row, col = np.concatenate(pairs).T
        inside = (row >= 0) & (col >= 0) & (row < owned) & (col < owned)
        graph = sparse.csr_matrix((np.ones(inside.sum()), (row[inside], col[inside])), shape=(owned, owned))
        order = np.asarray(reverse_cuthill_mckee(graph, symmetric_mode=True), dtype=np.int64)
    return np.concatenate([order[~late[order]], order[late[order]], np.arange(owned, count)])
