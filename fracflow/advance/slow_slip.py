"""Whether slip is slow: how far and how fast sections slip in a step without inertia, and what that radiates."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from fracflow._petsc import MPI
from fracflow.advance.slip_rate import creeps, slip_of_states
from fracflow.mesh.data import Bools, Floats
from fracflow.model.setup import Model
from fracflow.model.state import Sections, State, StepReport
from fracflow.scene.materials import Rock

SHARE = 0.1  # of the slip over which strength falls: no step without inertia may slip farther
AHEAD = 0.4  # of the slip that a step may have: one that slips so far may be twice as long next
RADIATED = 1e-3  # of the strength: what rho c_s v/2 of slip without inertia may reach
SETTLED = 0.3  # of that: what slip may radiate as inertia goes
FLOOR = 0.1  # of the largest traction: strength of what pressure has all but opened, in what slip radiates of it


@dataclass(frozen=True)
class Slipped:
    """How fast and how far a step without inertia slips.

    drops     some strength drops at once
    share     of the distance over which strength falls: the largest of the sections that still weaken [1]
    radiated  of the strength: rho c_s v/2, in the mean over all that slips [1]
    worst     (s,) the section of all ranks that dissipates most against its strength
    evolved   largest slip over that by which a state of friction may evolve in a step [1]
    """

    drops: bool
    share: float
    radiated: float
    worst: Bools
    evolved: float = 0.0

    def why_not(self, radiated: float = RADIATED) -> str:
        """Why that is not a slow process, which radiates at most ``radiated`` of the strength; empty where it is."""
        if self.drops:
            return "strength drops at once"
        if self.share > SHARE:
            return f"slip of {self.share:.3g} of the distance over which strength falls"
        if self.radiated > radiated:
            return f"slip that radiates {self.radiated:.3g} of the strength"
        if self.evolved > 1.0:
            return f"slip of {self.evolved:.3g} times what the state of friction allows a step"
        return ""

    @property
    def may_double(self) -> bool:
        """Whether a step twice as long is expected to resolve the weakening, too."""
        return self.share <= AHEAD * SHARE and self.evolved <= AHEAD


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
    has no resistance and radiates little. So R is the strength (``resistance``), or FLOOR times the largest traction since the
    start if that is more. A fall of strength counts relative to the fall under that pressure.
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
    strength = np.maximum(resistance(model, after), scale)
    sent = _impedance(model) / dt * float(joints.weights @ far**2)
    worst = np.array([float(drops), share])
    comm.Allreduce(MPI.IN_PLACE, worst, op=MPI.MAX)
    power = joints.weights * far * strength
    powers = np.array([sent, power.sum()])
    comm.Allreduce(MPI.IN_PLACE, powers, op=MPI.SUM)
    most = comm.allreduce(float(power.max(initial=0.0)), op=MPI.MAX)
    radiated = float(powers[0] / powers[1]) if powers[1] > 0.0 else 0.0
    evolved = slip_of_states(model, old, new) if creeps(model) else 0.0
    return Slipped(bool(worst[0]), float(worst[1]), radiated, (power == most) & (most > 0.0), evolved)


def resistance(model: Model, sections: Sections) -> Floats:
    """Strength (s,) of this rank's sections; the shear traction where friction follows the rate of slip; else 0 [stress]."""
    found = np.where(np.isfinite(sections.strength), sections.strength, 0.0)
    for group in (group for group in model.operators.joints.laws if group.law.creeps):
        found[group.sections] = np.linalg.norm(sections.traction[group.sections, :-1], axis=1)
    return found


def weak_waves(model: Model, state: State, period: float) -> float:
    """Kinetic energy of waves of a stress ``RADIATED`` times the strength, over their reach in a period. Collective.

    s^2/(2 mu) per area, on (c_s T)^2; nothing where no rock deforms [energy per thickness].
    """
    here = float(resistance(model, state.sections).max(initial=0.0))
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
    products = (rock.shear_modulus * (rock.density or 0.0) for rock in deforming(model))
    return max((0.5 * math.sqrt(product) for product in products), default=0.0)


def deforming(model: Model) -> list[Rock]:
    """Rocks with mass that deform."""
    return [rock for rock in model.scene.rock.values() if not rock.rigid and rock.density]
