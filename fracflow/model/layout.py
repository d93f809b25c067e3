"""The unknowns of a step in one vector: on each rank first its displacements, then its pressures."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fracflow._petsc import MPI, PETSc
from fracflow.mesh.blocks import Blocks, owner_of, petsc_ints
from fracflow.mesh.data import Bools, Floats, Ints
from fracflow.mesh.shared import Shared

NUMBERS_AT_ONCE = 100_000  # numbers that are looked through at once: what is made of them takes no memory beside


@dataclass(frozen=True)
class Layout:
    """Sizes and numbers of the solid and flow unknowns, apart and together."""

    comm: MPI.Comm
    solid_starts: Ints
    flow_starts: Ints

    @cached_property
    def solid_count(self) -> int:
        """Displacement unknowns of this rank."""
        return int(np.diff(self.solid_starts)[self.comm.rank])

    @cached_property
    def flow_count(self) -> int:
        """Pressure unknowns of this rank."""
        return int(np.diff(self.flow_starts)[self.comm.rank])

    @cached_property
    def start(self) -> int:
        """First number of this rank in the joined vector."""
        return int(self.solid_starts[self.comm.rank] + self.flow_starts[self.comm.rank])

    @cached_property
    def total(self) -> int:
        """Unknowns of all ranks."""
        return int(self.solid_starts[-1] + self.flow_starts[-1])

    def solid_numbers(self, numbers: Ints) -> Ints:
        """Joined numbers (...) of displacement unknowns (...)."""
        return numbers + self.flow_starts[owner_of(self.solid_starts, numbers)]

    def flow_numbers(self, numbers: Ints) -> Ints:
        """Joined numbers (...) of pressure unknowns (...)."""
        return numbers + self.solid_starts[owner_of(self.flow_starts, numbers) + 1]

    def is_flow(self, numbers: Ints) -> Bools:
        """Which joined numbers (...) are those of pressures."""
        ranks = self.comm.size
        edges = np.stack(
            [(self.solid_starts + self.flow_starts)[:ranks], self.solid_starts[1:] + self.flow_starts[:ranks]], 1
        )
        found: Bools = (np.searchsorted(edges.ravel(), numbers, side="right") - 1) % 2 == 1
        return found

    def marked(self, solid: Ints, flow: Ints, seen: Iterable[Ints]) -> Ints:
        """Joined numbers (n,) of unknowns that their ranks mark: all of this rank, and of others those ``seen``. Ascending.

        solid, flow  local numbers (m,) of this rank's unknowns that it marks
        seen         joined numbers (...), -1 for none

        Collective.
        """
        last = self.start + self.solid_count + self.flow_count
        own = np.zeros(last - self.start)
        own[solid] = own[self.solid_count + flow] = 1.0
        beside = [np.zeros(0, dtype=np.int64)]
        for numbers in seen:
            for begin in range(0, numbers.size, NUMBERS_AT_ONCE):
                part = numbers.ravel()[begin : begin + NUMBERS_AT_ONCE]
                beside.append(np.unique(part[((part < self.start) & (part >= 0)) | (part >= last)]))
        others = np.unique(np.concatenate(beside))
        owners = Shared(self.comm, len(own), self.total, others)
        there = others[owners.of_owners(own) > 0.0]
        owners.destroy()
        return np.sort(np.concatenate([self.start + np.flatnonzero(own), there]))

    def index_sets(self) -> tuple[PETSc.IS, PETSc.IS]:
        """The splits named solid and flow, for PCFIELDSPLIT. The caller destroys them."""
        middle = self.start + self.solid_count
        solid = PETSc.IS().createStride(self.solid_count, self.start, 1, comm=self.comm)
        flow = PETSc.IS().createStride(self.flow_count, middle, 1, comm=self.comm)
        return solid, flow

    def solid_vector(self) -> PETSc.Vec:
        """A new displacement vector, zero. Collective."""
        return create_vector((self.solid_count, int(self.solid_starts[-1])), self.comm)

    def flow_vector(self) -> PETSc.Vec:
        """A new pressure vector, zero. Collective."""
        return create_vector((self.flow_count, int(self.flow_starts[-1])), self.comm)

    def joined_vector(self) -> PETSc.Vec:
        """A new vector of both, zero. Collective."""
        return create_vector((self.solid_count + self.flow_count, self.total), self.comm)


def create_vector(sizes: tuple[int, int], comm: MPI.Comm) -> PETSc.Vec:
    """A vector of so many entries, here and in all, zero: spread over ranks, or as ``-vec_type`` says. Collective."""
    vector = PETSc.Vec().create(comm=comm)
    vector.setSizes(sizes)
    vector.setType("mpi")
    vector.setFromOptions()
    return vector


def layout_of(blocks: Blocks, with_flow: bool) -> Layout:
    """The unknowns of a scene; without flow the flow part is empty."""
    flow = blocks.flow.starts if with_flow else np.zeros(blocks.comm.size + 1, dtype=np.int64)
    return Layout(blocks.comm, blocks.solid.unknown_starts, flow)


def product(matrix: PETSc.Mat, vector: PETSc.Vec) -> Floats:
    """This rank's values (n,) of a matrix times a vector. Collective."""
    result = matrix.createVecLeft()
    matrix.mult(vector, result)
    values = result.getArray().copy()
    result.destroy()
    return values


def add_transposed(matrix: PETSc.Mat, values: Floats, result: PETSc.Vec) -> None:
    """``result`` += A' times the vector with these values (n,) on this rank. Collective."""
    vector = matrix.createVecLeft()
    vector.setArray(values)
    matrix.multTransposeAdd(vector, result, result)
    vector.destroy()


@dataclass(frozen=True)
class Rows:
    """Local rows of a sparse matrix whose columns are global numbers."""

    rows: Ints
    cols: Ints
    values: Floats


def local_rows(matrix: PETSc.Mat) -> Rows:
    """The entries of this rank's rows; row numbers are local, column numbers global."""
    indptr, indices, values = matrix.getValuesCSR()
    rows = np.repeat(np.arange(len(indptr) - 1), np.diff(indptr))
    return Rows(rows, indices.astype(np.int64), values)


@dataclass(frozen=True)
class FewEntries:
    """A vector that is zero but at few unknowns: their local numbers ``at`` (n,) on this rank, and ``values`` (n,)."""

    at: Ints
    values: Floats

    def times(self, vector: PETSc.Vec) -> Floats:
        """Products (n,) with the entries of a vector."""
        found: Floats = self.values * vector.getArray(readonly=True)[self.at]
        return found

    def dot(self, vector: PETSc.Vec) -> float:
        """The sum of these products over all ranks. Collective."""
        return float(vector.comm.tompi4py().allreduce(float(self.values @ vector.getArray(readonly=True)[self.at])))

    def add_to(self, vector: PETSc.Vec, times: float = 1.0) -> None:
        """``vector`` += ``times`` this one."""
        vector.getArray()[self.at] += times * self.values


def rows_of(matrix: PETSc.Mat, rows: PETSc.IS) -> PETSc.Mat:
    """Some rows of a matrix, with all its columns. The caller destroys it. Collective."""
    first, last = matrix.getOwnershipRangeColumn()
    cols = PETSc.IS().createStride(last - first, first, 1, comm=matrix.getComm())
    result = matrix.createSubMatrix(rows, cols)
    cols.destroy()
    return result


Sizes = tuple[tuple[int, int], tuple[int, int]]
"""Rows and columns of a matrix, of this rank and of all."""


def create_matrix(layout: Sizes, row_entries: int | Ints, comm: MPI.Comm) -> PETSc.Mat:
    """An empty AIJ matrix with room for ``row_entries``, one or (rows,), on a row in each part; more may come. Collective."""
    entries = row_entries if isinstance(row_entries, int) else petsc_ints(row_entries)
    matrix = _of_type(layout, comm)
    matrix.setPreallocationNNZ((entries, entries))
    matrix.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
    return matrix


def matrix_of(layout: Sizes, csr: tuple[Ints, Ints, Floats], comm: MPI.Comm, node: int = 1) -> PETSc.Mat:
    """AIJ of this rank's rows: starts (rows + 1,), columns (n,), values (n,); ``node`` unknowns a node. Collective."""
    matrix = _of_type(layout, comm, node)
    starts, columns, values = csr
    matrix.setPreallocationCSR((petsc_ints(starts), petsc_ints(columns), values))
    return matrix


def _of_type(layout: Sizes, comm: MPI.Comm, node: int = 1) -> PETSc.Mat:
    """A matrix without room as yet, AIJ or of the type of ``-mat_type``. Collective."""
    matrix = PETSc.Mat().create(comm=comm)
    matrix.setSizes(layout, bsize=node)
    matrix.setType("aij")
    matrix.setFromOptions()
    return matrix


def add_blocks(matrix: PETSc.Mat, rows: Ints, cols: Ints, values: Floats) -> None:
    """Add dense blocks: rows (n, r), cols (n, c), values (n, r, c). Not collective; assemble afterwards."""
    if len(rows):
        matrix.setValuesRCV(petsc_ints(rows), petsc_ints(cols), np.ascontiguousarray(values), PETSc.InsertMode.ADD)
