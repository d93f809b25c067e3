"""The request for a step and its rule; and the step of a stage, of which requests are substeps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from fracflow._petsc import PETSc
from fracflow.integrators import Alphas
from fracflow.model.loads import Loads
from fracflow.scene.time_table import AT_ONCE, Around, Rates

AT_A_JUMP = 1e-9  # of a step: times so near are one


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
        return StepRequest(
            self.time(end),
            length,
            controls,
            self.loads,
            unapplied=unapplied,
            next_length=ahead,
            step=self,
            begin=begin,
            end=end,
        )


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

    def demanded(self, request: StepRequest, well: str) -> float:
        """Flow rate that a well demands in a step, over the whole depth [volume rate]."""
        return request.loads.demanded(well, request.time, request.controls, self.adjacent, self.rates)


def to_next(times: Sequence[float], now: float, length: float) -> float:
    """Time to the next of some ascending times, or ``length``, if that is less."""
    return min([length, *(time - now for time in times if time - now > AT_A_JUMP * length)])


def on_the_way(before: Mapping[str, float], after: Mapping[str, float], start: float, end: float) -> dict[str, float]:
    """Controls at the fraction ``end`` of a step that goes on to ``after``, from ``before`` at the fraction ``start``."""
    if end == 1.0:
        return dict(after)
    share = (end - start) / (1.0 - start)
    return {name: value + share * (after[name] - value) for name, value in before.items()}
