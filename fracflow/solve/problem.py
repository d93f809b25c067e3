"""(4.2), (4.6) The two balances of one step as residuals of trial displacements and pressures.

solid  M a + K_s u + F_s(sigma_0) + G' W f(G u) - B p + C v - R = 0, K_s and C with those of terms
flow   B_F' v + x' + K_F(u) p - Q = 0, x = d (exp(c_f (p - p0)) - 1) L/2 of a compressible fluid, lumped: with the rule of the
       walls, only inflow and outflow change the fluid in a component
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cached_property

import numpy as np

from fracflow._petsc import PETSc, destroy, sum_over_ranks, timed
from fracflow.errors import NotConverged
from fracflow.integrators import acceleration, velocity
from fracflow.laws import LawStep
from fracflow.mesh.data import Bools, Floats, Ints
from fracflow.model.balance import static_balance_of
from fracflow.model.compressibility import compression_of, lost, uptake_at, why_not_finite
from fracflow.model.flow import Conduction
from fracflow.model.operators import Operators
from fracflow.model.state import MotionValues, Sections, State, Work
from fracflow.model.terms.term import TermStep
from fracflow.solve.motion_terms import Driven, MovingTerms, TermsOfStep, Unapplied, driven_by, volumes_beside_rates
from fracflow.solve.request import StepRequest, StepRule
from fracflow.solve.residual import (
    CANCELLATION,
    LEAST_FORCE,
    NOISE,
    TINY,
    UNIT_ROUND_OFF,
    Residual,
    flow_residual,
    flow_sizes,
    largest,
    largest_of,
    over_ranks,
    round_off_here,
    round_off_of_flow,
    round_off_of_jumps,
    round_off_of_rock,
    round_off_of_uptake,
    round_off_of_volumes,
)
from fracflow.solve.statuses import Statuses

SOLVED = 1e-10  # of the terms of the balance at a node: the solver leaves less
HUGE = 1e150  # a volume rate: squares of larger ones overflow
BLURRED = 1e-11  # of the largest term, and of a gap: round-off of jumps from which on strains are followed
SAME_TRIAL = 32.0  # round-offs of a jump by which followed strains may be off it
Guess = tuple[Floats, Floats]  # this rank's motion (n,) since the state, and pressures (m,)


class StepProblem:
    """One step from ``state``: what is given, and the balances at a trial. Writes nothing into the state."""

    def __init__(
        self,
        operators: Operators,
        state: State,
        request: StepRequest,
        rule: StepRule,
        start: Guess | None = None,
        work: Work | None = None,
    ) -> None:
        """Sample loads and wells over the step, under loads whose parts that nothing drains are closed. Collective.

        start    this rank's motion since the state, and pressures, to begin from
        work     in which its evaluations are counted
        """
        self.operators, self.state, self.request, self.rule, layout = operators, state, request, rule, operators.layout
        self.loads, self.alphas, self.time, self.controls = request.loads, rule.alphas, request.time, request.controls
        self.work = work or Work()
        self.tried, self.load, self.source = 0, layout.solid_vector(), layout.flow_vector()
        loads, time, controls, unapplied, rates = self.loads, self.time, self.controls, request.unapplied, rule.rates
        loads.force(time, controls, self.load, rule.adjacent, rates if rates is not None and rates.of_forces else None)
        if request.restraint is not None:
            self.load.axpy(1.0, request.restraint)
        loads.source(time, controls, self.source, rule.adjacent, rates)
        of_wells = rule.alphas.a1 == 0.0
        self.lag = Unapplied.of(loads, state, unapplied, of_wells, self.load, self.source) if unapplied else Unapplied()
        self.terms = TermsOfStep.of(operators, loads, state.forces.anchor, time, rule.adjacent, self.load)
        before = static_balance_of(operators, state) if rule.alphas.balance_old else None
        self.moving = MovingTerms(operators.mass, rule.alphas, self.terms, state.motion.acceleration, before)
        self.displacement, self.increment = state.motion.displacement.copy(), layout.solid_vector()
        self._known, self._is_blurred = state.sections.strain, False
        self._is_followed: Bools | None = None  # None where no strain is
        self.pressure = state.pressure.copy()
        self.begin_again(start)
        self.sections = state.sections
        self.solid_balance, self.flow_balance = layout.solid_vector(), layout.flow_vector()
        self.residual = Residual(np.inf, np.inf, np.inf)
        self.fluid_before = None if operators.flow is None else compression_of(operators, state)
        self.conduction: Conduction | None = None
        self.taken_up: Floats | None = None
        self._flow_rows: Floats | None = None
        self._flow_noise, self._carried = np.zeros(0), 0.0
        self._scale: float | None = None  # of flows, as the present conductances have it
        self._before = 0.0 if operators.flow is None else np.abs(operators.flow.driving(state.pressure))

    @cached_property
    def _prescribed(self) -> tuple[tuple[Ints, Floats], tuple[Ints, Floats]]:
        """Local numbers (n,) and values (n,) of what is prescribed at the end of the step: displacements, pressures."""
        displacement, pressure, loads = self.displacement.copy(), self.pressure.copy(), self.loads
        loads.impose(self.time, displacement, pressure, self.rule.adjacent, self.rule.rates)
        found = []
        for vector, parts, lags, rests in (
            (
                displacement,
                () if self.rule.is_instant else loads.supports,
                self.lag.displacement,
                loads.resting if loads.at_rest else loads.resting[:0],
            ),
            (pressure, loads.pressures, self.lag.pressure, loads.resting[:0]),
        ):
            values = vector.getArray()
            for part, lag in zip(parts, lags, strict=False):
                values[part.numbers] += lag
            if len(rests):
                values[rests] = self.state.motion.displacement.getArray(readonly=True)[rests]
            numbers = np.concatenate([rests, *(part.numbers for part in parts)])
            found.append((numbers, values[numbers]))
        destroy(displacement, pressure)
        return found[0], found[1]

    def move(self, increment: Floats, strain: Floats | None = None) -> None:
        """Set the trial by the motion (n,) of this rank's unknowns since the last state, but for the prescribed.

        strain  (s, dim) of the sections there, followed from the last trial; None to keep those that are known

        A nearly closed joint has a gap that is less than the round-off of how far both its walls have moved. The changes from
        one iterate to the next are small, and so is their round-off.
        """
        if strain is not None:
            self._known = strain
        old, held = self.state.motion.displacement.getArray(readonly=True), self.loads.held
        self.increment.setArray(increment)
        self.displacement.setArray(old + increment)
        for vector, (numbers, values) in zip((self.displacement, self.pressure), self._prescribed, strict=True):
            vector.getArray()[numbers] = values
        change, new = self.increment.getArray(), self.displacement.getArray(readonly=True)
        change[held] = new[held] - old[held]

    def begin_again(self, start: Guess | None = None) -> None:
        """Put the trial to where the step starts, or to a motion (n,) and pressures (m,), with its statuses. Collective."""
        motion, pressure = start or (
            np.zeros(self.operators.layout.solid_count),
            self.state.pressure.getArray(readonly=True),
        )
        self.trial_status, self._refused = Statuses.of(self.state.sections)
        self.pressure.setArray(pressure)
        self.move(motion)

    @cached_property
    def _largest_given(self) -> float:
        """The largest on this rank of the terms that no trial changes: loads and initial stress [force per thickness]."""
        return max(largest(self.load), largest(self.operators.prestress))

    @timed("FracEvaluate")
    def evaluate(self, hold: bool = True) -> None:
        """Balances at the present trial. Sections keep ``trial_status``, or with ``hold`` False may leave it once.

        Collective.
        """
        ops, u, p = self.operators, self.displacement, self.pressure
        self.work.evaluations += 1
        self._take(self.evaluate_joints(self._strain(), hold))
        solid, terms = self.solid_balance, [self._largest_given]
        solid.set(0.0)
        term = solid.duplicate()

        def add(scale: float) -> None:
            terms.append(largest(term))
            solid.axpy(scale, term)

        acceleration, speed = self.acceleration(), self.velocity()
        terms += self.moving.add(acceleration, speed, u, solid)
        ops.rock_force(u, term)
        add(1.0)
        solid.axpy(1.0, ops.prestress)
        term.set(0.0)
        ops.joints.force(self.sections.traction, term)
        add(1.0)
        flow_terms = [0.0]
        if ops.flow is not None:
            ops.flow.pressure_load.mult(p, term)
            add(-1.0)
            flow_terms = self._flow_balance(speed)
        solid.axpy(-1.0, self.load)
        destroy(acceleration, speed, term)
        self.loads.release(solid)
        for part in self.loads.pressures:
            self.flow_balance.getArray()[part.numbers] = 0.0
        self._measure(max(terms), max(flow_terms))

    def _strain(self) -> Floats:
        """Strains (s, dim) of the trial; those that are followed where a gap has few digits otherwise. Collective."""
        # jumps of this step added to those of the last state: a common motion of walls costs no digits afterwards
        strain = self.state.sections.strain + self.operators.joints.strain(self.increment)
        self._is_followed = None
        if self._is_blurred:
            joints, slack = self.operators.joints, UNIT_ROUND_OFF * self.operators.joints.moved(self.increment)
            is_narrow = slack[:, -1] > BLURRED * joints.may_close(self._known, self.state.sections)
            self._is_followed = is_narrow[:, None] & (np.abs(self._known - strain) <= SAME_TRIAL * slack)
            strain = np.where(self._is_followed, self._known, strain)
        self._known = strain
        return strain

    @timed("FracLaws")
    def evaluate_joints(self, strain: Floats, hold: bool = True) -> Sections:
        """(2.10b) Response of the sections to strains (s, dim), from their last accepted history with the present statuses."""
        return self.operators.joints.evaluate(strain, self.trial_status, self.law_step(hold))

    def law_step(self, hold: bool = True) -> LawStep:
        """The ``LawStep`` of this step: its length, since the history of the sections was accepted."""
        return LawStep(self.time, self.time - self.state.time, self.alphas.a0 > 0.0, hold)

    def term_step(self) -> TermStep:
        """The same for terms with a memory."""
        return TermStep(self.state.memory, self.alphas, self.time - self.state.time)

    def _take(self, answer: Sections) -> None:
        """Take the response of the sections to the present motion."""
        self.sections, self._moved = answer, self.operators.joints.moved(self.increment)
        self._rounded = self._moved
        if self._is_followed is not None:
            self._rounded = np.where(self._is_followed, np.abs(answer.strain), self._moved)

    def recorded(self) -> Sections:
        """The sections of the trial, as last evaluated, with the largest tractions and the round-off since the start."""
        before, now = self.state.sections, self.sections
        record = np.maximum(before.record, np.linalg.norm(now.traction, axis=1))
        blur = before.blur if self._is_followed is None else np.where(self._is_followed, 0.0, before.blur)
        return replace(now, blur=round_off_of_jumps(blur, self._rounded), record=record)

    # On arrays: sums of Vecs leave their parts to a collection that comes at the end of the run. Store the motion of
    # this step as the trial, and zero as the last state: both have more digits so.
    @cached_property
    def _start(self) -> MotionValues:
        old = self.state.motion.values()
        return MotionValues(np.zeros_like(old.displacement), old.velocity.copy(), old.acceleration.copy())

    def acceleration(self) -> PETSc.Vec:
        """(4.2e) Acceleration of the trial, in a new vector. Collective."""
        moved, result = self.increment.getArray(readonly=True), self.displacement.duplicate()
        result.setArray(acceleration(self.alphas, moved, self._start))
        for each in self._driven:
            result.getArray()[each.numbers] = each.acceleration
        return result

    def velocity(self) -> PETSc.Vec:
        """(4.2f) Velocity of the trial, in a new vector. Collective."""
        before, result = self.state.previous_step.velocity, self.displacement.duplicate()
        mean = 0.0 if before is None else before.getArray(readonly=True)
        result.setArray(velocity(self.alphas, self.increment.getArray(readonly=True), self._start, mean))
        for each in self._driven:
            result.getArray()[each.numbers] = each.speed
        return result

    @cached_property
    def _driven(self) -> list[Driven]:
        return driven_by(self.loads, self.state, self.rule, self.time)

    @cached_property
    def _unrated(self) -> Floats:
        return volumes_beside_rates(self.operators, self._driven)

    def uptake(self) -> PETSc.Vec | None:
        """Rate at which compression takes up fluid at the trial, in a new vector; None where it stores none."""
        if self.taken_up is None:
            return None
        result = self.operators.layout.flow_vector()
        result.setArray(self.taken_up)
        return result

    @timed("FracFlow")
    def _flow_balance(self, speed: PETSc.Vec) -> list[float]:
        flow, network = self.flow_balance, self.operators.flow
        assert network is not None
        size = CANCELLATION * self.alphas.a1 * np.abs(network.swept(self.displacement))
        terms, rows = [largest_of(size), largest(self.source)], size + np.abs(self.source.getArray(readonly=True))
        network.storage_coupling.multTranspose(speed, flow)
        terms.append(largest(flow))
        rows += np.abs(flow.getArray())
        stored = None if self.loads.summed is None else flow.getArray() - self.source.getArray(readonly=True)
        walls = self.operators.joints.walls(self.sections, network.law, self.law_step())
        self.conduction = network.conduct(self.displacement, self.pressure, walls, self.term_step())
        self._scale = None
        self.flow_scale()  # which refuses a trial that has none
        network.outflow(self.conduction, flow)
        flow.axpy(-1.0, self.source)
        before, now = self.fluid_before, self.conduction.compression
        if before is not None:
            self.taken_up = uptake_at(self.operators, self.state, self.alphas, before, now, self._unrated)
        if self.taken_up is not None:
            flow.getArray()[:] += self.taken_up
            rows += np.abs(self.taken_up)
            terms.append(largest_of(self.taken_up))
        if self.conduction.leaving is not None:
            leaving = network.at_nodes(np.abs(self.conduction.leaving.rate))
            rows += leaving
            terms.append(largest_of(leaving))
        self._close()
        through, runs = flow_sizes(self.conduction, self._before, self.state.max_overpressure, self.alphas.b1)
        self._carried = max(*terms, runs)
        moved = self.operators.joints.openings(self._moved)
        self._flow_noise = network.at_nodes(round_off_of_flow(network, self.conduction, moved, self.alphas.a1))
        self._flow_rows = rows + network.at_nodes(through)
        if stored is not None:
            self._sum(stored, rows, moved)
        return [*terms, float(through.max(initial=0.0))]

    def _close(self) -> None:
        """In place of the balance at a node of each undrained component: its volume, or its level, is kept."""
        assert self.conduction is not None
        change = self.pressure.getArray(readonly=True) - self.state.pressure.getArray(readonly=True)
        trial = (self.increment, change, self.fluid_before, self.conduction.compression)
        for closure in self.loads.closures:
            self.flow_balance.getArray()[closure.row] = self.flow_scale() * lost(self.operators, closure, *trial)

    def _sum(self, stored: Floats, rows: Floats, moved: Floats | None) -> None:
        """In place of the balance at each root its component's: what is ``stored`` (n,) of the inflow, without conduction.

        rows (n,) sizes of its terms; moved as for ``round_off_of_flow``. Flow within the component has no part in it, nor
        in its round-off. Flow from one component to another has. Collective.
        """
        summed, network, rate = self.loads.summed, self.operators.network, self.alphas.a1 / self.flow_scale()
        assert summed is not None and self.conduction is not None
        known = round_off_of_uptake(network, self.fluid_before, self.conduction, self.alphas.b1)
        known += NOISE * UNIT_ROUND_OFF * rows
        if moved is not None:
            known += network.at_nodes(round_off_of_volumes(network, moved, self.alphas.a1))
        taken = stored if self.taken_up is None else stored + self.taken_up
        if self.conduction.leaving is not None:  # at a given rate, which settles no pressure
            taken = taken + network.at_nodes(self.conduction.leaving.rate)
        passed, between = self.operators.layout.flow_vector(), summed.between(self.conduction)
        known += network.at_nodes(round_off_of_flow(network, between, moved, 0.0))
        network.outflow(between, passed)
        taken = taken + passed.getArray(readonly=True)
        passed.destroy()
        roots = summed.roots
        kept = self.flow_balance.getArray(), self._flow_noise, self._flow_rows
        for values, of_storage in zip(kept, (taken, known, rows), strict=True):
            values[roots] = summed.with_sums(of_storage, rate)[roots]

    def _measure(self, solid_terms: float, flow_terms: float) -> None:
        """Residuals from this rank's largest terms: one reduction for all of them, since ranks wait at each."""
        scales, comm = self.operators.scales, self.operators.layout.comm
        of_jumps = round_off_here(self.operators, self.sections, self._moved)
        of_strains = of_jumps
        if self._rounded is not self._moved:
            of_strains = round_off_here(self.operators, self.sections, self._rounded)
        balance = self.flow_balance.getArray(readonly=True)
        balance = np.where(np.abs(balance) <= self._flow_noise, 0.0, balance)
        here = [largest(self.solid_balance), solid_terms, largest_of(balance), flow_terms]
        here += [of_jumps, of_strains, largest(self.displacement), largest(self.increment)]
        here += [float(np.max(self._flow_noise, initial=0.0)), self._carried]
        solid, solid_terms, flow, flow_terms, of_jumps, of_strains, moved, by, hidden, carried = over_ranks(here, comm)
        noise = of_strains + round_off_of_rock(self.operators, max(moved, by))
        size = max(solid_terms, LEAST_FORCE * scales.force)
        self._is_blurred = of_jumps > BLURRED * size
        solid, noise = max(solid - noise, 0.0) / size, noise / size
        least, flow_terms = flow / max(carried, TINY), max(flow_terms, TINY)
        flow, noise = flow / flow_terms, max(noise, hidden / flow_terms)
        rows = self._flow_rows
        if rows is not None:
            own, rows = rows, rows + CANCELLATION * self.alphas.a1 * scales.length * moved
            if self.loads.summed is not None:
                rows[self.loads.summed.roots] = own[self.loads.summed.roots]
        at_nodes = flow_residual(balance, rows, flow_terms, (closure.row for closure in self.loads.closures), comm)
        self.residual = Residual(solid, flow, self.solid_balance.norm(PETSc.NormType.NORM_2), at_nodes, noise, least)
        if not np.isfinite(solid + flow):
            raise self._not_finite()

    def _not_finite(self) -> NotConverged:
        """The refusal of a trial that has no finite balance. Collective."""
        return NotConverged(
            f"time {self.time:.6g}: {why_not_finite(self.operators, self.conduction)}", kind="not finite"
        )

    def unaccounted(self) -> float:
        """Energy that the imbalance of the flow adds in this step, over the largest of the energy balance. Collective.

        Along a wide fracture flows are round-off of its pressure, and hide that the inflow of the whole of it is not balanced.
        In a step that takes no time it is the power, over that of the flow.
        """
        if self.conduction is None:
            return 0.0
        assert self.operators.flow is not None
        dt, driving = self.time - self.state.time, self.pressure.getArray() - self.operators.flow.resting.getArray()
        spent = self.conduction.conductance @ np.ptp(self.conduction.pressure, axis=1) ** 2
        brought = np.abs(self.source.getArray(readonly=True)) @ np.abs(driving)
        here = np.array([self.flow_left() @ driving, spent + brought])
        missed, power = sum_over_ranks(here, self.operators.layout.comm)
        energies, span = (self.state.energy.values(), abs(dt)) if dt else ((), 1.0)
        return span * abs(float(missed)) / max([span * float(power), *map(abs, energies), TINY])

    def flow_left(self) -> Floats:
        """Imbalance (q,) of the flow at this rank's nodes, with no sums of several [volume rate per thickness]. Collective."""
        left = self.flow_balance.getArray(readonly=True)
        if self.loads.summed is None:
            return left
        return self.loads.summed.without_sums(left, self.alphas.a1 / self.flow_scale())

    def flow_scale(self) -> float:
        """Size of a volume rate, by which rows of the flow are divided. Raises NotConverged if there is none. Collective."""
        if self.conduction is None:
            return 1.0
        if self._scale is None:
            stored, scales = self.conduction.compression, self.operators.scales
            held = 0.0 if stored is None else float(stored.weight.max(initial=0.0))
            here = [largest_of(self.conduction.conductance), held]
            conducts, holds = over_ranks(here, self.operators.layout.comm)
            scale = max(self.alphas.a1 * scales.length * scales.displacement, conducts * scales.pressure)
            scale = max(scale, self.alphas.b1 * holds * scales.pressure)
            if not scale < HUGE:
                raise self._not_finite()
            self._scale = 2.0 ** round(math.log2(scale)) if scale > 0.0 else 1.0
        return self._scale

    def undetermined(self, nodes: Ints) -> float:
        """Part of what nodes (n,) of this rank draw that is round-off, or left by the solver [volume rate per thickness]."""
        if self._flow_rows is None:
            return 0.0
        return float(self._flow_noise[nodes].sum() + SOLVED * self._flow_rows[nodes].sum())

    def change_statuses(self) -> np.ndarray:
        """Give every section that has left its status the next one; return which (s,) of this rank did."""
        return self.take_statuses(self.evaluate_joints(self.sections.strain, hold=False))

    def take_statuses(self, found: Sections) -> np.ndarray:
        """Give every section its status as ``found``; return which (s,) of this rank had another before."""
        now, before = Statuses(self.trial_status, self._refused), self.state.sections.history
        (self.trial_status, self._refused), changed = now.after(self.operators.joints, before, self.sections, found)
        return changed

    def initial_guess(self) -> Guess | None:
        """This rank's motion (n,) and pressures (m,) for another problem to start from; None if not finite. Collective."""
        if not np.isfinite(self.increment.norm() + self.pressure.norm()):
            return None
        return self.increment.getArray().copy(), self.pressure.getArray().copy()

    def destroy(self) -> None:
        """Free the vectors of the trial."""
        destroy(self.load, self.source, self.displacement, self.increment, self.pressure)
        destroy(self.solid_balance, self.flow_balance, self.moving)
