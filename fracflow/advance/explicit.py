"""Explicit stages: the critical time step, steps in substeps that are no longer, and their cost before a run."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from time import process_time

from fracflow._petsc import destroy
from fracflow.advance.outcome import Advance, Log, Outcome
from fracflow.integrators import EXPLICIT, Stepper
from fracflow.integrators.explicit import parts
from fracflow.model.operators import Operators
from fracflow.model.setup import Model
from fracflow.model.state import State, StepReport
from fracflow.remarks import note
from fracflow.solve.explicit import ExplicitCoupling
from fracflow.solve.leapfrog.nodes import takes
from fracflow.solve.leapfrog.steps import Leapfrog
from fracflow.solve.request import StepRequest, on_the_way

PRODUCTS = 16.0  # the time of a substep, in products of the rock's stiffness: 7 with 4e5 unknowns, 15 with 7e4
TIMED = 5  # products


class ExplicitSteps:
    """The explicit coupling of a model, and the line of its critical time step for the log."""

    def __init__(self, model: Model, log: Log) -> None:
        """Make the coupling when a stage first needs it."""
        self.model, self.log = model, log
        self._coupling: ExplicitCoupling | None = None
        self._leapfrog: Leapfrog | None = None

    @property
    def coupling(self) -> ExplicitCoupling:
        """With its critical time step. Raises InputError, on every rank. Collective."""
        if self._coupling is None:
            self._coupling = ExplicitCoupling(self.model.scene, self.model.operators, self.model.loads)
        return self._coupling

    @property
    def leapfrog(self) -> Leapfrog | None:
        """Steps in one sweep, where the scene is one for them. Raises InputError, on every rank. Collective."""
        if self._leapfrog is None and takes(self.model.operators):
            self._leapfrog = Leapfrog(self.coupling, self.model.scene, self.model.loads)
        return self._leapfrog

    def count(self, dt: float) -> int:
        """Number of equal substeps in a step of length ``dt``. Collective."""
        return parts(dt, self.coupling.critical)

    def part(self, stepper: Stepper, dt: float) -> float:
        """Length of the substeps in which a rule advances a step of length ``dt``. Collective."""
        return dt / self.count(dt) if stepper.explicit and dt > 0.0 else dt

    def locates(self, stepper: Stepper, dt: float) -> bool:
        """Whether steps of length ``dt`` may end at events. Collective.

        Where rock deforms they may not: central differences with unequal substeps feed energy into the walls' modes.
        """
        if not stepper.explicit:
            return True
        return math.isinf(self.coupling.critical) and self.model.operators.flow is None

    def log_steps(self, stepper: Stepper, dt: float) -> None:
        """Log how an explicit rule takes steps of length ``dt``. Collective."""
        if not stepper.explicit:
            return
        count, critical, locates = self.count(dt), self.coupling.critical, self.locates(stepper, dt)
        shown = self.model.scene.time_text
        limit = f"critical time step of the rock {shown(critical)}" if math.isfinite(critical) else "no rock deforms"
        cut = f"; time_step {shown(dt)} is taken in {count} parts of {shown(dt / count)}" if count > 1 else ""
        ends = "" if locates else f"; events are taken at the ends of {'parts' if count > 1 else 'steps'}"
        damps = "".join(f"; {note}" for note in self.coupling.notes)
        self.log(note(f"explicit: {limit}, whatever the stiffness of joints{damps}{cut}{ends}"))

    def destroy(self) -> None:
        """Free the coupling. Collective."""
        destroy(self._leapfrog, self._coupling)


@dataclass(frozen=True)
class ExplicitSubsteps:
    """Divides a step into equal substeps no longer than the critical one; the controls change linearly over the step."""

    inner: Advance
    explicit: ExplicitSteps

    def advance(self, state: State, request: StepRequest) -> Outcome:
        """All substeps, one after the other. Raises SolveError, on every rank. Collective."""
        dt, count = request.length, self.explicit.count(request.length)
        ahead = dt if request.next_length is None else request.next_length
        then = ahead / self.explicit.count(ahead) if ahead > 0.0 else 0.0
        steps = self.explicit.leapfrog
        made = steps.advance(state, request, count, then) if steps is not None else None
        if made is not None:
            return Outcome(*made, request.end)
        if count == 1:
            return self.inner.advance(state, request)
        now, total = state, StepReport()
        for done in range(1, count + 1):
            part = replace(
                request,
                time=request.time - dt * (count - done) / count,
                length=dt / count,
                controls=on_the_way(state.controls, request.controls, 0.0, done / count),
                next_length=dt / count if done < count else then,
            )
            try:
                found = self.inner.advance(now, part)
            finally:
                if now is not state:
                    now.destroy()
            now, report = found.state, found.report
            widest = max(total, report, key=lambda each: each.widening)
            total = replace(
                report.after(total),
                solid_residual=max(total.solid_residual, report.solid_residual),
                flow_residual=max(total.flow_residual, report.flow_residual),
                digits=min(total.digits, report.digits),
                widening=widest.widening,
                widest=widest.widest,
            )
        return Outcome(now, total, request.end)


@dataclass(frozen=True)
class ExplicitCost:
    """Explicit steps of the stages whose number of steps is known, and their substeps.

    seconds   of CPU that a substep takes on this process, without the cost that every step has [s]
    critical  longest stable time step, by the rock alone; infinite where no rock deforms [time]
    line      for the user
    """

    steps: int
    parts: int
    seconds: float
    critical: float
    line: str


def explicit_cost(model: Model) -> ExplicitCost | None:
    """The cost of the explicit steps; None where no stage has any. Raises InputError as ``ExplicitCoupling``. Collective."""
    scene, start, planned, events = model.scene, 0.0, [], False
    if scene.method.stepper not in EXPLICIT:
        return None
    for stage in scene.stage:
        count, start = stage.step_count(start) or 0, stage.finish(start)
        events = events or stage.kind == "auto"
        if stage.kind == "dynamic" and stage.time_step is not None:
            planned.append((count, stage.time_step))
    if not planned and not events:
        return None
    coupling = ExplicitCoupling(scene, model.operators, model.loads)
    critical = coupling.critical
    coupling.destroy()
    cuts = [(count, dt, parts(dt, critical)) for count, dt in planned]
    ways = [f" in {n} parts of {scene.time_text(dt / n, 4)}" if n > 1 else "" for _, dt, n in cuts]
    words = [f"{count} steps of {scene.time_text(dt, 4)}{way}" for (count, dt, _), way in zip(cuts, ways, strict=True)]
    words += ["as many as events take"] if events else []
    limit = (
        f"critical time step of the rock {scene.time_text(critical, 4)}"
        if math.isfinite(critical)
        else "no rock deforms"
    )
    return ExplicitCost(
        sum(count for count, _, _ in cuts),
        sum(count * n for count, _, n in cuts),
        PRODUCTS * _seconds_of_product(model.operators),
        critical,
        f"{', '.join(words)}; {limit}; without a factorisation",
    )


def _seconds_of_product(operators: Operators) -> float:
    """CPU time of a product of the rock's stiffness with a vector, on this process [s]. Collective."""
    moved, force = operators.layout.solid_vector(), operators.layout.solid_vector()
    operators.stiffness.mult(moved, force)
    began = process_time()
    for _ in range(TIMED):
        operators.stiffness.mult(moved, force)
    lasted = (process_time() - began) / TIMED
    destroy(moved, force)
    return lasted
