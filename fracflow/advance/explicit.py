"""Explicit stages: the critical time step, and steps in substeps that are no longer."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from fracflow.advance.outcome import Advance, Log, Outcome
from fracflow.integrators import Stepper
from fracflow.integrators.explicit import parts
from fracflow.model.setup import Model
from fracflow.model.state import State, StepReport
from fracflow.solve.explicit import ExplicitCoupling
from fracflow.solve.request import StepRequest, on_the_way


class ExplicitSteps:
    """The explicit coupling of a model, and the line of its critical time step for the log."""

    def __init__(self, model: Model, log: Log) -> None:
        """Make the coupling when a stage first needs it."""
        self.model, self.log = model, log
        self._coupling: ExplicitCoupling | None = None

    @property
    def coupling(self) -> ExplicitCoupling:
        """With its critical time step. Raises InputError, on every rank. Collective."""
        if self._coupling is None:
            self._coupling = ExplicitCoupling(self.model.scene, self.model.operators, self.model.loads)
        return self._coupling

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

    def tell(self, stepper: Stepper, dt: float) -> None:
        """Log how an explicit rule takes steps of length ``dt``. Collective."""
        if not stepper.explicit:
            return
        count, critical, locates = self.count(dt), self.coupling.critical, self.locates(stepper, dt)
        limit = f"critical time step of the rock {critical:.6g}" if math.isfinite(critical) else "no rock deforms"
        cut = f"; time_step {dt:.6g} is taken in {count} parts of {dt / count:.6g}" if count > 1 else ""
        ends = "" if locates else f"; events are taken at the ends of {'parts' if count > 1 else 'steps'}"
        damps = "".join(f"; {told}" for told in self.coupling.told)
        self.log(f"explicit: {limit}, whatever the stiffness of joints{damps}{cut}{ends}")

    def destroy(self) -> None:
        """Free the coupling. Collective."""
        if self._coupling is not None:
            self._coupling.destroy()


@dataclass(frozen=True)
class ExplicitSubsteps:
    """Divides a step into equal substeps no longer than the critical one; the controls change linearly over the step."""

    inner: Advance
    explicit: ExplicitSteps

    def advance(self, state: State, request: StepRequest) -> Outcome:
        """All substeps, one after the other. Raises SolveError, on every rank. Collective."""
        dt, count = request.length, self.explicit.count(request.length)
        if count == 1:
            return self.inner.advance(state, request)
        ahead = dt if request.next_length is None else request.next_length
        then = ahead / self.explicit.count(ahead) if ahead > 0.0 else 0.0
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
