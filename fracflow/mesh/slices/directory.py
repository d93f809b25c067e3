"""Things that ranks know of by number: each rank keeps a range of the numbers, and answers for them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fracflow._petsc import MPI
from fracflow.mesh.blocks import owner_of
from fracflow.mesh.data import Ints

Values = NDArray[Any]


class Route:
    """The way of rows of this rank to other ranks, and of the answers back to them. Collective."""

    def __init__(self, comm: MPI.Comm, to: Ints) -> None:
        """By the rank (n,) that each row goes to."""
        self.comm, self._order = comm, np.argsort(to, kind="stable")
        self._out = np.bincount(to, minlength=comm.size).astype(np.int64)
        self._in = np.empty_like(self._out)
        comm.Alltoall(self._out, self._in)

    @property
    def source(self) -> Ints:
        """Rank (k,) of each row that comes."""
        return np.repeat(np.arange(self.comm.size), self._in)

    def send(self, rows: Values) -> Values:
        """The rows (k, ...) that come here, rank by rank, for rows (n, ...) that go. Collective."""
        return _exchanged(self.comm, rows[self._order], self._out, self._in)

    def back(self, answers: Values) -> Values:
        """Answers (n, ...) in the order of the rows that went, for answers (k, ...) to those that came. Collective."""
        found = _exchanged(self.comm, answers, self._in, self._out)
        ordered = np.empty_like(found)
        ordered[self._order] = found
        return ordered


class Directory:
    """Numbers below ``total``, of which each rank keeps those from ``first`` to ``last``."""

    def __init__(self, comm: MPI.Comm, total: int) -> None:
        """Ranges are as long as one another, but for one number."""
        self.comm, self.total = comm, total
        self.starts = np.arange(comm.size + 1) * total // comm.size
        self.first, self.last = (int(each) for each in self.starts[comm.rank : comm.rank + 2])

    @property
    def numbers(self) -> Ints:
        """Those of this rank's range (s,)."""
        return np.arange(self.first, self.last)

    def route(self, numbers: Ints) -> Route:
        """The way to the ranks that keep numbers (n,). Collective."""
        return Route(self.comm, owner_of(self.starts, numbers))

    def look_up(self, kept: Values, numbers: Ints) -> Values:
        """Values (n, ...) of numbers (n,), from those (s, ...) that each rank keeps. Collective."""
        route = self.route(numbers)
        return route.back(kept[route.send(numbers) - self.first])

    def lowest(self, numbers: Ints, values: Ints, none: int) -> Ints:
        """The lowest value (s,) that any rank has for each number of its range, ``none`` where none has. Collective."""
        route, found = self.route(numbers), np.full(self.last - self.first, none, dtype=np.int64)
        np.minimum.at(found, route.send(numbers) - self.first, route.send(values))
        return found

    def put(self, kept: Values, numbers: Ints, values: Values) -> None:
        """Let what ranks keep (s, ...) have values (n, ...) at numbers (n,), each of which one rank has. Collective."""
        route = self.route(numbers)
        kept[route.send(numbers) - self.first] = route.send(values)


def _exchanged(comm: MPI.Comm, rows: Values, out: Ints, into: Ints) -> Values:
    """Rows (k, ...) of all ranks, so many ``into`` this one from each, for rows of 8 bytes a number ``out`` to each."""
    width = int(np.prod(rows.shape[1:], dtype=np.int64))
    sent = np.ascontiguousarray(rows)
    assert sent.dtype.itemsize == 8
    found = np.empty((int(into.sum()), *rows.shape[1:]), dtype=rows.dtype)
    comm.Alltoallv([sent.view(np.int64), (width * out, _starts(width * out)), MPI.INT64_T],
        [found.view(np.int64), (width * into, _starts(width * into)), MPI.INT64_T])  # fmt: skip
    return found


def _starts(counts: Ints) -> Ints:
    return np.cumsum(counts) - counts
