"""Sparse products on the unknowns of a few nodes of the rock alone, and loads that change."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fracflow._petsc import PETSc, destroy
from fracflow.mesh.blocks import petsc_ints
from fracflow.mesh.data import Bools, Floats, Ints
from fracflow.model.layout import Layout
from fracflow.model.loads import Loads
from fracflow.scene.time_table import Around
from fracflow.scene.values import TimeTable


class LocalMatrix:
    """The part of a matrix on chosen unknowns, ``numbers`` (n,) of this rank's in its own counting; rows as they are, or those.

    Values come and go as arrays.
    """

    def __init__(self, matrix: PETSc.Mat, numbers: Ints, square: bool) -> None:
        """Copy the part. Collective."""
        self.numbers = numbers
        start, stop = matrix.getOwnershipRange()
        comm, first = matrix.getComm(), matrix.getOwnershipRangeColumn()[0]
        cols = PETSc.IS().createGeneral(petsc_ints(numbers + first), comm=comm)
        rows = cols if square else PETSc.IS().createStride(stop - start, start, 1, comm=comm)
        self._matrix = matrix.createSubMatrix(rows, cols)
        destroy(*{id(each): each for each in (rows, cols)}.values())
        self._x, self._y = self._matrix.createVecs()

    def times(self, values: Floats) -> Floats:
        """The product with values (n,). Collective."""
        self._x.getArray()[:] = values
        self._matrix.mult(self._x, self._y)
        return self._y.getArray().copy()

    def transposed(self, values: Floats) -> Floats:
        """The product (n,) of its transpose with values (m,) of the rows. Collective."""
        self._y.getArray()[:] = values
        self._matrix.multTranspose(self._y, self._x)
        return self._x.getArray().copy()

    def destroy(self) -> None:
        """Free it. Collective."""
        destroy(self._matrix, self._x, self._y)


def touched(matrix: PETSc.Mat) -> Ints:
    """Numbers (n,) of this rank's unknowns with an entry in a column of a matrix, in its own counting. Collective."""
    x, y = matrix.createVecs()
    indptr, indices, values = matrix.getValuesCSR()
    csr = (indptr, indices, np.where(values != 0.0, 1.0, 0.0))
    ones = PETSc.Mat().createAIJ(matrix.getSizes(), csr=csr, comm=matrix.getComm())
    y.set(1.0)
    ones.multTranspose(y, x)
    found = np.flatnonzero(x.getArray() > 0.0)
    destroy(x, y, ones)
    return found


def at_nodes(matrix: PETSc.Mat, nodes: Ints) -> Floats | None:
    """Blocks (n, 2, 2) of a matrix at nodes (n,) of this rank; None where it couples any two nodes. Collective."""
    first, comm = matrix.getOwnershipRange()[0], matrix.getComm().tompi4py()
    indptr, indices, values = matrix.getValuesCSR()
    row = np.repeat(np.arange(len(indptr) - 1), np.diff(indptr))[values != 0.0]
    col, value = indices[values != 0.0] - first, values[values != 0.0]
    if comm.allreduce(int(np.any(row // 2 != col // 2))):
        return None
    place = np.full(len(indptr) // 2 + 1, -1)
    place[nodes] = np.arange(len(nodes))
    blocks = np.zeros((len(nodes), 2, 2))
    blocks[place[row // 2], row % 2, col % 2] = value
    return blocks


def by_nodes(blocks: Floats, values: Floats) -> Floats:
    """Blocks (n, 2, 2) times values (2 n,)."""
    x, y = values[::2], values[1::2]
    rows = blocks[:, 0, 0] * x + blocks[:, 0, 1] * y, blocks[:, 1, 0] * x + blocks[:, 1, 1] * y
    result: Floats = np.stack(rows, axis=1).ravel().astype(float, copy=False)
    return result


class ChangingLoads:
    """The loads of a scene: a constant part, and one that changes, on the unknowns ``numbers`` (n,) of this rank."""

    def __init__(self, loads: Loads, layout: Layout) -> None:
        """Divide them."""
        self.loads = loads
        self._changes = [
            i for i, each in enumerate(loads.forces) if each.control is not None or not _is_constant(each.value)
        ]
        patterns = [loads.forces[i].vector.getArray(readonly=True) for i in self._changes]
        is_loaded: Bools = np.zeros(layout.solid_count, dtype=bool)
        for pattern in patterns:
            is_loaded |= pattern != 0.0
        self.numbers = np.flatnonzero(is_loaded)
        self._patterns = np.array([pattern[self.numbers] for pattern in patterns]).reshape(
            len(patterns), len(self.numbers)
        )
        self._layout = layout

    @property
    def is_any(self) -> bool:
        """Whether any load of the scene changes."""
        return bool(self._changes)

    def constant(
        self, time: float, controls: Mapping[str, float], around: Around, anchor: PETSc.Vec | None
    ) -> PETSc.Vec:
        """The part that stays (n,), with an anchor, in a new vector."""
        result, factors = self._layout.solid_vector(), self.loads.factors(time, controls, around)
        for i, pattern in enumerate(self.loads.forces):
            if i not in self._changes:
                result.axpy(factors[i], pattern.vector)
        if anchor is not None:
            result.axpy(1.0, anchor)
        return result

    def changing(self, time: float, controls: Mapping[str, float], around: Around) -> Floats:
        """The part that changes, (n,) at ``numbers``."""
        if not self._changes:
            return np.zeros(0)
        factors = self.loads.factors(time, controls, around)
        return np.asarray(np.array([factors[i] for i in self._changes]) @ self._patterns)


def _is_constant(value: object) -> bool:
    return not isinstance(value, TimeTable) or len(value.values) == 1
