"""One step: its loads, its solver, its terms of the energy balance; and the state at the beginning of a stage."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fracflow._petsc import destroy, timed
from fracflow.advance.couplings import Couplings
from fracflow.advance.discontinuities import change, enter, keep_pace
from fracflow.advance.explicit import ExplicitSteps, ExplicitSubsteps
from fracflow.advance.network import FlowNetwork, StepBegin
from fracflow.advance.outcome import Advance, Log, Outcome
from fracflow.advance.slip_rate import creeps
from fracflow.advance.wells import TRIES_A_LIMIT, Trials, names_of, reached_after, reached_before, through, well_step
from fracflow.errors import NotConverged, SolveError
from fracflow.integrators import Alphas, Steady, Stepper, first, stepper_from
from fracflow.laws import LawStep
from fracflow.mesh.data import Bools
from fracflow.model.compressibility import brought, leaked, narrowing, room_between, stored, widening
from fracflow.model.energy import dissipated, update_balance, work_missed
from fracflow.model.energy_motion import Scheme
from fracflow.model.loads import Limit, Loads
from fracflow.model.setup import Model
from fracflow.model.state import PreviousStep, State, StepReport, Work
from fracflow.model.steep_weakening import refuse_jumps
from fracflow.model.well_volumes import volumes_after, volumes_at_jump
from fracflow.remarks import note
from fracflow.scene.boundary import Stage
from fracflow.scene.scene import Scene
from fracflow.solve.accept import accept, remember
from fracflow.solve.flow_round_off import check_digits
from fracflow.solve.problem import Guess, StepProblem
from fracflow.solve.request import StepRequest, StepRule, begins_anew, rule_of

Progress = Mapping[str, float]
NARROWS = 0.5  # of an aperture: where less is left after a step, its beginning does not predict its end
DONE: Progress = {"done": 1.0}


@dataclass(frozen=True)
class Trial:
    """A rejected step: its begin and length [time], and the reason."""

    time: float
    length: float
    why: str


@dataclass(frozen=True)
class Step:
    """A state worth recording, the stage it belongs to, and what it cost.

    progress  what the stage needs to go on from here; None where it cannot
    regime    the kind of step, where the stage chooses it; empty where that is the kind of the stage
    trial     a rejected trial from the state before, which is reported but not recorded; else None
    """

    state: State
    stage: int
    dt: float
    report: StepReport
    progress: Progress | None = None
    regime: str = ""
    trial: Trial | None = None


def stepper_of(scene: Scene, stage: Stage, regime: str = "") -> Stepper:
    """The integrator of a kind of stage, or of a regime of it; a stage auto begins without inertia."""
    method, kind = scene.method, regime or stage.kind
    if kind == "dynamic":
        return stepper_from(method.stepper, method)
    return stepper_from(method.flow_integrator, method) if kind in ("quasi-static", "auto") else Steady()


class Stepping:
    """Solvers of one model, kept between the steps that they make."""

    def __init__(self, model: Model, log: Log = lambda line: None) -> None:
        """Make the solvers that the stages need when they first need them; ``log`` takes lines about them."""
        self.model, self.log = model, log
        self.work = Work()  # of all steps and trials
        self.network = FlowNetwork(model, log)
        self.couplings = Couplings(model, log)
        self._network_version = 0
        self._at_rest: dict[Loads, Loads] = {}
        self._variants: dict[tuple[Loads, frozenset[Limit]], Loads] = {}
        self.explicit = ExplicitSteps(model, self.network, log)
        self.counts_volume = any(stage.kind == "auto" for stage in model.scene.stage)  # for the catalogue of events

    def closed(self, loads: Loads, stores: bool, begin: StepBegin) -> Loads:
        """The loads of a step with undrained components closed; solvers for components that exist no longer are freed."""
        found = self.network.close(loads, stores, begin)
        if self.network.version != self._network_version:
            self._network_version = self.network.version
            self.couplings.forget_closures()
        return found

    def by(self, stepper: Stepper) -> Advance:
        """The way to advance by one step of a rule."""
        return ExplicitSubsteps(self.explicit) if stepper.explicit else SingleStep(self, stepper)

    def step(self, state: State, request: StepRequest, stepper: Stepper) -> tuple[State, StepReport]:
        """One step by a rule, and what it cost. Raises SolveError, on every rank. Collective."""
        found = self.by(stepper).advance(state, request)
        return found.state, found.report

    def standing(self, loads: Loads) -> Loads:
        """The loads of a step without inertia."""
        is_same = not self.model.loads.has_resting and self.model.operators.damping is None
        if not is_same and loads not in self._at_rest:
            self._at_rest[loads] = loads.standing()
        return loads if is_same else self._at_rest[loads]

    def limited(self, loads: Loads, reached: frozenset[Limit]) -> Loads:
        """The loads with wells kept at the limits they have reached."""
        if reached and (loads, reached) not in self._variants:
            self._variants[loads, reached] = loads.at_limit(reached)
        return self._variants[loads, reached] if reached else loads

    def enter(self, state: State, stepper: Stepper, dt: float = 0.0) -> State:
        """A new state, as a stage takes it over; see ``advance.discontinuities``. Collective."""
        dt = self.explicit.part(stepper, dt)
        loads = self._limited_now(state)
        new = enter(self.model, self.network, loads, state, stepper, dt)
        if stepper.inertia and self.model.loads.limits:
            new, loads = self._with_limits(new, loads, state, stepper, dt)
        if new.uptake is None:
            return new
        ops, depth = self.model.operators, self.model.scene.flow_depth
        new = replace(new, volumes=volumes_at_jump(ops, loads, state, new, depth))
        if not self.counts_volume:
            return new
        jumped = stored(ops, room_between(ops, state, new), depth)
        return replace(new, injected=new.injected + jumped)  # where prescribed pressures of a compressible fluid jump

    def _with_limits(self, new: State, loads: Loads, state: State, stepper: Stepper, dt: float) -> tuple[State, Loads]:
        """The state as a stage with inertia takes it over, at whose first instant no limit is passed, and its loads."""
        model, reached = self.model, reached_before(self.model.loads, state)
        tried = {reached}
        rule = StepRule(Alphas(a4=-1.0), new.adjacent_steps, inertia=True)
        for _ in range(TRIES_A_LIMIT * len(model.loads.limits)):
            request = StepRequest(new.time, 0.0, new.controls, model.loads)
            problem = StepProblem(model.operators, new, replace(request, loads=loads), rule)
            problem.evaluate()
            reached = reached_after(problem, request, reached, new, model.scene.flow_depth)
            problem.destroy()
            if reached in tried:
                break
            tried.add(reached)
            new.destroy()
            loads = self.limited(model.loads, reached)
            new = replace(enter(model, self.network, loads, state, stepper, dt), **names_of(reached))
        return new, loads

    def change(self, state: State, leaving: Bools) -> State:
        """A new state at the same instant, where the friction of the sections (s,) has the other status. Collective."""
        return change(self.model, self.network, self._limited_now(state), state, leaving)

    def _limited_now(self, state: State) -> Loads:
        return self.limited(self.model.loads, reached_before(self.model.loads, state))

    def destroy(self) -> None:
        """Free the solvers. Collective."""
        destroy(self.couplings, self.explicit, self.network)


@dataclass(frozen=True)
class SingleStep:
    """One step by a rule, by the solvers of its model.

    A multistep integrator of flow carries walls on as they moved, through a fracture that pinches shut. It leaves them
    there, since nothing flows any more. Backward Euler stops them in time: it makes the steps in which one closes.
    """

    solvers: Stepping
    stepper: Stepper

    @timed("FracStep")
    def advance(self, state: State, request: StepRequest) -> Outcome:
        """The state at the end of the step. Raises SolveError, on every rank; ``state`` stays as it is. Collective."""
        solvers, stepper, ops = self.solvers, self.stepper, self.solvers.model.operators
        rule = first(stepper) if begins_anew(stepper, state.time, state.previous_step, request) else stepper
        keeps_pace = rule.inertia and rule.balance == "both" and ops.flow is not None and request.length > 0.0
        new, report = (self._keeping_pace if keeps_pace else self._by_rule)(rule, state, request)
        left = narrowing(ops, state, new) if rule.memory else 1.0
        if left < NARROWS:
            new.destroy()
            why = f"{max(left, 0.0):.2g} of an aperture would be left, below {NARROWS:g}"
            solvers.network.log(note(f"time {request.time:.6g}: {why}: this step goes by backward Euler"))
            rule = first(stepper)
            new, report = self._by_rule(rule, state, request)
        solvers.network.log_changes(request.time)
        if rule.storage and ops.flow is not None:
            report = replace(report, **widening(ops, request.loads, state, new)._asdict())
        return Outcome(new, report, request.end)

    def _keeping_pace(self, rule: Stepper, state: State, request: StepRequest) -> tuple[State, StepReport]:
        """The step from a state whose walls keep pace with the wells, for rules that use the previous acceleration.

        It is begun as if wells stayed at their limits, and once again where some do not. See ``keep_pace``.
        """
        solvers, new, report = self.solvers, state, StepReport()
        for _ in range(2):
            solvers.network.update(state)
            limited = solvers.limited(request.loads, reached_before(request.loads, new))
            begun = keep_pace(solvers.model, solvers.network, state, replace(request, loads=limited), rule)
            if new is not state:
                if begun is None:
                    break
                new.destroy()
            try:
                new, again = self._by_rule(rule, begun or state, request)
            finally:
                destroy(begun)
            report = again.after(report)
            kept, stay = set(new.wells_at_limit), {*new.wells_at_limit, *new.wells_shut}
            if kept.issuperset(state.wells_at_limit) and stay.issuperset(state.wells_shut):
                break
        return new, report

    def _by_rule(self, stepper: Stepper, state: State, request: StepRequest) -> tuple[State, StepReport]:
        """The step by one rule, solved until the wells at limits and the closed components are those of its end."""
        solvers, ops, network = self.solvers, self.solvers.model.operators, self.solvers.network
        loads = request.loads if stepper.inertia else solvers.standing(request.loads)
        request = replace(request, loads=loads)
        rule = rule_of(stepper, state, request, self.stepper)
        trials, begin = Trials(loads, state), StepBegin(state, rule.alphas)
        if ops.flow is not None:
            network.update(state)
        trial = self._foreseen(rule, state, request)
        for reached in trials:
            limited = solvers.limited(loads, reached)
            asked = replace(request, loads=solvers.closed(limited, stepper.storage, begin))
            problem = StepProblem(ops, state, asked, rule, trial, solvers.work)
            try:
                report = solvers.couplings.of(asked.loads).solve(problem)
                new = accept(problem, state.energy)
                digits, is_same, full = self._checked(problem, new, limited, stepper.storage, begin)
                trial = None if is_same else problem.initial_guess()
            except NotConverged as error:
                trials.fails(error, problem.tried)
                if self._is_closed(problem, limited, stepper.storage, begin):
                    full = network.overfull(limited, stepper.storage, problem)
                    if not full:
                        raise
                    trials.reached |= full
                trial = problem.initial_guess()
                continue
            finally:
                problem.destroy()
                solvers.work.trial.unbalanced = np.inf
            depth = solvers.model.scene.flow_depth
            now = full | (reached_after(problem, request, reached, new, depth) if loads.limits else reached)
            if trials.agrees(now, is_same, report.newton):
                totals = self._totals(stepper, problem, replace(request, loads=limited), now, new)
                missed = self._missed(state, new) if rule.inertia else 0.0
                return replace(new, **totals), replace(report, digits=digits, missed=missed)
            new.destroy()
        trials.refuse(request.time)

    def _missed(self, state: State, new: State) -> float:
        """Work that friction of all sections misses in a step [energy per thickness]. Collective."""
        joints, comm = self.solvers.model.operators.joints, self.solvers.model.operators.layout.comm
        return float(comm.allreduce(work_missed(joints.weights, state.sections, new.sections)))

    def _foreseen(self, rule: StepRule, state: State, request: StepRequest) -> Guess | None:
        """Motion and pressures to begin from: as the last step moved, where friction has a state; else None.

        Friction grows with the logarithm of the rate. From rest Newton's method needs some iterations for each decade of it.
        With inertia walls that went on at their velocities could end on another branch of friction that turns.
        """
        before = state.previous_step.velocity
        if before is None or rule.inertia or not creeps(self.solvers.model):
            return None
        return before.getArray(readonly=True) * request.length, state.pressure.getArray().copy()

    def _checked(
        self, problem: StepProblem, new: State, loads: Loads, stores: bool, begin: StepBegin
    ) -> tuple[float, bool, frozenset[Limit]]:
        """Digits of a solved state, whether it has the components it was solved with, and limits that wells come to there.

        Raises SolveError, on every rank, where it may not stand; it is freed then. Collective.
        """
        network, model = self.solvers.network, self.solvers.model
        try:
            refuse_jumps(model.operators.blocks, model.operators.joints, problem.state.sections, new.sections, new.time)
            digits = check_digits(problem, new, model.scene.accuracy.digits, network.log_digits)
            is_same = self._is_closed(problem, loads, stores, begin)
            return digits, is_same, network.overfull(loads, stores, problem) if is_same else frozenset()
        except SolveError:
            new.destroy()
            raise

    def _is_closed(self, problem: StepProblem, loads: Loads, stores: bool, begin: StepBegin) -> bool:
        """Whether a solved or failed trial still has the network components that it was solved with. Collective."""
        if problem.conduction is None:
            return True
        self.solvers.network.check(problem.conduction)
        return self.solvers.network.close(loads, stores, begin) is problem.loads

    def _totals(
        self, stepper: Stepper, problem: StepProblem, request: StepRequest, reached: frozenset[Limit], new: State
    ) -> dict[str, Any]:
        """Members of a solved state that go on from step to step: energies, volumes, dissipation, and the step itself."""
        model, state, rule, dt = self.solvers.model, problem.state, problem.rule, request.length
        ops, loads, depth = model.operators, request.loads, model.scene.flow_depth
        weighs = rule.alphas if rule.inertia else None
        scheme = Scheme(rule.inertia, stepper.storage, stepper.balance, weighs, loads.held)
        memory, follows = PreviousStep(), self.stepper.memory
        means = through(request, rule, reached, state, new, depth) if follows else {}
        wells = well_step(request, rule, means, state.time, stepper.storage, depth)
        room = room_between(ops, state, new) if ops.flow is not None else np.zeros(0)
        volumes, kept = volumes_after(ops, wells, state, new, room, dt, scheme)
        if follows or (dt > 0.0 and not rule.inertia and creeps(model)):
            memory = remember(ops, state, new, dt, {**kept, **means})
        lost = leaked(ops, state, new, dt, scheme, depth) if ops.flow is not None else {}
        pumps = self.solvers.counts_volume
        sent = ops.joints.radiated(state.sections, new.sections, LawStep(new.time, dt, rule.inertia))
        return {
            "energy": update_balance(ops, state, new, dt, scheme),
            **names_of(reached),
            "friction": state.friction + dissipated(state.sections, new.sections) - sent,
            "injected": state.injected + (brought(ops, loads, state, new, room, dt, scheme, depth) if pumps else 0.0),
            "left": {name: state.left.get(name, 0.0) + value for name, value in lost.items()},
            "volumes": volumes,
            "previous_step": memory,
            "adjacent_steps": rule.adjacent,
        }
