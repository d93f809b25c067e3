"""Clusters of joint sections that move each other through the nodes they share, however many ranks have them.

With a lumped mass G M^-1 G' couples only the sections at the copies of one node, of tied nodes, or around one rigid block.
These blocks are small and solved all at once, each on one rank.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fracflow._petsc import MPI, PETSc, destroy
from fracflow.mesh.blocks import owner_of
from fracflow.mesh.data import Floats, Ints
from fracflow.mesh.graph import components
from fracflow.mesh.shared import lowest_joined
from fracflow.model.joints import Joints
from fracflow.model.layout import local_rows

COUPLES = 1e-13  # of the largest entry: less is round-off of two equal numbers


@dataclass(frozen=True)
class Exchange:
    """Rows of this rank's sections, brought to where their clusters are solved for, and back.

    order    sections of this rank, those for rank 0 first
    sent     how many go to each rank; ``received`` how many come from each
    """

    comm: MPI.Comm
    order: Ints
    sent: Ints
    received: Ints

    @cached_property
    def stays(self) -> bool:
        """Whether one rank has all, in their order."""
        return self.comm.size == 1 and np.array_equal(self.order, np.arange(len(self.order)))

    def there(self, rows: Floats) -> Floats:
        """Rows (s, k) of this rank's sections -> rows (S, k) of the clusters it solves for, or themselves. Collective."""
        if self.stays:
            return rows
        return self._move(rows[self.order], self.sent, self.received)

    def back(self, rows: Floats) -> Floats:
        """Rows (S, k) of the clusters -> rows (s, k) of this rank's sections, or themselves. Collective."""
        if self.stays:
            return rows
        result = np.empty((len(self.order), rows.shape[1]))
        result[self.order] = self._move(rows, self.received, self.sent)
        return result

    def _move(self, rows: Floats, sent: Ints, received: Ints) -> Floats:
        if self.comm.size == 1:
            return rows
        width, result = rows.shape[1], np.empty((int(received.sum()), rows.shape[1]))
        self.comm.Alltoallv((np.ascontiguousarray(rows), width * sent), (result, width * received))
        return result


@dataclass(frozen=True)
class Batch:
    """Clusters of m sections each: their rows (c, m) in the order of the exchange, and G M^-1 G' (c, m dim, m dim)."""

    sections: Ints
    compliance: Floats


@dataclass(frozen=True)
class Clusters:
    """All clusters of a scene; ``batches`` are those this rank solves for."""

    exchange: Exchange
    batches: tuple[Batch, ...]


def find_clusters(joints: Joints, inverse: PETSc.Mat, comm: MPI.Comm) -> Clusters:
    """The clusters that a lumped mass of that ``inverse`` makes. Collective."""
    turned = joints.jump.transpose(PETSc.Mat())
    reached = joints.jump.matMult(inverse)
    coupling = reached.matMult(turned)
    rows, dim, size = local_rows(coupling), joints.dim, comm.size
    first = coupling.getOwnershipRange()[0]
    destroy(turned, reached, coupling)
    largest = comm.allreduce(float(np.abs(rows.values).max(initial=0.0)), op=MPI.MAX)
    kept = np.abs(rows.values) > COUPLES * largest
    row, col, value = rows.rows[kept] + first, rows.cols[kept], rows.values[kept]
    starts = np.concatenate([[0], np.cumsum(comm.allgather(len(joints.weights)))]).astype(np.int64)
    own = np.arange(starts[comm.rank], starts[comm.rank + 1])
    label = _labels(own, row // dim, col // dim, int(starts[-1]), comm)
    target = owner_of(starts, label)
    sent = np.bincount(target, minlength=size)
    exchange = Exchange(comm, np.argsort(target, kind="stable"), sent, np.array(comm.alltoall(sent.tolist())))

    # sections that this rank solves for, in ascending order, and the entries between them
    of, to = target[row // dim - starts[comm.rank]], [target == rank for rank in range(size)]
    parts = comm.alltoall(
        [(own[to[rank]], label[to[rank]], row[of == rank], col[of == rank], value[of == rank]) for rank in range(size)]
    )
    solved, label, row, col, value = (np.concatenate(each) for each in zip(*parts, strict=True))
    return Clusters(exchange, tuple(_batches(solved, label, row, col, value, dim)))


def _labels(own: Ints, row: Ints, col: Ints, count: int, comm: MPI.Comm) -> Ints:
    """Of each of this rank's sections (s,) the lowest of its cluster. Collective."""
    numbers = np.unique(np.concatenate([own, col]))
    piece = components(np.searchsorted(numbers, row), np.searchsorted(numbers, col), len(numbers))
    return lowest_joined(comm, len(own), count, numbers, piece)[np.searchsorted(numbers, own)]


def _batches(solved: Ints, label: Ints, row: Ints, col: Ints, value: Floats, dim: int) -> list[Batch]:
    _, cluster, counts = np.unique(label, return_inverse=True, return_counts=True)
    in_order = np.argsort(cluster, kind="stable")
    ends = np.cumsum(counts)
    place = np.empty(len(solved), dtype=np.int64)
    place[in_order] = np.arange(len(solved)) - (ends - counts)[cluster[in_order]]
    here, there = np.searchsorted(solved, row // dim), np.searchsorted(solved, col // dim)
    batches = []
    for size in np.unique(counts):
        members = in_order[np.isin(cluster[in_order], np.flatnonzero(counts == size))].reshape(-1, size)
        number = np.full(len(counts), -1)
        number[cluster[members[:, 0]]] = np.arange(len(members))
        inside = number[cluster[here]] >= 0
        matrix = np.zeros((len(members), size * dim, size * dim))
        one, other = here[inside], there[inside]
        at = number[cluster[one]], place[one] * dim + row[inside] % dim, place[other] * dim + col[inside] % dim
        matrix[at] = value[inside]
        batches.append(Batch(members, matrix))
    return batches
