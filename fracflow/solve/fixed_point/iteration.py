"""(4.5) The report's staggered cycle: the flow with the walls held, then the solid with the pressures held.

Its contraction is predicted before the first cycle of a step, and measured from then on. Plain cycles refuse, or hand the step
over to the monolithic solver, where the prediction is not below 1. Relaxed ones (``relaxation``) and those with added storage
go on until cycles run out. All stop when both balances hold and a plain cycle would change the pressures no more: small
changes alone would be believed too early.

A cycle goes on from the statuses of the last one. A section may then slide for a pressure that was on its way, and slide on
where it would also stick. So the last cycles begin with the statuses of the last step, as all other solvers do.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fracflow._petsc import MPI, PETSc, destroy, timed
from fracflow.errors import NotConverged, SolveError
from fracflow.integrators import Alphas
from fracflow.mesh.data import Floats
from fracflow.model.loads import Loads
from fracflow.model.operators import Operators
from fracflow.model.state import StepReport
from fracflow.scene.scene import Scene
from fracflow.solve.accept import step_report
from fracflow.solve.condensed_cost import Condensing
from fracflow.solve.fixed_point.contraction import (
    Prediction,
    add_storage,
    change_of,
    factor_with,
    is_solved,
    predict,
)
from fracflow.solve.fixed_point.failure import describe_divergence, measured_factor
from fracflow.solve.fixed_point.relaxation import RELAXATIONS, Cycles
from fracflow.solve.jacobian import JoinedMatrix
from fracflow.solve.newton import Newton
from fracflow.solve.options import solver_of
from fracflow.solve.problem import StepProblem
from fracflow.solve.residual import TINY
from fracflow.solve.stiffness import NewtonReport

CHANGED = 0.1  # relative change of a conductance or stiffness from which on an earlier prediction is too old
MEASURED = 3  # cycles of a step that is refused, so that the prediction can be held against something
WORTH = 1e-3  # of the residual of the flow: walls balanced so well leave the cycles as many (1e-5 and 0 took as many)
PRESSURE_ROUND_OFF = 1e-13  # of the largest pressure: smaller changes say nothing


@dataclass(frozen=True)
class Linearised:
    """A prediction and what it holds for.

    conductance  (j,) of the elements
    feedback     (j, 2) change of an element's flow with the opening of its ends
    storage      (j,) change of the volume rate with opening, alpha_1 L / 2
    tangent      (s, dim, dim) of the joint sections
    """

    prediction: Prediction
    alphas: Alphas
    conductance: Floats
    feedback: Floats
    storage: Floats
    tangent: Floats

    def change(self, other: Linearised, comm: MPI.Comm) -> float:
        """About how much the factor may have moved between the two, relative. Collective."""
        feedback = np.abs(other.feedback - self.feedback).max(axis=1, initial=0.0)
        base = self.storage + np.abs(self.feedback).max(axis=1, initial=0.0)
        here = [np.abs(other.tangent - self.tangent).max(initial=0.0), np.abs(self.tangent).max(initial=0.0)]
        moved, most = (comm.allreduce(float(part), op=MPI.MAX) for part in here)
        return max(
            change_of(self.conductance, other.conductance, comm),
            change_of(base, base + feedback, comm),
            moved / most if most > 0.0 else 0.0,
        )


class _Lost(Exception):
    """The cycles do not converge; the text says what stopped them, where something did.

    cost  what they took
    left  how many times too large what is tested still was
    """

    def __init__(self, why: str = "", cost: StepReport | None = None, left: float = np.nan) -> None:
        """Say why, at what cost, and how far they came."""
        super().__init__(why)
        self.cost, self.left = cost or StepReport(), left


class FixedPoint:
    """The cycle (4.5a,b), plain, relaxed or with added storage."""

    limit = 1.0  # predicted factor of a plain cycle from which on it is not tried

    def __init__(self, scene: Scene, operators: Operators, loads: Loads) -> None:
        """Make a matrix of both balances, whose block is the flow's, and one whose factors the solid keeps. Collective."""
        self.scene, self.name = scene, scene.method.fixed_point
        self.whole_matrix = JoinedMatrix(operators, loads)
        self.solid_matrix = JoinedMatrix(operators, loads)
        self.solid = Newton(scene, self.solid_matrix, "solid", "solid")
        self.solid.least = 1  # walls that are nearly balanced must still follow the last change of the pressures
        self.splits = self.whole_matrix.layout.index_sets()
        self.network = self.whole_matrix.matrix.createSubMatrix(self.splits[1], self.splits[1])
        self._network_of = -1  # the fill of the whole that the network was taken from
        self.flow = solver_of(self.network, "flow_fieldsplit_flow_")
        self.monolithic: Newton | None = None
        self.linearised: Linearised | None = None

    def expect(self, planned: Condensing) -> None:
        """Nothing here depends on which steps are planned."""

    def solve(self, problem: StepProblem) -> StepReport:
        """Cycle until converged; hand over where the scene says so. Raises SolveError, on every rank. Collective."""
        problem.evaluate()
        prediction, changes = self._prediction(problem), list[float]()
        hands_over = self.scene.method.on_divergence == "monolithic"
        is_hopeless = self.name == "plain" and prediction.factor >= self.limit
        try:
            if not np.isfinite(prediction.own) or (is_hopeless and hands_over):
                raise _Lost
            report = self._cycle(problem, prediction, changes, MEASURED if is_hopeless else None)
            report = replace(report, made=self._made(problem, prediction))
        except _Lost as lost:
            problem.begin_again()
            problem.evaluate()
            why = describe_divergence(self.scene, problem, self.whole_matrix, prediction, changes, lost.left, str(lost))
            if not hands_over:  # a smaller time step may help the solid, where it was the solid that failed
                is_solid = bool(str(lost)) and not is_hopeless
                raise (NotConverged(why, kind="fixed point") if is_solid else SolveError(why)) from lost
            report = replace(self._hand_over(problem).after(lost.cost), cycles=len(changes), handed_over=why)
        return replace(report, predicted=prediction.factor, measured=measured_factor(changes))

    def _cycle(
        self, problem: StepProblem, prediction: Prediction, changes: list[float], most: int | None
    ) -> StepReport:
        """Cycles until the balances hold. Raises _Lost when they diverge, or after ``most``. Collective."""
        accuracy, rule = self.scene.accuracy, RELAXATIONS[self.name]
        cycles, total, left = Cycles(prediction.factor), StepReport(), np.nan
        is_settled = False
        for number in range(1, (most or accuracy.max_cycles) + 1):
            keeps = not is_settled and self._has_changed(problem)
            try:
                problem.work.factorisations += 1
                added = self._added(problem, prediction)
                cycles = cycles.then(problem.pressure.getArray().copy(), added)
                step, share = rule(cycles, self._together)
                cycles = cycles.taking(share)
                problem.pressure.setArray(problem.pressure.getArray() + step)
                report = self._walls(problem, keeps)
            except SolveError as error:
                raise _Lost(f"in cycle {number}: {error}", total) from error
            changes.append(self._largest(added))
            residual = problem.residual
            cycle = step_report(report, residual, number)
            total = replace(
                cycle,
                newton=cycle.newton + 1,
                krylov=cycle.krylov + self.flow.getIterationNumber(),
                factorisations=cycle.factorisations + 1,
                out_of_balance=(),
            ).after(total)
            size = problem.pressure.norm(PETSc.NormType.INFINITY)
            still = max(accuracy.pressure * self._driven(problem), PRESSURE_ROUND_OFF * size)
            if most is None and changes[-1] <= still and residual.flow <= accuracy.residual:
                if not keeps:
                    return total
                is_settled = True
            left = max(changes[-1] / max(still, TINY), residual.flow / accuracy.residual)
            growing = self.name == "plain" and len(changes) > 3 and changes[-1] > changes[-2] > changes[-3]
            if growing or not np.isfinite(changes[-1]):
                break
        raise _Lost("", total, left)

    def _walls(self, problem: StepProblem, keeps: bool) -> NewtonReport:
        """(4.5b) Balance of the walls under these pressures. Raises SolveError, on every rank. Collective.

        keeps  begin with the statuses of the last cycle, and balance walls no better than the pressures are worth. Where that
               fails, and else, begin with those of the last step
        """
        if keeps:
            self.solid.enough = WORTH * problem.residual.flow
            try:
                return self.solid.solve(problem)
            except NotConverged:
                problem.move(np.zeros(problem.operators.layout.solid_count))
            finally:
                self.solid.enough = 0.0
        problem.trial_status = problem.state.sections.history
        return self.solid.solve(problem)

    def _has_changed(self, problem: StepProblem) -> bool:
        """Whether a section has another status than when the step began. Collective."""
        changed = problem.operators.joints.have_changed(problem.state.sections.history, problem.trial_status)
        return bool(self.whole_matrix.layout.comm.allreduce(bool(changed.any()), op=MPI.LOR))

    @timed("FracFlowSolve")
    def _added(self, problem: StepProblem, prediction: Prediction) -> Floats:
        """(4.5a) Changes (n,) that the flow makes to this rank's pressures, the walls as they are. Collective."""
        unit, scale = problem.operators.scales.pressure, problem.flow_scale()
        self.whole_matrix.fill(problem.alphas, problem.sections.tangent, problem.conduction, scale)
        if self.whole_matrix.fills != self._network_of:
            self._network_of = self.whole_matrix.fills
            self.whole_matrix.matrix.createSubMatrix(self.splits[1], self.splits[1], self.network)
            if prediction.storage is not None:
                rate = problem.alphas.a1 / scale
                add_storage(self.network, prediction.storage * unit / scale, problem.loads.summed, rate)
        balance, added = self.network.createVecs()
        balance.setArray(problem.flow_balance.getArray(readonly=True) / -scale)
        self.flow.solve(balance, added)
        if self.flow.getConvergedReason() < 0:  # a factorisation that failed is not made anew
            self.flow.destroy()
            self.flow = solver_of(self.network, "flow_fieldsplit_flow_")
        solved, result = is_solved(self.network, added, balance), added.getArray() * unit
        destroy(balance, added)
        if not solved:
            raise SolveError("the flow has no solution while the walls are held")
        return result

    def _made(self, problem: StepProblem, prediction: Prediction) -> float:
        """The factor of cycles with added storage where they ended: joints may slide and open in them. Collective."""
        if prediction.storage is None or self.linearised is None:
            return np.nan
        change = self.linearised.change(self._linearise(problem), problem.operators.layout.comm)
        if change <= CHANGED:
            return prediction.stored
        try:
            return factor_with(self.whole_matrix, problem, prediction.storage)
        except SolveError:  # the step is done, whatever can be said of its cycles
            return np.nan

    def _prediction(self, problem: StepProblem) -> Prediction:
        """That of an earlier step, as long as it holds: a factor moves about as much as what it is made of. Collective."""
        old, now = self.linearised, self._linearise(problem)
        if old is not None and old.alphas == now.alphas:
            change, factor = old.change(now, problem.operators.layout.comm), old.prediction.factor
            is_clear = (factor * (1.0 + change) < self.limit) == (factor / (1.0 + change) < self.limit)
            if change <= CHANGED and is_clear:
                return old.prediction
        self.linearised = replace(now, prediction=predict(self.whole_matrix, problem, self.name == "added-storage"))
        return self.linearised.prediction

    def _linearise(self, problem: StepProblem) -> Linearised:
        """The trial as a prediction sees it, without one. Not collective."""
        conduction, network = problem.conduction, problem.operators.network
        assert conduction is not None
        drop = conduction.pressure[:, 0] - conduction.pressure[:, 1]
        now = Linearised(
            Prediction(np.nan, ""),
            problem.alphas,
            conduction.conductance.copy(),
            conduction.slope * drop[:, None],
            0.5 * problem.alphas.a1 * network.length,
            problem.sections.tangent.copy(),
        )
        if conduction.compression is not None:
            now = replace(now, feedback=now.feedback + problem.alphas.b1 * conduction.compression.slope)
        return now

    def _hand_over(self, problem: StepProblem) -> StepReport:
        """The step with both balances at once. Collective."""
        if self.monolithic is None:
            self.monolithic = Newton(self.scene, self.whole_matrix, "monolithic")
        return step_report(self.monolithic.solve(problem), problem.residual, 0)

    def _together(self, values: Floats) -> Floats:
        return np.asarray(self.whole_matrix.layout.comm.allreduce(values, op=MPI.SUM))

    def _largest(self, values: Floats) -> float:
        here = float(np.abs(values).max(initial=0.0))
        return float(self.whole_matrix.layout.comm.allreduce(here if here == here else np.inf, op=MPI.MAX))

    def _driven(self, problem: StepProblem) -> float:
        """The pressure that drives: differences, or the change in the step; a datum drives nothing. Collective."""
        now, before = problem.pressure.getArray(readonly=True), problem.state.pressure.getArray(readonly=True)
        span = problem.pressure.max()[1] - problem.pressure.min()[1]
        return max(span, self._largest(now - before))

    def destroy(self) -> None:
        """Free matrices and solvers. Collective."""
        solvers, matrices = (self.monolithic, self.solid, self.flow), (self.whole_matrix, self.solid_matrix)
        destroy(*solvers, self.network, *self.splits, *matrices)
