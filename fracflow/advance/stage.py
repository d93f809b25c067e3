"""The stages of a scene, step after step: composed of ways to advance, one for each task that a step may need."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

from fracflow.advance.error_control import ErrorControlled, ErrorEstimator
from fracflow.advance.events import EventLocated, most_events
from fracflow.advance.incipient import search_incipient, utilisation
from fracflow.advance.instability import StableSlip, UpToLimitPoint, to_the_next, weakens
from fracflow.advance.outcome import Advance, Log, Outcome
from fracflow.advance.prescribed_times import PrescribedTimes, prescribed
from fracflow.advance.slip_rate import MOST_HALVINGS, BySlipRate, follows_slip
from fracflow.advance.step import DONE, Progress, Step, Stepping, stepper_of
from fracflow.advance.substeps import InSmallStrains, Rules, SubstepCursor, Substepped, most_halvings
from fracflow.errors import InputError
from fracflow.integrators import Stepper
from fracflow.model.energy import refuse_made_energy
from fracflow.model.setup import Model
from fracflow.model.state import State, forgetful
from fracflow.remarks import marked, note
from fracflow.scene.boundary import Stage
from fracflow.scene.scene import Scene
from fracflow.solve.request import LoadStep, StepRequest, to_next

JUST_OVER = 1.5  # times the shortest part: longer ones are halved where they fail


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


def refuse_moved(scene: Scene, number: int, progress: Mapping[str, float], time: float) -> None:
    """Raise InputError where the steps of a stage, as the scene now has them, do not lead to where a run was stopped in it.

    A step would else last from that time to the end of one of the others, with what is pumped in one of its own length.
    """
    stage, n = scene.stage[number], int(progress.get("n", 0))
    if not stage.time_step or stage.kind == "auto" or "start" not in progress:
        return
    start, fraction = progress["start"], SubstepCursor.of(progress).fraction
    length = stage.step_length(start, n + 1) if fraction else 0.0
    is_over = not fraction and n == stage.step_count(start)
    there = stage.finish(start) if is_over else start + n * stage.time_step + fraction * length
    if abs(there - time) > 1e-6 * stage.time_step + 1e-12 * abs(time):
        raise InputError(
            f"scene.toml: stage.{number}: the run was stopped amid this stage at time {time:.9g}, where its steps now are"
            f" at {there:.9g}: put its time_step and end back and let a stage follow it, or begin a new run: fracflow run"
        )


def _splits(stepping: Stepping, stepper: Stepper, dt: float) -> bool:
    """Whether substeps of steps of length ``dt`` end where a prescribed value jumps. Collective.

    Jumps that may come in any step are sampled by means, as all are where events are not located.
    """
    if not stepper.inertia:
        return dt > 0.0
    return most_events(stepping, stepper, dt) > 0 and not stepping.model.scene.jumps_anywhere


def fills(model: Model, stepper: Stepper) -> bool:
    """Whether steps by a rule fill fractures, at rest."""
    return stepper.storage and model.operators.flow is not None and not stepper.inertia


def composed(
    stepping: Stepping, number: int, estimator: ErrorEstimator, given: PrescribedTimes, place: SubstepCursor, log: Log
) -> Substepped:
    """The way to advance through the steps of a stage by the rule of an estimator, from a place in one of them."""
    model, whole, stepper = stepping.model, stepping.model.scene.stage[number].time_step or 0.0, estimator.stepper
    is_weakening = weakens(model) and not stepper.inertia
    is_sought = is_weakening or model.scene.accuracy.step_error is not None
    most = most_halvings(model.scene, fills(model, stepper) and not is_sought)
    most = max(most, to_the_next(model.scene, number, whole)) if is_weakening else most
    by_rate = follows_slip(model, stepper)
    order, finest = estimator.order or by_rate, max(estimator.finest, MOST_HALVINGS * by_rate)
    prompt = estimator.of_flow or (by_rate and not stepper.inertia)  # with inertia factors of one length serve again
    shrinks = not stepping.explicit.may_lengthen(stepper)
    rules = Rules(most, order, most_events(stepping, stepper, whole), finest, prompt, shrinks)
    step = stepping.by(stepper)
    step = EventLocated(step, stepping) if rules.events else step
    step = StableSlip(step, model, JUST_OVER * 0.5**most) if is_weakening else step
    step = ErrorControlled(step, estimator, stepping.explicit) if estimator.order else step
    step = BySlipRate(step, model, stepper.inertia) if by_rate else step
    step = SplitAtJumps(step, stepping, stepper, stepper.inertia or estimator.finest > 0) if given.ends else step
    step = InSmallStrains(step, model.scene) if fills(model, stepper) else step
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
    state = state if progress else estimator.begun(state)
    stepping.explicit.log_steps(stepper, whole)
    if estimator.finest and not progress:
        log(note(f"stage {stage.title}: parts of steps by {estimator.statement}"))
    splits = _splits(stepping, stepper, whole)
    is_filled = fills(model, stepper)
    asked = estimator.tolerance if estimator.finest else None
    given = prescribed(model.scene, stepper.inertia, splits, asked, whole if is_filled else 0.0)
    parts = composed(stepping, number, estimator, given, SubstepCursor.of(progress), log)
    method: Advance = parts if stepper.inertia else UpToLimitPoint(parts, model, parts.rules.most)
    # a jump while a fracture fills is applied at once: spread over a halved step, it would come half a step late
    at_once = stepper.inertia or is_filled
    ends = False
    while not ends and (count is None or n < count):
        dt, following = stage.step_length(start, n + 1), 0.0 if n + 1 == count else stage.step_length(start, n + 2)
        if stage.control is not None and stage.increment_per_step is not None and not held:
            controls[control] = base * (1.0 + (n + 1) * stage.increment_per_step)
        step = LoadStep(
            start, n + 1, whole, dt, following, dict(controls), model.loads, given.ends, given.jumps, at_once
        )
        found = method.advance(state, step.part(state.controls, parts.place.fraction, 1.0))
        state, n = found.state, n + (found.reached == 1.0)
        if stepper.inertia:
            refuse_made_energy(model.operators, state, dt)
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
            log(marked(f"stage {stage.title}: {line}"))
    if estimator.finest:
        line = f"stage {stage.title}: {estimator.summary}"
        log(marked(line) if estimator.missed else note(line))
