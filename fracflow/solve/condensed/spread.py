"""The sections of all ranks, each rank with the rows of its own in the compliance C: no rank holds the whole.

Jumps e of sections and pressures p follow from e = left + C (E p - D e) and K p + Q e = right. E has the areas on which fluid
presses, D what sections hold beyond the elastic moduli, Q what they take up as they open. D is zero for most sections. So the
unknowns are jumps of the others, c, and all pressures:

    (1 + C_cc D) e_c           - C_c E p       = left_c
       -Q C_.c D e_c     + (K + Q C E) p       = right - Q left

ScaLAPACK factors this dense matrix, of which each rank has a part. Jumps of all sections follow from the first equation.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import TypeVar

import numpy as np

from fracflow._petsc import MPI, PETSc, destroy
from fracflow.errors import Unsolved
from fracflow.mesh.data import Floats, Ints
from fracflow.model.operators import Operators
from fracflow.scene.scene import Scene
from fracflow.solve.clusters import Clusters, Exchange
from fracflow.solve.condensed.on_one_rank import MOST_CHANGES, CondensedFlow, CondensedSections, alike, summed_alike
from fracflow.solve.linear import BROKEN, check_solution
from fracflow.solve.sections import SectionProblem, SectionRows, SectionSolver

FEWEST = 1000
"""Jumps that pay for the messages of ScaLAPACK, where pressures are unknowns too: rank 0 solves for fewer."""
DRY = 4
"""Times as many without fluid, where few sections are unknowns."""
SLAB = 256  # rows of which sizes are taken at once
Numbers = TypeVar("Numbers", Floats, Ints)


def sections_of(scene: Scene, operators: Operators, compliance: Floats, elastic: Floats) -> SectionSolver:
    """The solver on rank 0 where jumps are few, or PETSc has no ScaLAPACK; else on all ranks. Collective.

    compliance  this rank's rows of it (s dim, S dim); ``elastic`` moduli (s, dim, dim)
    """
    fewest = FEWEST if operators.flow is not None else DRY * FEWEST
    is_spread = operators.layout.comm.size > 1 and compliance.shape[1] >= fewest
    kind = SpreadSections if is_spread and PETSc.Sys.hasExternalPackage("scalapack") else CondensedSections
    return kind(scene, operators, compliance, elastic)


class SpreadSections(SectionSolver):
    """All sections at once, on all ranks."""

    flow_kind, most_changes = CondensedFlow, MOST_CHANGES

    def __init__(self, scene: Scene, operators: Operators, compliance: Floats, elastic: Floats) -> None:
        """Keep this rank's rows (s dim, S dim) of the ``compliance``; moduli (s, dim, dim). Collective."""
        comm, here = operators.layout.comm, len(elastic)
        kept = np.where(np.arange(comm.size) == comm.rank, here, 0)
        exchange = Exchange(comm, np.arange(here), kept, kept)
        super().__init__(scene, operators, Clusters(exchange, ()), elastic)
        self._like = alike(operators, exchange)
        self._compliance, self._jumps = compliance, _first_of_each(compliance.shape[0], comm)
        self._system = DenseSystem(comm)
        if self.flow is not None:
            self._pressed = self._opened_by_pressure()

    def _opened_by_pressure(self) -> Floats:
        """C E (s dim, p): jumps of this rank's sections by a unit of each pressure. Collective."""
        comm, dim = self.operators.layout.comm, self.operators.joints.dim
        assert self.flow is not None
        node = _of_all_ranks(self.flow.nodes[:, 0], comm)
        area = _of_all_ranks(self.operators.joints.weights, comm)
        order = np.argsort(node, kind="stable")
        at_node, first = np.unique(node[order], return_index=True)
        result = np.zeros((len(self._compliance), int(self.operators.layout.flow_starts[-1])))
        for rows in _slabs(len(result)):
            by_section = self._compliance[rows, dim - 1 :: dim] * area
            result[rows, at_node] = np.add.reduceat(by_section[:, order], first, axis=1)
        return result

    def _gather(
        self, free: Floats, change: Floats, push: Floats, known: Floats, moduli: Floats, slopes: Floats, share: float
    ) -> SectionRows:
        alone, comm = super()._gather(free, change, push, known, moduli, slopes, share), self.operators.layout.comm
        push, known = (_of_all_ranks(each.ravel(), comm) for each in (push, known))
        moved, size = (self._compliance @ push).reshape(free.shape), np.zeros(free.size)
        for rows in _slabs(free.size):
            size[rows] = np.abs(self._compliance[rows]) @ known
        return replace(alone, left=alone.left - share * moved, size=alone.size + share * size.reshape(free.shape))

    def _step(self, problem: SectionProblem, rows: SectionRows, own_slopes: Floats, share: float) -> Floats:
        layout, dim = self.operators.layout, rows.left.shape[1]
        there, pulled, first, count = self._pulled(rows.moduli)
        pressures = 0 if self.flow is None else int(layout.flow_starts[-1])
        if not count + pressures:
            return rows.left
        scales = self.operators.scales
        units = np.repeat([scales.displacement, scales.pressure], [count, pressures])
        at = (there[:, None] * dim + np.arange(dim)).ravel()
        top = np.zeros((len(at), count + pressures + 1))
        top[:, :count] = pulled[at]
        top[np.arange(len(at)), first + np.arange(len(at))] += 1.0
        top[:, -1] = rows.left[there].ravel()
        numbers, values = first + np.arange(len(at)), top
        if self.flow is not None:
            top[:, count:-1] = -self._pressed[at]
            nodes, bottom = self._of_flow(problem, rows, own_slopes, pulled)
            numbers, values = np.concatenate([numbers, count + nodes]), np.concatenate([top, bottom])
        values[:, :-1] *= units
        solution = units * self._system.solve(
            numbers, values, f"time {problem.time:.6g}: jumps of joints and pressures"
        )
        change = rows.left - (pulled @ solution[:count]).reshape(rows.left.shape)
        if self.flow is not None:
            change += (self._pressed @ solution[count:]).reshape(rows.left.shape)
            own = slice(*layout.flow_starts[layout.comm.rank : layout.comm.rank + 2] + count)
            problem.pressure.setArray(problem.pressure.getArray() + solution[own])
        return change

    def _pulled(self, moduli: Floats) -> tuple[Ints, Floats, int, int]:
        """Sections c of this rank, C D (s dim, C) for those of all ranks, number of the first of its own jumps, and C.

        Sections that move alike on a rank are one. Collective.
        """
        comm, dim = self.operators.layout.comm, moduli.shape[1]
        there, summed = summed_alike(moduli, self._like)
        starts = _first_of_each(dim * len(there), comm)
        summed = _of_all_ranks(summed.ravel(), comm).reshape(-1, dim, dim)
        first_jumps = _of_all_ranks(self._jumps[comm.rank] + there * dim, comm)
        columns = (first_jumps[:, None] + np.arange(dim)).ravel()
        by_section = self._compliance[:, columns].reshape(len(self._compliance), len(summed), dim)
        pulled = np.einsum("xmi,mij->xmj", by_section, summed).reshape(len(self._compliance), len(columns))
        return there, pulled, int(starts[comm.rank]), int(starts[-1])

    def _of_flow(
        self, problem: SectionProblem, rows: SectionRows, own_slopes: Floats, pulled: Floats
    ) -> tuple[Ints, Floats]:
        """Flow nodes (n,) of this rank and of its joints, and what it adds to their rows (n, C + p + 1). Collective."""
        layout, flow, dim = self.operators.layout, self.flow, rows.left.shape[1]
        assert flow is not None and problem.conduction is not None
        first, last = layout.flow_starts[layout.comm.rank : layout.comm.rank + 2]
        joined, count = self.operators.blocks.joints.flow, pulled.shape[1]
        nodes, place = np.unique(np.concatenate([joined.ravel(), np.arange(first, last)]), return_inverse=True)
        ends = place[: joined.size].reshape(joined.shape)
        result = np.zeros((len(nodes), count + self._pressed.shape[1] + 1))

        # (j, end, section): what flows into an end as a section of its joint opens
        taken_up = problem.alphas.a1 * self._weights.reshape(-1, 2)[:, None] * np.eye(2)
        by_opening = taken_up + rows.slopes.reshape(-1, 2, 2).transpose(0, 2, 1)
        order = np.argsort(ends.ravel(), kind="stable")
        at_end, starts = np.unique(ends.ravel()[order], return_index=True)
        normal = slice(dim - 1, None, dim)
        for part, opened, sign in ((slice(count), pulled, -1.0), (slice(count, -1), self._pressed, 1.0)):
            if len(order):
                into = by_opening @ opened[normal].reshape(len(joined), 2, -1)
                result[at_end, part] = sign * np.add.reduceat(into.reshape(len(order), -1)[order], starts, axis=0)
        between = problem.conduction.tangents(problem.alphas.b1)[0]
        np.add.at(result, (ends[:, :, None], count + joined[:, None, :]), between)

        numbers = layout.flow_numbers(nodes)
        held = np.isin(numbers, layout.marked(nodes[:0], problem.loads.given_pressures, (numbers,)))
        is_own = (nodes >= first) & (nodes < last)
        result[held] = 0.0
        result[held & is_own, count + nodes[held & is_own]] = 1.0
        left = flow.left(problem, rows.left[:, -1], own_slopes)
        result[is_own, -1] = left.getArray()
        left.destroy()
        return nodes, result

    def destroy(self) -> None:
        """Free the solvers. Collective."""
        super().destroy()
        self._system.destroy()


class DenseSystem:
    """LU by ScaLAPACK of a dense matrix, of whose rows each rank has equally many."""

    def __init__(self, comm: MPI.Comm) -> None:
        """Make the solver. Collective."""
        self.comm = comm
        self.solver = PETSc.KSP().create(comm=comm)
        self.solver.setOptionsPrefix("condensed_jumps_")
        self.solver.setType("preonly")
        self.solver.getPC().setType("lu")
        self.solver.getPC().setFactorSolverType("scalapack")
        self.solver.setFromOptions()

    def solve(self, numbers: Ints, values: Floats, what: str) -> Floats:
        """The solution (n,), on all ranks, of the sums of rows (m, n + 1) that ranks give; the right side comes last.

        numbers  of these rows (m,), ascending
        what     is solved for, in words
        Raises Unsolved, on every rank. Collective.
        """
        rows = self._rows(numbers, values)
        rows /= np.maximum(np.abs(rows[:, :-1]).max(axis=1, initial=0.0, keepdims=True), np.finfo(float).tiny)
        here, count = len(rows), values.shape[1] - 1
        dense = PETSc.Mat().createDense(
            ((here, count), (here, count)), array=rows[:, :-1].ravel(order="F"), comm=self.comm
        )
        dense.assemble()
        matrix = dense.convert("scalapack", PETSc.Mat())
        dense.destroy()
        solution, right = matrix.createVecs()
        right.setArray(rows[:, -1])
        self.solver.setOperators(matrix)
        try:
            self.solver.solve(right, solution)
            check_solution(self.solver, solution, right, what)
            return _of_all_ranks(solution.getArray(), self.comm)
        except PETSc.Error as error:
            if error.ierr != BROKEN:
                raise
            raise Unsolved(f"{what}: the matrix is singular") from error
        finally:
            self.solver.reset()
            destroy(matrix, solution, right)

    def _rows(self, numbers: Ints, values: Floats) -> Floats:
        """The rows (h, n + 1) that are this rank's, summed over those that ranks give. Collective."""
        size, width = self.comm.size, values.shape[1]
        each = -(-(width - 1) // size)
        starts = np.minimum(each * np.arange(size + 1), width - 1)
        sent = np.diff(np.searchsorted(numbers, starts))
        received = np.array(self.comm.alltoall(sent.tolist()))
        at, parts = np.empty(received.sum(), dtype=np.int64), np.empty((received.sum(), width))
        self.comm.Alltoallv((numbers.astype(np.int64), sent), (at, received))
        self.comm.Alltoallv((values, width * sent), (parts, width * received))
        first, last = starts[self.comm.rank : self.comm.rank + 2]
        result, ends = np.zeros((last - first, width)), np.concatenate([[0], np.cumsum(received)])
        for begin, end in pairwise(ends):
            result[at[begin:end] - first] += parts[begin:end]  # no rank gives a row twice
        return result

    def destroy(self) -> None:
        """Free the solver. Collective."""
        destroy(self.solver)


def _slabs(count: int) -> list[slice]:
    return [slice(first, min(first + SLAB, count)) for first in range(0, count, SLAB)]


def _first_of_each(here: int, comm: MPI.Comm) -> Ints:
    """Number of the first of each rank, and of all (ranks + 1,). Collective."""
    return np.concatenate([[0], np.cumsum(comm.allgather(here))]).astype(np.int64)


def _of_all_ranks(here: Numbers, comm: MPI.Comm) -> Numbers:
    """Numbers (n,) of all ranks, of the length of a row of the compliance. Collective."""
    counts = np.array(comm.allgather(len(here)))
    result = np.empty(counts.sum(), dtype=here.dtype)
    comm.Allgatherv(np.ascontiguousarray(here), (result, counts))
    return result
