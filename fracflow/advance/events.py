"""A dynamic step ends at the first change of status of a joint section in it, as event-driven methods do.

Two states are connected by an integrator with all statuses held. Between them strains are the cubic through both ends'
strains and rates (Hermite), which for the trapezoidal rule is its own parabola. A wall without mass moves in proportion to the
nodes that carry its mass.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from fracflow._petsc import MPI
from fracflow.advance.outcome import Advance, Outcome
from fracflow.advance.step import Stepping
from fracflow.errors import NotConverged
from fracflow.integrators import Stepper
from fracflow.laws import LawStep
from fracflow.mesh.data import Bools, Floats
from fracflow.model.joints import Joints
from fracflow.model.state import State
from fracflow.solve.request import StepRequest

SAMPLES = 8  # instants at which a step is looked at: what leaves and returns between two of them is not seen
NARROW, MOST = 1e-12, 80  # of the step: how well a root is known, and evaluations for it
HALVED = 3  # every so many times its interval is halved, whatever the values say; always where they say nothing
LEAST = 1e-3  # of its interval: so far from either end it is looked for
FRICTION, CONTACT = 0, 1  # the two distances of ``JointLaw.approach``
TOGETHER = 1e-3  # of the step: events that lie so near behind the first are taken with it
NEAR = 1e-4  # of the step: how well the time of an event is known
REFINEMENTS = 6
BEYOND = 1.25  # a step towards an event looks so far past its own end for it
MANY = 16  # sliding sections: a crack, whose front passes sections one by one, and no block that sticks and slips


@dataclass(frozen=True)
class Event:
    """The first event in a step, with those just behind it.

    fraction  of the step, where the last of them lies
    sections  (s,) of this rank, whose friction changes its status there
    """

    fraction: float
    sections: Bools


def first_event(joints: Joints, old: State, new: State, dt: float, until: float = 1.0) -> Event | None:
    """The first event on the way from ``old`` to ``new``, ``dt`` apart [time], or past it up to ``until`` of the step.

    ``new`` was reached with the statuses of ``old``. None where there is none. Collective.
    """
    path = _path(joints, old, new, dt)
    friction, contact = _first_roots(joints, path, old, dt, until).T
    comm = joints.jump.getComm().tompi4py()
    here = min(friction.min(initial=np.inf), contact.min(initial=np.inf))
    first = comm.allreduce(float(here), op=MPI.MIN)
    if not np.isfinite(first):
        return None
    end = min(first + TOGETHER, until)
    near = [roots[roots <= end] for roots in (friction, contact)]
    last = comm.allreduce(float(max(part.max(initial=first) for part in near)), op=MPI.MAX)
    return Event(last, friction <= last)


Path = Callable[[Floats], tuple[Floats, Floats]]
"""Fractions (s,) of the step -> strains, and their rates times the step's length (s, dim), at each section."""


def _path(joints: Joints, old: State, new: State, dt: float) -> Path:
    start: Floats = old.sections.strain
    change: Floats = new.sections.strain - start
    # difference of a straight path's rate from the rates at either end
    left, right = (change - dt * joints.strain(state.motion.velocity) for state in (old, new))
    if joints.massless is not None:
        start, change, left, right = _without_mass(joints, (old, new), dt, (start, change, left, right))

    def at(fraction: Floats) -> tuple[Floats, Floats]:
        x = fraction[:, None]
        bend, lean = x * (1.0 - x), x * right - (1.0 - x) * left
        moved = change + (1.0 - 2.0 * x) * lean + bend * (left + right)
        return np.asarray(start + x * change + bend * lean, float), np.asarray(moved, float)

    return at


def _without_mass(joints: Joints, ends: tuple[State, State], dt: float, path: tuple[Floats, ...]) -> tuple[Floats, ...]:
    """The path with that of walls without mass, which move in proportion to the nodes that carry their mass. Collective.

    Closed, they follow it by a share, as the joint lets them; open, all the way. Where they part or meet on the way, the
    path is that of the open wall, which passes there at the same instant.
    """
    assert joints.massless is not None
    old, new = ends
    at_old, at_new = (joints.carried(state.motion.displacement) for state in ends)
    whole, (start, change, *_) = at_new - at_old, path
    follows = np.abs(change) <= np.abs(whole)
    share = np.where(follows, change, 0.0) / np.where(follows & (whole != 0.0), whole, 1.0)
    steps, past = (LawStep(old.time, 0.0, True), LawStep(new.time, dt, True)), old.sections.history
    gap = [
        joints.approach(state.sections.strain, change, past, step)[:, CONTACT]
        for state, step in zip(ends, steps, strict=True)
    ]
    opens, closes = (gap[0] < 0.0) & (gap[1] > 0.0), (gap[0] > 0.0) & (gap[1] < 0.0)
    free = np.zeros(start.shape, dtype=bool)
    free[:, -1] = opens | closes
    behind = np.where(opens[:, None], new.sections.strain - whole, start)
    share = np.where(free, 1.0, share)
    bends = [share * (whole - dt * joints.carried(state.motion.velocity)) for state in ends]
    found = (np.where(free, behind, start), np.where(free, whole, change), *bends)
    return tuple(np.where(joints.massless.components, its, other) for its, other in zip(found, path, strict=True))


def _first_roots(joints: Joints, path: Path, old: State, dt: float, until: float) -> Floats:
    """Fractions (s, 2) of the step at which a distance falls through zero, for contact either way; inf where it does not."""
    count = len(joints.weights)
    signs = np.ones((count, 2))

    def distances(fraction: Floats) -> Floats:
        step = LawStep(old.time + fraction * dt, fraction * dt, inertia=True)
        return signs * joints.approach(*path(fraction), old.sections.history, step)

    times = np.linspace(0.0, until, SAMPLES + 1)
    values = np.stack([distances(np.full(count, time)) for time in times])
    contact = values[..., CONTACT]
    signs[:, CONTACT] = np.sign(contact[np.argmax(contact != 0.0, axis=0), np.arange(count)])
    values[..., CONTACT] = signs[:, CONTACT] * contact
    falls = (values[:-1] >= 0.0) & (values[1:] < 0.0)
    roots = np.where(np.all(values < 0.0, axis=0), 0.0, np.inf)
    for kind in (FRICTION, CONTACT):
        there = falls[:, :, kind].any(axis=0)
        if there.any():
            first, every = np.argmax(falls[:, :, kind], axis=0), np.arange(count)
            above, below = values[first, every, kind], values[first + 1, every, kind]
            brackets = (times[first], times[first + 1]), (above, below)

            def distance(at: Floats, column: int = kind) -> Floats:
                return distances(at)[:, column]

            found = _fall(distance, *brackets, there)
            roots[:, kind] = np.where(there, found, roots[:, kind])
    return roots


def _fall(
    distance: Callable[[Floats], Floats], ends: tuple[Floats, Floats], values: tuple[Floats, Floats], there: Bools
) -> Floats:
    """Where ``distance`` has just fallen below zero between fractions with values of either sign: false position (Illinois)."""
    (low, high), (above, below) = ends, values
    stays = np.zeros(len(low))  # 1 where it was the upper end that stayed last, -1 where the lower
    for turn in range(MOST):
        wide = there & (high - low > NARROW)
        if not wide.any():
            break
        slopes = wide & np.isfinite(above) & (above > 0.0) & (turn % HALVED != 1)
        share = np.full(len(low), 0.5)
        np.divide(above, above - np.where(slopes, below, 0.0), out=share, where=slopes)
        middle = low + np.clip(share, LEAST, 1.0 - LEAST) * (high - low)  # of an interval that has its root at one end
        value = distance(middle)
        beyond = value < 0.0
        # an end that stays twice counts half, or the other would creep up to it
        above = np.where(beyond, np.where(stays < 0.0, 0.5, 1.0) * above, value)
        below = np.where(beyond, value, np.where(stays > 0.0, 0.5, 1.0) * below)
        low, high = np.where(beyond, low, middle), np.where(beyond, middle, high)
        stays = np.where(beyond, -1.0, 1.0)
    return high


def most_events(stepping: Stepping, stepper: Stepper, dt: float) -> int:
    """Number of events at which substeps of one step of length ``dt`` may end; 0 without inertia. Collective."""
    scene = stepping.model.scene
    locates = stepper.inertia and not scene.is_unbounded and scene.method.events != "at-step-ends"
    return scene.accuracy.max_events if locates and stepping.explicit.locates(stepper, dt) else 0


@dataclass(frozen=True)
class EventLocated:
    """Ends a substep at the first event in it.

    The substep is computed with all statuses held, then again up to where the first section changes its status. The section
    changes there, and accelerations follow. A section that would change as the substep begins does so at once, but once only.
    If it would change back, statuses change as they do without location.
    """

    inner: Advance
    stepping: Stepping

    def advance(self, state: State, request: StepRequest) -> Outcome:
        """The state at the first event, after it, or at the end where there is none.

        Raises SolveError, on every rank. Collective.
        """
        if not request.may_stop or not _are_sought(self.stepping, state):
            return self.inner.advance(state, request)
        start, held, joints = state, replace(request, hold=True), self.stepping.model.operators.joints
        try:
            try:
                found = self.inner.advance(start, held)
            except NotConverged:  # where no state keeps every status
                return self.inner.advance(start, request)
            event = first_event(joints, start, found.state, request.length)
            if event is not None and event.fraction <= NEAR:
                found.state.destroy()
                start = self.stepping.change(state, event.sections)
                found = _after(self.inner.advance(start, held), found)
                event = first_event(joints, start, found.state, request.length)
                if event is not None and event.fraction <= NEAR:
                    found.state.destroy()
                    return _after(self.inner.advance(start, request), found)
            share, last = 1.0, event  # of the last substep, and the event at its end
            for _ in range(REFINEMENTS):
                if event is None:
                    return found
                last, aim = event, min(event.fraction * share, 1.0)
                if abs(aim - share) <= NEAR:
                    break
                found.state.destroy()
                if aim <= NEAR:  # it returned to where it began: there is no way to keep the statuses
                    return _after(self.inner.advance(start, request), found)
                found = _after(self.inner.advance(start, held.shortened(start.controls, aim)), found)
                share = aim
                event = first_event(joints, start, found.state, share * request.length, BEYOND)
            return found if event is None or last is None else self._changed(found, last)
        finally:
            if start is not state:
                start.destroy()

    def _changed(self, found: Outcome, event: Event) -> Outcome:
        """The same after the event that it ends at. Collective."""
        count = self.stepping.model.operators.layout.comm.allreduce(int(event.sections.sum()), op=MPI.SUM)
        if count == 0:
            return found
        try:
            after = self.stepping.change(found.state, event.sections)
        finally:
            found.state.destroy()
        return replace(found, state=after, report=replace(found.report, located=found.report.located + count))


def _after(found: Outcome, earlier: Outcome) -> Outcome:
    """The same with the cost of an earlier advance, whose state was discarded."""
    return replace(found, report=found.report.after(earlier.report))


def _are_sought(stepping: Stepping, state: State) -> bool:
    """Whether a step from here ends at events: always, or with events = "auto" where few sections slide. Collective.

    The limit grows with the number of sections, so that refining the mesh does not change the rule; rigid rock slides all at
    once.
    """
    scene = stepping.model.scene
    if scene.method.events == "located" or all(rock.rigid for rock in scene.rock.values()):
        return True
    sliding = int(np.count_nonzero(state.sections.is_sliding))
    return int(stepping.model.operators.layout.comm.allreduce(sliding, op=MPI.SUM)) < MANY * 2**scene.refine
