"""Sparse products on the unknowns of a few nodes of the rock alone, and loads that change."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fracflow._petsc import PETSc, destroy
from fracflow.mesh.blocks import petsc_ints
from fracflow.mesh.data import Bools, Floats, Ints
from fracflow.mesh.graph import components
from fracflow.model.layout import Layout
from fracflow.model.loads import Loads, Pattern
from fracflow.model.operators import Operators
from fracflow.scene.time_table import Around
from fracflow.scene.values import TimeTable


class LocalMatrix:
    """The part of a matrix on chosen unknowns, ``numbers`` (n,) of this rank's in its own counting; rows as they are, or those.

    Values come and go as arrays.
    """

    def __init__(self, matrix: PETSc.Mat, numbers: Ints, square: bool, by_nodes: bool = False) -> None:
        """Copy the part; ``by_nodes`` in blocks of two, where numbers come in pairs. Collective."""
        self.numbers = numbers
        start, stop = matrix.getOwnershipRange()
        comm, first = matrix.getComm(), matrix.getOwnershipRangeColumn()[0]
        cols = PETSc.IS().createGeneral(petsc_ints(numbers + first), comm=comm)
        rows = cols if square else PETSc.IS().createStride(stop - start, start, 1, comm=comm)
        self._matrix = matrix.createSubMatrix(rows, cols)
        destroy(*{id(each): each for each in (rows, cols)}.values())
        if by_nodes:
            self._matrix = in_blocks(self._matrix)
        self._x, self._y = self._matrix.createVecs()

    def times(self, values: Floats, by: float = 1.0) -> Floats:
        """The product with values (n,), and with a number. Collective."""
        self._x.getArray()[:] = values
        self._matrix.mult(self._x, self._y)
        return by * self._y.getArray()

    def transposed(self, values: Floats) -> Floats:
        """The product (n,) of its transpose with values (m,) of the rows. Collective."""
        self._y.getArray()[:] = values
        self._matrix.multTranspose(self._y, self._x)
        return self._x.getArray().copy()

    @cached_property
    def is_own(self) -> bool:
        """Whether no rank has an entry at an unknown of another. Collective."""
        first, stop = self._matrix.getOwnershipRangeColumn()
        columns = self._matrix.getValuesCSR()[1]
        others = ((columns < first) | (columns >= stop)).any()
        return bool(self._matrix.getComm().tompi4py().allreduce(int(others)) == 0)

    def own_rows(self) -> tuple[Ints, Ints, Floats]:
        """Starts (r + 1,), columns (k,) among ``numbers``, and entries (k,) of its rows, where all are this rank's."""
        starts, columns, entries = self._matrix.getValuesCSR()
        return starts, columns - self._matrix.getOwnershipRangeColumn()[0], entries

    def destroy(self) -> None:
        """Free it. Collective."""
        destroy(self._matrix, self._x, self._y)


def in_blocks(matrix: PETSc.Mat) -> PETSc.Mat:
    """A matrix in blocks of two; the given one is freed. Collective."""
    from scipy import sparse  # imports much

    indptr, indices, values = matrix.getValuesCSR()
    shape = (matrix.getLocalSize()[0], matrix.getSize()[1])
    square = sparse.csr_matrix((values, indices, indptr), shape=shape).tobsr((2, 2))
    square.sort_indices()
    csr = (petsc_ints(square.indptr), petsc_ints(square.indices), np.ascontiguousarray(square.data))
    found = PETSc.Mat().createBAIJ(matrix.getSizes(), 2, csr=csr, comm=matrix.getComm())
    matrix.destroy()
    return found


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


def bodies_of(operators: Operators) -> Ints:
    """Unknowns (b, r) of the rigid bodies of this rank, in its own counting."""
    block, layout = operators.blocks.solid, operators.layout
    found = block.body_unknown[block.body_owner == layout.comm.rank]
    return np.asarray(found - int(layout.solid_starts[layout.comm.rank]), dtype=np.int64)


def _own_entries(matrix: PETSc.Mat) -> tuple[Ints, Ints, Floats]:
    """Row, column and value (k,) of the entries between this rank's unknowns that are not 0."""
    first, count = matrix.getOwnershipRange()[0], matrix.getLocalSize()[0]
    indptr, indices, values = matrix.getValuesCSR()
    row, col = np.repeat(np.arange(count), np.diff(indptr)), indices.astype(np.int64) - first
    kept = (values != 0.0) & (col >= 0) & (col < count)
    return row[kept], col[kept], values[kept]


def groups_of(operators: Operators, own: Ints, by_nodes: bool) -> list[Ints]:
    """Places (c, m) in ``own`` of unknowns that masses or dashpots couple, by their number m; else pairs of a node.

    No such group is on several ranks, for a term has blocks of nodes and of rigid bodies alone.
    """
    if by_nodes:
        return [np.arange(len(own)).reshape(-1, 2)]
    matrices = [operators.mass, *(term.damping for term in operators.terms if term.damping is not None)]
    entries = [_own_entries(matrix)[:2] for matrix in matrices]
    row, col = (np.concatenate(each) for each in zip(*entries, strict=True))
    inside = np.isin(row, own) & np.isin(col, own)
    label = components(np.searchsorted(own, row[inside]), np.searchsorted(own, col[inside]), len(own))
    _, group, counts = np.unique(label, return_inverse=True, return_counts=True)
    in_order = np.argsort(group, kind="stable")
    return [in_order[counts[group[in_order]] == m].reshape(-1, m) for m in np.unique(counts)]


@dataclass(frozen=True)
class BlockDiagonal:
    """A matrix that couples unknowns within a group alone.

    groups  places (c, m) of the unknowns of each group, by their number m: each place is in one group
    blocks  (c, m, m) of each
    """

    groups: list[Ints]
    blocks: list[Floats]

    @cached_property
    def _diagonal(self) -> Floats | None:
        """Its diagonal (n,), where it couples none of them: of dashpots at sides along an axis, for one."""
        result = np.empty(sum(members.size for members in self.groups))
        for members, block in zip(self.groups, self.blocks, strict=True):
            of_block = np.einsum("cii->ci", block)
            if np.count_nonzero(block) > np.count_nonzero(of_block):
                return None
            result[members] = of_block
        return result

    def times(self, values: Floats) -> Floats:
        """The product (n,) with values (n,)."""
        if self._diagonal is not None:
            return self._diagonal * values
        result = np.empty(len(values))
        for members, block in zip(self.groups, self.blocks, strict=True):
            if members.shape[1] == 2:
                x, y = values[members[:, 0]], values[members[:, 1]]
                result[members[:, 0]] = block[:, 0, 0] * x + block[:, 0, 1] * y
                result[members[:, 1]] = block[:, 1, 0] * x + block[:, 1, 1] * y
            else:
                result[members] = np.einsum("cij,cj->ci", block, values[members])
        return result


def block_diagonal(matrix: PETSc.Mat, own: Ints, groups: list[Ints]) -> BlockDiagonal:
    """The part of a matrix within each group of ``own`` (n,)."""
    row, col, value = _own_entries(matrix)
    found = [np.zeros((*members.shape, members.shape[1])) for members in groups]
    batch, number, place = (np.full(matrix.getLocalSize()[0], -1) for _ in range(3))
    for i, members in enumerate(groups):
        batch[own[members]] = i
        number[own[members]] = np.arange(len(members))[:, None]
        place[own[members]] = np.arange(members.shape[1])
    for i, blocks in enumerate(found):
        inside = (batch[row] == i) & (batch[col] == i)
        one, other = row[inside], col[inside]
        same = number[one] == number[other]
        blocks[number[one[same]], place[one[same]], place[other[same]]] = value[inside][same]
    return BlockDiagonal(groups, found)


class ChangingLoads:
    """The loads of a scene: a constant part, and one that changes, on the unknowns ``numbers`` (n,) of this rank."""

    def __init__(self, loads: Loads, layout: Layout) -> None:
        """Divide them."""
        self.loads = loads
        self._changes = [
            i for i, each in enumerate(loads.forces) if each.control is not None or not _is_constant(each.value)
        ]
        vectors = [loads.forces[i].vector.getArray(readonly=True) for i in self._changes]
        is_loaded: Bools = np.zeros(layout.solid_count, dtype=bool)
        for vector in vectors:
            is_loaded |= vector != 0.0
        self.numbers = np.flatnonzero(is_loaded)
        self.patterns = np.array([vector[self.numbers] for vector in vectors]).reshape(len(vectors), len(self.numbers))
        self._layout = layout

    @property
    def forces(self) -> list[Pattern]:
        """Those that change; ``patterns`` (k, n) are their values at ``numbers``."""
        return [self.loads.forces[i] for i in self._changes]

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
        return np.asarray(np.array([factors[i] for i in self._changes]) @ self.patterns)


def _is_constant(value: object) -> bool:
    return not isinstance(value, TimeTable) or len(value.values) == 1
