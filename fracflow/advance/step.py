"""One step: its loads, its solver, its terms of the energy balance; and the state at the beginning of a stage."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from fracflow.advance.couplings import Couplings
from fracflow.advance.discontinuities import change, enter, keep_pace
from fracflow.advance.explicit import ExplicitSteps, ExplicitSubsteps
from fracflow.advance.network import FlowNetwork
from fracflow.advance.outcome import Advance, Log, Outcome
from fracflow.advance.sampling import begins_anew, rule_of
from fracflow.advance.wells import reached_after, reached_before, refuse_cycle, through, well_step
from fracflow.errors import NotConverged, SolveError
from fracflow.integrators import Steady, Stepper, first, stepper_from
from fracflow.mesh.data import Bools, Floats
from fracflow.model.compressibility import brought, leaked, narrowing, stored, widening
from fracflow.model.energy import dissipated, update_balance
from fracflow.model.energy_motion import Scheme
from fracflow.model.joints import refuse_jumps
from fracflow.model.loads import Limit, Loads
from fracflow.model.setup import Model
from fracflow.model.state import PreviousStep, State, StepReport
from fracflow.model.well_volumes import volumes_after, volumes_at_jump
from fracflow.scene.boundary import Stage
from fracflow.scene.scene import Scene
from fracflow.solve.accept import accept, remember
from fracflow.solve.explicit import ExplicitProblem
from fracflow.solve.flow_round_off import check_digits
from fracflow.solve.problem import StepProblem
from fracflow.solve.request import StepRequest

Progress = Mapping[str, float]
NARROWS = 0.5  # of an aperture: where less is left after a step, its beginning does not predict its end
MOST_TRIES = 4  # of a step whose wells reach limits, or whose elements pinch shut
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
        self.network = FlowNetwork(model, log)
        self.couplings = Couplings(model, log)
        self._network_version = 0
        self._at_rest: dict[Loads, Loads] = {}
        self._variants: dict[tuple[Loads, frozenset[Limit]], Loads] = {}
        self.explicit = ExplicitSteps(model, log)
        self.counts_volume = any(stage.kind == "auto" for stage in model.scene.stage)  # for the catalogue of events

    def closed(self, loads: Loads, stores: bool) -> Loads:
        """The loads with undrained components closed; solvers for components that exist no longer are freed."""
        found = self.network.close(loads, stores)
        if self.network.version != self._network_version:
            self._network_version = self.network.version
            self.couplings.forget_closures()
        return found

    def by(self, stepper: Stepper) -> Advance:
        """The way to advance by one step of a rule."""
        single = SingleStep(self, stepper)
        return ExplicitSubsteps(single, self.explicit) if stepper.explicit else single

    def step(self, state: State, request: StepRequest, stepper: Stepper) -> tuple[State, StepReport]:
        """One step by a rule, and what it cost. Raises SolveError, on every rank. Collective."""
        found = self.by(stepper).advance(state, request)
        return found.state, found.report

    def standing(self, loads: Loads) -> Loads:
        """The loads of a step without inertia."""
        if not len(self.model.loads.fixed_resting) and self.model.operators.damping is None:
            return loads
        if loads not in self._at_rest:
            self._at_rest[loads] = loads.standing()
        return self._at_rest[loads]

    def limited(self, loads: Loads, reached: frozenset[Limit]) -> Loads:
        """The loads with wells kept at the limits they have reached."""
        key = (loads, reached)
        if reached and key not in self._variants:
            self._variants[key] = loads.at_limit(reached)
        return self._variants[key] if reached else loads

    def enter(self, state: State, stepper: Stepper, dt: float = 0.0) -> State:
        """A new state, as a stage takes it over; see ``advance.discontinuities``. Collective."""
        dt = self.explicit.part(stepper, dt)
        new = enter(self.model, self.network, self._limited_now(state), state, stepper, dt)
        if new.uptake is None:
            return new
        fluid = self.model.scene.fluid
        depth = fluid.flow_depth if fluid is not None else 1.0
        new = replace(new, volumes=volumes_at_jump(self.model.operators, self._limited_now(state), state, new, depth))
        if not self.counts_volume:
            return new
        jumped = stored(self.model.operators, state, new, depth)
        return replace(new, injected=new.injected + jumped)  # where prescribed pressures of a compressible fluid jump

    def change(self, state: State, leaving: Bools) -> State:
        """A new state at the same instant, where the friction of the sections (s,) has the other status. Collective."""
        return change(self.model, self.network, self._limited_now(state), state, leaving)

    def _limited_now(self, state: State) -> Loads:
        return self.limited(self.model.loads, reached_before(self.model.loads, state))

    def destroy(self) -> None:
        """Free the solvers. Collective."""
        self.couplings.destroy()
        self.explicit.destroy()
        self.network.destroy()


@dataclass(frozen=True)
class SingleStep:
    """One step by a rule, by the solvers of its model.

    A multistep integrator of flow carries walls on as they moved, through a fracture that pinches shut. It leaves them
    there, since nothing flows any more. Backward Euler stops them in time: it makes the steps in which one closes.
    """

    solvers: Stepping
    stepper: Stepper

    def advance(self, state: State, request: StepRequest) -> Outcome:
        """The state at the end of the step. Raises SolveError, on every rank; ``state`` stays as it is. Collective."""
        solvers, stepper, time = self.solvers, self.stepper, request.time
        rule = first(stepper) if begins_anew(stepper, state, request) else stepper
        begun = self._begun(rule, state, state, request)
        try:
            new, report = self._solve(rule, begun or state, request)
        finally:
            if begun is not None:
                begun.destroy()
        if set(state.wells_at_limit) - set(
            new.wells_at_limit
        ):  # the step was begun as if these wells stayed at their limits
            begun = self._begun(rule, state, new, request)
            if begun is not None:
                new.destroy()
                try:
                    new, again = self._solve(rule, begun, request)
                finally:
                    begun.destroy()
                report = again.after(report)
        left = narrowing(solvers.model.operators, state, new) if rule.memory else 1.0
        if left < NARROWS:
            new.destroy()
            what = f"{max(left, 0.0):.2g} of an aperture would be left, below {NARROWS:g}"
            solvers.network.log(f"time {time:.6g}: {what}: this step goes by backward Euler")
            rule = first(stepper)
            new, report = self._solve(rule, state, request)
        solvers.network.tell(time)
        if rule.storage:
            grown, where = widening(solvers.model.operators, state, new)
            report = replace(report, widening=grown, widest=where)
        return Outcome(new, report, request.end)

    def _begun(self, rule: Stepper, state: State, limits: State, request: StepRequest) -> State | None:
        """The state from which a step starts, if another; for rules that use the previous acceleration. See ``keep_pace``.

        limits  the state whose wells at their limits stay there
        """
        if (
            not rule.inertia
            or rule.balance != "both"
            or self.solvers.model.operators.flow is None
            or request.length == 0.0
        ):
            return None
        self.solvers.network.update(state)
        limited = self.solvers.limited(request.loads, reached_before(request.loads, limits))
        return keep_pace(self.solvers.model, self.solvers.network, state, replace(request, loads=limited), rule)

    def _solve(self, stepper: Stepper, state: State, request: StepRequest) -> tuple[State, StepReport]:
        """The same by one rule, with the loads of wells at limits and of closed components of the network."""
        solvers, follows = self.solvers, self.stepper
        if not stepper.inertia:
            request = replace(request, loads=solvers.standing(request.loads))
        dt, loads, ops = request.length, request.loads, solvers.model.operators
        rule = rule_of(stepper, state, request, follows)
        explicit = solvers.explicit.coupling if stepper.explicit else None
        weighs = rule.alphas if rule.inertia and explicit is None else None
        scheme = Scheme(rule.inertia, stepper.storage, stepper.balance, weighs, loads.held)
        fluid, reached = solvers.model.scene.fluid, reached_before(loads, state)
        depth = fluid.flow_depth if fluid is not None else 1.0
        if ops.flow is not None:
            solvers.network.update(state)
        trial: tuple[Floats, Floats] | None = None
        failed, same, spent = None, False, 0
        for _ in range(MOST_TRIES + 2 * len(loads.limits)):
            limited = solvers.limited(loads, reached)
            asked = replace(request, loads=solvers.closed(limited, stepper.storage))
            kind = StepProblem if explicit is None else ExplicitProblem
            problem = kind(ops, state, asked, rule, trial)
            try:
                report = (explicit or solvers.couplings.of(asked.loads)).solve(problem)
                new = accept(problem, state.energy)
                try:
                    refuse_jumps(ops.blocks, ops.joints, state, new)
                    needed = solvers.model.scene.accuracy.digits
                    digits = check_digits(problem, new, needed, solvers.network.tell_digits)
                    same = self._is_closed(problem, limited, stepper.storage)
                    trial = None if same else problem.initial_guess()
                    full = solvers.network.overfull(limited, stepper.storage, problem) if same else frozenset()
                except SolveError:
                    new.destroy()
                    raise
            except NotConverged as error:
                spent += problem.tried
                failed = error.after(spent)
                if self._is_closed(problem, limited, stepper.storage):
                    full = solvers.network.overfull(limited, stepper.storage, problem)
                    if not full:
                        raise
                    reached |= full
                trial = problem.initial_guess()
                continue
            finally:
                problem.destroy()
            now = reached_after(request, rule, reached, new, depth) | full
            if now == reached and same:
                energy = update_balance(ops, state, new, dt, scheme)
                wells = tuple(sorted(limit.well for limit in now))
                memory = remember(ops, state, new, dt) if follows.memory else PreviousStep()
                means: dict[str, float] = {}
                if follows.memory and loads.limits:
                    means = through(replace(request, loads=limited), rule, now, state, new, depth)
                wells_now = well_step(replace(request, loads=limited), rule, means, state.time, stepper.storage, depth)
                volumes, kept = volumes_after(ops, wells_now, state, new, dt, scheme)
                if follows.memory:
                    memory = replace(memory, through={**kept, **means})
                friction, injected = dissipated(state, new), state.injected
                if solvers.counts_volume:
                    injected += brought(ops, limited, state, new, dt, scheme, depth)
                lost = leaked(ops, state, new, dt, scheme, depth)
                left = {name: state.left.get(name, 0.0) + value for name, value in lost.items()}
                new = replace(new, energy=energy, wells_at_limit=wells, friction=friction, injected=injected, left=left)
                new = replace(new, volumes=volumes)
                return replace(new, previous_step=memory, adjacent_steps=rule.adjacent), replace(report, digits=digits)
            new.destroy()
            spent += report.newton
            reached, failed = now, None
        if same and not failed:
            refuse_cycle(reached, request.time, spent)
        raise NotConverged(
            f"time {request.time:.6g}: elements keep pinching shut and opening again, which changes the outlets: take a"
            f" smaller time_step, or give minimum_hydraulic_aperture{f' (last: {failed})' if failed else ''}",
            spent,
        )

    def _is_closed(self, problem: StepProblem, loads: Loads, stores: bool) -> bool:
        """Whether a solved or failed trial still has the network components that it was solved with. Collective."""
        if problem.conduction is None:
            return True
        self.solvers.network.check(problem.conduction)
        return self.solvers.network.close(loads, stores) is problem.loads
