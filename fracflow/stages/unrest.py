"""Where slip has no quasi-static continuation, and where motion has come to rest: when a stage auto changes its regime."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from fracflow._petsc import MPI
from fracflow.assembly.inertia import fastest_cell
from fracflow.begin.setup import Model
from fracflow.coupling.period import longest_period
from fracflow.errors import SolveError
from fracflow.scene_actions import Stage
from fracflow.scene_materials import Rock
from fracflow.state import State
from fracflow.steps.parts import Place

SHARE = 0.1  # of the slip over which strength falls: no step without inertia may slip farther
RADIATED = 1e-3  # of the strength: what rho c_s v/2 of slip without inertia may reach
PARTS = 50  # of the longest period, at least, in steps with inertia
LONG = 20.0  # longest periods: an event that has lasted so long may have nothing that ends it
CREEP = 2.0  # times the kinetic energy at the onset: no more than slow slip goes on with


@dataclass(frozen=True)
class Course:
    """Where a stage auto is, all of it numbers, for checkpoints.

    least   step with inertia, and shortest without [time]
    period  longest period of vibration, as at the last onset [time]
    step    length of the next step without inertia [time]
    calm    steps in a row that could have been longer
    begun   onset of the event under way; ``moves`` 1 during one
    count   whole steps with inertia since then
    creep   kinetic energy that slow slip and weak waves may have, as at the onset [energy per thickness]
    peak    largest one since
    loud    when it was last above the share of its peak that counts as rest [time]
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

    def as_progress(self, place: Place | None = None) -> dict[str, float]:
        """What a checkpoint keeps of it, and of the place in a step with inertia."""
        return {**vars(self), **(place or Place()).as_progress()}

    @classmethod
    def of(cls, progress: Mapping[str, float]) -> Course:
        """The one that a checkpoint kept."""
        return cls(**{name: progress[name] for name in cls.__dataclass_fields__})

    def onset(self, state: State, period: float, weak: float) -> Course:
        """As an event begins from a state whose books have its kinetic energy; ``weak`` waves have less than that."""
        energy = state.energy["kinetic"]
        begun = replace(self, moves=1.0, begun=state.time, count=0.0, period=period)
        return replace(begun, creep=max(CREEP * energy, weak), peak=energy, loud=state.time)

    def moved_to(self, state: State, at_rest: float) -> Course:
        """After a step, or a part of one, with inertia."""
        energy = state.energy["kinetic"]
        peak = max(self.peak, energy)
        is_loud = energy > max(at_rest * peak, self.creep)
        return replace(self, peak=peak, loud=state.time if is_loud else self.loud)

    def is_quiet(self, state: State, stage: Stage) -> bool:
        """Whether kinetic energy has been low for long enough."""
        return state.time - self.loud >= stage.rest_periods * self.period

    def restless(self, before: float, now: float, absorbs: bool) -> str:
        """What the log tells of an event when it has lasted ``LONG`` periods: ``now``, and not yet ``before``; else nothing."""
        if not before < self.begun + LONG * self.period <= now:
            return ""
        leave = "" if absorbs else "let waves leave by [[absorbing]] sides, "
        return (
            f"the event that began at {self.begun:.9g} has lasted {LONG:g} longest periods and is not at rest; where nothing"
            f' damps its waves it never is: {leave}set method.stepper = "generalised-alpha" with a rho_infinity below 1, which'
            " damps what the steps do not resolve, or raise at_rest"
        )

    def at_rest(self) -> Course:
        """As an event ends: the first step without inertia lasts a period."""
        return replace(self, moves=0.0, step=max(self.period, self.least), calm=0.0)


def begin(model: Model, state: State, stage: Stage) -> Course:
    """The course at the start of a stage. Raises SolveError where nothing tells how long an event lasts. Collective."""
    period = longest_period(model.operators, model.loads, state.sections)
    cell = fastest_cell(model.operators, model.scene)
    least = stage.dynamic_time_step or min(2.0 / math.sqrt(cell) if cell > 0.0 else math.inf, period / PARTS)
    if not math.isfinite(least + period):
        raise SolveError(
            f"stage {stage.title}: nothing has mass and can move, so that there are no dynamics to change to"
        )
    assert stage.time_step is not None
    return Course(least, period, max(stage.time_step, least))


def runs_away(model: Model, old: State, new: State, dt: float) -> str:
    """Why slip in a step without inertia is not that of a slow process; empty where it is. Collective.

    Strength that drops at once leaves no equilibrium at all; where it falls with slip a step must resolve that; and what
    slip radiates, rho c_s v/2, is to be small beside the strength.
    """
    joints, comm = model.operators.joints, model.operators.layout.comm
    slipped = np.linalg.norm((new.sections.inelastic - old.sections.inelastic)[:, :-1], axis=1)
    drops, share = False, 0.0
    for group in joints.laws:
        here = group.sections
        drop = group.law.strength_drop(np.maximum(-new.sections.traction[here, -1], 0.0))
        length = np.where(drop > 0.0, group.law.slip_length(len(here)), np.inf)
        starts = (new.sections.is_sliding[here] | (slipped[here] > 0.0)) & ~old.sections.is_sliding[here]
        drops |= bool(np.any(starts & (length == 0.0)))
        gradual = np.where(length > 0.0, length, np.inf)
        share = max(share, float((slipped[here] / gradual).max(initial=0.0)))
    strength = np.where(np.isfinite(new.sections.strength), new.sections.strength, np.inf)
    least = model.operators.scales.pressure * 1e-6
    radiated = _impedance(model) * slipped / dt / np.maximum(strength, least)
    found = np.array([float(drops), share, float(radiated.max(initial=0.0))])
    comm.Allreduce(MPI.IN_PLACE, found, op=MPI.MAX)
    if found[0]:
        return "strength drops at once"
    if found[1] > SHARE:
        return f"slip of {found[1]:.3g} of the distance over which strength falls"
    if found[2] > RADIATED:
        return f"slip that radiates {found[2]:.3g} of the strength"
    return ""


def weak_waves(model: Model, state: State, period: float) -> float:
    """Kinetic energy of waves of a stress ``RADIATED`` times the strength, wherever they come in a period. Collective.

    s^2/(2 mu) per area, on (c_s T)^2; nothing where no rock deforms [energy per thickness].
    """
    strength = state.sections.strength
    here = float(np.max(np.where(np.isfinite(strength), strength, 0.0), initial=0.0))
    stress = RADIATED * model.operators.layout.comm.allreduce(here, op=MPI.MAX)
    return max((0.5 * stress**2 * period**2 / rock.density for rock in _deforming(model) if rock.density), default=0.0)


def may_rest(model: Model, state: State) -> bool:
    """Whether no section slides that would drop again once it stuck: such slip has to end by itself. Collective."""
    joints, slides = model.operators.joints, False
    for group in joints.laws:
        here = group.sections
        drop = group.law.strength_drop(np.maximum(-state.sections.traction[here, -1], 0.0))
        at_once = (drop > 0.0) & (group.law.slip_length(len(here)) == 0.0)
        slides |= bool(np.any(at_once & state.sections.is_sliding[here]))
    return not model.operators.layout.comm.allreduce(slides, op=MPI.LOR)


def _impedance(model: Model) -> float:
    """Largest rho c_s/2 of the rocks that deform [stress time/length]."""
    rocks = _deforming(model)
    moduli = [(rock.youngs_modulus or 0.0) / (2.0 * (1.0 + (rock.poissons_ratio or 0.0))) for rock in rocks]
    products = (modulus * (rock.density or 0.0) for modulus, rock in zip(moduli, rocks, strict=True))
    return max((0.5 * math.sqrt(product) for product in products), default=0.0)


def _deforming(model: Model) -> list[Rock]:
    return [rock for rock in model.scene.rock.values() if not rock.rigid and rock.density]
