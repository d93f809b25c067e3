"""The regime of a stage auto: its events from their onset until motion has come to rest, and its steps with inertia."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from fracflow._petsc import MPI
from fracflow.advance.slow_slip import deforming
from fracflow.advance.substeps import SubstepCursor
from fracflow.errors import SolveError
from fracflow.model.setup import Model
from fracflow.model.state import State
from fracflow.scene.boundary import Stage
from fracflow.solve.period import longest_period

PARTS = 50  # of the longest period, at least, in steps with inertia
LONG = 20.0  # longest periods: an event that has lasted so long may have nothing that ends it
CREEP = 2.0  # times the kinetic energy at the onset: slow slip goes on with no more


def wave_step(model: Model, state: State, stage: Stage) -> tuple[float, float]:
    """Length of a step with inertia, and the longest period of vibration [time].

    By default it is the time of a P wave through a typical joint, at most a share of the period. Rock without a mesh has
    none: an S wave's time along and back over the fractures takes its place. Raises SolveError where the duration of an event
    is unknown. Collective.
    """
    if model.scene.is_unbounded:
        period = _there_and_back(model)
    else:
        period = longest_period(model.operators, model.loads, state.sections)
    least = stage.dynamic_time_step or min(transit(model), period / PARTS)
    if not math.isfinite(least + period):
        moduli = [rock.youngs_modulus for rock in deforming(model) if rock.youngs_modulus is not None]
        soft = f"a youngs_modulus of the right unit, where the smallest is {min(moduli):g}, and " if moduli else ""
        raise SolveError(
            f"stage {stage.title}: no longest period of vibration was found, so that there are no dynamics to change to: give"
            f" {soft}a density to a rock that supports do not hold everywhere, or use kind = 'quasi-static'"
        )
    return least, period


def transit(model: Model) -> float:
    """Time that a P wave takes through a joint of typical length; inf where no rock deforms, or without joints. Collective.

    The mean of the joints' lengths, weighted by themselves: one small cell does not determine the length of steps.
    """
    joints = model.operators.joints
    lengths = joints.weights.reshape(-1, joints.points).sum(axis=1)
    sums = np.array([lengths @ lengths, lengths.sum()])
    model.operators.layout.comm.Allreduce(MPI.IN_PLACE, sums, op=MPI.SUM)
    speed = max((rock.p_speed for rock in deforming(model)), default=0.0)
    return float(sums[0] / sums[1]) / speed if sums[1] > 0.0 and speed > 0.0 else math.inf


def _there_and_back(model: Model) -> float:
    """Time of an S wave over twice the extent of all fractures, of rock that is not meshed [time]."""
    block = model.operators.blocks.solid
    low, high = block.piece_box[:, 0].min(axis=0), block.piece_box[:, 1].max(axis=0)
    speed = max((rock.s_speed for rock in deforming(model)), default=0.0)
    return 2.0 * float((high - low).max()) / speed if speed > 0.0 else math.inf


@dataclass(frozen=True)
class EventState:
    """Where a stage auto is, all of it numbers, for checkpoints.

    least   step with inertia, and shortest without [time]
    period  longest period of vibration, as at the last onset [time]
    step    length of the next step without inertia [time]
    calm    accepted steps in a row that could have been longer
    begun   onset of the event under way; ``moves`` 1 during one
    count   whole steps with inertia since then
    creep   kinetic energy that slow slip and weak waves may have, as at the onset [energy per thickness]
    peak    largest one since
    trials  steps without inertia that were rejected since the last event
    loud    when it was last above the share of its peak that counts as rest [time]
    over    1 once an event is over in the rock that the stage is in
    """

    least: float
    period: float
    step: float
    calm: float = 0.0
    moves: float = 0.0
    begun: float = 0.0
    count: float = 0.0
    creep: float = 0.0
    peak: float = 0.0
    loud: float = 0.0
    trials: float = 0.0
    over: float = 0.0

    def as_progress(self, place: SubstepCursor | None = None) -> dict[str, float]:
        """The numbers that a checkpoint stores of it, and of the place in a step with inertia."""
        return {**vars(self), **(place or SubstepCursor()).as_progress()}

    @classmethod
    def of(cls, progress: Mapping[str, float]) -> EventState:
        """The one that a checkpoint kept."""
        return cls(**{name: progress[name] for name in cls.__dataclass_fields__ if name in progress})

    def onset(self, state: State, period: float, weak: float) -> EventState:
        """As an event begins from a state whose energy balance has its kinetic energy; ``weak`` waves have less than that."""
        energy = state.energy["kinetic"]
        begun = replace(self, moves=1.0, begun=state.time, count=0.0, period=period)
        return replace(begun, creep=max(CREEP * energy, weak), peak=energy, loud=state.time)

    def moved_to(self, state: State, at_rest: float) -> EventState:
        """After a step or substep with inertia."""
        energy = state.energy["kinetic"]
        peak = max(self.peak, energy)
        is_loud = energy > max(at_rest * peak, self.creep)
        return replace(self, peak=peak, loud=state.time if is_loud else self.loud)

    def is_quiet(self, state: State, stage: Stage) -> bool:
        """Whether kinetic energy has been low for long enough."""
        return state.time - self.loud >= stage.rest_periods * self.period

    def is_unstable(self, before: float, now: float, absorbs: bool, damps: bool) -> str:
        """The line of the log on an event when it has lasted ``LONG`` periods: ``now``, and not yet ``before``; else nothing.

        absorbs  the scene has sides that absorb
        damps    its stepper damps already, or is to be the explicit one: no other is a remedy then
        """
        if not before < self.begun + LONG * self.period <= now:
            return ""
        leave = [] if absorbs else ["let waves leave by [[absorbing]] sides"]
        stepper = 'set method.stepper = "generalised-alpha" with a rho_infinity below 1'
        stepper += ", which damps what the steps do not resolve"
        remedies = [*leave, *([] if damps else [stepper]), "raise at_rest"]
        return (
            f"the event has lasted {LONG:g} longest periods and is not at rest; where nothing"
            f" damps its waves it never is: {', or '.join(remedies)}"
        )

    def at_rest(self) -> EventState:
        """As an event ends: the first step without inertia lasts a period."""
        return replace(self, moves=0.0, step=max(self.period, self.least), calm=0.0, trials=0.0, over=1.0)


def after_change_of_rock(progress: Mapping[str, float], model: Model, state: State, stage: Stage) -> EventState:
    """The event state of a stage that goes on in another rock. Raises SolveError as ``begin``. Collective."""
    event, (least, period) = EventState.of(progress), wave_step(model, state, stage)
    return replace(event, least=least, period=period, step=max(event.step, least), over=0.0)


def begin(model: Model, state: State, stage: Stage) -> EventState:
    """The event state at the start of a stage. Raises SolveError where the duration of an event is unknown. Collective."""
    least, period = wave_step(model, state, stage)
    assert stage.time_step is not None
    return EventState(least, period, max(stage.time_step, least))
