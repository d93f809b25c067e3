"""A partition of cells by where they are: the box of all ranks is cut in two, and each half again.

Cuts depend on counts of cells alone, so the partition is the same whenever it is asked, on the same number of ranks.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Literal

import numpy as np

from fracflow._petsc import MPI
from fracflow.mesh.data import Bools, Floats, Ints


def bisected(middle: Floats, comm: MPI.Comm) -> Ints:
    """Rank (m,) of each cell by its middle (m, dim), those at one place on one rank (Berger and Bokhari 1987). Collective."""
    key = _ordered(middle)
    rank = np.zeros(len(middle), dtype=np.int64)  # the first of those that share the box of the cell
    ranks = np.array([comm.size])  # how many share each box, of which ``first`` is the first
    first = np.array([0])
    while (ranks > 1).any():
        box = np.searchsorted(first, rank)
        low, high = (_over_boxes(middle, box, len(first), pick, comm) for pick in (MPI.MIN, MPI.MAX))
        axis = np.argmax(high - low, axis=1)
        total = _counts(box, len(first), comm)
        left = np.where(ranks > 1, total * (ranks // 2) // ranks, total)
        along = key[np.arange(len(key)), axis[box]]
        is_left = _lowest_ones(along, key[np.arange(len(key)), 1 - axis[box]], box, left, comm)
        rank = np.where(is_left, rank, rank + (ranks // 2)[box])
        halves = np.stack([ranks // 2, ranks - ranks // 2], axis=1)
        halves[ranks == 1] = (1, 0)
        starts = np.stack([first, first + halves[:, 0]], axis=1)
        ranks, first = halves[halves > 0], starts[halves > 0]
    return rank


def _ordered(values: Floats) -> Ints:
    """Integers in the order of the numbers (...)."""
    bits = (values + 0.0).view(np.int64)  # a zero has one sign
    return np.asarray(bits ^ ((bits >> 63) & np.int64(2**63 - 1)))


def _over_boxes(middle: Floats, box: Ints, count: int, pick: MPI.Op, comm: MPI.Comm) -> Floats:
    """The least or the largest coordinates (count, dim) of the cells in each box; 0 of an empty one. Collective."""
    is_least = pick == MPI.MIN
    found = np.full((count, middle.shape[1]), np.inf if is_least else -np.inf)
    (np.minimum if is_least else np.maximum).at(found, box, middle)
    comm.Allreduce(MPI.IN_PLACE, found, pick)
    return np.where(np.isfinite(found), found, 0.0)


def _counts(box: Ints, count: int, comm: MPI.Comm) -> Ints:
    found = np.bincount(box, minlength=count).astype(np.int64)
    comm.Allreduce(MPI.IN_PLACE, found, MPI.SUM)
    return found


def _lowest_ones(along: Ints, across: Ints, box: Ints, wanted: Ints, comm: MPI.Comm) -> Bools:
    """Which cells (m,) are the lowest ``along`` in their box, ``wanted`` (boxes,) of them; of equal ones by ``across``.

    Cells that are equal in both stay together, and may be some more. Collective.
    """
    limit, below = _limits(along, box, wanted, comm)
    ties = np.flatnonzero(along == limit[box])
    last, _ = _limits(across[ties], box[ties], wanted - below, comm)
    is_low = along < limit[box]
    is_low[ties] = across[ties] <= last[box[ties]]
    return is_low


def _limits(key: Ints, box: Ints, wanted: Ints, comm: MPI.Comm) -> tuple[Ints, Ints]:
    """The least key (boxes,) up to which a box has all ``wanted`` cells, and how many are below it. Collective.

    Bisection over the bits of the keys: no rank sorts the cells of others.
    """
    order = np.lexsort([key, box])
    key, ends = key[order], np.searchsorted(box[order], np.arange(len(wanted) + 1))
    parts = [key[start:end] for start, end in pairwise(ends.tolist())]

    def upto(limit: Ints, side: Literal["left", "right"]) -> Ints:
        pairs = zip(parts, limit, strict=True)
        found = np.array([np.searchsorted(part, each, side=side) for part, each in pairs], dtype=np.int64)
        comm.Allreduce(MPI.IN_PLACE, found, MPI.SUM)
        return found

    low, high = np.full(len(wanted), -(2**63) + 1), np.full(len(wanted), 2**63 - 1)
    while (low < high).any():
        middle = (low & high) + ((low ^ high) >> 1)  # their mean, which does not overflow
        is_enough = upto(middle, "right") >= wanted
        low, high = np.where(is_enough, low, middle + 1), np.where(is_enough, middle, high)
    return low, upto(low, "left")
