"""Explicit stages: the critical time step, steps in substeps that are no longer, and their cost before a run."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from time import process_time
from typing import TYPE_CHECKING

from fracflow._petsc import destroy, memory_kept
from fracflow.advance.network import FlowNetwork
from fracflow.advance.outcome import Log, Outcome
from fracflow.integrators import EXPLICIT, Stepper
from fracflow.integrators.explicit import parts
from fracflow.model.operators import Operators
from fracflow.model.setup import Model
from fracflow.model.state import COUNTS, State, StepReport
from fracflow.model.steep_weakening import refuse_jumps
from fracflow.remarks import marked, note
from fracflow.scene.time_table import Around
from fracflow.solve.leapfrog.ahead import StepsAhead
from fracflow.solve.request import StepRequest
from fracflow.solve.residual import refuse_few, significant_digits

if TYPE_CHECKING:
    from fracflow.advance.explicit_flow import ExplicitFlow
    from fracflow.solve.explicit import ExplicitModel
    from fracflow.solve.leapfrog.steps import Leapfrog

PRODUCTS = 16.0  # the time of a substep, in products of the rock's stiffness: 7 with 4e5 unknowns, 15 with 7e4
TIMED = 5  # products


class ExplicitSteps:
    """Parts of the explicit steps of a model, and the line of their critical time step for the log."""

    def __init__(self, model: Model, network: FlowNetwork, log: Log) -> None:
        """Make it when a stage first needs it."""
        self.model, self.network, self.log = model, network, log
        self._explicit: ExplicitModel | None = None
        self._leapfrog: Leapfrog | None = None
        self._flow: ExplicitFlow | None = None

    @property
    def explicit(self) -> ExplicitModel:
        """With its critical time step. Raises InputError, on every rank. Collective."""
        if self._explicit is None:
            from fracflow.solve.explicit import ExplicitModel  # few runs have explicit steps

            self._explicit = ExplicitModel(self.model.scene, self.model.operators, self.model.loads)
        return self._explicit

    @property
    def leapfrog(self) -> Leapfrog:
        """Steps of the rock and of joints. Raises InputError, on every rank. Collective."""
        if self._leapfrog is None:
            from fracflow.solve.leapfrog.steps import Leapfrog

            self._leapfrog = Leapfrog(self.explicit, self.model.scene, self.model.loads)
        return self._leapfrog

    @property
    def flow(self) -> ExplicitFlow | None:
        """Those of joints and fluid; None without a fluid. Collective."""
        if self._flow is None and self.model.operators.flow is not None:
            from fracflow.advance.explicit_flow import ExplicitFlow

            self._flow = ExplicitFlow(self.model, self.network, self.explicit.sections)
        return self._flow

    def count(self, dt: float) -> int:
        """Number of equal substeps in a step of length ``dt``. Collective."""
        return parts(dt, self.explicit.critical)

    def part(self, stepper: Stepper, dt: float) -> float:
        """Length of the substeps in which a rule advances a step of length ``dt``. Collective."""
        return dt / self.count(dt) if stepper.explicit and dt > 0.0 else dt

    def may_lengthen(self, stepper: Stepper) -> bool:
        """Whether a substep may be longer than the one before it. Collective.

        Central differences of rock keep w (M - dt^2 K/4) w/2 + u K u/2, w and u the means of a step: an energy for each length.
        A vibration of omega = 2/dt has hardly any of the one of dt, and its own of that of dt/2. One change of length is
        bounded. Steps that change again and again, in time with a vibration, feed it without end.
        """
        return not stepper.explicit or math.isinf(self.explicit.critical)

    def locates(self, stepper: Stepper, dt: float) -> bool:
        """Whether steps of length ``dt`` may end at events. Collective."""
        return self.may_lengthen(stepper) and not (stepper.explicit and self.model.operators.flow is not None)

    def log_steps(self, stepper: Stepper, dt: float) -> None:
        """Log how an explicit rule takes steps of length ``dt``. Collective."""
        if not stepper.explicit:
            return
        count, critical, locates = self.count(dt), self.explicit.critical, self.locates(stepper, dt)
        shown = self.model.scene.time_text
        limit = f"critical time step of the rock {shown(critical)}" if math.isfinite(critical) else "no rock deforms"
        cut = f"; time_step {shown(dt)} is taken in {count} parts of {shown(dt / count)}" if count > 1 else ""
        ends = "" if locates else f"; events are taken at the ends of {'parts' if count > 1 else 'steps'}"
        damps = "".join(f"; {line}" for line in self.explicit.notes)
        self.log(note(f"explicit: {limit}, whatever the stiffness of joints{damps}{cut}{ends}"))
        for doubt in self.explicit.doubts:
            self.log(marked(doubt))

    def destroy(self) -> None:
        """Free it. Collective."""
        destroy(self._flow, self._leapfrog, self._explicit)


@dataclass(frozen=True)
class ExplicitSubsteps:
    """Divides a step into equal substeps no longer than the critical one; the controls change linearly over the step."""

    explicit: ExplicitSteps

    @memory_kept()
    def advance(self, state: State, request: StepRequest) -> Outcome:
        """All substeps, one after the other. Raises SolveError, on every rank. Collective."""
        explicit, flow, dt = self.explicit, self.explicit.flow, request.length
        count, ahead = explicit.count(dt), dt if request.next_length is None else request.next_length
        then = ahead / explicit.count(ahead) if ahead > 0.0 else 0.0
        run, reports = explicit.leapfrog.run, list[StepReport]()
        run.begin(state, dt / count)
        if flow is not None:
            flow.begin(state)
        try:
            steps = StepsAhead(request, state.controls, count, then)
            while steps.left:
                row = explicit.leapfrog.in_a_row(steps)
                if row is not None:
                    solved = row.done if explicit.model.operators.blocks.sizes.joints else 0
                    reports.append(StepReport(row.iterations, cycles=1, solid_residual=row.left, solved=solved))
                    steps = steps.after(row.done)
                if steps.left:
                    reports.append(self._part(*steps.next_one, steps.left == 1))
                    steps = steps.after(1)
            around = steps.dt, then
            new = run.end(state if flow is None else flow.now, request, around, {} if flow is None else flow.parts)
            return Outcome(new, replace(of_substeps(reports), digits=self._digits(new)), request.end)
        finally:
            if flow is not None:
                flow.end()

    def _part(self, part: StepRequest, around: Around, is_last: bool) -> StepReport:
        """One substep, and its cost. Collective."""
        explicit, flow, run = self.explicit, self.explicit.flow, self.explicit.leapfrog.run
        blocks, joints = explicit.model.operators.blocks, explicit.model.operators.joints
        run.predict(part.time, part.controls, around)
        report, before = StepReport(cycles=1), run.sections
        if flow is not None:
            found, report = flow.solve(run.free_strain(), part, around)
            run.pull(found, flow.pressed())
            refuse_jumps(blocks, joints, before, run.sections, part.time)
            report = replace(report, **flow.accept(run.sections)._asdict())
        elif blocks.sizes.joints:
            solved = explicit.leapfrog.joints_at_end(run.free_strain(), part)
            run.pull(solved.sections)
            refuse_jumps(blocks, joints, before, run.sections, part.time)
            refused = int(solved.is_refused)
            report = StepReport(solved.iterations, cycles=1, solid_residual=solved.left, solved=1, refused=refused)
        run.move(part.time, around, is_last)
        return report

    def _digits(self, new: State) -> float:
        """Fewest digits of a new state. Raises SolveError, on every rank, and frees it, where they are too few. Collective."""
        model, flow = self.explicit.model, self.explicit.flow
        try:
            if flow is not None:
                return flow.check(new)
            sums = self.explicit.leapfrog.run.sums
            found = significant_digits(model.operators, new, None if sums is None else sums.largest)
            refuse_few(found, model.scene.accuracy.digits, new.time)
            return found.digits
        except BaseException:
            self.explicit.leapfrog.run.last = None
            new.destroy()
            raise


def of_substeps(reports: Sequence[StepReport]) -> StepReport:
    """The report of a step from those of its substeps."""
    widest = max(reports, key=lambda each: each.widening)
    most = ("cycles", "round_off", "solid_residual", "flow_residual", "grown")
    return replace(
        reports[-1],
        handed_over=next((each.handed_over for each in reversed(reports) if each.handed_over), ""),
        widening=widest.widening,
        widest=widest.widest,
        **{name: max(getattr(each, name) for each in reports) for name in most},
        **{name: sum(getattr(each, name) for each in reports) for name in COUNTS},
    )


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
    """The cost of the explicit steps; None where no stage has any. Raises InputError as ``ExplicitModel``. Collective."""
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
    from fracflow.solve.explicit import ExplicitModel

    explicit = ExplicitModel(scene, model.operators, model.loads)
    critical = explicit.critical
    explicit.destroy()
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
        PRODUCTS * seconds_of_product(model.operators),
        critical,
        f"{', '.join(words)}; {limit}; without a factorisation",
    )


def seconds_of_product(operators: Operators) -> float:
    """CPU time of a product of the rock's stiffness with a vector, on this process [s]. Collective."""
    moved, force = operators.layout.solid_vector(), operators.layout.solid_vector()
    operators.rock_force(moved, force)
    began = process_time()
    for _ in range(TIMED):
        operators.rock_force(moved, force)
    lasted = (process_time() - began) / TIMED
    destroy(moved, force)
    return lasted
