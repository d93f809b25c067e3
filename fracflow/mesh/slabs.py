"""Arrays of all ranks in original order, by slabs of rows: rank 0 holds no more of the rows of others than a slab."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from fracflow._petsc import MPI, gathered
from fracflow.mesh.data import Ints
from fracflow.storage.sealed import Slabs, slabs_of

Values = NDArray[Any]


class ByRows(Protocol):
    """Values (n, ...) of which some rows are taken: an array, or something that computes them."""

    def __getitem__(self, rows: Any, /) -> Any:
        """Those of the rows (k,), or of a slice."""

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of the numbers."""

    @property
    def shape(self) -> tuple[int, ...]:
        """That of all."""


class Order:
    """The rows (n, ...) of this rank in arrays (total, ...) of original order; no row is of two ranks.

    count  n
    """

    def __init__(self, comm: MPI.Comm, ids: Ints, total: int) -> None:
        """By the original numbers (n,) of the rows."""
        self.comm, self.total, self.count = comm, total, len(ids)
        self._rows: Ints | None = None  # as they come: on one rank they are in order, and need no memory
        if (ids[1:] < ids[:-1]).any():
            self._rows = np.argsort(ids, kind="stable")
            ids = ids[self._rows]
        self._ids = ids

    def of(self, values: ByRows) -> Distributed:
        """The array that has these values (n, ...) on this rank."""
        return Distributed(self, values)

    def collect(self, values: ByRows, first: int, last: int) -> Values | None:
        """Rows (last - first, ...) of an array on rank 0, zero where no rank has one; None elsewhere. Collective."""
        rows, places, counts = self._part(first, last)
        if counts is None:
            if len(rows):
                self.comm.Send(places, 0)
                self.comm.Send([np.ascontiguousarray(values[rows]), MPI.BYTE], 0)
            return None
        slab = np.zeros((last - first, *values.shape[1:]), dtype=values.dtype)
        slab[places] = values[rows]
        for rank, there in self._of_others(counts):
            part = np.empty((len(there), *values.shape[1:]), dtype=values.dtype)
            self.comm.Recv([part, MPI.BYTE], rank)
            slab[there] = part
        return slab

    def hand_out(self, slab: Values | None, first: int, last: int, values: Values, root: int = 0) -> None:
        """Put rows (last - first, ...) that rank ``root`` has into the ``values`` (n, ...) of the ranks. Collective."""
        rows, places, counts = self._part(first, last, root)
        if counts is None or slab is None:
            if len(rows):
                self.comm.Send(places, root)
                part = np.empty((len(rows), *values.shape[1:]), dtype=values.dtype)
                self.comm.Recv([part, MPI.BYTE], root)
                values[rows] = part
            return
        values[rows] = slab[places]
        for rank, there in self._of_others(counts, root):
            self.comm.Send([np.ascontiguousarray(slab[there]), MPI.BYTE], rank)

    def whole(self, values: ByRows) -> Values | None:
        """The array (total, ...) on rank 0, None elsewhere. Collective."""
        shape = (self.total, *values.shape[1:])
        found = np.empty(shape, dtype=values.dtype) if self.comm.rank == 0 else None
        for first, last in slabs_of(values.dtype, shape):
            slab = self.collect(values, first, last)
            if found is not None:
                found[first:last] = slab
        return found

    def _part(self, first: int, last: int, root: int = 0) -> tuple[Ints, NDArray[np.int32], list[int] | None]:
        """This rank's rows from ``first`` to ``last``, their places there, and on rank ``root`` how many each rank has."""
        start, end = np.searchsorted(self._ids, (first, last))
        places = (self._ids[start:end] - first).astype(np.int32)
        rows = np.arange(start, end) if self._rows is None else self._rows[start:end]
        return rows, places, gathered(len(places), self.comm, root)

    def _of_others(self, counts: list[int], root: int = 0) -> Iterator[tuple[int, NDArray[np.int32]]]:
        """The other ranks that have rows of a slab, and the places of these, which they send."""
        for rank, count in enumerate(counts):
            if rank != root and count:
                there = np.empty(count, dtype=np.int32)
                self.comm.Recv(there, rank)
                yield rank, there


@dataclass(frozen=True)
class Distributed:
    """An array of all ranks: its values (n, ...) on this one, and their order."""

    order: Order
    values: ByRows

    @property
    def shape(self) -> tuple[int, ...]:
        """That of the whole array."""
        return self.order.total, *self.values.shape[1:]


@contextmanager
def on_rank_0(comm: MPI.Comm, arrays: Mapping[str, Distributed]) -> Iterator[dict[str, Slabs] | None]:
    """Arrays that rank 0 may read by slabs, as long as it likes; to the others, which send their rows meanwhile, None.

    Rank 0 may raise at any slab, or leave some out: the others go on without an error, on which the caller agrees. All ranks
    compute their rows of an array when its first slab is asked for, and keep those of no other. Collective.
    """
    turns = _Turns(arrays)
    if comm.rank:
        while (asked := comm.bcast(None, root=0)) is not None:
            turns.collect(*asked)
        yield None
        return
    try:
        yield {name: Slabs(each.values.dtype, each.shape, _Asked(name, each, turns)) for name, each in arrays.items()}
    finally:
        comm.bcast(None, root=0)


class _Turns:
    """Arrays of which one at a time has its values (n, ...) on this rank."""

    def __init__(self, arrays: Mapping[str, Distributed]) -> None:
        self._arrays, self._name, self._values = arrays, "", np.zeros(0)

    def collect(self, name: str, first: int, last: int) -> Values | None:
        """As ``Order.collect``. Collective."""
        array = self._arrays[name]
        if name != self._name:
            self._values = np.zeros(0)  # before there are others
            self._name, self._values = name, array.values[:]
        return array.order.collect(self._values, first, last)


@dataclass(frozen=True)
class _Asked:
    """The slabs of an array, for which rank 0 asks the others one by one."""

    name: str
    array: Distributed
    turns: _Turns

    def __iter__(self) -> Iterator[Values]:
        for first, last in slabs_of(self.array.values.dtype, self.array.shape):
            self.array.order.comm.bcast((self.name, first, last), root=0)
            slab = self.turns.collect(self.name, first, last)
            assert slab is not None
            yield slab
