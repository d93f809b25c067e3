"""The Jacobian of a step over all unknowns: one sparse matrix on a fixed pattern, refilled when a tangent has changed.

Multigrid is given the unknowns of a node as a block, and the motions that cost no energy.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from fracflow._petsc import MPI, PETSc, destroy, timed
from fracflow.integrators import Alphas
from fracflow.mesh.blocks import Blocks, petsc_ints
from fracflow.mesh.data import Floats, Ints
from fracflow.model.compressed import FarRock
from fracflow.model.flow import Compression, Conduction
from fracflow.model.joints import section_groups
from fracflow.model.layout import Rows, add_blocks, create_matrix, local_rows, matrix_of
from fracflow.model.loads import Loads
from fracflow.model.network_parts import Closure, closure_row
from fracflow.model.operators import Operators

PARTS = ("solid", "flow")
ROCK = ("stiffness", "mass", "damping")
"""Operators whose values are read where they are needed."""
AT_ONCE = 100_000  # values, so that what is made of them takes no memory beside


@dataclass(frozen=True)
class FreePart:
    """The free part of a solve: entries and diagonal of held rows and columns; numbers of blocks, -1 where held.

    ``flow_rows`` are ``flow_nodes``, or -1 where a closure stands for the balance of a node. ``keeping`` are the rows of
    closures that keep the fluid at a joint end.
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
        jump = ops.joints.jump.transposeMatMult(ops.joints.jump)
        parts = {
            "stiffness": self._place(local_rows(ops.stiffness), "solid", "solid"),
            "mass": self._place(local_rows(ops.mass), "solid", "solid"),
            "jump": self._place(local_rows(jump), "solid", "solid"),
        }
        jump.destroy()
        if ops.damping is not None and not loads.at_rest:
            parts["damping"] = self._place(local_rows(ops.damping), "solid", "solid")
        if ops.flow is not None:
            squeeze, pattern = ops.flow.storage_coupling.transpose(PETSc.Mat()), ops.flow.pattern.transpose(PETSc.Mat())
            network = self._network_pattern()
            parts |= {
                "pressure_load": self._place(local_rows(ops.flow.pressure_load), "solid", "flow"),
                "storage_coupling": self._place(local_rows(squeeze), "flow", "solid"),
                "feedback": self._place(local_rows(pattern), "flow", "solid"),
                "network": self._place(local_rows(network), "flow", "flow"),
            }
            destroy(squeeze, pattern, network)
        self.rows_here = layout.solid_count + layout.flow_count
        diagonal = np.arange(self.rows_here) * layout.total + layout.start + np.arange(self.rows_here)
        keys = {name: part.rows * layout.total + part.cols for name, part in parts.items()}
        self._closures = [self._closure(closure) for closure in loads.closures]
        self._fluids = [closure for closure in loads.closures if closure.by == "fluid"]
        union = _union([diagonal, *keys.values(), *(rows.rows * layout.total + rows.cols for rows in self._closures)])
        row, self._col = union // layout.total, petsc_ints(union % layout.total)
        self._diagonal = np.searchsorted(union, diagonal)
        names = [
            each for each in ("stiffness", "mass", "damping", "pressure_load", "storage_coupling") if each in parts
        ]
        self._places = {name: petsc_ints(np.searchsorted(union, keys[name])) for name in names}
        self._couplings = {name: parts[name].values for name in names if name not in ROCK}
        self._closing = [
            (
                np.flatnonzero(np.isin(row, c.rows)),
                np.searchsorted(union, c.rows * layout.total + c.cols),
                c.values,
            )
            for c in self._closures
        ]
        self._indptr = petsc_ints(np.searchsorted(row, np.arange(self.rows_here + 1)))
        local = (self.rows_here, layout.total)
        csr = (self._indptr, self._col, np.zeros(len(union)))
        is_dry = layout.flow_starts[-1] == 0
        node = node_size(ops) if is_dry else 1
        self.matrix = matrix_of((local, local), csr, layout.comm, node)
        if is_dry:
            space = near_null_space(ops)
            self.matrix.setNearNullSpace(space)
            space.destroy()
        self.fixed = np.union1d(loads.fixed_solid, loads.fixed_flow)
        self._prepare_blocks()
        self.stood: tuple[Any, ...] = ()
        """By which the matrix was filled, the state apart: alphas, size of flow, free part."""
        self._changing_rows, self._changing_entries = self._find_changing()
        self._standing = np.zeros(0)  # values of those entries without the state
        self._filled: tuple[Any, ...] | None = None
        self.fills = 0
        self.whole = self.matrix if ops.far is None else self._with_far(ops.far)

    def _with_far(self, far: FarRock) -> PETSc.Mat:
        whole = PETSc.Mat().createPython(self.matrix.getSizes(), _WithFar(self, far), comm=self.layout.comm)
        whole.setUp()
        return whole

    def _place(self, rows: Rows, row_part: str, col_part: str) -> Rows:
        layout = self.layout
        offset = 0 if row_part == "solid" else layout.solid_count
        number = layout.solid_numbers if col_part == "solid" else layout.flow_numbers
        return Rows(rows.rows + offset, number(rows.cols), rows.values)

    def _closure(self, closure: Closure) -> Rows:
        """A closure's row in scaled unknowns, on the rank that has it."""
        cols, weights = closure_row(closure, self.layout)
        here = len(closure.row) > 0
        row = self.layout.solid_count + int(closure.row[0]) if here else 0
        count = len(cols) if here else 0
        scale = 1.0 if closure.by == "level" else self.operators.scales.displacement / closure.size
        return Rows(np.full(count, row), cols[:count], scale * weights[:count])

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
            inside = np.isin(ops.blocks.joints.flow, closure.nodes)
            self._keeping[inside], self._kept[inside] = layout.flow_numbers(closure.nodes[:1])[0], closure.size

    def _find_changing(self) -> tuple[Ints, Ints]:
        """Entries of this rank's rows to which the state adds something: numbers of rows, places of entries. Collective."""
        marks = self.layout.joined_vector()
        for numbers in (*self._sections, self._flow_nodes, self._keeping):
            chosen = petsc_ints(numbers[numbers >= 0])
            marks.setValues(chosen, np.ones(len(chosen)), PETSc.InsertMode.ADD)
        marks.assemble()
        changes = marks.getArray(readonly=True) > 0.0
        entries = np.flatnonzero(np.repeat(changes, np.diff(self._indptr)))
        marks.destroy()
        return np.flatnonzero(changes), entries

    def _held(self, only: str | None) -> np.ndarray:
        """Whether each of the unknowns of all ranks is held."""
        held = np.zeros(self.layout.total, dtype=bool)
        held[self.fixed] = True
        if only == "solid":
            held[self.layout.flow_numbers(np.arange(self.layout.flow_starts[-1]))] = True
        elif only == "flow":
            held[self.layout.solid_numbers(np.arange(self.layout.solid_starts[-1]))] = True
        return held

    def _find_free(self, only: str | None) -> FreePart:
        held = self._held(only)

        def free(numbers: Ints) -> Ints:
            return np.where(held[numbers], -1, numbers)

        own = held[self.layout.start : self.layout.start + self.rows_here]
        closed = np.zeros(self.layout.total, dtype=bool)
        here = [int(rows.rows[0]) + self.layout.start for rows in self._closures if len(rows.rows)]
        closed[np.concatenate(self.layout.comm.allgather(np.array(here, dtype=np.int64)))] = True
        nodes = free(self._flow_nodes)
        return FreePart(
            np.flatnonzero(np.repeat(own, np.diff(self._indptr)) | held[self._col]),
            self._diagonal[own],
            np.where(closed[self._flow_nodes], -1, nodes),
            tuple(free(numbers) for numbers in self._sections),
            nodes,
            tuple(free(numbers) for _, numbers, _ in self._ends),
            tuple(free(numbers) for _, numbers, _ in self._slips),
            np.where(self._keeping < 0, -1, free(self._keeping)),
        )

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
            self._stand_again(matrix)
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
            if conduction.compression is not None and self._fluids:
                self._keep_fluid(free, conduction.compression)
        matrix.assemble()

    def standing(self) -> PETSc.Mat:
        """The matrix as it was filled last, but without the state. The caller destroys it. Collective."""
        result = self.matrix.copy()
        self._stand_again(result)
        result.assemble()
        return result

    def _stand(self, matrix: PETSc.Mat) -> None:
        """Fill ``matrix`` with all that does not depend on the state, the held rows too. Collective."""
        alphas, flow_scale, only = self.stood
        scales, free, data = self.operators.scales, self._free_parts[only], np.zeros(len(self._col))
        solid_solid = scales.displacement / scales.force

        def add(name: str, scale: float) -> None:
            if name in self._places:
                rock = getattr(self.operators, name) if name in ROCK else None
                values = self._couplings[name] if rock is None else rock.getValuesCSR()[2]
                for begin in range(0, len(values), AT_ONCE):
                    part = slice(begin, begin + AT_ONCE)
                    data[self._places[name][part]] += scale * values[part]

        add("stiffness", 1.0)
        add("mass", alphas.mass)
        data *= solid_solid
        add("damping", solid_solid * alphas.a1)
        add("pressure_load", -scales.pressure / scales.force)
        add("storage_coupling", scales.displacement / flow_scale * alphas.a1)
        for entries, places, weights in self._closing:
            data[entries] = 0.0
            data[places] = weights
        data[free.held_entries] = 0.0
        data[free.held_diagonal] = 1.0
        matrix.setValuesCSR(self._indptr, self._col, data)
        matrix.assemble()
        self._standing = data[self._changing_entries]

    def _stand_again(self, matrix: PETSc.Mat) -> None:
        """Take out the state that was added before. Collective."""
        indptr = np.concatenate([[0], np.cumsum(np.diff(self._indptr)[self._changing_rows])])
        rows = petsc_ints(self._changing_rows + self.layout.start)
        cols = self._col[self._changing_entries]
        matrix.setValuesIJV(petsc_ints(indptr), cols, self._standing, PETSc.InsertMode.INSERT, rows)
        matrix.assemble(PETSc.Mat.AssemblyType.FLUSH)

    def _keep_fluid(self, free: FreePart, stored: Compression) -> None:
        """Add what compression does to the rows that keep the fluid of a part."""
        scales, size = self.operators.scales, self._kept.ravel()
        rows, values = free.keeping.reshape(-1, 1), stored.weight.ravel() * scales.pressure / size
        add_blocks(self.matrix, rows, free.flow_nodes.reshape(-1, 1), values[:, None, None])
        values = stored.slope.ravel() * scales.displacement / size
        for (ends, _, normal), unknowns in zip(self._ends, free.ends, strict=True):
            add_blocks(self.matrix, rows[ends], unknowns, (values[ends, None] * normal)[:, None, :])

    def destroy(self) -> None:
        """Free the matrices. Collective."""
        if self.whole is not self.matrix:
            self.whole.destroy()
        self.matrix.destroy()


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
            force = self.far.force(given.getArray(readonly=True)[: layout.solid_count])
            result.getArray()[: layout.solid_count] += scales.displacement / scales.force * force


def _union(keys: list[Ints]) -> Ints:
    """All keys once, ascending. Each array is nearly so already: a stable sort merges them, where np.unique starts afresh."""
    merged = np.sort(np.concatenate(keys), kind="stable")
    is_first = np.ones(len(merged), dtype=bool)
    is_first[1:] = merged[1:] != merged[:-1]
    return merged[is_first]


def rigid_motions(blocks: Blocks) -> Floats:
    """The translations and the rotation of the plane as this rank's unknowns (n, 3), about the middle of the mesh. Collective.

    Nodal unknowns get the motion of their node, a rigid body's its own translation and turn.
    """
    block, comm, dim = blocks.solid, blocks.comm, blocks.sizes.dim
    start, end = block.unknown_starts[comm.rank : comm.rank + 2]
    middle = comm.allreduce(block.points[: block.owned].sum(axis=0)) / blocks.sizes.nodes
    motions = np.zeros((int(end - start), dim + 1))

    def turn(points: Floats) -> Floats:
        arm = points - middle
        return np.stack([-arm[:, 1], arm[:, 0]], axis=1)

    places = [(block.unknown, block.points), (block.body_unknown[:, :dim], block.body_center)]
    for unknowns, points in places:
        for axis in range(dim):
            here = np.flatnonzero((unknowns[:, axis] >= start) & (unknowns[:, axis] < end))
            rows = unknowns[here, axis] - start
            motions[rows, axis] = 1.0
            motions[rows, dim] = turn(points[here])[:, axis]
    turned = block.body_unknown[:, dim]
    motions[turned[(turned >= start) & (turned < end)] - start, dim] = 1.0
    return motions


def near_null_space(operators: Operators) -> PETSc.NullSpace:
    """The rigid motions, orthonormal, as PETSc has them. The caller destroys it. Collective."""
    blocks, layout = operators.blocks, operators.layout
    vectors: list[PETSc.Vec] = []
    for motion in rigid_motions(blocks).T:
        vector = layout.solid_vector()
        vector.setArray(motion)
        for other in vectors:
            vector.axpy(-vector.dot(other), other)
        vector.normalize()
        vectors.append(vector)
    space = PETSc.NullSpace().create(vectors=vectors, comm=layout.comm)
    destroy(*vectors)
    return space


def node_size(operators: Operators) -> int:
    """Unknowns of a node, where all unknowns are nodes'; else 1, which says nothing."""
    return operators.blocks.sizes.dim if operators.expand is None else 1


def tell_rigid_motions(operators: Operators, solid: PETSc.IS) -> None:
    """Give the split ``solid`` both; PCFIELDSPLIT passes them to the matrix of the split. Collective."""
    solid.setBlockSize(node_size(operators))
    space = near_null_space(operators)
    solid.compose("nearnullspace", space)
    space.destroy()
