"""The pattern of a matrix that others are added to, found and filled some rows at a time.

Arrays made of all entries at once take several times the memory of the matrix.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fracflow._petsc import MPI, PETSc
from fracflow.mesh.blocks import petsc_ints
from fracflow.mesh.data import Ints
from fracflow.model.layout import rows_of

ROWS_AT_ONCE = 50_000  # rows


@dataclass(frozen=True)
class Entries:
    """Entries of this rank's rows in one of the parts: starts (rows + 1,), global columns (n,) in PETSc's integers."""

    starts: Ints
    columns: Ints

    def keys(self, first: int, last: int, total: int) -> Ints:
        """Row * total + column (k,) of those in some rows, for a matrix of ``total`` columns."""
        starts = self.starts[first : last + 1]
        return np.repeat(np.arange(first, last), np.diff(starts)) * total + self.columns[starts[0] : starts[-1]]


@dataclass(frozen=True)
class Pattern:
    """Rows of this rank with the entries of all parts.

    edges    (c + 1,) rows at which those taken at once begin; c is the same on every rank
    starts   (rows + 1,) where each row begins
    columns  (n,) global numbers, ascending in each row
    places   name -> (k,) where the entries of a part are
    marks    name -> for each so many rows, bits of the entries that are of a part, whose columns ascend
    """

    edges: Ints
    starts: Ints
    columns: Ints
    places: Mapping[str, Ints]
    marks: Mapping[str, tuple[NDArray[np.uint8], ...]]

    @classmethod
    def of(cls, parts: Mapping[str, Entries], large: Collection[str], total: int, comm: MPI.Comm) -> Pattern:
        """The pattern of all ``parts``, of ``total`` columns; those of the ``large`` ones are marked. Collective."""
        rows = len(next(iter(parts.values())).starts) - 1
        edges = edges_of(rows, comm)
        counts, begin = np.zeros(rows, dtype=np.int64), 0
        columns: list[Ints] = []
        found: dict[str, list[NDArray[Any]]] = {name: [] for name in parts}
        for first, last in pairwise(edges):
            keys = {name: part.keys(first, last, total) for name, part in parts.items()}
            union = _union(list(keys.values()))
            counts[first:last] = np.bincount(union // total - first, minlength=last - first)
            columns.append(petsc_ints(union % total))
            for name, own in keys.items():
                place = np.searchsorted(union, own)
                if name in large:
                    is_its = np.zeros(len(union), dtype=bool)
                    is_its[place] = True
                    found[name].append(np.packbits(is_its))
                else:
                    found[name].append(petsc_ints(begin + place))
            begin += len(union)
        places = {name: np.concatenate(each) for name, each in found.items() if name not in large}
        marks = {name: tuple(found[name]) for name in parts if name in large}
        starts = petsc_ints(np.concatenate([[0], np.cumsum(counts)]))
        return cls(edges, starts, np.concatenate(columns), places, marks)


def edges_of(rows: int, comm: MPI.Comm) -> Ints:
    """Rows (c + 1,) at which those taken at once begin, c on every rank. Collective."""
    count = comm.allreduce(max(-(-rows // ROWS_AT_ONCE), 1), op=MPI.MAX)
    return np.minimum(np.arange(count + 1) * ROWS_AT_ONCE, rows)


def by_rows(matrix: PETSc.Mat, edges: Ints) -> Iterator[tuple[Ints, Ints, NDArray[np.float64]]]:
    """This rank's rows between edges (c + 1,): starts, columns and values of so many at a time. Collective."""
    for first, last in pairwise(edges):
        yield csr_of(matrix, first, last) if len(edges) > 2 else matrix.getValuesCSR()


def csr_of(matrix: PETSc.Mat, first: int, last: int) -> tuple[Ints, Ints, NDArray[np.float64]]:
    """Starts (r + 1,), columns (n,) and values (n,) of r of this rank's rows. Collective."""
    rows = PETSc.IS().createStride(last - first, matrix.getOwnershipRange()[0] + first, 1, comm=matrix.getComm())
    part = rows_of(matrix, rows)
    found: tuple[Ints, Ints, NDArray[np.float64]] = part.getValuesCSR()
    rows.destroy()
    part.destroy()
    return found


def _union(keys: list[Ints]) -> Ints:
    """All keys once, ascending. Each array is nearly so already: a stable sort merges them, where np.unique starts afresh."""
    merged = np.sort(np.concatenate(keys), kind="stable")
    is_first = np.ones(len(merged), dtype=bool)
    is_first[1:] = merged[1:] != merged[:-1]
    return merged[is_first]
