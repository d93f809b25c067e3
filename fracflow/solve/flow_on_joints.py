"""The film of a step that is solved on the joints: its balance, on pressures alone once the sections' answers are put in.

That of explicit steps is the trapezoidal rule for what the walls really move,
2/dt B' (u_new - u) + x'_new + K_F p_new = Q_new + Q - K_F p - x'; condensed steps have another right side.
"""

from __future__ import annotations

import numpy as np

from fracflow._petsc import PETSc
from fracflow.elements import flow as flow_element
from fracflow.mesh.data import Floats, Ints
from fracflow.model.layout import add_blocks, create_matrix
from fracflow.model.operators import Operators
from fracflow.solve.clusters import Clusters
from fracflow.solve.compressibility import uptake_at
from fracflow.solve.linear_check import check_solution
from fracflow.solve.problem import StepProblem
from fracflow.solve.residual import TINY, largest, over_ranks


class FilmOnJoints:
    """Balance, matrix and solver of the pressures; sections are joint ends, two a joint."""

    def __init__(self, operators: Operators, clusters: Clusters) -> None:
        """Make matrix and solver. Collective."""
        self.operators, self.clusters = operators, clusters
        layout, flow = operators.layout, operators.blocks.joints.flow
        size = (layout.flow_count, int(layout.flow_starts[-1]))
        self.matrix = create_matrix((size, size), 8, layout.comm)
        self.solver = PETSc.KSP().create(comm=layout.comm)
        self.solver.setOptionsPrefix("explicit_")
        # the network is small beside the rock: on one rank PETSc's own factorisation takes a tenth of the time of MUMPS
        self.solver.getPC().setFactorSolverType("petsc" if layout.comm.size == 1 else "mumps")
        self.solver.setFromOptions()
        # of each section: the node at its end of the joint, and both nodes of the joint
        numbers = np.concatenate([flow.reshape(-1, 1), np.repeat(flow, 2, axis=0)], axis=1).astype(float)
        self.nodes: Ints = clusters.exchange.there(numbers).astype(np.int64)
        self.fills = 0

    def given(self, problem: StepProblem) -> PETSc.Vec:
        """What is known of the balance before the step is solved, in a new vector. Collective."""
        state, result = problem.state, problem.source.copy()
        result.axpy(1.0, state.forces.source)
        result.axpy(-1.0, state.forces.conduction)
        if state.uptake is not None:
            result.axpy(-1.0, state.uptake)
        return result

    def balance(self, problem: StepProblem, change: Floats, given: PETSc.Vec) -> tuple[float, Floats]:
        """Evaluate ``problem.flow_balance`` where sections have moved by ``change`` (s, dim) in the step.

        What is left of it over its largest term, and its derivatives (s, 2), at both nodes of the joint, by the opening of
        each section. Collective.
        """
        network, joints, flow = self.operators.flow, self.operators.joints, problem.flow_balance
        assert network is not None
        opening = joints.openings(problem.state.sections.strain + change)
        conduction = network.conduct(problem.displacement, problem.pressure, opening)
        problem.conduction = conduction
        swept = problem.alphas.a1 * (joints.weights * change[:, -1]).reshape(-1, 2)
        slope = flow_element.conductivity_tangent(conduction.slope, conduction.pressure)
        flow.set(0.0)
        taken = uptake_at(self.operators, problem.state, problem.alphas, problem.fluid_before, conduction.compression)
        problem.taken_up = taken
        if taken is not None and conduction.compression is not None:
            slope[:, np.arange(2), np.arange(2)] += problem.alphas.b1 * conduction.compression.slope
            flow.getArray()[:] += taken
        network.outflow(conduction, flow)
        network.taken_up(swept, flow)
        flow.axpy(-1.0, given)
        for part in problem.loads.pressures:
            flow.getArray()[part.numbers] = 0.0
        through = conduction.conductance[:, None] * np.abs(conduction.pressure)
        terms = [float(np.abs(each).max(initial=0.0)) for each in (swept, through)]
        left, *sizes = over_ranks([largest(flow), *terms, largest(given)], self.operators.layout.comm)
        return left / max(*sizes, TINY), slope.transpose(0, 2, 1).reshape(-1, 2)

    def solve(
        self,
        problem: StepProblem,
        answers: list[Floats],
        weights: Floats,
        slopes: Floats,
        own: Floats,
        own_slopes: Floats,
    ) -> Floats:
        """Correct ``problem.pressure``; what it changes at this rank's sections (s,).

        answers     of each batch: opening (c, m, m) of a section by a unit of pressure at another
        weights, slopes  of the sections this rank solves for, (S,) and (S, 2)
        own, own_slopes  of this rank's sections: how they open without a change of pressure (s,), and slopes (s, 2)

        Raises NotConverged, on every rank. Collective.
        """
        network, layout = self.operators.flow, self.operators.layout
        assert network is not None and problem.conduction is not None
        start, count, rate = int(layout.flow_starts[layout.comm.rank]), layout.flow_count, problem.alphas.a1
        held = np.isin(layout.flow_numbers(np.arange(int(layout.flow_starts[-1]))), problem.loads.fixed_flow)
        between = flow_element.conductivity(problem.conduction.conductance)
        if (stored := problem.conduction.compression) is not None:
            between[:, np.arange(2), np.arange(2)] += problem.alphas.b1 * stored.weight
        joined = self.operators.blocks.joints.flow
        self.matrix.zeroEntries()
        add_blocks(self.matrix, np.where(held[joined], -1, joined), joined, between)
        for batch, opened in zip(self.clusters.batches, answers, strict=True):
            node, ends = self.nodes[batch.sections, 0], self.nodes[batch.sections, 1:]
            rows = np.concatenate([node[..., None], ends], axis=2).reshape(len(node), -1)
            by_opening = np.concatenate([rate * weights[batch.sections, None], slopes[batch.sections]], axis=2)
            values = by_opening[..., None] * opened[:, :, None, :]
            add_blocks(self.matrix, np.where(held[rows], -1, rows), node, values.reshape(len(node), -1, node.shape[1]))
        rows = start + np.flatnonzero(held[start : start + count])
        add_blocks(self.matrix, rows[:, None], rows[:, None], np.ones((len(rows), 1, 1)))
        self.matrix.assemble()
        self.fills += 1

        left, change = problem.flow_balance.copy(), problem.pressure.duplicate()
        taken = rate * self.operators.joints.weights * own
        both = (own_slopes * own[:, None]).reshape(-1, 2, 2).sum(axis=1)
        network.taken_up(taken.reshape(-1, 2) + both, left)
        left.scale(-1.0)
        for part in problem.loads.pressures:
            left.getArray()[part.numbers] = 0.0
        self.solver.setOperators(self.matrix)
        self.solver.solve(left, change)
        try:
            check_solution(self.solver, change, left, f"time {problem.time:.6g}: pressures of the film on the joints")
            found = network.at_ends(change).ravel()
            problem.pressure.axpy(1.0, change)
        finally:
            left.destroy()
            change.destroy()
        return found

    def destroy(self) -> None:
        """Free matrix and solver. Collective."""
        self.solver.destroy()
        self.matrix.destroy()
