"""The Jacobian of a step over all unknowns: one sparse matrix on a fixed pattern, refilled when a tangent has changed.

Multigrid is given the unknowns of a node as a block, and the motions that cost no energy.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from fracflow._petsc import MPI, PETSc, destroy, timed
from fracflow.integrators import Alphas
from fracflow.mesh.blocks import petsc_ints
from fracflow.mesh.data import Bools, Floats, Ints
from fracflow.model.flow import Conduction
from fracflow.model.joints import section_groups
from fracflow.model.layout import NUMBERS_AT_ONCE, add_blocks, create_matrix, matrix_of, rows_of
from fracflow.model.loads import Loads
from fracflow.model.operators import Operators
from fracflow.model.undrained import Closure, SummedBalances, closure_row
from fracflow.solve.fractured_rock.rigid_motions import near_null_space, node_size
from fracflow.solve.pattern import Entries, Pattern, by_rows, csr_of

if TYPE_CHECKING:
    from fracflow.model.multipole_rock import FarRock

PARTS = ("solid", "flow")
ROCK = ("stiffness", "mass", "damping")
"""Operators whose values are read where they are needed."""
BY_STATE = ("jump", "network", "feedback")  # parts of the pattern to whose entries joints and flow add by their state


@dataclass(frozen=True)
class FreePart:
    """The free part of a solve: entries and diagonal of held rows and columns; numbers of blocks, -1 where held.

    ``flow_rows`` are ``flow_nodes``, or -1 where a closure stands for the balance of a node. ``keeping`` are the rows of
    closures, or of sums of balances, that count the fluid at a joint end.
    """

    held_entries: Ints
    held_diagonal: Ints
    flow_rows: Ints
    sections: tuple[Ints, ...]
    flow_nodes: Ints
    ends: tuple[Ints, ...]
    slips: tuple[Ints, ...]
    keeping: Ints


class JoinedMatrix:
    """(4.8) [[A, -B], [alpha_1 B_F' + d(K_F p + b_1 x)/du, K_F + b_1 dx/dp]] in scaled unknowns; held rows are 1.

    ``only`` leaves one of the two splits free, "solid" or "flow"; None both.
    """

    def __init__(self, operators: Operators, loads: Loads) -> None:
        """Find the pattern and place the constant operators on it. Collective."""
        self.operators, self.layout = operators, operators.layout
        ops, layout = operators, operators.layout
        self.rows_here = layout.solid_count + layout.flow_count
        here = np.arange(self.rows_here + 1)
        self._couplings: dict[str, Floats] = {}
        parts = {"diagonal": Entries(here, petsc_ints(layout.start + here[:-1]))}
        for name in ROCK:
            if name != "damping" or (ops.damping is not None and not loads.at_rest):
                parts[name] = self._entries(getattr(ops, name), "solid", "solid")[0]
        jump = ops.joints.jump.transposeMatMult(ops.joints.jump)
        parts["jump"] = self._entries(jump, "solid", "solid")[0]
        jump.destroy()
        if ops.flow is not None:
            squeeze = ops.flow.storage_coupling.transpose(PETSc.Mat())
            network, load = self._network_pattern(), ops.flow.pressure_load
            parts["pressure_load"], self._couplings["pressure_load"] = self._entries(load, "solid", "flow")
            parts["storage_coupling"], self._couplings["storage_coupling"] = self._entries(squeeze, "flow", "solid")
            parts["feedback"] = self._entries(ops.flow.feedback, "flow", "solid")[0]
            parts["network"] = self._entries(network, "flow", "flow")[0]
            destroy(squeeze, network)
        self._fluids, self._summed = [closure for closure in loads.closures if closure.by == "fluid"], loads.summed
        closing = [self._closure(closure) for closure in loads.closures]
        swept = self._summed_parts(parts) if self._summed is not None else np.zeros(0)
        closing = sorted((each for each in closing if len(each[1])), key=lambda each: each[0])
        counts = np.zeros(self.rows_here, dtype=np.int64)
        counts[[row for row, *_ in closing]] = [len(cols) for _, cols, _ in closing]
        columns = np.concatenate([np.zeros(0, dtype=np.int64), *(cols for _, cols, _ in closing)])
        parts["closures"] = Entries(np.concatenate([[0], np.cumsum(counts)]), petsc_ints(columns))
        pattern = Pattern.of(parts, ROCK, layout.total, layout.comm)
        parts.clear()
        self._edges, self._starts, self._marks = pattern.edges, pattern.starts, pattern.marks
        self._diagonal = pattern.places["diagonal"]
        self._places = {name: pattern.places[name] for name in self._couplings}
        self._closed = np.array([row for row, *_ in closing], dtype=np.int64)
        places = np.split(pattern.places["closures"], np.cumsum([len(cols) for _, cols, _ in closing]))
        self._closing = [
            (np.arange(*self._starts[row : row + 2]), place, weights)
            for place, (row, _, weights) in zip(places[:-1], closing, strict=True)
        ]
        if self._summed is not None:
            rows = layout.solid_count + self._summed.roots
            self._closed = np.concatenate([self._closed, rows])
            entries = np.concatenate([np.arange(*self._starts[row : row + 2]) for row in rows] or [self._closed[:0]])
            self._closing.append((entries, pattern.places["summed walls"], swept))
        local = (self.rows_here, layout.total)
        csr = (pattern.starts, pattern.columns, np.zeros(len(pattern.columns)))
        is_dry = layout.flow_starts[-1] == 0
        node = node_size(ops) if is_dry else 1
        self.matrix = matrix_of((local, local), csr, layout.comm, node)
        if is_dry:
            space = near_null_space(ops)
            self.matrix.setNearNullSpace(space)
            space.destroy()
        self._prepare_blocks()
        seen = [pattern.columns, self._flow_nodes, self._keeping, *self._sections]
        seen += [numbers for _, numbers, _ in (*self._ends, *self._slips)]
        self.fixed = layout.marked(loads.held, loads.given_pressures, seen)
        self.stood: tuple[Any, ...] = ()
        """By which the matrix was filled, the state apart: alphas, size of flow, free part."""
        added = [pattern.places[name] for name in BY_STATE if name in pattern.places]
        changing, starts, self._changing_entries = self._find_changing(added)
        columns, rows = pattern.columns[self._changing_entries], petsc_ints(changing + self.layout.start)
        self._changing = petsc_ints(starts), columns, rows
        self._standing = np.zeros(0)  # values of those entries without the state
        self._columns: Ints | None = pattern.columns  # until it is filled for the first time
        self._filled: tuple[Any, ...] | None = None
        self.fills = 0
        self.whole = self.matrix if ops.far is None else self._with_far(ops.far)

    def _with_far(self, far: FarRock) -> PETSc.Mat:
        whole = PETSc.Mat().createPython(self.matrix.getSizes(), _WithFar(self, far), comm=self.layout.comm)
        whole.setUp()
        return whole

    def _entries(self, matrix: PETSc.Mat, row_part: str, col_part: str) -> tuple[Entries, Floats]:
        """Where the entries of a part are, and their values (n,)."""
        layout, number = self.layout, (self.layout.solid_numbers if col_part == "solid" else self.layout.flow_numbers)
        starts, columns, values = matrix.getValuesCSR()
        for begin in range(0, len(columns), NUMBERS_AT_ONCE):
            part = slice(begin, begin + NUMBERS_AT_ONCE)
            columns[part] = number(columns[part])
        around = (0, layout.flow_count) if row_part == "solid" else (layout.solid_count, 0)
        return Entries(np.pad(starts, around, mode="edge"), columns), values

    def _closure(self, closure: Closure) -> tuple[int, Ints, Floats]:
        """A closure's row in scaled unknowns, with columns and weights (n,), on the rank that has it."""
        cols, weights = closure_row(closure, self.layout)
        here = len(closure.row) > 0
        row = self.layout.solid_count + int(closure.row[0]) if here else 0
        scale = 1.0 if closure.by == "level" else self.operators.scales.displacement / closure.size
        return row, cols, scale * weights

    def _summed_parts(self, parts: dict[str, Entries]) -> Floats:
        """Put what sums of balances depend on into ``parts``; scaled values (n,) of "summed walls". Collective."""
        network, summed = self.operators.network, self._summed
        assert summed is not None
        volumes = network.storage_coupling.matTransposeMult(summed.members).transpose()
        opened, beside = summed.members.matMult(network.feedback), self._network_pattern()
        near = summed.members.matMult(beside)
        parts["summed pressures"] = self._entries(near, "flow", "flow")[0]
        parts["summed openings"] = self._entries(opened, "flow", "solid")[0]
        parts["summed walls"], values = self._entries(volumes, "flow", "solid")
        starts = volumes.getValuesCSR()[0]
        destroy(volumes, opened, beside, near)
        sizes = np.ones(self.layout.flow_count)
        sizes[summed.roots] = summed.sizes
        return values * self.operators.scales.displacement / np.repeat(sizes, np.diff(starts))

    def _network_pattern(self) -> PETSc.Mat:
        size = (self.layout.flow_count, int(self.layout.flow_starts[-1]))
        matrix = create_matrix((size, size), 8, self.layout.comm)
        flow = self.operators.blocks.joints.flow
        add_blocks(matrix, flow, flow, np.ones((len(flow), 2, 2)))
        matrix.assemble()
        return matrix

    def _prepare_blocks(self) -> None:
        ops, layout = self.operators, self.layout
        self._free_parts: dict[str | None, FreePart] = {}
        self._flow_nodes = np.zeros((0, 2), dtype=np.int64)
        self._sections = [layout.solid_numbers(group.unknowns) for group in ops.joints.groups]
        self._ends: list[tuple[Ints, Ints, Floats]] = []
        self._slips: list[tuple[Ints, Ints, Floats]] = []
        if ops.flow is not None:
            self._flow_nodes = layout.flow_numbers(ops.blocks.joints.flow)
            for group in section_groups(ops.flow.opening, 1):
                self._ends.append((group.sections, layout.solid_numbers(group.unknowns), group.jump[:, 0]))
            for group in section_groups(ops.flow.slipping, ops.joints.dim - 1) if ops.flow.slipping is not None else ():
                self._slips.append((group.sections, layout.solid_numbers(group.unknowns), group.jump))
        # of each joint end the row that keeps the fluid of its part, where one does, and its size
        self._keeping, self._kept = np.full(self._flow_nodes.shape, -1), np.ones(self._flow_nodes.shape)
        for closure in self._fluids:
            self._keeping[closure.ends] = layout.flow_numbers(np.array([closure.number]))[0]
            self._kept[closure.ends] = closure.size
        if self._summed is not None:
            is_its = self._summed.root_at >= 0
            self._keeping[is_its] = layout.flow_numbers(self._summed.root_at[is_its])
            self._kept = self._kept * self._summed.size_at

    def _columns_of(self, first: int, last: int) -> tuple[Ints, Ints]:
        """Starts (r + 1,) and columns (n,) of some of this rank's rows. Collective."""
        if self._columns is None:
            return csr_of(self.matrix, first, last)[:2]
        begin, end = self._starts[first], self._starts[last]
        return self._starts[first : last + 1] - begin, self._columns[begin:end]

    def _find_changing(self, added: list[Ints]) -> tuple[Ints, Ints, Ints]:
        """Rows (r,) of this rank to which the state adds something, starts (r + 1,) and places (n,) of its entries. Collective.

        added  places of the parts that it adds to; it also adds anywhere in a row that keeps fluid
        """
        marks = self.layout.joined_vector()
        chosen = petsc_ints(self._keeping[self._keeping >= 0])
        marks.setValues(chosen, np.ones(len(chosen)), PETSc.InsertMode.ADD)
        marks.assemble()
        is_changing = np.repeat(marks.getArray(readonly=True) > 0.0, np.diff(self._starts))
        marks.destroy()
        is_changing[np.concatenate(added)] = True
        entries = np.flatnonzero(is_changing)
        ends = np.searchsorted(entries, self._starts)
        rows = np.flatnonzero(np.diff(ends))
        return rows, np.append(ends[rows], ends[-1]), entries

    def held(self, only: str | None) -> Bools:
        """Whether each of this rank's unknowns (n,) is held."""
        return self._is_held(self.layout.start + np.arange(self.rows_here), only)

    def _is_held(self, numbers: Ints, only: str | None) -> Bools:
        held = np.isin(numbers, self.fixed)
        return held if only is None else held | (self.layout.is_flow(numbers) == (only == "solid"))

    def _find_free(self, only: str | None) -> FreePart:
        def free(numbers: Ints) -> Ints:
            return np.where(self._is_held(numbers, only), -1, numbers)

        own, nodes = self.held(only), free(self._flow_nodes)
        closed = self.layout.marked(self._closed[:0], self._closed - self.layout.solid_count, (self._flow_nodes,))
        return FreePart(
            self._entries_of(own, only),
            self._diagonal[own],
            np.where(np.isin(self._flow_nodes, closed), -1, nodes),
            tuple(free(numbers) for numbers in self._sections),
            nodes,
            tuple(free(numbers) for _, numbers, _ in self._ends),
            tuple(free(numbers) for _, numbers, _ in self._slips),
            np.where(self._keeping < 0, -1, free(self._keeping)),
        )

    def _entries_of(self, held: Bools, only: str | None) -> Ints:
        """Places of entries (n,) in this rank's rows and in columns that are held; its own (n,) are marked. Collective."""
        found = []
        for first, last in pairwise(self._edges):
            starts, numbers = self._columns_of(first, last)
            of_held = np.repeat(held[first:last], np.diff(starts))
            column = numbers - self.layout.start
            is_own = (column >= 0) & (column < self.rows_here)
            of_held[is_own] |= held[column[is_own]]
            of_held[~is_own] |= self._is_held(numbers[~is_own], only)
            found.append(self._starts[first] + np.flatnonzero(of_held))
        return np.concatenate(found)

    @property
    def alphas(self) -> Alphas | None:
        """Those of the last filling."""
        return self._filled[0] if self._filled is not None else None

    @timed("FracAssemble")
    def fill(
        self, alphas: Alphas, moduli: Floats, conduction: Conduction | None, flow_scale: float, only: str | None = None
    ) -> bool:
        """Refill with moduli (s, dim, dim) where anything differs from the last time; whether it did. Collective."""
        now, arrays = (alphas, flow_scale, only), [moduli]
        if conduction is not None and only != "solid":
            arrays += [conduction.conductance, conduction.slope, conduction.pressure]
            if conduction.by_slip is not None:
                arrays.append(conduction.by_slip)
            if conduction.compression is not None:
                arrays += [conduction.compression.weight, conduction.compression.slope]
            if conduction.leaving is not None:
                arrays += conduction.leaving[1:]
        same = (
            self._filled is not None
            and self._filled[:3] == now
            and all(np.array_equal(a, b) for a, b in zip(arrays, self._filled[3:], strict=True))
        )
        if self.layout.comm.allreduce(same, op=MPI.LAND):
            return False
        self._filled = (*now, *[a.copy() for a in arrays])
        self._refill(alphas, moduli, conduction, flow_scale, only)
        self.fills += 1
        return True

    def _refill(
        self, alphas: Alphas, moduli: Floats, conduction: Conduction | None, flow_scale: float, only: str | None
    ) -> None:
        ops, scales, matrix = self.operators, self.operators.scales, self.matrix
        solid_solid = scales.displacement / scales.force
        if only not in self._free_parts:
            self._free_parts[only] = self._find_free(only)
        free = self._free_parts[only]
        if self.stood != (alphas, flow_scale, only):
            self.stood = (alphas, flow_scale, only)
            self._stand(matrix)
        else:
            self._insert(matrix, self._standing)
            matrix.assemble(PETSc.Mat.AssemblyType.FLUSH)
        for numbers, (_, values) in zip(free.sections, ops.joints.tangent(moduli), strict=True):
            add_blocks(matrix, numbers, numbers, solid_solid * values)
        if ops.flow is not None and conduction is not None:
            flow_solid, nodes = scales.displacement / flow_scale, free.flow_rows
            between, slope = conduction.tangents(alphas.b1)
            add_blocks(matrix, nodes, free.flow_nodes, scales.pressure / flow_scale * between)
            for (ends, _, normal), unknowns in zip(self._ends, free.ends, strict=True):
                joint, end = ends // 2, ends % 2
                values = slope[joint, :, end][:, :, None] * normal[:, None, :]
                add_blocks(matrix, nodes[joint], unknowns, flow_solid * values)
            if conduction.by_slip is not None:
                drop = np.stack([conduction.pressure[:, 0] - conduction.pressure[:, 1]] * 2, axis=1) * [1.0, -1.0]
                for (ends, _, along), unknowns in zip(self._slips, free.slips, strict=True):
                    joint, end = ends // 2, ends % 2
                    change = np.einsum("nt,ntk->nk", conduction.by_slip[joint, end], along)
                    values = drop[joint][:, :, None] * change[:, None, :]
                    add_blocks(matrix, nodes[joint], unknowns, flow_solid * values)
            if self._summed is not None:
                self._keep_fluid(free, *(each / alphas.a1 for each in conduction.of_ends(alphas.b1)))
                self._let_through(free, self._summed, conduction, alphas.a1)
            elif self._fluids and conduction.compression is not None:
                self._keep_fluid(free, conduction.compression.weight, conduction.compression.slope)
        matrix.assemble()

    @contextmanager
    def standing(self) -> Iterator[PETSc.Mat]:
        """The matrix without the state, as long as that is needed: then it is again as it was filled last. Collective."""
        matrix, state = self.matrix, self.matrix.stateGet()
        rows = PETSc.IS().createGeneral(self._changing[2], comm=self.layout.comm)
        part = rows_of(matrix, rows)
        row_starts, _, all_values = part.getValuesCSR()
        shift = row_starts[:-1] - self._starts[self._changing[2] - self.layout.start]
        shift = np.repeat(shift, np.diff(self._changing[0]))
        values = all_values[self._changing_entries + shift]
        destroy(rows, part)
        self._insert(matrix, self._standing)
        matrix.assemble()
        try:
            yield matrix
        finally:
            self._insert(matrix, values)
            matrix.assemble()
            matrix.stateSet(state)  # so that no solver takes it for another

    def _stand(self, matrix: PETSc.Mat) -> None:
        """Fill ``matrix`` with all that does not depend on the state, the held rows too. Collective."""
        alphas, flow_scale, only = self.stood
        scales, free, kept = self.operators.scales, self._free_parts[only], []
        solid_solid = scales.displacement / scales.force
        couplings = {
            "pressure_load": -scales.pressure / scales.force,
            "storage_coupling": scales.displacement / flow_scale * alphas.a1,
        }
        edges = np.minimum(self._edges, self.layout.solid_count)
        rock = {name: by_rows(getattr(self.operators, name), edges) for name in self._marks}
        for number, (first, last) in enumerate(pairwise(self._edges)):
            begin, end = self._starts[first], self._starts[last]
            data = np.zeros(end - begin)
            for name, scale in (("stiffness", 1.0), ("mass", alphas.mass), ("damping", solid_solid * alphas.a1)):
                if name == "damping":
                    data *= solid_solid
                if name in rock and scale:
                    is_its = np.unpackbits(self._marks[name][number], count=len(data)).view(bool)
                    data[is_its] += scale * next(rock[name])[2]
            for name in self._couplings:
                here = _between(self._places[name], begin, end)
                data[self._places[name][here] - begin] += couplings[name] * self._couplings[name][here]
            for entries, places, weights in self._closing:
                data[entries[_between(entries, begin, end)] - begin] = 0.0
                here = _between(places, begin, end)
                data[places[here] - begin] = weights[here]
            data[free.held_entries[_between(free.held_entries, begin, end)] - begin] = 0.0
            data[free.held_diagonal[_between(free.held_diagonal, begin, end)] - begin] = 1.0
            kept.append(data[self._changing_entries[_between(self._changing_entries, begin, end)] - begin])
            self._put(matrix, first, last, data)
        self._standing, self._columns = np.concatenate(kept), None

    def _put(self, matrix: PETSc.Mat, first: int, last: int, data: Floats) -> None:
        """Set all values (n,) of some rows. Collective."""
        starts, columns = self._columns_of(first, last)
        rows = petsc_ints(np.arange(first, last) + self.layout.start)
        matrix.setValuesIJV(starts, columns, data, PETSc.InsertMode.INSERT, rows)
        matrix.assemble()

    def _insert(self, matrix: PETSc.Mat, values: Floats) -> None:
        """Set the entries to which the state adds something. Collective."""
        starts, columns, rows = self._changing
        matrix.setValuesIJV(starts, columns, values, PETSc.InsertMode.INSERT, rows)

    def _keep_fluid(self, free: FreePart, by_pressure: Floats, by_opening: Floats) -> None:
        """Add what the fluid at joint ends (j, 2) does to the rows that keep that of a part, or balance it as volumes."""
        scales, size = self.operators.scales, self._kept.ravel()
        rows, values = free.keeping.reshape(-1, 1), by_pressure.ravel() * scales.pressure / size
        add_blocks(self.matrix, rows, free.flow_nodes.reshape(-1, 1), values[:, None, None])
        values = by_opening.ravel() * scales.displacement / size
        for (ends, _, normal), unknowns in zip(self._ends, free.ends, strict=True):
            add_blocks(self.matrix, rows[ends], unknowns, (values[ends, None] * normal)[:, None, :])

    def _let_through(self, free: FreePart, summed: SummedBalances, conduction: Conduction, rate: float) -> None:
        """Add what flows from component to component, ``rate`` a volume, to the sums of their balances."""
        scales, size = self.operators.scales, rate * self._kept[:, :, None]
        rows = np.where(summed.is_joining[:, None] & (summed.root_at >= 0), free.keeping, -1)
        by_pressure, by_opening = (each / size for each in summed.between(conduction).tangents(0.0))
        add_blocks(self.matrix, rows, free.flow_nodes, scales.pressure * by_pressure)
        for (ends, _, normal), unknowns in zip(self._ends, free.ends, strict=True):
            values = by_opening[ends // 2, :, ends % 2][:, :, None] * normal[:, None, :]
            add_blocks(self.matrix, rows[ends // 2], unknowns, scales.displacement * values)

    def destroy(self) -> None:
        """Free the matrices. Collective."""
        if self.whole is not self.matrix:
            self.whole.setType("shell")  # ends its context now: PETSc may keep a broken solver until Python has ended
        destroy(self.whole, self.matrix)


class _WithFar:
    """PETSc's context of the whole Jacobian where rock has more than its entries."""

    def __init__(self, filled: JoinedMatrix, far: FarRock) -> None:
        """Both are the caller's."""
        self.filled, self.far = filled, far

    def mult(self, _: PETSc.Mat, given: PETSc.Vec, result: PETSc.Vec) -> None:
        """The entries, and far walls, which are never held but with all displacements. Collective."""
        self.filled.matrix.mult(given, result)
        if self.filled.stood[2] != "flow":
            layout, scales = self.filled.layout, self.filled.operators.scales
            force = self.far.tangent_force(given.getArray(readonly=True)[: layout.solid_count])
            result.getArray()[: layout.solid_count] += scales.displacement / scales.force * force


def _between(places: Ints, begin: int, end: int) -> slice:
    """Those of places (n,), in the order of rows, that lie from ``begin`` to before ``end``, which are starts of rows."""
    return slice(*np.searchsorted(places, (begin, end)))
