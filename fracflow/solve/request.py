"""The request for a step, and the step of a stage, of which requests are substeps; the rule of a step.

A rule samples tables in time so that their whole integral enters the solution. With inertia, forces and flow rates are sampled
so that the trapezoid's sum over the steps is the table's integral, and jumps of pressures likewise. Without it what is
prescribed holds as just before the end of the step: what jumps there comes in the step after it. Flow rates are then sampled
as the rule takes the derivative of what is stored.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fracflow._petsc import PETSc
from fracflow.integrators import Alphas, Stepper
from fracflow.mesh.data import Floats
from fracflow.model.loads import Limit, Loads
from fracflow.model.state import PreviousStep, State
from fracflow.scene.time_table import AT_ONCE, JUST_AFTER, JUST_BEFORE, Around, Rates, TimeTable

AT_A_JUMP = 1e-9  # of a step: times so near are one
MOST_GROWTH = 1.0 + 2.0**0.5
"""Of steps in a row: up to here BDF2 is stable. A longer one after a short ramp would carry the walls on at its speed."""


@dataclass(frozen=True)
class StepRequest:
    """One step that is to be made from a state.

    time             at its end [time]
    length           of the step [time]; 0 where time has no part
    controls         value of each load factor at its end
    loads            loads, wells and supports that act
    restraint        a force (n,) beside the loads [force per thickness]; None for none
    unapplied        share of what the state lacks of the prescribed that does not arrive in this step [1]
    hold             all joint sections keep their status, whatever their tractions
    next_length      length of the next step, 0 where the stage ends or this one is cut at a jump; None for one as long as
                     this one [time]
    expects_failure  a failure costs little: where statuses cycle, it is given up early, and not passed to another solver
    max_iterations   while no section changes, where accuracy.max_iterations is more; 0 for no such limit
    may_stop         it may end at an event before its end
    step             the step of a stage that this is a part of, from its fraction ``begin`` to ``end``; None for one by itself
    """

    time: float
    length: float
    controls: Mapping[str, float]
    loads: Loads
    restraint: PETSc.Vec | None = None
    unapplied: float = 0.0
    hold: bool = False
    next_length: float | None = None
    expects_failure: bool = False
    max_iterations: int = 0
    may_stop: bool = False
    step: LoadStep | None = None
    begin: float = 0.0
    end: float = 1.0

    def shortened(self, before: Mapping[str, float], share: float) -> StepRequest:
        """The first ``share`` of the same part, from a state with the controls ``before``; the rest of the step follows it."""
        if share == 1.0:
            return self
        assert self.step is not None
        to = self.begin + share * (self.end - self.begin)
        asked = self.step.part(before, self.begin, to)
        return replace(asked, length=share * self.length, next_length=self.step.after(to), hold=self.hold)


@dataclass(frozen=True)
class LoadStep:
    """A step of a stage with its prescribed values; substeps are fractions of it.

    start      of the stage [time]
    number     of the step in it, from 1
    spacing    length of the stage's steps [time]; 0 where time has no part
    length     of this one: the last may be shorter [time]
    following  length of the one after it [time]; 0 where the stage ends
    controls   value of each load factor at its end
    loads      loads, wells and supports that act
    ends       times, ascending, at which parts end, as something prescribed jumps or bends
    jumps      those at which something jumps
    fills      a jump is applied whole by the end of the substep; else it is spread evenly over the step
    in_halves  a part is expected to be followed by one as long; else by all the rest of the step
    """

    start: float
    number: int
    spacing: float
    length: float
    following: float
    controls: Mapping[str, float]
    loads: Loads
    ends: Sequence[float] = ()
    jumps: Sequence[float] = ()
    fills: bool = True
    in_halves: bool = True

    def time(self, fraction: float) -> float:
        """When a fraction of it is over [time]."""
        if self.spacing == 0.0:
            return self.start
        return self.start + (self.number - 1 + fraction * (self.length / self.spacing)) * self.spacing

    def after(self, fraction: float) -> float:
        """Planned length of the substep that follows a fraction of it: up to the next end of substeps [time]."""
        if self.spacing == 0.0 or (fraction == 1.0 and self.following == 0.0):
            return 0.0
        length = self.following if fraction == 1.0 else (1.0 - fraction) * self.length
        return to_next(self.ends, self.time(fraction), length)

    @property
    def begin(self) -> float:
        """When it begins [time]."""
        return self.start + (self.number - 1) * self.spacing

    def first(self, times: Sequence[float], begin: float, end: float) -> float | None:
        """The fraction at which the first of some times lies that comes after ``begin``, up to ``end``; None for none."""
        for time in times:
            place = (time - self.begin) / self.length
            if begin + AT_A_JUMP < place <= end + AT_A_JUMP:
                return end if place > end - AT_A_JUMP else place
        return None

    def part(self, before: Mapping[str, float], begin: float, end: float) -> StepRequest:
        """The request between two fractions of it, from a state with the controls ``before``."""
        length, ahead = self.length * (end - begin), self.after(end)
        if end < 1.0 and self.in_halves:
            ahead = min(ahead, length)
        there = self.first(self.jumps, begin, 1.0) or 1.0  # all that was prescribed as the part begins
        unapplied = 0.0 if self.fills else (there - end) / (there - begin)
        controls = on_the_way(before, self.controls, begin, end)
        made = StepRequest(self.time(end), length, controls, self.loads, unapplied=unapplied, next_length=ahead)
        return replace(made, step=self, begin=begin, end=end)


@dataclass(frozen=True)
class StepRule:
    """How a step takes rates at its end, and samples what is tabled in time.

    alphas    (4.3), its coefficients of velocity and acceleration
    adjacent  lengths of the step and of the one that follows, over halves of which a jump in time is spread [time]
    rates     how flow rates are sampled, if not as above; without inertia jumps of supports are as ``adjacent`` says
    inertia   the mass matrix takes part
    """

    alphas: Alphas
    adjacent: Around = AT_ONCE
    rates: Rates | None = None
    inertia: bool = False

    @property
    def is_instant(self) -> bool:
        """Whether only pressures and accelerations are sought: nothing moves."""
        return self.inertia and self.alphas.a0 == 0.0

    def demanded(self, request: StepRequest, well: str) -> float:
        """Flow rate that a well demands in a step, over the whole depth [volume rate]."""
        return request.loads.demanded(well, request.time, request.controls, self.adjacent, self.rates)

    def shut(self, request: StepRequest, well: str) -> float:
        """Flow rate at the end of a step over which a well brings nothing, over the whole depth [volume rate]."""
        rates = self.rates or Rates(around=self.adjacent)
        return rates.of(TimeTable.constant(0.0), request.time, None, request.controls, well)

    def pushes(self, request: StepRequest, limit: Limit) -> bool:
        """Whether a well's flow rate in a step drives its pressure towards a limit."""
        return limit.sign * (self.demanded(request, limit.well) - self.shut(request, limit.well)) > 0.0


def to_next(times: Sequence[float], now: float, length: float) -> float:
    """Time to the next of some ascending times, or ``length``, if that is less."""
    return min([length, *(time - now for time in times if time - now > AT_A_JUMP * length)])


def on_the_way(before: Mapping[str, float], after: Mapping[str, float], start: float, end: float) -> dict[str, float]:
    """Controls at the fraction ``end`` of a step that goes on to ``after``, from ``before`` at the fraction ``start``."""
    if end == 1.0:
        return dict(after)
    share = (end - start) / (1.0 - start)
    return {name: float(between(value, after[name], share)) for name, value in before.items()}


def between(before: float, after: float, share: float | Floats) -> float | Floats:
    """A value once shares (k,) of its change are made: exactly ``after`` once all is."""
    return np.where(share == 1.0, after, before + share * (after - before))


def sides_of(rule: Stepper, dt: float, ahead: float | None) -> Around:
    """Lengths of the steps around the end of one of length ``dt`` that one of length ``ahead`` follows; None: one as long."""
    if rule.inertia:
        return dt, dt if ahead is None else ahead
    return JUST_BEFORE if dt > 0.0 else JUST_AFTER


def rule_of(stepper: Stepper, state: State, request: StepRequest, follows: Stepper) -> StepRule:
    """How a step by a rule takes rates and samples what is tabled; ``follows``, the rule of the steps after it.

    Flow rates are not sampled apart with inertia, where a rule weighs both its ends. Backward Euler takes their mean over the
    step; BDF2 combines it with that over the last step as it does those of the walls' velocities. Of a well that has a limit
    the last mean is of the rate that went through it, whatever its table says. The trapezoid takes the value at the end, with
    the difference of its sum from the integral of the step. Where it begins by backward Euler, that step corrects for the half
    by which the next one counts its end.
    """
    dt, ahead, last, begin = request.length, request.next_length, state.previous_step.time_step, state.time
    alphas = stepper.alphas(dt, last) if last > 0.0 else stepper.alphas(dt)
    adjacent = sides_of(stepper, dt, ahead)
    rates: Rates | None = Rates(now=1.0, share=0.0, begin=begin)
    if stepper.inertia:
        rates = Rates(now=1.0, share=0.0, begin=begin, of_forces=True) if stepper.balance == "end" else None
    elif not stepper.storage or dt == 0.0:
        rates = Rates(around=adjacent)
    elif alphas.a4 > 0.0:
        rates = Rates(around=(dt, ahead or 0.0))
    elif follows.alphas(dt).a4 > 0.0 and ahead:
        share = 0.5 * ahead / (dt + 0.5 * ahead)
        rates = Rates(now=1.0 - share, share=share, around=(0.0, ahead), begin=begin)
    elif alphas.a6 > 0.0 and last > 0.0:
        factors, through = (alphas.a1 * dt, alphas.a6), state.previous_step.through
        rates = Rates(*factors, 0.0, begin=begin, before=begin - last, controls=state.controls, through=through)
    return StepRule(alphas, adjacent, rates, stepper.inertia)


def begins_anew(rule: Stepper, begin: float, previous: PreviousStep, request: StepRequest) -> bool:
    """Whether a step from the time ``begin`` of a multistep rule is taken by backward Euler, without the previous step.

    There is no previous step, or one that is far shorter. Or the next length is not known, by which a rule that
    weighs both ends divides the integral of a table. Or a rate jumps as the step begins, of which such a rule would take half.
    """
    dt, ahead = request.length, request.next_length
    if not rule.memory or previous.time_step == 0.0 or dt > MOST_GROWTH * previous.time_step:
        return True
    if rule.alphas(dt).a4 == 0.0:
        return False
    tables = [well.value for well in request.loads.wells if isinstance(well.value, TimeTable)]
    if any(begin < time < begin + 0.5 * dt for table in tables for time in table.jumps[0]):
        return True
    return ahead is None and any(begin < time < begin + dt for table in tables for time in table.times)
