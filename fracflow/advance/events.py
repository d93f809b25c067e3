"""A dynamic step ends at the first change of status of a joint section in it, as event-driven methods do."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from fracflow._petsc import MPI
from fracflow.advance.event_kinds import Event, first_event
from fracflow.advance.step import Stepping
from fracflow.advance.substeps import Attempted
from fracflow.errors import NotConverged
from fracflow.model.state import State, StepReport

NEAR = 1e-4  # of the step: how well the time of an event is known
REFINEMENTS = 6
BEYOND = 1.25  # a step towards an event looks so far past its own end for it
MANY = 16  # sliding sections: a crack, whose front passes sections one by one, and no block that sticks and slips

Take = Callable[[State, float, bool], tuple[State, StepReport]]
"""(state, fraction of the step, hold) -> the state there, with every status held or free to change."""
Reach = Callable[[State, float, float, bool], tuple[State, StepReport]]
"""(state, fraction of the part, the same as a fraction of the step, hold) -> the state there."""


def take_part(
    stepping: Stepping, state: State, reach: Reach, begin: float, end: float, dt: float, may_stop: bool
) -> Attempted:
    """The part of a step, ``dt`` long, between two fractions of it, or up to the first event in it if it may stop there.

    Raises SolveError, on every rank. Collective.
    """

    def place(share: float) -> float:
        return end if share == 1.0 else begin + share * (end - begin)

    def take(old: State, share: float, hold: bool) -> tuple[State, StepReport]:
        return reach(old, share, place(share), hold)

    new, report, share = to_first_event(stepping, state, take, dt) if may_stop else (*take(state, 1.0, False), 1.0)
    return Attempted(new, report, place(share))


def to_first_event(stepping: Stepping, state: State, take: Take, dt: float) -> tuple[State, StepReport, float]:
    """The state at the first event of a step of length ``dt``, after it, or at the end where there is none.

    The step is taken with all statuses held, and again to where the first section leaves its own; there the section
    changes, and accelerations follow. One that would leave as the step begins does so at once, but once only: should it
    want to return, statuses change as they do without location. Raises SolveError, on every rank. Collective.
    """
    if not _are_sought(stepping, state):
        return *take(state, 1.0, False), 1.0
    start = state
    try:
        try:
            new, report = take(start, 1.0, True)
        except NotConverged:  # where no state keeps every status
            return *take(start, 1.0, False), 1.0
        event = first_event(stepping.model.operators.joints, start, new, dt)
        if event is not None and event.fraction <= NEAR:
            new.destroy()
            start = stepping.change(state, event.sections)
            new, more = take(start, 1.0, True)
            report = more.after(report)
            event = first_event(stepping.model.operators.joints, start, new, dt)
            if event is not None and event.fraction <= NEAR:
                new.destroy()
                new, more = take(start, 1.0, False)
                return new, more.after(report), 1.0
        return (new, report, 1.0) if event is None else _approach(stepping, start, new, report, event, take, dt)
    finally:
        if start is not state:
            start.destroy()


def _are_sought(stepping: Stepping, state: State) -> bool:
    """Whether a step from here ends at events: always, or with events = "auto" where few sections slide. Collective.

    How many are many grows with the mesh, so that refining it does not change the rule; rigid rock slides all at once.
    """
    scene = stepping.model.scene
    if scene.method.events == "located" or all(rock.rigid for rock in scene.rock.values()):
        return True
    sliding = int(np.count_nonzero(state.sections.is_sliding))
    return int(stepping.model.operators.layout.comm.allreduce(sliding, op=MPI.SUM)) < MANY * 2**scene.refine


def _approach(
    stepping: Stepping, start: State, new: State, report: StepReport, event: Event, take: Take, dt: float
) -> tuple[State, StepReport, float]:
    """From a state past an event to the one at it, by steps that hold every status; ``new`` is used up. Collective."""
    reached = 1.0
    leaving = np.zeros_like(event.sections)
    for _ in range(REFINEMENTS):
        aim = min(event.fraction * reached, 1.0)
        leaving = event.sections
        if abs(aim - reached) <= NEAR:
            break
        new.destroy()
        if aim <= NEAR:  # it returned to where it began: there is no way to keep the statuses
            new, more = take(start, 1.0, False)
            return new, more.after(report), 1.0
        new, more = take(start, aim, True)
        report, reached = more.after(report), aim
        found = first_event(stepping.model.operators.joints, start, new, aim * dt, BEYOND)
        if found is None:
            leaving = np.zeros_like(leaving)
            break
        event = found
    comm = stepping.model.operators.layout.comm
    count = comm.allreduce(int(leaving.sum()), op=MPI.SUM)
    if count == 0:
        return new, report, reached
    try:
        after = stepping.change(new, leaving)
    finally:
        new.destroy()
    return after, replace(report, located=report.located + count), reached
