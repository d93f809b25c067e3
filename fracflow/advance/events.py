"""A dynamic step ends at the first change of status of a joint section in it, as event-driven methods do."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fracflow._petsc import MPI
from fracflow.advance.event_kinds import Event, first_event
from fracflow.advance.outcome import Advance, Outcome
from fracflow.advance.step import Stepping
from fracflow.errors import NotConverged
from fracflow.model.state import State
from fracflow.solve.request import StepRequest

NEAR = 1e-4  # of the step: how well the time of an event is known
REFINEMENTS = 6
BEYOND = 1.25  # a step towards an event looks so far past its own end for it
MANY = 16  # sliding sections: a crack, whose front passes sections one by one, and no block that sticks and slips


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
