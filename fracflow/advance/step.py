"""One step: its loads, its solver, what it adds to the energy books; and how a stage takes over a state."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial

from fracflow._petsc import PETSc
from fracflow.advance.couplings import Couplings
from fracflow.advance.discontinuities import change, enter, keep_pace
from fracflow.advance.explicit import ExplicitSteps
from fracflow.advance.network import Network
from fracflow.advance.sampling import begins_anew, rates_of, sides_of
from fracflow.advance.wells import reached_after, reached_before, refuse_cycle, through
from fracflow.errors import NotConverged, SolveError
from fracflow.integrators import Explicit, Steady, Stepper, first, stepper_from
from fracflow.mesh.data import Bools, Floats
from fracflow.model.compressibility import narrowing, widening
from fracflow.model.energy import book, dissipated
from fracflow.model.energy_motion import Scheme
from fracflow.model.loads import Limit, Loads
from fracflow.model.setup import Model
from fracflow.model.softening import refuse_jumps
from fracflow.model.state import Memory, State, StepReport
from fracflow.model.volume import brought, stored
from fracflow.scene.boundary import Stage
from fracflow.scene.scene import Scene
from fracflow.solve.accept import accept, remember
from fracflow.solve.explicit import ExplicitProblem
from fracflow.solve.flow_round_off import check_digits
from fracflow.solve.problem import StepProblem

Progress = Mapping[str, float]
NARROWS = 0.5  # of an aperture: where less is left after a step, its end is not what its beginning foretells
MOST_TRIES = 4  # of a step whose wells reach limits, or whose elements pinch shut
DONE: Progress = {"done": 1.0}
Trial = Callable[[float, float, str], None]
"""(time, length, why) of a step that was tried from a time, and thrown away."""


@dataclass(frozen=True)
class Step:
    """A state worth recording, the stage it belongs to, and what it cost.

    progress  what the stage needs to go on from here; None where it cannot
    regime    the kind of step, where the stage chooses it; empty where that is the kind of the stage
    """

    state: State
    stage: int
    dt: float
    report: StepReport
    progress: Progress | None = None
    regime: str = ""


def stepper_of(scene: Scene, stage: Stage, regime: str = "") -> Stepper:
    """The rule that a kind of stage, or a regime of it, steps by; a stage auto begins without inertia."""
    method, kind = scene.method, regime or stage.kind
    if kind == "dynamic":
        return stepper_from(method.stepper, method)
    return stepper_from(method.flow_integrator, method) if kind in ("quasi-static", "auto") else Steady()


class Stepping:
    """Makes steps of one model; keeps the solvers between them."""

    def __init__(self, model: Model) -> None:
        """Make the solvers that the stages need when they first need them."""
        self.model = model
        self.tell_trial: Trial = lambda time, length, why: None
        self.network = Network(model)
        self.couplings = Couplings(model, lambda line: self.network.log(line))
        self._network_version = 0
        self._at_rest: dict[Loads, Loads] = {}
        self._variants: dict[tuple[Loads, frozenset[Limit]], Loads] = {}
        self.explicit = ExplicitSteps(model, lambda line: self.network.log(line))
        self._counts_volume = any(stage.kind == "auto" for stage in model.scene.stage)  # for the catalogue of events

    def _closed(self, loads: Loads, stores: bool) -> Loads:
        """The loads with what nothing drains closed; solvers for parts of the network that are no more are freed."""
        found = self.network.close(loads, stores)
        if self.network.version != self._network_version:
            self._network_version = self.network.version
            self.couplings.forget_closures()
        return found

    def step(
        self,
        state: State,
        stepper: Stepper,
        time: float,
        dt: float,
        controls: Mapping[str, float],
        loads: Loads | None = None,
        restraint: PETSc.Vec | None = None,
        lacking: float = 0.0,
        hold: bool = False,
        ahead: float | None = None,
        brief: bool = False,
        most: int = 0,
    ) -> tuple[State, StepReport]:
        """One step to ``time``, by default under the loads of the scene and no restraint.

        A rule of the film that remembers carries walls on as they moved, through a fracture that pinches shut, and leaves
        them there, for nothing flows any more. Backward Euler stops them in time: it makes the steps in which one closes.

        lacking  share of what ``state`` lacks of the prescribed that does not arrive in this step
        hold     all joint sections keep their status
        ahead    length of the step that follows, 0 where the stage ends or this one is cut at a jump; by default as long as
                 this one
        brief    it will be shortened where sections keep changing, and not be given to another solver
        most     iterations that it is given while no section changes, where accuracy.max_iterations is more; 0: no such limit
        Raises SolveError, on every rank; ``state`` stays as it is. Collective.
        """
        if isinstance(stepper, Explicit) and (count := self.explicit.count(dt)) > 1:
            return self.explicit.in_parts(
                lambda now, at, part, way, then: self.step(now, stepper, at, part, way, hold=hold, ahead=then),
                state,
                time,
                (dt, dt if ahead is None else ahead),
                controls,
                count,
            )
        loads = loads or self.model.loads
        rule = first(stepper) if begins_anew(stepper, loads, state, dt, ahead) else stepper
        given = (stepper, time, dt, controls, loads, restraint, lacking, hold, ahead, brief, most)
        begun = self._begun(rule, state, loads, state, time, dt, controls, ahead)
        try:
            new, report = self._step_by(rule, begun or state, *given)
        finally:
            if begun is not None:
                begun.destroy()
        if set(state.limited) - set(new.limited):  # the step was begun as if these wells stayed at their limits
            begun = self._begun(rule, state, loads, new, time, dt, controls, ahead)
            if begun is not None:
                new.destroy()
                try:
                    new, again = self._step_by(rule, begun, *given)
                finally:
                    begun.destroy()
                report = again.after(report)
        left = narrowing(self.model.operators, state, new) if rule.memory else 1.0
        if left < NARROWS:
            new.destroy()
            what = f"{max(left, 0.0):.2g} of an aperture would be left, below {NARROWS:g}"
            self.network.log(f"time {time:.6g}: {what}: this step goes by backward Euler")
            rule = first(stepper)
            new, report = self._step_by(rule, state, *given)
        self.network.tell(time)
        if rule.storage:
            grown, where = widening(self.model.operators, state, new)
            report = replace(report, widening=grown, widest=where)
        return new, report

    def _begun(
        self,
        rule: Stepper,
        state: State,
        loads: Loads,
        limits: State,
        time: float,
        dt: float,
        controls: Mapping[str, float],
        ahead: float | None,
    ) -> State | None:
        """The state that a step goes from, where that is another; of rules that look back on a. See ``keep_pace``.

        limits  the state whose wells at their limits stay there
        """
        if not rule.inertia or rule.balance != "both" or self.model.operators.flow is None or dt == 0.0:
            return None
        self.network.look_at(state)
        limited = self._limited(loads, reached_before(loads, limits))
        return keep_pace(self.model, self.network, limited, state, (time, dt), controls, sides_of(rule, dt, ahead))

    def _step_by(
        self,
        rule: Stepper,
        state: State,
        stepper: Stepper,
        time: float,
        dt: float,
        controls: Mapping[str, float],
        loads: Loads,
        restraint: PETSc.Vec | None,
        lacking: float,
        hold: bool,
        ahead: float | None,
        brief: bool,
        most: int,
    ) -> tuple[State, StepReport]:
        last = state.memory.time_step
        alphas = rule.alphas(dt, last) if last > 0.0 else rule.alphas(dt)
        around, rates = sides_of(rule, dt, ahead), rates_of(rule, alphas, state, dt, ahead, stepper)
        loads = self._standing(loads) if not rule.inertia else loads
        explicit = self.explicit.coupling if isinstance(rule, Explicit) else None
        weighs = alphas if rule.inertia and explicit is None else None
        scheme = Scheme(rule.inertia, rule.storage, rule.balance, weighs, loads.held)
        fluid, network = self.model.scene.fluid, self.model.operators.flow
        reached = reached_before(loads, state)
        if network is not None:
            self.network.look_at(state)
        trial: tuple[Floats, Floats] | None = None
        failed, same, spent = None, False, 0
        for _ in range(MOST_TRIES + 2 * len(loads.limits)):
            limited = self._limited(loads, reached)
            closed = self._closed(limited, rule.storage)
            problem = (StepProblem if explicit is None else ExplicitProblem)(
                self.model.operators,
                closed,
                state,
                alphas,
                time,
                controls,
                restraint,
                lacking,
                trial,
                hold,
                around,
                rates,
            )
            problem.brief, problem.most = brief, most
            try:
                report = (explicit or self.couplings.of(closed)).solve(problem)
                new = accept(problem, state.energy)
                self._refuse_jumps(state, new)
                asked = self.model.scene.accuracy.digits
                report = replace(report, digits=check_digits(problem, new, asked, self.network.tell_digits))
                same = self._is_closed(problem, limited, rule.storage)
                trial = None if same else problem.hand_on()
                try:
                    full = self.network.overfull(limited, rule.storage, problem) if same else frozenset()
                except SolveError:
                    new.destroy()
                    raise
            except NotConverged as error:
                spent += problem.tried
                failed = error.after(spent)
                if self._is_closed(problem, limited, rule.storage):
                    full = self.network.overfull(limited, rule.storage, problem)
                    if not full:
                        raise
                    reached |= full
                trial = problem.hand_on()
                continue
            finally:
                problem.destroy()
            depth = fluid.flow_depth if fluid is not None else 1.0
            now = reached_after(
                loads, reached, new, lambda well: loads.demanded(well, time, controls, around, rates), depth
            )
            now |= full
            if now == reached and same:
                energy = book(self.model.operators, state, new, dt, scheme)
                wells = tuple(sorted(limit.well for limit in now))
                memory = remember(self.model.operators, state, new, dt) if stepper.memory else Memory()
                if stepper.memory and loads.limits:
                    asked_for = partial(limited.demanded, time=time, controls=controls, around=around, rates=rates)
                    memory = replace(
                        memory, through=through(loads, limited, now, state, new, alphas, dt, asked_for, depth)
                    )
                friction, injected = dissipated(state, new), state.injected
                if self._counts_volume:
                    injected += brought(self.model.operators, limited, state, new, dt, scheme, depth)
                new = replace(new, energy=energy, limited=wells, friction=friction, injected=injected)
                return replace(new, memory=memory, around=around), report
            new.destroy()
            spent += report.newton
            reached, failed = now, None
        if same and not failed:
            refuse_cycle(reached, time, spent)
        raise NotConverged(
            f"time {time:.6g}: elements keep pinching shut and opening again, which changes what nothing drains: take a smaller"
            f" time_step, or give minimum_hydraulic_aperture{f' (last: {failed})' if failed else ''}",
            spent,
        )

    def _refuse_jumps(self, old: State, new: State) -> None:
        """Raise SolveError, on every rank, where a joint's strength fell faster than its spring unloads. Collective."""
        ops = self.model.operators
        try:
            refuse_jumps(ops.blocks, ops.joints, old, new)
        except SolveError:
            new.destroy()
            raise

    def _is_closed(self, problem: StepProblem, loads: Loads, stores: bool) -> bool:
        """Whether a solved or failed trial has the parts of the network that it was solved with. Collective."""
        if problem.conduction is None:
            return True
        self.network.look(problem.conduction)
        return self.network.close(loads, stores) is problem.loads

    def _standing(self, loads: Loads) -> Loads:
        if not len(self.model.loads.fixed_resting) and self.model.operators.damping is None:
            return loads
        if loads not in self._at_rest:
            self._at_rest[loads] = loads.standing()
        return self._at_rest[loads]

    def _limited(self, loads: Loads, reached: frozenset[Limit]) -> Loads:
        key = (loads, reached)
        if reached and key not in self._variants:
            self._variants[key] = loads.at_limit(reached)
        return self._variants[key] if reached else loads

    def enter(self, state: State, stepper: Stepper, dt: float = 0.0) -> State:
        """A new state, as a stage takes it over; see ``advance.discontinuities``. Collective."""
        dt /= self.explicit.count(dt) if isinstance(stepper, Explicit) and dt > 0.0 else 1
        new = enter(self.model, self.network, self._limited_now(state), state, stepper, dt)
        if not self._counts_volume or new.uptake is None:
            return new
        fluid = self.model.scene.fluid
        jumped = stored(self.model.operators, state, new, fluid.flow_depth if fluid is not None else 1.0)
        return replace(new, injected=new.injected + jumped)  # where prescribed pressures of a compressible fluid jump

    def change(self, state: State, leaving: Bools) -> State:
        """A new state at the same instant, where the friction of the sections (s,) has the other status. Collective."""
        return change(self.model, self.network, self._limited_now(state), state, leaving)

    def _limited_now(self, state: State) -> Loads:
        return self._limited(self.model.loads, reached_before(self.model.loads, state))

    def destroy(self) -> None:
        """Free the solvers. Collective."""
        self.couplings.destroy()
        self.explicit.destroy()
        self.network.destroy()
