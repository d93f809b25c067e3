"""Step after step: the search for incipient failure, and the stages of a scene."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

from fracflow._petsc import MPI
from fracflow.advance.error_control import Judge
from fracflow.advance.events import take_part
from fracflow.advance.instability import is_near, refuse_unstable_slip, to_limit_point, to_the_next, weakens
from fracflow.advance.prescribed import prescribed
from fracflow.advance.step import DONE, Progress, Step, Stepping, stepper_of
from fracflow.advance.substeps import (
    AT_A_JUMP,
    Attempted,
    Place,
    Rules,
    in_parts,
    most_halvings,
    next_jump,
    on_the_way,
    still_lacking,
    to_next,
)
from fracflow.errors import SolveError
from fracflow.integrators import Steady, Stepper
from fracflow.model.setup import Model
from fracflow.model.state import State, StepReport, forgetful
from fracflow.scene.boundary import Stage
from fracflow.solve.request import StepRequest

DOUBLINGS = 60
JUST_OVER = 1.5  # times the shortest part: longer ones are halved where they fail
SEARCH_TOLERANCE = 1e-13  # of the control; far below the stage's own tolerance, so that ranks agree on where it ends


def utilisation(model: Model, state: State) -> float:
    """Largest |f_s| / f_sy over all sections; 1 where one slides. Collective."""
    here = float(state.sections.utilisation.max(initial=0.0))
    if state.sections.is_sliding.any():
        here = max(here, 1.0)
    return float(model.operators.layout.comm.allreduce(here, op=MPI.MAX))


class _Search:
    """How far the control may rise: states tried from one start, and how far each is from the strength sought."""

    def __init__(self, stepping: Stepping, state: State, stage: Stage, log: Callable[[str], None]) -> None:
        assert stage.control is not None
        self.log = log
        self.stepping, self.state, self.stage, self.control = stepping, state, stage, stage.control
        self.tried: dict[float, tuple[State, StepReport]] = {}
        self.failure: SolveError | None = None

    def excess(self, value: float) -> float:
        """Utilisation over what is sought, positive where there is no such state. Collective."""
        if value not in self.tried:
            controls = {**self.state.controls, self.control: value}
            request = StepRequest(self.state.time, 0.0, controls, self.stepping.model.loads)
            try:
                self.tried[value] = self.stepping.step(self.state, request, Steady())
            except SolveError as error:
                self.failure = error
                self.log(f"no state found at control.{self.control} = {value:.12g}, taken as past failure: {error}")
                return self.stage.tolerance
        return min(utilisation(self.stepping.model, self.tried[value][0]), 1.0) - (1.0 - self.stage.tolerance)

    def between(self, low: float, high: float) -> float:
        """The last value in a bracket that was tried and slides nowhere. Collective."""
        if self.excess(low) < 0.0:
            from scipy.optimize import brentq  # imports much

            brentq(self.excess, low, high, xtol=SEARCH_TOLERANCE * abs(high), rtol=1e-15)
        model = self.stepping.model
        below = {v: u for v, (new, _) in self.tried.items() if (u := utilisation(model, new)) < 1.0}
        sought = 1.0 - self.stage.tolerance
        best = min(below, key=lambda value: abs(below[value] - sought), default=low)
        if not below or below[best] < 1.0 - 2.0 * self.stage.tolerance:
            reached = f"|f_s|/f_sy = {below[best]:.9g}" if below else "no state"
            raise SolveError(
                f"stage {_name(self.stage)}: the search for incipient failure ended at control.{self.control} = {best:.9g}"
                f" with {reached}, sought 1 - {self.stage.tolerance:g}; beyond it {self.failure or 'sections slide at once'}"
            )
        return best

    def destroy(self) -> None:
        """Free the states that were not taken out of ``tried``."""
        for state, _ in self.tried.values():
            state.destroy()


def _name(stage: Stage) -> str:
    return stage.name or stage.kind


def search_incipient(
    stepping: Stepping, state: State, number: int, log: Callable[[str], None], progress: Progress
) -> Iterator[Step]:
    """Raise the control until max |f_s| / f_sy = 1 - tolerance; yields the elastic states on the way.

    Raises SolveError, on every rank, where no state is that near to the strength. Collective.
    """
    model, stage = stepping.model, stepping.model.scene.stage[number]
    control = stage.control
    assert control is not None
    low = state.controls[control]
    if utilisation(model, state) >= 1.0 - stage.tolerance:
        log(f"stage {_name(stage)}: already at incipient failure")
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
            f"stage {_name(stage)}: control.{control} raised to {low:.6g} and no fracture came to its"
            " strength: do the wells it drives reach one?"
        )
    try:
        value = search.between(low, high)
        best = search.tried.pop(value)
    finally:
        search.destroy()
    log(f"incipient failure at {control} = {value:.12g}: |f_s|/f_sy = 1 - {1.0 - utilisation(model, best[0]):.3e}")
    yield Step(best[0], number, 0.0, best[1], DONE)


def first_part(stepping: Stepping, stage: Stage, stepper: Stepper, time: float) -> float:
    """Length of a stage's first part, as it is foreseen: up to the first jump, where parts with inertia end there."""
    length, scene = stage.step_length(time), stepping.model.scene
    if stage.kind == "auto" or not stepper.inertia or not _splits(stepping, stepper, length):
        return length
    return to_next(scene.jump_times, time, length)


def _events(stepping: Stepping, stepper: Stepper, dt: float) -> int:
    """Events that parts of one step of length ``dt`` may end at; none without inertia. Collective."""
    scene = stepping.model.scene
    locates = stepper.inertia and scene.method.events != "at-step-ends" and stepping.explicit.locates(stepper, dt)
    return scene.accuracy.max_events if locates else 0


def _splits(stepping: Stepping, stepper: Stepper, dt: float) -> bool:
    """Whether parts of steps of length ``dt`` end where something prescribed jumps. Collective.

    Jumps that may come in any step are sampled by means, as all are where events are not located.
    """
    if not stepper.inertia:
        return dt > 0.0
    return _events(stepping, stepper, dt) > 0 and not stepping.model.scene.jumps_anywhere


def run_stage(
    stepping: Stepping, state: State, number: int, log: Callable[[str], None], progress: Progress
) -> Iterator[Step]:
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
    count, whole_step = stage.step_count(start), stage.time_step or 0.0
    dt = whole_step
    place = Place.of(progress)
    judge = Judge(model, stage, stepper, start, progress)
    stepping.explicit.tell(stepper, dt)
    if judge.finest and not progress:
        log(f"stage {_name(stage)}: parts of steps by {judge.told}")
    hurries = weakens(model) and not stepper.inertia
    most = most_halvings(model.scene)
    rules = Rules(
        max(most, to_the_next(model.scene, number, whole_step)) if hurries else most,
        judge.order,
        _events(stepping, stepper, dt),
        judge.finest,
        judge.of_film,
    )
    fills = stepper.storage and model.operators.flow is not None
    shortest = JUST_OVER * 0.5**rules.most
    given = prescribed(
        model.scene, stepper.inertia, _splits(stepping, stepper, dt), judge.tolerance if judge.finest else None
    )
    anew = stepper.inertia or judge.finest > 0  # else a rule that remembers forgets, and no more is needed

    def following(n: int, to: float) -> float:
        """Length of the part after the fraction ``to`` of step ``n``, as it is foreseen: up to the next jump."""
        if whole_step == 0.0 or (to == 1.0 and n == count):
            return 0.0
        length, now = stage.step_length(start, n + 1) if to == 1.0 else (1.0 - to) * dt, moment(n, to)
        return to_next(given.ends, now, length)

    def moment(n: int, to: float) -> float:
        return start + (n - 1 + to * (dt / whole_step)) * whole_step if whole_step > 0.0 else start

    def attempt(state: State, begin: float, end: float, may_stop: bool) -> Attempted:
        at = start + (n - 1) * whole_step
        cut = next_jump(given.ends, at, dt, begin, end)
        end = end if cut is None else cut
        jumps = cut is not None and next_jump(given.jumps, at, dt, begin, end) is not None
        whole, arrives = dt * (end - begin), next_jump(given.jumps, at, dt, begin, 1.0) or 1.0
        brief = hurries and (end - begin > shortest or is_near(model, state))

        def reach(old: State, share: float, to: float, hold: bool) -> tuple[State, StepReport]:
            # what jumps while a film fills is there at once: spread over a halved step, it would come half a step late
            lacking = 0.0 if stepper.inertia or fills else still_lacking(begin, to, arrives)
            now = on_the_way(old.controls, controls, begin, to)
            ahead = following(n, to)
            if jumps and to == end:  # which is then no matter of means
                ahead = 0.0
            elif share == 1.0 and to < 1.0:
                ahead = min(ahead, share * whole)
            request = StepRequest(
                moment(n, to),
                share * whole,
                now,
                model.loads,
                unapplied=lacking,
                hold=hold,
                next_length=ahead,
                expects_failure=brief,
            )
            return stepping.step(old, request, stepper)

        found = take_part(stepping, state, reach, begin, end, whole, may_stop)
        new, length = found.state, dt * (found.fraction - begin)
        if hurries:
            refuse_unstable_slip(model, state, new, found.report.newton)
        error = judge.error(length, stepping.explicit.part(stepper, length), state, new)
        if found.fraction == end and jumps and not (n == count and end == 1.0):
            left = new
            try:
                new = stepping.enter(left, stepper, following(n, end)) if anew else forgetful(left)
            finally:
                left.destroy()
        return replace(found, state=new, error=error, foreseen=cut is not None and found.fraction == end)

    def is_straight(begin: float, end: float) -> bool:
        at = start + (n - 1) * whole_step
        cut = next_jump(given.ends, at, dt, begin, end)
        inside = begin + 2.0 * AT_A_JUMP, (end if cut is None else cut) - 2.0 * AT_A_JUMP
        return given.is_straight(*(at + fraction * dt for fraction in inside))

    while count is None or n < count:
        n += 1
        dt = stage.step_length(start, n)
        if stage.control is not None and stage.increment_per_step is not None and not held:
            controls[control] = base * (1.0 + n * stage.increment_per_step)
        parts = in_parts(attempt, state, rules, log, place, is_straight)
        for part in parts if stepper.inertia else to_limit_point(model, state, parts, dt * 0.5**rules.most):
            state = part.state
            failed = utilisation(model, state) >= 1.0
            if failed and stage.then == "hold" and not held:
                held = True
                controls[control] = state.controls[control]
                log(f"time {state.time:.6g}: first failure; {control} held at {controls[control]:.12g}")
            judge.follow(state, dt * (part.end - part.start))
            ends = stage.until == "incipient" and failed
            place = part.place.next_step() if part.is_last else part.place
            there: Progress = {"n": n if part.is_last else n - 1, "start": start, "base": base, "held": float(held)}
            there = {**there, **place.as_progress(), **judge.as_progress()}
            yield Step(state, number, dt * (part.end - part.start), part.report, DONE if ends else there)
            if ends:
                break
            if line := judge.outlook(state.time):
                log(f"stage {_name(stage)}: {line}")
        if ends:
            break
    if judge.finest:
        log(f"stage {_name(stage)}: {judge.last_words}")
