"""LU by LAPACK of the free rows and columns of a matrix, where half of their entries or more are there.

Those of unmeshed rock with given pressures all are: MUMPS takes four times as long for 320 unknowns.
"""

from __future__ import annotations

import numpy as np

from fracflow._petsc import PETSc, destroy, precondition_by
from fracflow.mesh.data import Bools, Ints
from fracflow.solve.jacobian import JoinedMatrix

FULL = 0.5  # of the free entries: with a pressure unknown at each joint .45 are there, and MUMPS is faster


def factor_by_lapack(solver: PETSc.KSP, matrix: JoinedMatrix) -> None:
    """Give a solver that is LU alone such factors of the matrix, on one rank."""
    precondition_by(solver, FreeBlock(matrix))


class FreeBlock:
    """PETSc's context of a preconditioner on one rank. Held rows and columns are those of the identity.

    A block with a pivot that is nothing makes all results infinite, as PETSc does with factors that failed.
    """

    def __init__(self, matrix: JoinedMatrix) -> None:
        """The matrix is the caller's."""
        self.matrix, self._only = matrix, ""
        self._free, self._entries, self._places = (np.zeros(0, dtype=np.int64) for _ in range(3))
        self._made: tuple[PETSc.Mat, PETSc.IS, PETSc.Vec, PETSc.Vec] | None = None
        self._is_sound = False

    def setUp(self, _: PETSc.PC) -> None:  # PETSc's name
        """Factor the present matrix. Collective, on one rank."""
        if self._made is None or self._only != self.matrix.stood[2]:
            self._made = self._chosen()
        block, rows = self._made[:2]
        block.setUnfactored()
        values = block.getDenseArray().T.reshape(-1)
        values[:] = 0.0  # entries that the matrix has not are those of the last factors
        values[self._places] = self.matrix.matrix.getValuesCSR()[2][self._entries]
        block.assemble()
        try:
            block.factorLU(rows, rows)
            self._is_sound = True
        except PETSc.Error:
            self._is_sound = False

    def _chosen(self) -> tuple[PETSc.Mat, PETSc.IS, PETSc.Vec, PETSc.Vec]:
        """A block for the free rows, by columns, its rows, and two vectors."""
        destroy(*(self._made or ()))
        self._only = self.matrix.stood[2]
        self._free, rows, columns, self._entries = entries_of(self.matrix, ~self.matrix.held(self._only))
        count = len(self._free)
        self._places = columns * count + rows
        block = PETSc.Mat().createDense((count, count), comm=PETSc.COMM_SELF)
        block.setUp()
        return block, PETSc.IS().createStride(count, comm=PETSc.COMM_SELF), *block.createVecs()

    def apply(self, _: PETSc.PC, given: PETSc.Vec, result: PETSc.Vec) -> None:
        """Solve for the free unknowns; held ones are as given."""
        assert self._made is not None
        block, _, right, found = self._made
        given.copy(result)
        right.setArray(given.getArray(readonly=True)[self._free])
        if self._is_sound:
            block.solve(right, found)
        else:
            found.set(np.inf)
        result.getArray()[self._free] = found.getArray(readonly=True)

    def destroy(self, _: PETSc.PC) -> None:
        """Free the block."""
        destroy(*(self._made or ()))
        self._made = None


def entries_of(matrix: JoinedMatrix, free: Bools) -> tuple[Ints, Ints, Ints, Ints]:
    """Free unknowns (f,), and of the entries (n,) between them the rows and columns in the block and their numbers."""
    numbers = np.cumsum(free) - 1
    starts, columns, _ = matrix.matrix.getValuesCSR()
    rows = np.repeat(np.arange(len(free)), np.diff(starts))
    entries = np.flatnonzero(free[rows] & free[columns])
    return np.flatnonzero(free), numbers[rows[entries]], numbers[columns[entries]], entries


def is_full(matrix: JoinedMatrix) -> bool:
    """Whether FULL of the entries between free unknowns are there, of a matrix on one rank."""
    free, *_, entries = entries_of(matrix, ~matrix.held(None))
    return len(entries) >= FULL * len(free) ** 2 > 0.0
