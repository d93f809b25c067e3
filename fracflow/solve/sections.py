"""Joints and fracture flow on the sections alone: Newton's method over clusters of sections, all at once.

At the end of an explicit step e = e_free - S G M^-1 G' W (t(e, p) - t_old), t = f - n p: the motion e of a section in the
step, from its motion under the previous tractions of joints and fluid. Statuses as in ``newton``: held until the balance
holds, then each section may change its own once, until none does. No iteration takes a joint past its closure. Pressures
follow the trapezoidal rule for the motion of the walls, 2/dt B' (u_new - u) + x'_new + K_F p_new = Q_new + Q - K_F p - x';
condensed steps have another right side.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from fracflow._petsc import MPI, PETSc, destroy, timed
from fracflow.errors import NotConverged, Unsolved
from fracflow.integrators import Alphas
from fracflow.laws import LawStep
from fracflow.mesh.data import Floats, Ints
from fracflow.model.compressibility import uptake_at
from fracflow.model.flow import Compression, Conduction
from fracflow.model.layout import add_blocks, create_matrix
from fracflow.model.loads import Loads
from fracflow.model.operators import Operators
from fracflow.model.state import SectionHistory, Sections, State
from fracflow.model.terms.term import TermStep
from fracflow.scene.scene import Scene
from fracflow.solve.clusters import Clusters
from fracflow.solve.failure import fractures_of
from fracflow.solve.linear import check_solution, drop_factors
from fracflow.solve.newton import MOST_CHANGES
from fracflow.solve.request import StepRequest, StepRule
from fracflow.solve.residual import TINY, largest, over_ranks, round_off_of_uptake


class SectionProblem(Protocol):
    """A step of sections and fluid, meanings as in ``StepProblem``: what is given, and the trial."""

    state: State
    request: StepRequest
    rule: StepRule
    loads: Loads
    alphas: Alphas
    time: float
    source: PETSc.Vec
    displacement: PETSc.Vec
    pressure: PETSc.Vec
    flow_balance: PETSc.Vec
    sections: Sections
    trial_status: SectionHistory
    conduction: Conduction | None
    fluid_before: Compression | None
    taken_up: Floats | None
    operators: Operators

    def evaluate_joints(self, strain: Floats, hold: bool = True) -> Sections:
        """(2.10b) Response of the sections to strains (s, dim)."""
        ...

    def law_step(self, hold: bool = True) -> LawStep:
        """The step as laws see it."""
        ...

    def term_step(self) -> TermStep:
        """The same for terms with a memory."""
        ...

    def change_statuses(self) -> np.ndarray:
        """Give every section that has left its status the next one; return which (s,) of this rank did."""
        ...

    def undetermined(self, nodes: Ints) -> float:
        """Part of what nodes (n,) of this rank draw that is not known [volume rate per thickness]."""
        ...


def given_before(problem: SectionProblem) -> PETSc.Vec:
    """Q_new + Q - K_F p - x' of the trapezoidal rule, in a new vector. Collective."""
    state, result = problem.state, problem.source.copy()
    result.axpy(1.0, state.forces.source)
    result.axpy(-1.0, state.forces.conduction)
    if state.uptake is not None:
        result.axpy(-1.0, state.uptake)
    return result


class FlowOnJoints:
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
        self._free: tuple[Loads | None, Ints, Ints] = None, flow, self.nodes
        """Flow nodes of joints (j, 2), and of sections as above, -1 where the pressure is prescribed; by which loads."""

    def given(self, problem: SectionProblem) -> PETSc.Vec:
        """Terms of the balance that are known before the step is solved, in a new vector. Collective."""
        return given_before(problem)

    def balance(self, problem: SectionProblem, change: Floats, given: PETSc.Vec) -> tuple[float, Floats]:
        """Evaluate ``problem.flow_balance`` where sections have moved by ``change`` (s, dim) in the step.

        Gives its residual beyond round-off over its largest term, and its derivatives (s, 2), at both nodes of the joint, by
        the opening of each section. Collective.
        """
        network, joints, flow = self.operators.network, self.operators.joints, problem.flow_balance
        walls = joints.walls(problem.sections, network.law, problem.law_step())
        conduction = network.conduct(problem.displacement, problem.pressure, walls, problem.term_step())
        problem.conduction = conduction
        swept = problem.alphas.a1 * (joints.weights * change[:, -1]).reshape(-1, 2)
        slope = conduction.tangents(problem.alphas.b1)[1]
        flow.set(0.0)
        taken = uptake_at(self.operators, problem.state, problem.alphas, problem.fluid_before, conduction.compression)
        problem.taken_up = taken
        if taken is not None:
            flow.getArray()[:] += taken
        network.outflow(conduction, flow)
        network.taken_up(swept, flow)
        flow.axpy(-1.0, given)
        for part in problem.loads.pressures:
            flow.getArray()[part.numbers] = 0.0
        through = conduction.conductance[:, None] * np.abs(conduction.pressure)
        terms = [float(np.abs(each).max(initial=0.0)) for each in (swept, through)]
        known = round_off_of_uptake(network, problem.fluid_before, conduction, problem.alphas.b1)
        size = np.abs(flow.getArray(readonly=True))
        beyond = float(np.subtract(size, known, out=size.copy(), where=np.isfinite(size)).max(initial=0.0))
        left, *sizes = over_ranks([beyond, *terms, largest(given)], self.operators.layout.comm)
        return left / max(*sizes, TINY), slope.transpose(0, 2, 1).reshape(-1, 2)

    def left(self, problem: SectionProblem, own: Floats, own_slopes: Floats) -> PETSc.Vec:
        """Flow that pressures have to balance once sections open by ``own`` (s,), whose slopes are (s, 2). Collective."""
        result = problem.flow_balance.copy()
        taken = problem.alphas.a1 * self.operators.joints.weights * own
        both = (own_slopes * own[:, None]).reshape(-1, 2, 2).sum(axis=1)
        self.operators.network.taken_up(taken.reshape(-1, 2) + both, result)
        result.scale(-1.0)
        for part in problem.loads.pressures:
            result.getArray()[part.numbers] = 0.0
        return result

    def solve(
        self,
        problem: SectionProblem,
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
        network, layout = self.operators.network, self.operators.layout
        assert problem.conduction is not None
        start, rate = int(layout.flow_starts[layout.comm.rank]), problem.alphas.a1
        if self._free[0] is not problem.loads:
            self._free = problem.loads, *self._find_free(problem.loads)
        _, free, of_sections = self._free
        between = problem.conduction.tangents(problem.alphas.b1)[0]
        joined = self.operators.blocks.joints.flow
        self.matrix.zeroEntries()
        add_blocks(self.matrix, free, joined, between)
        for batch, opened in zip(self.clusters.batches, answers, strict=True):
            node = self.nodes[batch.sections, 0]
            rows = of_sections[batch.sections].reshape(len(node), -1)
            by_opening = np.concatenate([rate * weights[batch.sections, None], slopes[batch.sections]], axis=2)
            values = by_opening[..., None] * opened[:, :, None, :]
            add_blocks(self.matrix, rows, node, values.reshape(len(node), -1, node.shape[1]))
        rows = start + np.unique(problem.loads.given_pressures)
        add_blocks(self.matrix, rows[:, None], rows[:, None], np.ones((len(rows), 1, 1)))
        self.matrix.assemble()
        self.fills += 1

        left, change = self.left(problem, own, own_slopes), problem.pressure.duplicate()
        self.solver.setOperators(self.matrix)
        self.solver.solve(left, change)
        try:
            check_solution(self.solver, change, left, f"time {problem.time:.6g}: pressures of the fluid on the joints")
            found = network.at_ends(change).ravel()
            problem.pressure.axpy(1.0, change)
        except Unsolved:
            drop_factors(self.solver)
            raise
        finally:
            destroy(left, change)
        return found

    def _find_free(self, loads: Loads) -> tuple[Ints, Ints]:
        """Flow nodes of joints and of sections, -1 where the pressure is prescribed. Collective."""
        layout, found = self.operators.layout, (self.operators.blocks.joints.flow, self.nodes)
        joined = [layout.flow_numbers(each) for each in found]
        given = layout.marked(np.zeros(0, dtype=np.int64), loads.given_pressures, joined)
        ends, sections = (
            np.where(np.isin(number, given), -1, each) for number, each in zip(joined, found, strict=True)
        )
        return ends, sections

    def destroy(self) -> None:
        """Free matrix and solver. Collective."""
        destroy(self.solver, self.matrix)


TIGHT = 1e-12  # of the largest motion of a section in the step
MOTION_ROUND_OFF = 8.0 * float(np.finfo(float).eps)  # of the motions whose difference is the motion of a section


@dataclass(frozen=True)
class SectionReport:
    """Newton iterations, and residuals: of motions over the largest, of flows over the largest term."""

    iterations: int
    motion: float
    flow: float


@dataclass(frozen=True)
class SectionRows:
    """Data of the sections of clusters in an iteration, (S, ...): residual, its size, W D, slopes of the flow."""

    left: Floats
    size: Floats
    moduli: Floats
    slopes: Floats


class SectionSolver:
    """Solves for the motion of sections in a step, and for the pressures."""

    flow_kind, most_changes = FlowOnJoints, MOST_CHANGES

    def __init__(self, scene: Scene, operators: Operators, clusters: Clusters, elastic: Floats | float = 0.0) -> None:
        """Keep what is constant; ``elastic`` are moduli (s, dim, dim) that the compliance has in it already. Collective."""
        self.scene, self.operators, self.clusters = scene, operators, clusters
        self.flow = self.flow_kind(operators, clusters) if operators.flow is not None else None
        self._sizes = [np.abs(batch.compliance) for batch in clusters.batches]
        self._weights = clusters.exchange.there(operators.joints.weights[:, None])[:, 0]
        count, dim = len(operators.joints.weights), operators.joints.dim
        self.elastic = np.broadcast_to(np.asarray(elastic), (count, dim, dim))

    def total_traction(self, traction: Floats, pressure: PETSc.Vec) -> Floats:
        """Tractions t = f - n p (s, dim) of effective tractions, and of the pressures of the flow nodes. Collective."""
        network, result = self.operators.flow, traction.copy()
        if network is not None:
            result[:, -1] -= network.at_ends(pressure).ravel()
        return result

    def pressure_change(self, problem: SectionProblem, change: Floats) -> Floats:
        """Change (s, dim) of total tractions, beyond elastic moduli, of sections moved by ``change`` [stress]. Collective."""
        before = self.total_traction(problem.state.sections.traction, problem.state.pressure)
        now = self.total_traction(problem.sections.traction, problem.pressure)
        return now - before - np.einsum("sij,sj->si", self.elastic, change)

    @timed("FracSections")
    def solve(
        self, problem: SectionProblem, free: Floats, share: float, start: Floats | None = None, least: int = 0
    ) -> tuple[Floats, SectionReport]:
        """Bring sections and pressures of ``problem`` into balance, from the free motion (s, dim) of sections.

        share  S of ``integrators.explicit``; ``start`` first trial (s, dim) of the motion of sections.
        least  iterations in any case
        Returns their motion. Raises NotConverged, on every rank. Collective.
        """
        total, change, comm = 0, np.zeros_like(free) if start is None else start, self.operators.layout.comm
        pulled = self.total_traction(problem.state.sections.traction, problem.state.pressure)
        given = self.flow.given(problem) if self.flow is not None else None
        try:
            for _ in range(self.most_changes):
                change, report = self._with_statuses(problem, free, change, pulled, given, share, least - total)
                total += report.iterations
                if problem.request.hold:
                    return change, replace(report, iterations=total)
                changed = problem.change_statuses()
                if not comm.allreduce(bool(changed.any()), op=MPI.LOR):
                    return change, replace(report, iterations=total)
        finally:
            destroy(given)
        where = fractures_of(self.operators.blocks, changed) or "the network"
        raise NotConverged(
            f"time {problem.time:.6g}: {where} keeps changing between sticking and sliding within one explicit"
            " step: take a smaller time_step",
            kind="statuses",
        )

    def _with_statuses(
        self,
        problem: SectionProblem,
        free: Floats,
        change: Floats,
        pulled: Floats,
        given: PETSc.Vec | None,
        share: float,
        least: int,
    ) -> tuple[Floats, SectionReport]:
        """The balance with the statuses of ``problem.trial_status``, beginning from ``change``. Collective."""
        joints, solver, comm = self.operators.joints, self.flow, self.operators.layout.comm
        before, weights, most = problem.state.sections, joints.weights[:, None], self.scene.accuracy.max_iterations
        for iteration in range(most + 1):
            answer = problem.evaluate_joints(before.strain + change)
            problem.sections = answer
            flow, slopes = 0.0, np.zeros((len(free), 2))
            if solver is not None and given is not None:
                flow, slopes = solver.balance(problem, change, given)
            pull, moduli = self.total_traction(answer.traction, problem.pressure), weights[:, :, None] * answer.tangent
            push = weights * (pull - pulled - np.einsum("sij,sj->si", self.elastic, change))
            known = np.einsum("sij,sj->si", np.abs(moduli), np.abs(answer.strain)) + weights * np.abs(answer.traction)
            moduli = moduli - weights[:, :, None] * self.elastic
            rows = self._gather(free, change, push, known + weights * np.abs(pull), moduli, slopes, share)
            beyond = np.abs(rows.left) - MOTION_ROUND_OFF * rows.size
            here = [float(each.max(initial=0.0)) for each in (np.abs(change), beyond, np.abs(rows.left))]
            moved, beyond_all, worst, bad = over_ranks([*here, float(not np.isfinite(push).all())], comm)
            if bad:
                break
            if beyond_all <= TIGHT * moved and flow <= self.scene.accuracy.residual and iteration >= least:
                return change, SectionReport(iteration, worst / moved if moved > 0.0 else 0.0, flow)
            step = self._step(problem, rows, slopes, share)
            allowed = comm.allreduce(joints.step_limit(before.strain + change, step, before), op=MPI.MIN)
            change = change + allowed * step
        stuck = self.clusters.exchange.back((beyond > TIGHT * moved).astype(float)).any(axis=1)
        where = fractures_of(self.operators.blocks, stuck) or "the network"
        raise NotConverged(
            f"time {problem.time:.6g}: {where} found no balance of joints and flow in {iteration} iterations of an"
            f" explicit step (motion of sections out by {worst:.1e}, flow by {flow:.1e} of its largest term): take a smaller"
            " time_step",
            kind="sections",
        )

    def _gather(
        self, free: Floats, change: Floats, push: Floats, known: Floats, moduli: Floats, slopes: Floats, share: float
    ) -> SectionRows:
        """Gather data of this rank's sections in the clusters, with the balance of motions there. Collective.

        known  sizes of the terms whose difference is ``push``
        """
        count, dim = free.shape
        rows = np.hstack([free, change, push, known, moduli.reshape(count, dim**2), slopes])
        there = np.split(self.clusters.exchange.there(rows), np.cumsum([dim, dim, dim, dim, dim**2]), axis=1)
        free, change, push, known, flat, slopes = there
        left, size = free - change, np.abs(free) + np.abs(change)
        for batch, widest in zip(self.clusters.batches, self._sizes, strict=True):
            at, shape = batch.sections, (*batch.sections.shape, dim)
            column = len(batch.sections), -1, 1
            left[at] -= share * (batch.compliance @ push[at].reshape(column)).reshape(shape)
            size[at] += share * (widest @ known[at].reshape(column)).reshape(shape)
        return SectionRows(left, size, flat.reshape(-1, dim, dim), slopes)

    def _step(self, problem: SectionProblem, rows: SectionRows, own_slopes: Floats, share: float) -> Floats:
        """Newton's correction (s, dim) of the motion of sections; that of the pressures is applied here. Collective."""
        dim, exchange = rows.left.shape[1], self.clusters.exchange
        alone, by_pressure = np.zeros_like(rows.left), []
        for batch in self.clusters.batches:
            at, (clusters, members) = batch.sections, batch.sections.shape
            scaled = batch.compliance if share == 1.0 else share * batch.compliance
            compliance = scaled.reshape(clusters, members * dim, members, dim)
            right = rows.left[at].reshape(clusters, -1, 1)
            if self.flow is not None:
                right = np.concatenate([right, compliance[..., -1] * self._weights[at][:, None]], axis=2)
            answer = self._answer(compliance, rows.moduli[at], right)
            alone[at] = answer[:, :, 0].reshape(clusters, members, dim)
            by_pressure.append(answer[:, :, 1:].reshape(clusters, members, dim, -1))
        if self.flow is None:
            return exchange.back(alone)
        own = exchange.back(alone)[:, -1]
        opened = [each[:, :, -1] for each in by_pressure]
        with np.errstate(invalid="ignore"):  # sections may have no answer, which the next trial refuses
            raised = self.flow.solve(problem, opened, self._weights, rows.slopes, own, own_slopes)
        there = exchange.there(raised[:, None])[:, 0]
        for batch, answer in zip(self.clusters.batches, by_pressure, strict=True):
            alone[batch.sections] += np.einsum("cmip,cp->cmi", answer, there[batch.sections])
        return exchange.back(alone)

    def _answer(self, compliance: Floats, moduli: Floats, right: Floats) -> Floats:
        """(1 + S G M^-1 G' W D)^-1 of right sides (c, m dim, k); compliance (c, m dim, m, dim), moduli (c, m, dim, dim)."""
        matrix = np.einsum("cxmi,cmij->cxmj", compliance, moduli).reshape(*right.shape[:2], -1)
        matrix += np.eye(right.shape[1])
        return np.asarray(np.linalg.solve(matrix, right))

    def destroy(self) -> None:
        """Free the flow's solver. Collective."""
        destroy(self.flow)
