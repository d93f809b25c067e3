"""Damping of an explicit step by its mean velocity: a product of PETSc, or half of that where the matrix is symmetric."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from fracflow._petsc import MPI, PETSc
from fracflow.mesh.data import Floats, Ints
from fracflow.solve.leapfrog.compiled import address, library
from fracflow.solve.leapfrog.local import LocalMatrix

if TYPE_CHECKING:
    from scipy import sparse

SYMMETRIC = 1e-14  # of the largest entry: by so much those across the diagonal may differ


class Damping(Protocol):
    """D on its unknowns ``numbers`` (n,), local numbers of this rank."""

    numbers: Ints

    def damp(self, moved: Floats, dt: float, before: Floats, force: Floats) -> tuple[Floats, float]:
        """D of the mean velocity (n,) [force per thickness], and its work. Collective.

        moved, dt  motion (n,) in a step, and its length
        force      (n,) that it is taken off
        before     that force (n,) in the step before: work is that of the mean of both on the motion
        """
        ...

    def given(self) -> dict[str, int] | None:
        """Counts and addresses by their names in ``steps.c``; None where that has no loops."""
        ...

    def destroy(self) -> None:
        """Free it. Collective."""
        ...


class PlainDamping:
    """By PETSc."""

    def __init__(self, matrix: LocalMatrix) -> None:
        """Take the matrix over."""
        self._matrix, self.numbers = matrix, matrix.numbers

    def damp(self, moved: Floats, dt: float, before: Floats, force: Floats) -> tuple[Floats, float]:
        """D of the mean velocity (n,) [force per thickness], and its work. Collective.

        moved, dt  motion (n,) in a step, and its length
        force      (n,) that it is taken off
        before     that force (n,) in the step before: work is that of the mean of both on the motion
        """
        found = self._matrix.times(moved, 1.0 / dt)
        np.subtract(force, found, out=force)
        return found, 0.5 * float((before + found) @ moved)

    def given(self) -> dict[str, int] | None:
        """None: it has no loops."""
        return None

    def destroy(self) -> None:
        """Free it. Collective."""
        self._matrix.destroy()


class SymmetricDamping:
    """By ``nodes.c``, which reads blocks of two nodes once for both: the product is bound by what it reads."""

    def __init__(self, numbers: Ints, starts: Ints, columns: Ints, blocks: Floats) -> None:
        """Keep blocks (k, 2, 2) on and right of the diagonal, by rows."""
        loops = library()
        assert loops is not None
        self.numbers, self._loops = numbers, loops
        self._kept: list[NDArray[np.generic]] = [np.ascontiguousarray(each, np.int32) for each in (starts, columns)]
        self._kept.append(np.ascontiguousarray(blocks))
        self._given = [*map(address, self._kept)]

    def damp(self, moved: Floats, dt: float, before: Floats, force: Floats) -> tuple[Floats, float]:
        """D of the mean velocity (n,) [force per thickness], and its work.

        moved, dt  motion (n,) in a step, and its length
        force      (n,) that it is taken off
        before     that force (n,) in the step before: work is that of the mean of both on the motion
        """
        found = np.empty(len(moved))
        given = map(address, (moved, before, found, force))
        return found, 0.5 * float(self._loops.fracflow_damp(len(moved) // 2, *self._given, 1.0 / dt, *given))

    def given(self) -> dict[str, int] | None:
        """Counts and addresses by their names in ``steps.c``."""
        names = ("damping_starts", "damping_columns", "damping")
        return {"damped": len(self.numbers) // 2, **dict(zip(names, self._given, strict=True))}

    def destroy(self) -> None:
        """Nothing is PETSc's."""


def damping_of(matrix: PETSc.Mat, numbers: Ints, plain: bool) -> Damping:
    """D on unknowns (n,), where ``plain`` two a node; by compiled loops where they serve on all ranks. Collective."""
    rows = LocalMatrix(matrix, numbers, square=True)
    found = _symmetric(rows) if plain and rows.is_own else None
    if matrix.getComm().tompi4py().allreduce(int(found is not None), op=MPI.MIN):
        assert found is not None
        rows.destroy()
        return found
    if plain:
        rows.destroy()
        rows = LocalMatrix(matrix, numbers, square=True, by_nodes=True)
    return PlainDamping(rows)


def _symmetric(matrix: LocalMatrix) -> SymmetricDamping | None:
    """None where nothing was compiled, or the matrix is not symmetric."""
    from scipy import sparse  # imports much

    starts, columns, entries = matrix.own_rows()
    count = len(matrix.numbers)
    half = half_of(sparse.csr_matrix((entries, columns, starts), shape=(count, count)))
    return None if half is None else SymmetricDamping(matrix.numbers, *half)


def half_of(whole: sparse.csr_matrix) -> tuple[Ints, Ints, Floats] | None:
    """Starts, columns and blocks of two nodes on and right of the diagonal of a matrix (n, n + g).

    None where nothing was compiled, or its first columns (n, n) are not symmetric.
    """
    count, first = whole.shape[0], whole[:, : whole.shape[0]]
    largest = np.abs(whole.data).max(initial=0.0)
    apart = np.abs((first - first.T).data).max(initial=0.0)  # no rank need have any
    if library() is None or apart > SYMMETRIC * largest:
        return None
    blocks = whole.tobsr((2, 2))
    blocks.sort_indices()
    row = np.repeat(np.arange(count // 2), np.diff(blocks.indptr))
    kept = blocks.indices >= row
    starts = np.concatenate([[0], np.cumsum(np.bincount(row[kept], minlength=count // 2))])
    columns = blocks.indices[kept]
    if not (np.diff(starts).all() and np.array_equal(columns[starts[:-1]], np.arange(count // 2))):
        return None
    return starts, columns, blocks.data[kept]
