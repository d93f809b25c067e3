"""The stage auto: large steps without inertia, wave steps while something moves, and back, any number of times."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from fracflow.advance.events import EventLocated, most_events
from fracflow.advance.excitation import excitations, why_inertia
from fracflow.advance.instability import patch_at_limit
from fracflow.advance.outcome import Log
from fracflow.advance.prescribed_times import prescribed
from fracflow.advance.regime import LONG, EventState, begin
from fracflow.advance.slip_rate import MOST_HALVINGS, BySlipRate, follows_slip, longest_step
from fracflow.advance.slow_slip import RADIATED, SETTLED, Tried, may_rest, slipped, weak_waves
from fracflow.advance.step import Progress, Step, Stepping, Trial, stepper_of
from fracflow.advance.step_error import step_error
from fracflow.advance.substeps import CALM, Rules, SubstepCursor, Substepped, halvings_given, most_halvings
from fracflow.diagnostics.slip import coarse_of_slip, of_fractures
from fracflow.errors import NotConverged, OtherRock, ReductionInvalid
from fracflow.mesh.agreement import on_root
from fracflow.model.energy import refuse_made_energy
from fracflow.model.state import State, StepReport
from fracflow.remarks import marked
from fracflow.scene.advice import is_for_explicit
from fracflow.solve.failure import fractures_of, places_of
from fracflow.solve.newton import BRIEF
from fracflow.solve.period import longest_period
from fracflow.solve.request import LoadStep, StepRequest

NEAR = 1e-9  # of a step: times so near are one
TIME_ROUND_OFF = 1e-14  # of a time
SEEN = 1e-2  # of the spread of a table: what it leaves a straight line by, where the scene states no tolerance
REPORTED = 4  # trials rejected on the way to one step from which on the log reports them
REST, WAVES = "quasi-static", "dynamic"


def run_auto(stepping: Stepping, state: State, number: int, log: Log, progress: Progress) -> Iterator[Step]:
    """All steps of a stage auto, or those after the one with ``progress``. The caller owns the states. Collective.

    With "moving" in it a stage before has left ``state`` in motion, and ``progress`` is that stage's.

    Rock without a mesh has no inertia: OtherRock is raised, on every rank, where an event begins in it. The stage goes on once
    the rock is meshed, and finds out again whether there is an event. OtherRock is raised again where such an event is over.

    A change of regime is a step of no length. Where inertia comes in, the state is in balance except for forces that no
    state at rest balances; these alone start the motion. Where it goes, the kinetic energy is counted as dissipated by
    switching.
    """
    model, stage = stepping.model, stepping.model.scene.stage[number]
    goes_on = bool(progress) and "moving" not in progress
    event = EventState.of(progress) if goes_on else begin(model, state, stage)
    place = SubstepCursor.of(progress) if goes_on else SubstepCursor()
    regimes = _Regimes(stepping, number, log, event, place)
    if not goes_on:
        shown = model.scene.time_text
        log(
            f"stage {stage.title}: longest period {shown(event.period)}, steps with inertia {shown(event.least)},"
            f" without at most {shown(stage.time_step or 0.0)}"
        )
    if "moving" in progress:
        weak, known = weak_waves(model, state, event.period), progress.get("moves", 0.0) > 0.0
        if known or state.energy["kinetic"] > weak:
            log(f"time {state.time:.9g}: begins in motion")
            kept = {name: progress[name] for name in ("creep", "peak", "loud")} if known else {}
            event = replace(event.onset(state, event.period, weak), **kept)
        else:
            state = stepping.enter(state, regimes.still)
            yield Step(state, number, 0.0, StepReport(), event.as_progress(), REST)
    spent, waves = StepReport(), regimes.waves
    while waves.place.fraction or regimes.end - state.time > max(NEAR * event.least, TIME_ROUND_OFF * abs(regimes.end)):
        if model.of_event and event.over and not (event.moves or regimes.is_excited(state.time)):
            raise OtherRock("the event is over", event.as_progress())
        if event.moves:
            if not waves.place.fraction and event.is_quiet(state, stage) and not regimes.is_excited(state.time):
                settled, event, trials = regimes.return_to_quasi_static(state, event)
                yield from (Step(state, number, 0.0, StepReport(), trial=trial) for trial in trials)
                if settled is not None:
                    state, waves.place = settled, SubstepCursor()
                    yield Step(state, number, 0.0, regimes.counted(StepReport()), event.as_progress(), REST)
                    continue
            before, step = state.time, regimes.wave_step(state, event)
            found = waves.advance(state, step.part(state.controls, waves.place.fraction, 1.0))
            state = found.state
            refuse_made_energy(model.operators, state, state.time - before)
            event = replace(event.moved_to(state, stage.at_rest), count=event.count + (found.reached == 1.0))
            absorbs = any(term.absorbs for term in model.scene.terms)
            if line := event.is_unstable(
                before, state.time, absorbs, regimes.moving.damps or is_for_explicit(model.scene)
            ):
                log(marked(f"time {state.time:.9g}: {line}"))
            report = regimes.counted(found.report)
            yield Step(state, number, found.length, report, event.as_progress(waves.place), WAVES)
            continue
        if why := regimes.is_excited(state.time):
            if model.scene.is_unbounded:
                raise OtherRock(why, event.as_progress(), spent.wasted, spent.rejected)
            log(f"time {state.time:.9g}: an event begins: {why}")
        else:
            tried = regimes.slow_step(state, event)
            if tried.state is not None:
                event, state = regimes.accepted(state.time, event, tried, spent), tried.state
                report, spent = tried.report.after_trials(spent), StepReport()
                yield Step(state, number, tried.length, report, event.as_progress(), REST)
                continue
            spent = spent.with_rejected(tried.newton)
            yield Step(state, number, 0.0, StepReport(), trial=Trial(state.time, tried.length, tried.why))
            if min(tried.length, event.step) > event.least * (1.0 + NEAR):
                event = replace(event, step=max(0.5 * tried.length, event.least), calm=0.0)
                continue
            if model.scene.is_unbounded:
                raise OtherRock(tried.why, event.as_progress(), spent.wasted, spent.rejected)
            regimes.log_onset(state, event.trials + spent.rejected, tried.why)
        entered = stepping.enter(state, regimes.moving, event.least)
        period = longest_period(model.operators, model.loads, state.sections)
        event = event.onset(entered, period, weak_waves(model, state, period))
        yield Step(entered, number, 0.0, spent, event.as_progress(), WAVES)
        state, spent = entered, StepReport()


class _Regimes:
    """Steps of both regimes of one stage."""

    def __init__(self, stepping: Stepping, number: int, log: Log, event: EventState, place: SubstepCursor) -> None:
        model, scene, least = stepping.model, stepping.model.scene, event.least
        self.end, self.longest = scene.stage[number].end or 0.0, scene.stage[number].time_step or 0.0
        self.stepping, self.model, self.log, self.scene, self.stage = stepping, model, log, scene, scene.stage[number]
        self.prescribed = prescribed(scene, inertia=False, splits=True, share=scene.accuracy.tolerance or SEEN)
        self.still, self.moving = (stepper_of(scene, self.stage, kind) for kind in (REST, WAVES))
        if not scene.is_unbounded:
            stepping.explicit.log_steps(self.moving, least)
            if not self.moving.explicit:
                stepping.couplings.expect(self.moving, least)
        events = most_events(stepping, self.moving, least)
        step = stepping.by(self.moving)
        step = EventLocated(step, stepping) if events else step
        by_rate = follows_slip(model, self.moving)
        step = BySlipRate(step, model, inertia=True) if by_rate else step
        shrinks = not scene.is_unbounded and not stepping.explicit.may_lengthen(self.moving)
        rules = Rules(most_halvings(scene), int(by_rate), events, MOST_HALVINGS * by_rate, shrinks=shrinks)
        self.waves = Substepped(step, rules, log, place)
        slow = model.slow.get(number)
        self.most = None if slow is None else slow.error
        self.decision = "" if slow is None else slow.name
        self.period = event.period
        self.vain = StepReport()
        self.coarse: dict[str, tuple[str, ...]] | None = None
        self.shaken = () if self.most is not None else excitations(scene, event.period)
        shakes, self.jumps = {span.start for span in self.shaken}, scene.jump_times
        self.corners = sorted({*self.prescribed.ends, *shakes} - {*self.jumps})

    def slow_step(self, state: State, event: EventState) -> Tried:
        """A step without inertia of the planned length, or the reason why it may not be taken. Collective."""
        time, jumps = self._target(state.time, event.step)
        ends = jumps or time >= self.end
        ahead = 0.0 if ends else self._target(time, event.step)[0] - time
        return replace(self._attempt(state, time, ahead=ahead), jumps=jumps)

    def accepted(self, time: float, event: EventState, tried: Tried, spent: StepReport) -> EventState:
        """The event after a step without inertia from a time, with the trials rejected on the way to it."""
        if spent.rejected >= REPORTED:
            rejected = f"{spent.rejected} trials rejected ({spent.wasted} Newton iterations)"
            self.log(f"time {time:.9g}: {rejected}; the step of {self.scene.time_text(tried.length, 3)} is taken")
        event = replace(event, calm=event.calm + 1.0, trials=event.trials + spent.rejected)
        if event.calm > CALM and tried.may_double:
            event = replace(event, step=min(2.0 * event.step, max(self.longest, event.least)), calm=0.0)
        if tried.jumps:
            after = self.longest * 0.5 ** halvings_given(self.scene)
            event = replace(event, step=max(min(event.step, after), event.least), calm=0.0)
        return event

    def log_onset(self, state: State, trials: float, why: str) -> None:
        """Log that an event begins as no step without inertia may be taken. Collective."""
        done = f"an event begins, after {trials:.0f} trials rejected"
        self.log(f"time {state.time:.9g}: {done}: {why}{self._coarse(state)}")
        if patch := patch_at_limit(self.model, state):
            self.log(f"time {state.time:.9g}: limit point: {patch.describe(self.scene)}")

    def _coarse(self, state: State) -> str:
        """Which fractures slide whose lengths of slip the mesh does not resolve, in words; empty if none. Collective."""
        if self.coarse is None:
            model, comm, mesh = self.model, self.model.operators.layout.comm, self.model.mesh
            found = on_root(comm, lambda: coarse_of_slip(model.scene, mesh, model.placed.wells) if mesh else {})
            self.coarse = comm.bcast(found, root=0)
        slides = fractures_of(self.model.operators.blocks, state.sections.is_sliding).split(", ")
        here = {what: [name for name in names if name in slides] for what, names in self.coarse.items()}
        said = [f"{what} in {of_fractures(names)}" for what, names in here.items() if names]
        return f"; of what slides the mesh does not resolve {', '.join(said)}" if said else ""

    def counted(self, report: StepReport) -> StepReport:
        """The report of a recorded step, with the trials without inertia that were rejected since the one before."""
        vain, self.vain = self.vain, StepReport()
        return report.after_trials(vain)

    def is_excited(self, time: float) -> str:
        """The excitation that begins at a time or has not ended; empty if there is none."""
        slack = max(3.0 * NEAR * self.longest, 3e-11 * abs(time))  # steps end just before a jump
        spans = (span for span in self.shaken if span.start <= time + slack)
        return next((span.why for span in spans if time < max(span.end, span.start + slack)), "")

    def _must_not_matter(self, old: State, new: State) -> None:
        """Raise ReductionInvalid, on every rank, where a step needs the inertia that the plan leaves out. Collective."""
        if self.most is None:
            return
        kinks = (time for table in self.scene.time_tables for time in table.times if time > new.time)
        left = min([self.end, *kinks]) - new.time  # to where a rate changes next
        if why := why_inertia(old, new, self.period, left, self.most):
            new.destroy()
            raise ReductionInvalid(self.decision, old.time, why)

    def _target(self, time: float, step: float) -> tuple[float, bool]:
        """Where a step ends: just before the next jump of what is prescribed; and whether it is there.

        Or else at the next corner of its table, which may be the peak of a pulse, or with the stage.
        """
        least = NEAR * self.longest
        ends = [(self.end, False)] if time + step > self.end - NEAR * step else [(time + step, False)]
        for jump in self.jumps:
            slack = max(least, 1e-11 * abs(jump))  # tables are sampled from the left there
            if time < jump - 2.0 * slack and ends[0][0] > jump - 2.0 * slack:
                ends.append((jump - slack, True))
        ends += [(bend, False) for bend in self.corners if time + least < bend < ends[0][0] - least]
        end, jumps = min(ends)
        while not self.prescribed.is_straight(time, end):
            end, jumps = 0.5 * (time + end), False
        return end, jumps

    def _attempt(
        self, state: State, time: float, radiated: float = RADIATED, iterations: int = BRIEF, ahead: float | None = None
    ) -> Tried:
        """A step without inertia whose slip radiates at most a share of the strength, or why there is none. Collective.

        iterations  as ``StepRequest.max_iterations``
        ahead       length of the step after it, as it is foreseen
        """
        dt, allowed, ops = time - state.time, self.scene.accuracy.step_error, self.model.operators
        request = StepRequest(time, dt, state.controls, self.model.loads, next_length=ahead)
        request = replace(request, expects_failure=True, max_iterations=iterations)
        try:
            new, report = self.stepping.step(state, request, self.still)
        except NotConverged as failure:
            if self.most is not None:
                raise ReductionInvalid(self.decision, state.time, "there is no step without it") from failure
            return Tried(str(failure).removeprefix(f"time {time:.6g}: ").partition(";")[0], failure.newton, length=dt)
        self._must_not_matter(state, new)
        slip = slipped(self.model, state, new, dt)
        why = slip.why_not(radiated)
        if not why and allowed is not None and state.motion.velocity.norm() > 0.0:
            error = step_error(ops, self.still, dt, state, new)
            why = f"an error of {error:.3g}" if error > allowed else ""
        elif why:
            why += f", most in {places_of(ops.blocks, slip.worst, ops.joints.natural)}"
        if not why:
            return Tried("", report.newton, new, report, slip.may_double, dt)
        new.destroy()
        return Tried(why, report.newton, length=dt)

    def wave_step(self, state: State, event: EventState) -> LoadStep:
        """The step with inertia that a state is in."""
        start = event.begun + event.count * event.least
        whole = min(event.least, self.end - start)
        return LoadStep(start, 1, whole, whole, whole, state.controls, self.model.loads, in_halves=False)

    def return_to_quasi_static(self, state: State, event: EventState) -> tuple[State | None, EventState, list[Trial]]:
        """The state taken over without inertia, if a step without inertia keeps the sliding sections; and the step tried.

        Collective.
        """
        trials: list[Trial] = []
        if not may_rest(self.model, state):
            return None, event, trials
        entered, still, lasted = self.stepping.enter(state, self.still), event.at_rest(), state.time - event.begun
        # long after motion has stopped, Newton's method may fail only because the step is so long
        first = max(min(still.step, longest_step(self.model, state)), event.least)
        for length in (first, event.least) if lasted > LONG * event.period else (first,):
            time = self._target(entered.time, length)[0]
            tried = self._attempt(entered, time, SETTLED * RADIATED, self.scene.accuracy.max_iterations)
            if tried.state is not None:
                tried.state.destroy()
                self.log(f"time {state.time:.9g}: at rest, {self.scene.time_text(lasted)} after the event began")
                return entered, replace(still, step=length), trials
            why, self.vain = tried.why, self.vain.with_rejected(tried.newton)
            trials.append(Trial(state.time, time - state.time, why))
        entered.destroy()
        self.log(f"time {state.time:.9g}: not at rest yet: without inertia there is {why}")
        return None, replace(event, loud=state.time), trials
