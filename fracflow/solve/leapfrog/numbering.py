"""The order of nodes in a sweep through the rock, and which of them wait for other ranks."""

from __future__ import annotations

import numpy as np

from fracflow._petsc import MPI, PETSc, destroy
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


class GhostWay:
    """Sends own values to ranks that have them as ghosts, and adds other values at ghosts to those of their owners."""

    def __init__(
        self, comm: MPI.Comm, wanted: Ints, values: tuple[Floats, Floats], others: tuple[Floats, Floats] | None = None
    ) -> None:
        """Keep arrays of own values (n,) and of ghosts (g,), by whose numbers ``wanted`` (g,) these are found. Collective."""
        own, ghosts = values
        self._size = (len(own), comm.allreduce(len(own)))
        self._values = self._vectors(comm, own, ghosts)
        self._others = None if others is None else self._vectors(comm, *others)
        chosen = PETSc.IS().createGeneral(petsc_ints(wanted), comm=PETSc.COMM_SELF)
        self._scatter = PETSc.Scatter().create(self._values[0], chosen, self._values[1], None)
        chosen.destroy()

    def _vectors(self, comm: MPI.Comm, own: Floats, ghosts: Floats) -> tuple[PETSc.Vec, PETSc.Vec]:
        whole = PETSc.Vec().createWithArray(own, size=self._size, comm=comm)
        return whole, PETSc.Vec().createWithArray(ghosts, comm=PETSc.COMM_SELF)

    def begin(self) -> None:
        """Send values. Collective."""
        self._scatter.scatterBegin(*self._values, PETSc.InsertMode.INSERT, PETSc.ScatterMode.FORWARD)

    def end(self) -> None:
        """Receive them. Collective."""
        self._scatter.scatterEnd(*self._values, PETSc.InsertMode.INSERT, PETSc.ScatterMode.FORWARD)

    def begin_back(self) -> None:
        """Send the others. Collective."""
        assert self._others is not None
        own, ghosts = self._others
        self._scatter.scatterBegin(ghosts, own, PETSc.InsertMode.ADD, PETSc.ScatterMode.REVERSE)

    def end_back(self) -> None:
        """Receive them, and add them to those of this rank. Collective."""
        assert self._others is not None
        own, ghosts = self._others
        self._scatter.scatterEnd(ghosts, own, PETSc.InsertMode.ADD, PETSc.ScatterMode.REVERSE)

    def destroy(self) -> None:
        """Free it. Collective."""
        destroy(*self._values, *(self._others or ()), self._scatter)


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
