"""The stages of a scene, step after step: composed of ways to advance, one for each task that a step may need."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from fracflow._petsc import MPI, destroy
from fracflow.advance.error_control import ErrorControlled, ErrorEstimator
from fracflow.advance.events import EventLocated
from fracflow.advance.instability import StableSlip, UpToLimitPoint, to_the_next, weakens
from fracflow.advance.outcome import Advance, Log, Outcome
from fracflow.advance.prescribed_times import PrescribedTimes, prescribed
from fracflow.advance.step import DONE, Progress, Step, Stepping, stepper_of
from fracflow.advance.substeps import Rules, SubstepCursor, Substepped, most_halvings
from fracflow.errors import SolveError
from fracflow.integrators import Steady, Stepper
from fracflow.model.setup import Model
from fracflow.model.state import Sections, State, StepReport, forgetful
from fracflow.scene.boundary import Stage
from fracflow.solve.request import LoadStep, StepRequest, to_next

DOUBLINGS = 60
SEARCH_TOLERANCE = 1e-13  # of the control; far below the stage's own tolerance, so that ranks agree on where it ends
JUST_OVER = 1.5  # times the shortest part: longer ones are halved where they fail


def utilisation(model: Model, sections: Sections) -> float:
    """Largest |f_s| / f_sy over all sections; 1 where one slides. Collective."""
    here = max(float(sections.utilisation.max(initial=0.0)), float(sections.is_sliding.any()))
    return float(model.operators.layout.comm.allreduce(here, op=MPI.MAX))


class _Search:
    """How far the control may rise: states tried from one start, and how far each is from the strength sought."""

    def __init__(self, stepping: Stepping, state: State, stage: Stage, log: Log) -> None:
        assert stage.control is not None
        self.log = log
        self.stepping, self.state, self.stage, self.control = stepping, state, stage, stage.control
        self.tried: dict[float, tuple[State, StepReport]] = {}
        self.failure: SolveError | None = None

    def excess(self, value: float) -> float:
        """Utilisation less the one that is sought; positive where there is no such state. Collective."""
        if value not in self.tried:
            controls = {**self.state.controls, self.control: value}
            request = StepRequest(self.state.time, 0.0, controls, self.stepping.model.loads)
            try:
                self.tried[value] = self.stepping.step(self.state, request, Steady())
            except SolveError as error:
                self.failure = error
                self.log(f"no state found at control.{self.control} = {value:.12g}, taken as past failure: {error}")
                return self.stage.tolerance
        return min(utilisation(self.stepping.model, self.tried[value][0].sections), 1.0) - (1.0 - self.stage.tolerance)

    def between(self, low: float, high: float) -> float:
        """The last value in a bracket that was tried and slides nowhere. Collective."""
        if self.excess(low) < 0.0:
            from scipy.optimize import brentq  # imports much

            brentq(self.excess, low, high, xtol=SEARCH_TOLERANCE * abs(high), rtol=1e-15)
        model = self.stepping.model
        below = {v: u for v, (new, _) in self.tried.items() if (u := utilisation(model, new.sections)) < 1.0}
        sought = 1.0 - self.stage.tolerance
        best = min(below, key=lambda value: abs(below[value] - sought), default=low)
        if not below or below[best] < 1.0 - 2.0 * self.stage.tolerance:
            reached = f"|f_s|/f_sy = {below[best]:.9g}" if below else "no state"
            raise SolveError(
                f"stage {self.stage.title}: the search for incipient failure ended at control.{self.control} = {best:.9g}"
                f" with {reached}, sought 1 - {self.stage.tolerance:g}; beyond it {self.failure or 'sections slide at once'}"
            )
        return best

    def destroy(self) -> None:
        """Free the states that were not taken out of ``tried``."""
        destroy(*(state for state, _ in self.tried.values()))


def search_incipient(stepping: Stepping, state: State, number: int, log: Log, progress: Progress) -> Iterator[Step]:
    """Raise the control until max |f_s| / f_sy = 1 - tolerance; yields the elastic states on the way.

    Raises SolveError, on every rank, where no state is that near to the strength. Collective.
    """
    model, stage = stepping.model, stepping.model.scene.stage[number]
    control = stage.control
    assert control is not None
    low = state.controls[control]
    if utilisation(model, state.sections) >= 1.0 - stage.tolerance:
        log(f"stage {stage.title}: already at incipient failure")
        return
    increment = progress.get("increment", model.scene.control[control].increment)
    for _ in range(DOUBLINGS):
        search, high = _Search(stepping, state, stage, log), low + increment
        if search.excess(high) >= 0.0:
            break
        state, report = search.tried.pop(high)
        low, increment = high, 2.0 * increment
        yield Step(state, number, 0.0, report, {"increment": increment})
    else:
        raise SolveError(
            f"stage {stage.title}: control.{control} raised to {low:.6g} and no fracture came to its"
            " strength: do the wells it drives reach one?"
        )
    try:
        value = search.between(low, high)
        best = search.tried.pop(value)
    finally:
        search.destroy()
    reached = utilisation(model, best[0].sections)
    log(f"incipient failure at {control} = {value:.12g}: |f_s|/f_sy = 1 - {1.0 - reached:.3e}")
    yield Step(best[0], number, 0.0, best[1], DONE)


@dataclass(frozen=True)
class SplitAtJumps:
    """Ends substeps where a prescribed value jumps or bends, and takes the state over anew after a jump.

    renews  pressures and accelerations are computed anew then; else the rule only drops the previous step
    """

    inner: Advance
    stepping: Stepping
    stepper: Stepper
    renews: bool

    def advance(self, state: State, request: StepRequest) -> Outcome:
        """The same up to the first such time. Raises SolveError, on every rank. Collective."""
        step, begin = request.step, request.begin
        assert step is not None
        cut = step.first(step.ends, begin, request.end)
        if cut is None:
            return self.inner.advance(state, request)
        part = replace(step.part(state.controls, begin, cut), may_stop=request.may_stop)
        jumps = step.first(step.jumps, begin, cut) is not None
        found = self.inner.advance(state, replace(part, next_length=0.0) if jumps else part)
        if found.reached < cut:
            return found
        if not jumps or (cut == 1.0 and step.following == 0.0):
            return replace(found, foreseen=True)
        left, ahead = found.state, step.after(cut)
        try:
            new = self.stepping.enter(left, self.stepper, ahead) if self.renews else forgetful(left)
        finally:
            left.destroy()
        return replace(found, state=new, foreseen=True)


def first_substep(stepping: Stepping, stage: Stage, stepper: Stepper, time: float) -> float:
    """Planned length of a stage's first substep: up to the first jump, where substeps with inertia end there."""
    length, scene = stage.step_length(time), stepping.model.scene
    if stage.kind == "auto" or not stepper.inertia or not _splits(stepping, stepper, length):
        return length
    return to_next(scene.jump_times, time, length)


def _events(stepping: Stepping, stepper: Stepper, dt: float) -> int:
    """Number of events at which substeps of one step of length ``dt`` may end; 0 without inertia. Collective."""
    scene = stepping.model.scene
    locates = stepper.inertia and scene.method.events != "at-step-ends" and stepping.explicit.locates(stepper, dt)
    return scene.accuracy.max_events if locates else 0


def _splits(stepping: Stepping, stepper: Stepper, dt: float) -> bool:
    """Whether substeps of steps of length ``dt`` end where a prescribed value jumps. Collective.

    Jumps that may come in any step are sampled by means, as all are where events are not located.
    """
    if not stepper.inertia:
        return dt > 0.0
    return _events(stepping, stepper, dt) > 0 and not stepping.model.scene.jumps_anywhere


def composed(
    stepping: Stepping, number: int, estimator: ErrorEstimator, given: PrescribedTimes, place: SubstepCursor, log: Log
) -> Substepped:
    """The way to advance through the steps of a stage by the rule of an estimator, from a place in one of them."""
    model, whole, stepper = stepping.model, stepping.model.scene.stage[number].time_step or 0.0, estimator.stepper
    is_weakening, most = weakens(model) and not stepper.inertia, most_halvings(model.scene)
    most = max(most, to_the_next(model.scene, number, whole)) if is_weakening else most
    rules = Rules(most, estimator.order, _events(stepping, stepper, whole), estimator.finest, estimator.of_flow)
    step = stepping.by(stepper)
    step = EventLocated(step, stepping) if rules.events else step
    step = StableSlip(step, model, JUST_OVER * 0.5**most) if is_weakening else step
    step = ErrorControlled(step, estimator, stepping.explicit) if estimator.order else step
    step = SplitAtJumps(step, stepping, stepper, stepper.inertia or estimator.finest > 0) if given.ends else step
    return Substepped(step, rules, log, place, given)


def run_stage(stepping: Stepping, state: State, number: int, log: Log, progress: Progress) -> Iterator[Step]:
    """All steps of a stage, or those after the one with ``progress``. The caller owns the states. Collective."""
    model = stepping.model
    stage = model.scene.stage[number]
    stepper = stepper_of(model.scene, stage)
    if "done" in progress:
        return
    if stage.takes_no_time:
        yield from search_incipient(stepping, state, number, log, progress)
        return
    controls, control = dict(state.controls), stage.control or ""
    start, base = progress.get("start", state.time), progress.get("base", controls.get(control, 0.0))
    n, held = int(progress.get("n", 0)), bool(progress.get("held", 0.0))
    count, whole = stage.step_count(start), stage.time_step or 0.0
    estimator = ErrorEstimator(model, stage, stepper, start, progress)
    stepping.explicit.log_steps(stepper, whole)
    if estimator.finest and not progress:
        log(f"stage {stage.title}: parts of steps by {estimator.statement}")
    splits = _splits(stepping, stepper, whole)
    given = prescribed(model.scene, stepper.inertia, splits, estimator.tolerance if estimator.finest else None)
    parts = composed(stepping, number, estimator, given, SubstepCursor.of(progress), log)
    method: Advance = parts if stepper.inertia else UpToLimitPoint(parts, model, parts.rules.most)
    # a jump while a fracture fills is applied at once: spread over a halved step, it would come half a step late
    fills = stepper.inertia or (stepper.storage and model.operators.flow is not None)
    ends = False
    while not ends and (count is None or n < count):
        dt, following = stage.step_length(start, n + 1), 0.0 if n + 1 == count else stage.step_length(start, n + 2)
        if stage.control is not None and stage.increment_per_step is not None and not held:
            controls[control] = base * (1.0 + (n + 1) * stage.increment_per_step)
        step = LoadStep(start, n + 1, whole, dt, following, dict(controls), model.loads, given.ends, given.jumps, fills)
        found = method.advance(state, step.part(state.controls, parts.place.fraction, 1.0))
        state, n = found.state, n + (found.reached == 1.0)
        failed = utilisation(model, state.sections) >= 1.0
        if failed and stage.then == "hold" and not held:
            held, controls[control] = True, state.controls[control]
            log(f"time {state.time:.6g}: first failure; {control} held at {controls[control]:.12g}")
        if estimator.order:
            estimator.accept(state, found.length)
        ends = stage.until == "incipient" and failed
        there: Progress = {"n": n, "start": start, "base": base, "held": float(held)}
        there = {**there, **parts.place.as_progress(), **estimator.as_progress()}
        yield Step(state, number, found.length, found.report, DONE if ends else there)
        if not ends and (line := estimator.outlook(state.time)):
            log(f"stage {stage.title}: {line}")
    if estimator.finest:
        log(f"stage {stage.title}: {estimator.summary}")
