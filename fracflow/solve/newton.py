"""(4.7) Newton's method on one step, or a method in its place: SNES, with the safeguards that joints need.

With overshoot = "hold" the statuses of the last step are tried first. Once the balances hold with them, every section that has
left its status is given the next one. The iteration goes on from there, until none has. So the elastic root is preferred, and
no section slips because an iterate overshot. With overshoot = "one-change", as in 5.1, every iteration lets each section
change its status, but once only. With a drop of strength it may end in a sliding state where "hold" finds an elastic one (5.3
does, just below failure). No iteration takes a joint past its closure.
"""

from __future__ import annotations

import numpy as np

from fracflow._petsc import MPI, PETSc, destroy
from fracflow.errors import NotConverged, SolveError, StatusCycling, Unsolved
from fracflow.laws.base import Bools
from fracflow.laws.closure import STEP_FRACTION
from fracflow.mesh.data import Floats
from fracflow.scene.scene import Scene
from fracflow.solve.failure import CIRCLES, FLOATING, check_step, describe_failure, describe_floating, why_stopped
from fracflow.solve.floating import Floating
from fracflow.solve.globalisation import (
    JUST_PAST,
    PERIODS,
    ActiveSetRounds,
    Repetition,
    StatusHistory,
    all_changed,
    by_energy,
    by_residual,
    statuses,
)
from fracflow.solve.jacobian import JoinedMatrix
from fracflow.solve.linear import factors_of, renew, set_up, solve_nonlinear, solves_both
from fracflow.solve.problem import StepProblem
from fracflow.solve.residual import over_ranks
from fracflow.solve.stiffness import NEWTON_METHODS, NewtonReport, SingularMatrix, softly_held

MOST_CHANGES = 50  # rounds of status changes in one step
BRIEF_CHANGES = 12  # of them where a shorter step may be taken instead
BRIEF = 20  # iterations with the same statuses there
PATIENCE = 15  # full Newton steps before a line search, with a fluid without a change of status
REPEATS = "with and without a line search its residuals repeat"
SLACK = 1e3  # times the accuracy of the balance: net force on a loose block that is round-off


class Newton:
    """Newton's method over all unknowns, or over one split while the other is held.

    prefix  of the PETSc options; ``only`` None, "solid" or "flow".
    """

    def __init__(self, scene: Scene, matrix: JoinedMatrix, prefix: str, only: str | None = None) -> None:
        """Make the SNES. Collective."""
        self.scene, self.matrix, self.prefix, self.only = scene, matrix, prefix, only
        self.method = NEWTON_METHODS[scene.method.newton]
        self.holds = scene.method.overshoot == "hold" or only == "flow"
        layout = matrix.layout
        self.unknowns, self.balance = layout.joined_vector(), layout.joined_vector()
        self.snes = PETSc.SNES().create(comm=layout.comm)
        self.snes.setOptionsPrefix(f"{prefix}_")
        self.snes.setType("newtonls")
        self.snes.setFunction(self._function, self.balance)
        self.snes.setConvergenceTest(self._converged)
        self.snes.setTolerances(max_it=scene.accuracy.max_iterations)
        self.snes.setLineSearchPreCheck(self._pre_check)
        self.snes.setMaxLinearSolveFailures(scene.accuracy.max_iterations)
        self.snes.setFromOptions()
        # kept, since a collection of garbage with another handle to it would clear its test (petsc4py's tp_traverse)
        self.solver = self.snes.getKSP()
        set_up(self.solver, matrix)
        self.factors = factors_of(scene, self.solver, matrix)
        self.snes.setJacobian(self._jacobian, matrix.whole, self.factors.factored)
        self.least = 0  # iterations in any case
        self.enough = 0.0  # residual of the solid that serves here, where it is more than the accuracy asked
        self.problem: StepProblem  # from ``solve`` on, as are the rounds
        self.floating: Floating | None = None
        self._krylov = 0
        self._step = np.inf
        self._is_endless, self._searched = False, 0  # iterations in a row whose step was searched
        self._restless = np.zeros(0, dtype=bool)
        self._strained: Floats | None = None  # sections where the step ends that SNES takes
        self._inner, self._circles = StatusHistory(layout.comm), False
        self._repetition = Repetition(scene.accuracy.residual)
        self._rounds: ActiveSetRounds
        self._is_held = False
        self._is_start, self._is_filled, self._polished, self._unaccounted = True, False, 0, np.inf
        self._out_of_balance: list[float] = []
        self._refusals: list[BaseException] = []  # of the functions below, until SNES has ended

    def solve(self, problem: StepProblem) -> NewtonReport:
        """Bring the trial of ``problem`` into balance. Raises SolveError, on every rank. Collective."""
        before = self.factors.made
        try:
            return self._solve(problem)
        finally:
            problem.work.factorisations += self.factors.made - before

    def solves_both(self, problem: StepProblem) -> bool:
        """Whether the linear solver leaves little of each balance of a trial that failed. Collective.

        It has factors of the last matrix then: those of an earlier one leave much, and say nothing of it.
        """
        before = self.factors.made
        self.factors.renew()
        problem.work.factorisations += self.factors.made - before
        return solves_both(self.solver, self.balance, self.matrix.layout.solid_count)

    def _solve(self, problem: StepProblem) -> NewtonReport:
        self.problem, self._krylov, self._step = problem, 0, np.inf
        self._restless, self._is_filled, self._out_of_balance = np.zeros(0, dtype=bool), False, []
        made, iterations, comm = self.factors.made, 0, self.matrix.layout.comm
        self._rounds = ActiveSetRounds(problem)
        self.factors.begin()
        most = BRIEF_CHANGES if problem.request.expects_failure else MOST_CHANGES
        for _ in range(most):
            self._pack(problem)
            self._is_start, self._circles, self._polished, self._is_held = True, False, 0, False
            self._is_endless, self._searched = False, 0
            del self._out_of_balance[-1:]  # the same iterate, before its sections changed
            try:
                solve_nonlinear(self.snes, self.unknowns, f"time {problem.time:.6g}: {self.prefix}", self._refusals)
            except Unsolved as error:
                self._renew_balance()
                if isinstance(error.__cause__, PETSc.Error):
                    renew(self.solver, self.matrix)
                raise
            except SingularMatrix as error:
                raise self._failure(
                    "its linear solve gave no number", iterations + self.snes.getIterationNumber()
                ) from error
            iterations += self.snes.getIterationNumber()
            self._unpack(self.unknowns)
            if self.snes.getConvergedReason() <= 0:
                is_short = 0 < problem.request.max_iterations < self.scene.accuracy.max_iterations
                raise self._failure(REPEATS if self._is_endless else why_stopped(self.snes, is_short), iterations)
            if self.only == "flow" or problem.request.hold:
                break
            self._restless = self._rounds.change(problem, self._searches())
            if not comm.allreduce(bool(self._restless.any()), op=MPI.LOR):
                break
            if self._rounds.is_lost:
                raise self._failure(CIRCLES, iterations)
        else:
            raise self._failure(f"after {most} rounds of changes of status", iterations)
        if self._floats(problem):
            self._refuse_floating(problem)
        return NewtonReport(iterations, self._krylov, self.factors.made - made, tuple(self._out_of_balance))

    def _pack(self, problem: StepProblem) -> None:
        scales, middle = self.matrix.operators.scales, self.matrix.layout.solid_count
        local = self.unknowns.getArray()
        local[:middle] = problem.increment.getArray(readonly=True) / scales.displacement
        local[middle:] = problem.pressure.getArray(readonly=True) / scales.pressure

    def _unpack(self, unknowns: PETSc.Vec, strain: Floats | None = None) -> None:
        scales, middle = self.matrix.operators.scales, self.matrix.layout.solid_count
        local = unknowns.getArray(readonly=True)
        if self.only != "solid":
            self.problem.pressure.setArray(local[middle:] * scales.pressure)
        if self.only != "flow":
            self.problem.move(local[:middle] * scales.displacement, strain)
        else:
            self.problem.move(self.problem.increment.getArray().copy())

    def _renew_balance(self) -> None:
        """Take another vector: newer PETSc keeps the right side of a linear solver locked that broke. Collective."""
        self.balance.destroy()
        self.balance = self.matrix.layout.joined_vector()
        self.snes.setFunction(self._function, self.balance)

    def _function(self, snes: PETSc.SNES, unknowns: PETSc.Vec, balance: PETSc.Vec) -> None:
        """The balances for SNES; from a refusal on they are infinite, which ends SNES on every rank. Collective."""
        if not self._refusals:
            try:
                return self._evaluate(unknowns, balance, self._strained)
            except SolveError as error:
                self._refusals.append(error)
            finally:
                self._strained = None
        balance.set(np.inf)

    def _evaluate(self, unknowns: PETSc.Vec, balance: PETSc.Vec, strain: Floats | None = None) -> None:
        problem = self.problem
        self._unpack(unknowns, strain)
        problem.evaluate(hold=self.holds or self._is_start or problem.request.hold)
        middle = self.matrix.layout.solid_count
        local = balance.getArray()
        local[:middle] = problem.solid_balance.getArray(readonly=True) / self.matrix.operators.scales.force
        local[middle:] = problem.flow_balance.getArray(readonly=True) / problem.flow_scale()
        if self.only == "solid":
            local[middle:] = 0.0
        elif self.only == "flow":
            local[:middle] = 0.0

    def _jacobian(self, snes: PETSc.SNES, unknowns: PETSc.Vec, jacobian: PETSc.Mat, _: PETSc.Mat) -> None:
        problem = self.problem
        if self.method.is_kept and self._is_filled:
            return
        moduli = self.method.moduli(problem)
        if is_loose := self._floats(problem):
            moduli = softly_held(moduli, self.matrix.operators.scales)
        conduction = problem.conduction
        if self._is_held and conduction is not None:
            conduction = conduction.held()
        self.matrix.fill(problem.alphas, moduli, conduction, problem.flow_scale(), self.only)
        self.factors.changed(must=is_loose)
        self._is_filled = True

    def _floats(self, problem: StepProblem, without: Bools | None = None) -> bool:
        """Whether blocks float at the present trial, without inertia and with fracture flow as it takes part. Collective.

        without  (s, 2) what sections are taken not to carry, along and across
        """
        if problem.alphas.a0 > 0.0 or self.only == "flow":
            return False
        operators = self.matrix.operators
        if self.floating is None:
            self.floating = Floating(operators, problem.loads)
        is_filled = operators.flow is not None and self.only is None and problem.alphas.a1 > 0.0
        return self.floating.find(problem.sections, is_filled, without).shape[1] > 0

    def _refuse_flight(self, problem: StepProblem, step: Floats) -> None:
        """Raise NotConverged where a step carries loose blocks off that no joint stops, in strains. Collective."""
        if not self._floats(problem):
            return
        before = problem.sections
        after = problem.evaluate_joints(before.strain + step)
        if not self.matrix.layout.comm.allreduce(bool(np.any(before.is_open & ~after.is_open)), op=MPI.LOR):
            self._refuse_floating(problem, always=False)

    def _refuse_floating(self, problem: StepProblem, always: bool = True) -> None:
        """Raise NotConverged that names a loose block; if not ``always``, only one with a net force on it. Collective."""
        assert self.floating is not None
        slack = SLACK * self._round_off(problem)
        push = self.floating.motions.T @ self.floating.net_force(problem.solid_balance).ravel()
        if always or np.abs(push).max() > slack:
            raise NotConverged(describe_floating(self.scene, problem, self.floating, slack), kind=FLOATING)

    def _round_off(self, problem: StepProblem) -> float:
        """Round-off bound of a balance that holds [force per thickness]. Collective."""
        size = problem.solid_balance.norm(PETSc.NormType.INFINITY)
        return self.scene.accuracy.residual * float(size) / max(problem.residual.solid, 1e-300)

    def _pre_check(self, unknowns: PETSc.Vec, step: PETSc.Vec) -> bool:
        try:
            return self._shorten(unknowns, step)
        except (SolveError, SingularMatrix) as error:
            self._refusals.append(error)
            return False

    def _shorten(self, unknowns: PETSc.Vec, step: PETSc.Vec) -> bool:
        """Whether a step was shortened. Raises SolveError or SingularMatrix where it may not be made. Collective."""
        problem = self.problem
        start = problem.sections.strain
        self._krylov += self.factors.check(self.balance, step)
        self._step = step.norm()
        if self.method.weakness and not np.isfinite(self._step):
            raise SingularMatrix
        try:
            check_step(self.solver, step, self.balance, problem, self.prefix)
        except NotConverged:
            if self._floats(problem):
                self._refuse_floating(problem)
            raise
        strains, fraction = self._strains(step)
        is_coupled = problem.conduction is not None and self.only is None and not self.method.weakness
        if is_coupled and not self._is_held and (fraction < 1.0 or self._growth(problem, strains)[0] < -STEP_FRACTION):
            newton = step.copy(), strains, fraction
            try:
                self._hold_conductances(problem, step)
                strains, fraction = self._strains(step)
                if fraction < newton[2]:
                    newton[0].copy(step)
                    _, strains, fraction = newton
                    self._is_held = False
            finally:
                newton[0].destroy()
        self._is_held = self._is_held and self._growth(problem, strains)[1] > 1.0
        if fraction == 1.0:
            self._refuse_flight(problem, strains)
        if fraction < 1.0:
            step.scale(fraction)
        if self._circles:
            searched = self._search(problem, unknowns, step, strains * fraction)
            step.scale(searched)
            fraction *= searched
        if fraction < 1.0:
            self._step = np.inf
        self._strained = start + fraction * strains
        return bool(fraction < 1.0)

    def _strains(self, step: PETSc.Vec) -> tuple[Floats, float]:
        """Strains (s, dim) that a step adds to the sections, and the fraction of it that they allow. Collective."""
        layout, joints = self.matrix.layout, self.matrix.operators.joints
        change, scale = layout.solid_vector(), self.matrix.operators.scales.displacement
        change.setArray(step.getArray(readonly=True)[: layout.solid_count] * -scale)
        self._step = change.norm()
        strains = joints.strain(change)
        change.destroy()
        sections = self.problem.sections
        return strains, layout.comm.allreduce(joints.step_limit(sections.strain, strains, sections), op=MPI.MIN)

    def _hold_conductances(self, problem: StepProblem, step: PETSc.Vec) -> None:
        """Make the step anew with the conductances as they are. Collective.

        Where a front of pressure enters a narrow fracture, an aperture d grows by c d^3 k (d_1 - d) in a step, in short. That
        rises with d by more than 1 where d_1 is far above, and Newton's method then goes away from the solution: it closes the
        fracture. With c d^3 held the aperture stays between d and d_1, and rises to the next solution above it. Steps go on so
        until no joint in contact widens by its own aperture.
        """
        self._is_held, self._is_filled = True, False
        self._jacobian(self.snes, self.unknowns, self.matrix.whole, self.factors.factored)
        self.solver.setOperators(self.matrix.whole, self.factors.factored)
        self.solver.solve(self.balance, step)
        self._krylov += self.factors.check(self.balance, step)
        check_step(self.solver, step, self.balance, problem, self.prefix)

    def _growth(self, problem: StepProblem, strains: Floats) -> tuple[float, float]:
        """Least and largest change that strains (s, dim) make to apertures of joints in contact, over these. Collective."""
        joints, sections = self.matrix.operators.joints, problem.sections
        now, change = joints.openings(sections.strain), joints.openings(strains * ~sections.is_open[:, None])
        grown = np.zeros(0)
        if now is not None and change is not None:
            wide = self.matrix.operators.network.aperture + now
            parted = wide > 0.0  # walls of springs may overlap
            grown = change[parted] / wide[parted]
        shrinks, grows = over_ranks([-grown.min(initial=0.0), grown.max(initial=0.0)], self.matrix.layout.comm)
        return -shrinks, grows

    def _search(self, problem: StepProblem, unknowns: PETSc.Vec, step: PETSc.Vec, strains: Floats) -> float:
        """Fraction of a step that ends the cycling; the problem stays evaluated at any trial. Collective."""
        comm, middle, start = self.matrix.layout.comm, self.matrix.layout.solid_count, problem.sections.strain
        trial, balance = unknowns.duplicate(), self.balance.duplicate()
        joints = self.matrix.operators.joints
        change = comm.allreduce(joints.change_at(start, strains, problem.sections), op=MPI.MIN)

        def at(fraction: float) -> None:
            trial.waxpy(-fraction, step, unknowns)
            self._evaluate(trial, balance, start + fraction * strains)

        def size(fraction: float) -> float:
            try:
                at(fraction)
            except NotConverged:  # the laws have no response there, on any rank
                return np.inf
            return float(balance.norm())

        def power(fraction: float) -> float:
            at(fraction)
            return float(comm.allreduce(float(balance.getArray()[:middle] @ step.getArray(readonly=True)[:middle])))

        try:
            if self.scene.method.line_search == "energy":
                return by_energy(power, power(0.0), change * (1.0 + JUST_PAST))
            return by_residual(size, size(0.0), change * (1.0 + JUST_PAST))
        finally:
            destroy(trial, balance)

    def _searches(self) -> bool:
        """Whether steps are shortened once statuses cycle, or full steps converge slowly."""
        return self.scene.method.line_search != "none" and not self.method.weakness and self.only != "flow"

    def _converged(self, snes: PETSc.SNES, iteration: int, norms: tuple[float, float, float]) -> int:
        problem, accuracy, reasons = self.problem, self.scene.accuracy, PETSc.SNES.ConvergedReason
        if self._refusals:
            return int(reasons.DIVERGED_FUNCTION_DOMAIN)
        self._out_of_balance.append(problem.residual.out_of_balance)
        problem.tried += iteration > 0
        sizes = problem.residual
        trial = problem.work.trial
        trial.iteration, trial.unbalanced = problem.tried, max(sizes.solid, sizes.flow, sizes.at_nodes)
        if iteration == 0:
            self._inner.begin()
        returns = self._inner.see(statuses(problem))
        # without a fluid the balance minimises an energy, and once searched for its minimum is; else a front of pressure opens
        # sections one after another, and whole steps follow it
        is_wet = problem.conduction is not None
        lets = is_wet and returns and self._searches() and self.holds and not problem.request.hold
        if lets and self._rounds.let_slide(problem, self._inner.changed[:, 0]):
            self._inner.begin()
        else:
            repeats, before = self._repeats(problem), self._circles
            self._searched = self._searched + 1 if before else 0
            self._is_endless = repeats and self._searched >= max(PERIODS)  # a search that helped would end elsewhere
            cycles = returns or repeats or (self._inner.still if is_wet else iteration) >= PATIENCE
            goes_on = before and not (is_wet and self._inner.is_new)
            self._circles = self._searches() and (cycles or goes_on)
        if not (self.holds or self._is_start):
            self._restless = problem.take_statuses(problem.sections)
        self._is_start = False
        is_balanced = self._balanced(problem, iteration)
        self._polished = self._polished + 1 if is_balanced else 0
        more = is_balanced and not self.only and iteration < accuracy.max_iterations and self._polishes(problem)
        if is_balanced and not more:
            return int(reasons.CONVERGED_FNORM_RELATIVE)
        if self._is_endless and not is_balanced:
            return int(reasons.DIVERGED_LINE_SEARCH)
        most = min(accuracy.max_iterations, problem.request.max_iterations or accuracy.max_iterations)
        return int(reasons.ITERATING if iteration < most else reasons.DIVERGED_MAX_IT)

    def _repeats(self, problem: StepProblem) -> bool:
        """Whether residuals repeat while every section keeps its status: the laws have more kinks than those."""
        if not self._inner.still:
            self._repetition.begin()
        residual = problem.residual
        return self._repetition.see(residual.solid, residual.flow)

    def _polishes(self, problem: StepProblem) -> bool:
        """Whether a balanced flow has one iteration more: the work of wells depends on its digits. Collective.

        More follow while its unaccounted energy is too large and still falls.
        """
        is_first, least, before = self._polished == 1, self.scene.accuracy.residual, self._unaccounted
        self._unaccounted = problem.unaccounted()
        falls = is_first or self._unaccounted < 0.5 * before
        is_small = is_first and problem.residual.carried > least  # beside that at full pressure
        return is_small or (self._unaccounted > least and falls)

    def _balanced(self, problem: StepProblem, iteration: int) -> bool:
        accuracy, residual = self.scene.accuracy, problem.residual
        worst = residual.flow if self.only else max(residual.flow, residual.at_nodes)
        flow = self.only == "solid" or worst <= accuracy.residual
        if self.only == "flow" or iteration < self.least:
            return flow and iteration >= self.least
        if self.scene.method.newton_test == "displacement":
            size = problem.displacement.norm()
            return flow and iteration > 0 and self._step <= accuracy.displacement * size
        if self.scene.method.newton_test == "out-of-balance" and accuracy.out_of_balance is not None:
            return flow and residual.out_of_balance < accuracy.out_of_balance
        return flow and residual.solid <= max(accuracy.residual, self.enough)

    def _failure(self, why: str, iterations: int) -> SolveError:
        problem, rounds = self.problem, self._rounds
        restless, flipped = all_changed(problem, self._restless, self._inner, rounds.seen)
        is_loose = self.only != "flow" and self._floats(problem, np.stack([restless | flipped, flipped], axis=1))
        if is_loose and problem.residual.solid <= SLACK * self.scene.accuracy.residual and self.floating is not None:
            why = describe_floating(self.scene, problem, self.floating, self._round_off(problem))
            return NotConverged(why, kind=FLOATING)
        loose = self.floating if is_loose else None
        changes = self.matrix.layout.comm.allreduce(bool((restless | flipped).any()), op=MPI.LOR)
        failure = StatusCycling if changes else NotConverged
        return failure(describe_failure(self.scene, problem, restless, flipped, why, iterations, loose))

    def destroy(self) -> None:
        """Free the solver. Collective."""
        if self.solver.getPC().getType() == "python":  # PETSc may keep a solver that broke until Python has ended
            self.solver.getPC().setType("none")
        destroy(self.factors, self.snes, self.solver, self.unknowns, self.balance)
