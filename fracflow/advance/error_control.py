"""The accuracy that a scene requires: what error its substeps may have, and where they are very short for a vibration."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from fracflow._petsc import MPI, PETSc
from fracflow.advance.explicit import ExplicitSteps
from fracflow.advance.outcome import Advance, Outcome
from fracflow.advance.prescribed_times import AT_A_TIME, bends_of, latest
from fracflow.advance.step_error import (
    LEAST,
    Vibration,
    displacement_since,
    largest_displacement,
    local_error,
    step_error,
    swing_of,
    vibration,
)
from fracflow.errors import SolveError
from fracflow.integrators import FlowRule, Rates, Stepper, storage_error
from fracflow.mesh.data import Floats
from fracflow.model.compressibility import compression_of
from fracflow.model.setup import Model
from fracflow.model.state import StageStart, State
from fracflow.scene.boundary import Stage
from fracflow.solve.request import MOST_GROWTH, StepRequest

MOST_PARTS = 1e5  # of the rest of a stage: more substeps are reported
WATCHED = 500  # substeps in a row before the report: some periods of the vibration
FINEST = 24  # halvings of a step that a tolerance may demand: flow after a jump of pressure begins so
PASSING = 0.5  # of the allowed error, for what is gone once flow comes to rest; the rest is for what adds up
LATE = 2.0  # allowed error of fracture flow at the end of a stage, over that at its beginning
SOLVED = 1e-9  # of the changes of the whole run: what Newton's method may leave of them is no error of time steps


@dataclass(frozen=True)
class _Tried:
    """End of a substep, its size and error as in ``ErrorEstimator``, and the vibration that makes it very short.

    passing  the part of the error that is gone once flow comes to rest; with it ``error`` is nothing
    """

    time: float
    size: float
    error: float
    follows: Vibration
    passing: float = 0.0


class ErrorEstimator:
    """Whether the substeps of a stage are as accurate as the scene requires, and relative to which size.

    ``accuracy.step_error`` limits the error that a substep adds; ``accuracy.tolerance`` allows it a share of itself. With
    inertia errors stay and add up: the share is dt/(length of the stage). Without inertia only storage in the fractures has a
    history: the share is dt/(time since the stage began), as fracture flow drains and earlier errors decay. That time restarts
    where a prescribed value jumps or bends. The share falls to a third towards the end of the stage, as errors made there
    stay. With neither key there is no estimate.

    Errors of both signs follow each other where a front of pressure fills one joint after another, and after a jump. Their sum
    is small, however many they are (``passing_error``). A substep in which it is half of the tolerance is accurate too; the
    other half is shared by the rest.

    The end of a substep, and of rejected ones, shows how far the motion will go. That holds only until accepted states have
    come as far: a long substep may end on the peak of a short load.

    Changes count from the start of the stage (``begun``): those of a small pumping are not lost in what a large load did
    before it. Smaller ones than SOLVED/tolerance of those since the start of the run are not followed.
    """

    def __init__(
        self, model: Model, stage: Stage, stepper: Stepper, start: float, progress: Mapping[str, float]
    ) -> None:
        """For a stage from ``start`` [time]; ``progress`` is what ``as_progress`` gave."""
        self.operators, self.loads, self.stepper, self.start = model.operators, model.loads, stepper, start
        asked = model.scene.accuracy
        self.by_step, self.tolerance = asked.step_error, asked.tolerance
        by_sum = self.by_step is None and self.tolerance is not None
        self.of_flow = by_sum and stepper.storage and not stepper.inertia and model.operators.flow is not None
        # of the allowed error, for the sum of those that do not pass
        self.adding = 1.0 - PASSING if self.of_flow and cast(FlowRule, stepper).has_passing_error else 1.0
        # where fracture flow begins anew, since earlier steps do not predict later ones
        self.bends = bends_of(model.scene.time_tables, self.tolerance) if self.of_flow and self.tolerance else {}
        # less is round-off
        self.least = LEAST * (self._volume() if self.of_flow else self.operators.scales.length) if by_sum else 0.0
        self.length = None if stage.step_count(start) is None else stage.finish(start) - start
        self.largest = progress.get("farthest", 0.0)
        self.last = progress.get("last", 0.0)  # length of the last part [time]
        self.guess = progress.get("guess", 0.0)  # as ``largest``, of parts that were refused, before the time ``until``
        self.until = progress.get("until", start)
        self.error_now = progress.get("error_now", 0.0)  # of all parts so far, and the largest yet: as ``largest``
        self.error_most = progress.get("error_most", 0.0)
        self.tried: _Tried | None = None
        self.follows = Vibration.of(progress)
        # without inertia and fluid, time has no part in what a step ends with
        estimates = self.by_step is not None or self.of_flow or (by_sum and stepper.inertia)
        self.order = stepper.order if estimates else 0
        self.finest = FINEST if estimates and by_sum else 0

    @property
    def statement(self) -> str:
        """The tolerance and the size to which it is relative, for the log."""
        of = "volume stored in fractures" if self.of_flow else "displacements"
        return f"accuracy.tolerance = {self.tolerance:g} of {of}"

    @property
    def reached(self) -> float:
        """The estimated error of the stage so far, of the largest size."""
        return self.error_most / max(self.largest, float(np.finfo(float).tiny))

    @property
    def missed(self) -> bool:
        """Whether that error is above the tolerance."""
        return self.tolerance is not None and self.reached > self.tolerance

    @property
    def summary(self) -> str:
        """The estimated error of the stage, for the log."""
        of = "volume stored in fractures" if self.of_flow else "displacement"
        missed = ", more than asked: substeps could not be shorter, or the motion stayed smaller than expected"
        missed = missed if self.missed else ""
        return (
            f"time steps made an error of {self.reached:.2g} (estimated) of the largest {of}, accuracy.tolerance ="
            f" {self.tolerance:g}{missed}; that of the mesh is not in it (--converge)"
        )

    def error(self, dt: float, part: float, old: State, new: State) -> float:
        """Error of a step over the allowed one; ``part`` is the length of the equal substeps of ``dt``. Collective."""
        if self.order == 0:
            return 0.0
        if self.by_step is not None:
            return step_error(self.operators, self.stepper, part, old, new, self.largest) / self.by_step
        assert self.tolerance is not None
        self._use_rejected()
        size = self._size(new)
        largest = max(self.largest, self.guess, size)
        passing, allowed = np.inf, max(self.tolerance * largest, float(np.finfo(float).tiny))
        if self.of_flow:
            error, passing = self._flow_error(dt, old, new)
            span = self._span(old.time, new.time) / self.adding
        else:
            error = local_error(self.operators, self.stepper, part, old, new)
            span = new.time - self.start if self.length is None else self.length
        over = error / (allowed * min(1.0, dt / span))
        if passes := passing / (PASSING * allowed) < over:
            over, error = passing / (PASSING * allowed), 0.0
        self.tried = _Tried(new.time, size, error, self._followed(dt, part, old, new), passing if passes else 0.0)
        return over

    def _span(self, begin: float, end: float) -> float:
        """Time over which a substep of fracture flow gets its share of the allowed error; anew from each bend, by its size."""
        since, bend = end - self.start, latest(self.bends, begin)
        anew = since if bend is None or bend < self.start else (end - bend) / self.bends[bend]
        return min(since, anew) * (1.0 + LATE * since / (self.length or np.inf))

    def _left(self, time: float, dt: float) -> float:
        """Number of substeps of such a length that remain in the stage; 0 where it is not known."""
        return 0.0 if self.length is None else (self.start + self.length - time) / dt

    def _followed(self, dt: float, part: float, old: State, new: State) -> Vibration:
        """The motion that makes a substep short, where very many remain. Collective."""
        if not self._left(new.time, dt) > MOST_PARTS:
            return Vibration()
        is_known = part == dt and not self.of_flow
        return vibration(self.operators, self.stepper, dt, old, new) if is_known else Vibration(1)

    def outlook(self, time: float) -> str:
        """A line on the remainder of a stage whose substeps have long been very short; "" elsewhere.

        Raises SolveError, on every rank, where they follow a vibration smaller than the allowed error. Errors of its
        phase are counted as if they added up, but come to twice its amplitude at most. A run that is resumed goes on.
        """
        if self.follows.parts != WATCHED or self.tolerance is None:
            return ""
        amplitude, period = swing_of(self.follows.acceleration, self.follows.jerk)
        largest = max(self.largest, self.guess)
        asked = (
            f"time {time:.6g}: {self.statement} needs substeps as short as {self.last:.2g}, about"
            f" {self._left(time, self.last):.1g} more of them"
        )
        if not math.isfinite(amplitude):
            return asked
        follows = (
            f"They follow a vibration {self.follows.place} of period {period:.2g} and amplitude {amplitude:.2g},"
            f" {amplitude / max(largest, float(np.finfo(float).tiny)):.1g} of the largest displacement"
        )
        if 2.0 * amplitude > self.tolerance * largest:
            return f"{asked}. {follows}"
        raise SolveError(
            f'{asked}, which gain nothing. {follows}: take kind = "quasi-static", accuracy.step_error ='
            f" {self.tolerance:g} or resume"
        )

    def _use_rejected(self) -> None:
        """Take the size of the motion from the last rejected trial.

        Of two substeps with the same end the later, shorter one is more accurate.
        """
        if self.tried is not None:
            ends_last = self.tried.time >= self.until
            self.guess = self.tried.size if ends_last else max(self.guess, self.tried.size)
            self.until = max(self.until, self.tried.time)
            self.tried = None

    def accept(self, state: State, dt: float) -> None:
        """Accept the state at the end of a substep of length ``dt``. Collective."""
        self.last, self.largest = dt, max(self.largest, self._size(state))
        if self.tried is not None:
            left = max(0.0, 1.0 - dt / (state.time - self.start)) if self.of_flow else 1.0
            self.error_now = left * self.error_now + self.tried.error
            self.error_most = max(self.error_most, self.error_now, self.tried.passing)
            seen = self.tried.follows
            self.follows = self.follows.followed_by(seen) if seen.parts else seen
            self.tried = None
        if state.time >= self.until:
            self.guess = 0.0

    def as_progress(self) -> dict[str, float]:
        """The numbers that a checkpoint stores."""
        kept = {name: getattr(self, name) for name in ("last", "guess", "until", "error_now", "error_most")}
        return {"farthest": self.largest, **kept, **self.follows.as_progress()}

    def begun(self, state: State) -> State:
        """A state with which the stage begins, with what its changes count from. It has the same vectors. Collective."""
        if self.tolerance is None or not self.finest:
            return state
        moved = state.motion.values().displacement.copy()
        return replace(state, stage_start=StageStart(moved, self._compressed(state)))

    def _size(self, state: State) -> float:
        """Largest displacement, or the volume that walls and compression have taken up or released, in the stage.

        Each counts by itself: in a sealed fracture both are the same, and fluid that stays where it is adds up to nothing.
        """
        if self.tolerance is None or not self.finest:
            return largest_displacement(self.operators, state)
        ever = self._changed(state, None)
        changed = ever if state.stage_start is None else self._changed(state, state.stage_start)
        return max(changed, self.least, SOLVED / self.tolerance * ever)

    def _changed(self, state: State, since: StageStart | None) -> float:
        """The same of a stage, or of the run, as it is. Collective."""
        if not self.of_flow:
            return largest_displacement(self.operators, state, since)
        walls = displacement_since(state, since)
        moved, compressed = self._sum(self._room(walls)), self._compressed(state)
        walls.destroy()
        if compressed is None:
            return moved
        before = None if since is None else since.compressed
        return moved + self._sum(compressed if before is None else compressed - before)

    def _compressed(self, state: State) -> Floats | None:
        """Fluid (f,) that compression holds at this rank's flow nodes [volume per thickness]; None without. Collective."""
        found, flow = compression_of(self.operators, state), self.operators.flow
        return None if found is None or flow is None else flow.at_nodes(found.held)

    def _volume(self) -> float:
        """Volume of all fractures at their initial apertures [volume per thickness]. Collective."""
        network = self.operators.network
        return self._sum(network.aperture * 0.5 * network.length[:, None])

    def _flow_error(self, dt: float, old: State, new: State) -> tuple[float, float]:
        """Volume that a substep puts in the wrong place, and that of ``passing_error`` [volume per thickness]. Collective."""
        before, after = ((state.motion.velocity, state.uptake) for state in (old, new))
        last, passing, passed = self.last, after, before
        if self.stepper.memory:
            last = old.previous_step.time_step
            passing = new.previous_step.velocity, new.previous_step.uptake
            passed = (old.previous_step.velocity, old.previous_step.uptake) if last > 0.0 else before
        bend = latest(self.bends, old.time)
        at_bend = bend is not None and math.isclose(bend, old.time, rel_tol=AT_A_TIME)
        if at_bend or (self.stepper.memory and dt > MOST_GROWTH * last):
            last = 0.0
        rates = Rates(self._rate(before), self._rate(after), self._rate(passing), self._rate(passed), last)
        rule, found = cast(FlowRule, self.stepper), []
        for wrong in (storage_error(rule, dt, rates), rule.passing_error(dt, rates) if last > 0.0 else None):
            if wrong is not None:
                wrong[self.loads.given_pressures] = 0.0  # there walls follow the pressure, whatever the step
            found.append(np.inf if wrong is None else self._sum(wrong))
        return found[0], found[1]

    def _rate(self, of: tuple[PETSc.Vec | None, PETSc.Vec | None]) -> Floats:
        """Rate of storage at this rank's flow nodes: of velocities of walls, and what compression takes up. Collective."""
        walls, taken = of
        assert walls is not None
        return self._room(walls) + (0.0 if taken is None else taken.getArray(readonly=True))

    def _room(self, walls: PETSc.Vec) -> Floats:
        assert self.operators.flow is not None
        return self.operators.flow.swept(walls)

    def _sum(self, at_nodes: Floats) -> float:
        return float(self.operators.layout.comm.allreduce(float(np.abs(at_nodes).sum()), op=MPI.SUM))


@dataclass(frozen=True)
class ErrorControlled:
    """Adds the estimated error of a substep, over the allowed one, to its outcome."""

    inner: Advance
    estimator: ErrorEstimator
    explicit: ExplicitSteps

    def advance(self, state: State, request: StepRequest) -> Outcome:
        """The same with its error. Raises SolveError, on every rank. Collective."""
        found, estimator = self.inner.advance(state, request), self.estimator
        assert request.step is not None
        length = request.step.length * (found.reached - request.begin)
        error = estimator.error(length, self.explicit.part(estimator.stepper, length), state, found.state)
        return replace(found, error=error)
