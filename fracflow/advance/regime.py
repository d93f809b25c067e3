"""When a stage auto changes its regime: slip has no quasi-static continuation, or motion has come to rest; steps of both."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from fracflow._petsc import MPI
from fracflow.advance.initial_state import equilibrium_state
from fracflow.advance.substeps import SubstepCursor
from fracflow.errors import SolveError
from fracflow.mesh.data import Bools
from fracflow.model.setup import Model
from fracflow.model.state import State, StepReport
from fracflow.scene.boundary import Stage
from fracflow.scene.materials import Rock
from fracflow.solve.newton import BRIEF
from fracflow.solve.period import longest_period

SHARE = 0.1  # of the slip over which strength falls: no step without inertia may slip farther
PARTS = 50  # of the longest period, at least, in steps with inertia
LONGER = 3  # steps without inertia before they are twice as long
AHEAD = 0.4  # of the slip that a step may have: one that slips so far may be twice as long next
RADIATED = 1e-3  # of the strength: what rho c_s v/2 of slip without inertia may reach
SETTLED = 0.3  # of that: what slip may radiate as inertia goes
FLOOR = 0.1  # of the largest traction: strength of what pressure has all but opened, in what slip radiates of it
LONG = 20.0  # longest periods: an event that has lasted so long may have nothing that ends it
CREEP = 2.0  # times the kinetic energy at the onset: slow slip goes on with no more


def wave_step(model: Model, state: State, stage: Stage) -> tuple[float, float]:
    """Length of a step with inertia, and the longest period of vibration [time].

    By default it is the time of a P wave through a typical joint, at most a share of the period. Raises SolveError where
    the duration of an event is unknown. Collective.
    """
    period = longest_period(model.operators, model.loads, state.sections)
    least = stage.dynamic_time_step or min(transit(model), period / PARTS)
    if not math.isfinite(least + period):
        raise SolveError(
            f"stage {stage.title}: nothing has mass and can move, so that there are no dynamics to change to"
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
    speed = max((_p_speed(rock) for rock in deforming(model)), default=0.0)
    return float(sums[0] / sums[1]) / speed if sums[1] > 0.0 and speed > 0.0 else math.inf


def deforming(model: Model) -> list[Rock]:
    """Rocks with mass that deform."""
    return [rock for rock in model.scene.rock.values() if not rock.rigid and rock.density]


def _p_speed(rock: Rock) -> float:
    """c_p [length/time]."""
    young, nu, density = rock.youngs_modulus or 0.0, rock.poissons_ratio or 0.0, rock.density or math.inf
    return math.sqrt(young * (1.0 - nu) / ((1.0 + nu) * (1.0 - 2.0 * nu)) / density)


def estimated_cost(model: Model, iteration: float, iterations: int) -> dict[str, str]:
    """Time that events and slow slip of each stage auto take beside the steps planned, by the seconds of a Newton iteration.

    iterations  of a step
    The number of events is not known: the cost is that of one. On one process.
    """
    found = {}
    for stage in (stage for stage in model.scene.stage if stage.kind == "auto"):
        state = equilibrium_state(model)
        try:
            least, period = wave_step(model, state, stage)
        except SolveError:
            continue
        finally:
            state.destroy()
        longest = max(stage.time_step or 0.0, least)
        trials = math.ceil(math.log2(longest / least))
        waves = math.ceil(max(1.0, stage.rest_periods) * period / least)
        after = LONGER * math.ceil(math.log2(max(longest / period, 1.0)))
        seconds = iteration * (trials * BRIEF + (waves + after) * iterations)
        found[f"each event in stage {stage.title}, about"] = (
            f"{trials} trials rejected before it, at least {waves} steps with inertia of {least:.3g}, {after} steps until"
            f" they are as long again: from {seconds:.2g} CPU s on"
        )
        if weakens := sum(1 for _ in _weakening(model)):
            steps = math.ceil(1.0 / SHARE) * weakens
            found[f"slow slip in stage {stage.title}, up to"] = (
                f"{steps} steps more, where {weakens} fractures weaken one after another, each over {1.0 / SHARE:.0f} steps:"
                f" {steps * iteration * iterations:.2g} CPU s, and half as many trials rejected"
            )
    return found


def _weakening(model: Model) -> Iterator[int]:
    """Fractures whose strength falls over a slip of some length."""
    joints, blocks = model.operators.joints, model.operators.blocks.joints
    pressed = np.maximum(-joints.initial[:, -1], 0.0)
    for number in range(len(blocks.fractures)):
        of_it = np.repeat(blocks.fracture == number, joints.points)
        for group in joints.laws:
            here = of_it[group.sections]
            lengths = group.law.slip_length(len(here))
            if np.any(here & (group.law.strength_drop(pressed[group.sections]) > 0.0) & (lengths > 0.0)):
                yield number
                break


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

        absorbs, damps  the scene has sides that absorb, or damps by its stepper already, which is then no remedy
        """
        if not before < self.begun + LONG * self.period <= now:
            return ""
        leave = [] if absorbs else ["let waves leave by [[absorbing]] sides"]
        stepper = 'set method.stepper = "generalised-alpha" with a rho_infinity below 1'
        stepper += ", which damps what the steps do not resolve"
        remedies = [*leave, *([] if damps else [stepper]), "raise at_rest"]
        return (
            f"the event that began at {self.begun:.9g} has lasted {LONG:g} longest periods and is not at rest; where nothing"
            f" damps its waves it never is: {', or '.join(remedies)}"
        )

    def at_rest(self) -> EventState:
        """As an event ends: the first step without inertia lasts a period."""
        return replace(self, moves=0.0, step=max(self.period, self.least), calm=0.0, trials=0.0)


def begin(model: Model, state: State, stage: Stage) -> EventState:
    """The event state at the start of a stage. Raises SolveError where the duration of an event is unknown. Collective."""
    least, period = wave_step(model, state, stage)
    assert stage.time_step is not None
    return EventState(least, period, max(stage.time_step, least))


@dataclass(frozen=True)
class Slipped:
    """How fast and how far a step without inertia slips.

    drops     some strength drops at once
    share     of the distance over which strength falls: the largest of the sections that still weaken [1]
    radiated  of the strength: rho c_s v/2, in the mean over all that slips [1]
    worst     (s,) the section of all ranks that dissipates most against its strength
    """

    drops: bool
    share: float
    radiated: float
    worst: Bools

    def why_not(self, radiated: float = RADIATED) -> str:
        """Why that is not a slow process, which radiates at most ``radiated`` of the strength; empty where it is."""
        if self.drops:
            return "strength drops at once"
        if self.share > SHARE:
            return f"slip of {self.share:.3g} of the distance over which strength falls"
        if self.radiated > radiated:
            return f"slip that radiates {self.radiated:.3g} of the strength"
        return ""

    @property
    def may_double(self) -> bool:
        """Whether a step twice as long is expected to resolve the weakening, too."""
        return self.share <= AHEAD * SHARE


@dataclass(frozen=True)
class Tried:
    """A step without inertia.

    why         it may not be taken; empty where it may
    newton      iterations spent on it
    state       that it led to, with its ``report``; None where it may not be taken
    may_double  whether one twice as long may follow, by its slip
    length      of it [time]
    jumps       something prescribed jumps just behind its end
    """

    why: str
    newton: int
    state: State | None = None
    report: StepReport = field(default_factory=StepReport)
    may_double: bool = False
    length: float = 0.0
    jumps: bool = False


def slipped(model: Model, old: State, new: State, dt: float) -> Slipped:
    """How fast and how far sections slip in a step without inertia. Collective.

    Strength that drops at once leaves no equilibrium; where it falls with slip a step must resolve the fall. The power that
    slip radiates, the sum of rho c_s v^2/2, must be small beside its power against strength, the sum of v R. Sums are over all
    sliding sections, by area, so that fast slip outweighs slow slip. Pressure may take all strength from a section, which then
    has no resistance and radiates little. So R is the strength, or FLOOR times the largest traction since the start if that is
    more. A fall of strength counts relative to the fall under that pressure.
    """
    joints, comm = model.operators.joints, model.operators.layout.comm
    before, after = old.sections, new.sections
    far = np.linalg.norm((after.inelastic - before.inelastic)[:, :-1], axis=1)
    scale = FLOOR * np.maximum(after.record, np.linalg.norm(before.traction, axis=1))
    drops, share = False, 0.0
    for group, past in zip(joints.laws, before.history, strict=True):
        here = group.sections
        pressed = np.maximum(-after.traction[here, -1], 0.0)
        drop, length = group.law.strength_drop(pressed), group.law.slip_length(len(here))
        starts = (after.is_sliding[here] | (far[here] > 0.0)) & ~before.is_sliding[here]
        drops |= bool(np.any(starts & (drop > 0.0) & (length == 0.0)))
        falls = (group.law.steepness(after.traction[here], past) > 0.0) & (drop > 0.0) & (length > 0.0)
        all_of_it = np.where(falls, group.law.strength_drop(np.maximum(pressed, scale[here])), 1.0)
        parts = far[here] / np.where(falls, length, 1.0) * drop / all_of_it
        share = max(share, float(np.where(falls, parts, 0.0).max(initial=0.0)))
    strength = np.maximum(np.where(np.isfinite(after.strength), after.strength, 0.0), scale)
    sent = _impedance(model) / dt * float(joints.weights @ far**2)
    worst = np.array([float(drops), share])
    comm.Allreduce(MPI.IN_PLACE, worst, op=MPI.MAX)
    power = joints.weights * far * strength
    powers = np.array([sent, power.sum()])
    comm.Allreduce(MPI.IN_PLACE, powers, op=MPI.SUM)
    most = comm.allreduce(float(power.max(initial=0.0)), op=MPI.MAX)
    radiated = float(powers[0] / powers[1]) if powers[1] > 0.0 else 0.0
    return Slipped(bool(worst[0]), float(worst[1]), radiated, (power == most) & (most > 0.0))


def weak_waves(model: Model, state: State, period: float) -> float:
    """Kinetic energy of waves of a stress ``RADIATED`` times the strength, over their reach in a period. Collective.

    s^2/(2 mu) per area, on (c_s T)^2; nothing where no rock deforms [energy per thickness].
    """
    strength = state.sections.strength
    here = float(np.max(np.where(np.isfinite(strength), strength, 0.0), initial=0.0))
    stress = RADIATED * model.operators.layout.comm.allreduce(here, op=MPI.MAX)
    return max((0.5 * stress**2 * period**2 / rock.density for rock in deforming(model) if rock.density), default=0.0)


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
    rocks = deforming(model)
    moduli = [(rock.youngs_modulus or 0.0) / (2.0 * (1.0 + (rock.poissons_ratio or 0.0))) for rock in rocks]
    products = (modulus * (rock.density or 0.0) for modulus, rock in zip(moduli, rocks, strict=True))
    return max((0.5 * math.sqrt(product) for product in products), default=0.0)
