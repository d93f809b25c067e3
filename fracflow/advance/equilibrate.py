"""The stage that finds equilibrium: fractures past their strength slip, and blocks without support move."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from fracflow._petsc import PETSc, destroy
from fracflow.advance.initial_state import imbalance
from fracflow.advance.outcome import Advance, Log, Outcome
from fracflow.advance.step import DONE, Progress, Step, Stepping
from fracflow.advance.substeps import Rules, Substepped, most_halvings
from fracflow.integrators import Steady
from fracflow.model.loads import Loads, PrescribedValues
from fracflow.model.properties import initial_pressure
from fracflow.model.setup import Model
from fracflow.model.state import State
from fracflow.remarks import counted, note
from fracflow.scene.time_table import AT_ONCE
from fracflow.scene.units import LENGTH
from fracflow.solve.request import LoadStep, StepRequest


@dataclass(frozen=True)
class Restrained:
    """Advances under the remainder of a ``force`` that is removed in equal increments."""

    inner: Advance
    force: PETSc.Vec
    left: PETSc.Vec
    count: int

    def advance(self, state: State, request: StepRequest) -> Outcome:
        """The same at the end of a request. Raises SolveError, on every rank. Collective."""
        assert request.step is not None
        self.force.copy(self.left)
        self.left.scale(1.0 - (request.step.number - 1 + request.end) / self.count)
        return self.inner.advance(state, replace(request, restraint=self.left))


def equilibrate(stepping: Stepping, state: State, number: int, log: Log, progress: Progress) -> Iterator[Step]:
    """Release the initial state in equal increments, the fluid kept at its initial pressure. Collective.

    The force that held the state out of balance is taken away; its work meanwhile counts as work of boundaries.
    Raises SolveError where no equilibrium is found. The caller owns the states.
    """
    if "done" in progress:
        return
    model = stepping.model
    stage = model.scene.stage[number]
    loads, count = _resting_fluid(model), stage.steps or 1
    held_back = imbalance(model, state.motion.displacement, state.sections.traction, state.pressure)
    model.loads.standing().release(held_back)

    left = held_back.duplicate()
    restrained = Restrained(stepping.by(Steady()), held_back, left, count)
    parts = Substepped(restrained, Rules(most_halvings(model.scene)), log)
    n = 0
    try:
        while n < count:
            step = LoadStep(state.time, n + 1, 0.0, 0.0, 0.0, state.controls, loads)
            found = parts.advance(state, step.part(state.controls, parts.place.fraction, 1.0))
            state, n = found.state, n + (found.reached == 1.0)
            yield Step(state, number, 0.0, found.report, DONE if n == count else None)
    finally:
        destroy(held_back, left)
    log(note(f"equilibrium: {_summary(model, state)}"))


def _resting_fluid(model: Model) -> Loads:
    """The scene's loads with every pressure kept at its initial value."""
    ops, loads = model.operators, model.loads
    if ops.flow is None:
        return loads
    points = ops.blocks.flow.points
    initial = initial_pressure(model.scene, points)
    kept = PrescribedValues(np.arange(len(points)), lambda time, around=AT_ONCE: initial)
    return replace(loads, pressures=(kept,), limits=())


def _summary(model: Model, state: State) -> str:
    comm, sections = model.operators.layout.comm, state.sections
    slid = comm.allreduce(int(np.any(sections.inelastic != 0.0, axis=1).sum()))
    opened = comm.allreduce(int(sections.is_open.sum()))
    farthest = state.motion.displacement.norm(PETSc.NormType.INFINITY)
    unit = model.scene.unit_system.behind(LENGTH)
    are_open = f"{opened} {'is' if opened == 1 else 'are'} open"
    return f"{counted(slid, 'section')} slid, {are_open}, largest displacement {farthest:.3g}{unit}"
