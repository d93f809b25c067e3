"""Common parts of laws with friction: the elastic trial, the choice between sticking and sliding, and the response.

``friction.h`` has a compiled copy, which ``tests/laws/test_compiled.py`` holds to it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from fracflow.laws.base import (
    Bools,
    Floats,
    History,
    HistoryVariable,
    JointLaw,
    JointResponse,
    Parameter,
    per_section,
    per_tangent,
)
from fracflow.laws.closure import NormalClosure

PLASTIC_SLIP = HistoryVariable("shear", "length", "plastic slip", published=False)  # output has it as plastic_slip
SLIDING = HistoryVariable("shear", "1", "direction of the sliding traction, 0 while it sticks", published=False)
SLIP_PATH = HistoryVariable("scalar", "length", "length of the path of plastic slip", published=False)
ONSET_ROUND_OFF = 1e-12
TINY_STRENGTH = 1e-9  # of the joint's own stress scale: keeps margins finite where the strength is nil


@dataclass(frozen=True, eq=False)
class Trial:
    """Sections (n,) at a strain, before it is known which of them slide.

    opening, f_n, k_n   of the closure; ``normal_energy`` int f_n d eps_n
    crushed             at or past -d0, where the law has no response
    free                open, and so without shear traction
    k_s, f_s0           shear stiffness (n,) and initial shear traction (n, dim-1)
    shear               elastic shear traction (n, dim-1) with the plastic slip of the history; ``size`` its length
    along               its component along the previous direction of sliding
    """

    closure: NormalClosure
    strain: Floats
    history: History
    f_n: Floats
    k_n: Floats
    normal_energy: Floats
    crushed: Bools
    is_open: Bools
    free: Bools
    k_s: Floats
    f_s0: Floats
    shear: Floats
    size: Floats
    along: Floats
    was_sliding: Bools

    @staticmethod
    def of(law: FrictionLaw, strain: Floats, history: History) -> Trial:
        """The elastic trial of a law at strain (n, dim)."""
        sections, dim = strain.shape
        closure = law.closure
        opening = strain[:, -1]
        f_n, k_n, energy = closure.evaluate(opening)
        is_open, k_s = closure.is_open(opening), per_section(law.shear_stiffness, sections)
        f_s0 = per_tangent(law.initial_shear_traction, sections, dim - 1)
        shear = f_s0 + k_s[:, None] * (strain[:, :-1] - history["plastic_slip"])
        latch = history["sliding"]
        return Trial(
            closure, strain, history, f_n, k_n, energy, ~np.isfinite(f_n), is_open, is_open & (not law.strength_when_open),
            k_s, f_s0, shear, np.linalg.norm(shear, axis=-1), np.einsum("ni,ni->n", shear, latch), latch.any(axis=-1),
        )  # fmt: skip

    def normal_traction(self) -> Floats:
        """Normal traction (n,), 0 where the law has no response."""
        return np.where(self.crushed, 0.0, self.f_n)

    def slides(self, onset: Floats, kept: Floats, hold: bool) -> Bools:
        """(2.12) Sections that slide (n,): sticking ones from |f_s| = ``onset`` on, sliding ones while they carry ``kept``.

        Where the plastic increment would reverse a section sticks. With ``hold`` every section keeps its status.
        """
        if hold:
            return self.was_sliding & ~self.free
        # a sliding section without motion must not re-stick by round-off: with alpha < 1 it would heal. A section exactly at
        # its strength fails, whatever the round-off
        moved = self.k_s * np.abs(self.strain[:, :-1]).sum(axis=-1)
        slack = ONSET_ROUND_OFF * (np.where(np.isfinite(onset), onset, 0.0) + moved)
        persists = np.where(self.crushed, self.was_sliding, self.along >= kept - slack)
        fails = (self.size >= onset - slack) & (self.size > 0.0) & ~self.crushed
        return np.where(self.was_sliding, persists, fails) & ~self.free

    def margin(self, onset: Floats, kept: Floats) -> Floats:
        """Distance (n,) of that choice from its threshold: shear excess over strength; if open, the gap.

        Where there is neither traction nor strength, as where a fracture under gravity daylights, there is nothing to choose.
        """
        limited = np.isfinite(onset) & ((self.size > 0.0) | (onset > 0.0))
        tiny = TINY_STRENGTH * self.closure.stress_scale(len(onset))
        scale = np.maximum(np.where(limited, onset, 1.0), tiny)
        excess = np.where(self.was_sliding, self.along - kept, self.size - onset)
        shear = np.where(limited, np.abs(np.where(limited, excess, 0.0)) / scale, np.inf)
        return np.where(self.free, self.closure.gap(self.strain[:, -1]), shear)

    def approach(self, change: Floats, strength: Floats, carried: Floats) -> Floats:
        """Distances (n, 2) from the next event of sections that move by ``change`` (n, dim) in a step.

        Friction [stress]: sticking, ``strength`` (n,) less trial traction; sliding, k_s times the plastic slip of a step, the
        way it slides, with -d ``carried`` / d f_n (n,) of what it carries. Contact [1]: opening past that at which f_n
        vanishes, over d0. A change by round-off is no event.
        """
        moved = self.k_s * np.abs(self.strain[:, :-1]).sum(axis=-1)
        slack = ONSET_ROUND_OFF * (self.closure.stress_scale(len(change)) + moved)
        along = np.einsum("ni,ni->n", change[:, :-1], self.history["sliding"])
        with np.errstate(invalid="ignore"):
            slips = self.k_s * along + carried * self.k_n * change[:, -1]
            left = strength - self.size
        left = left + np.where(self.size > 0.0, -slack, slack)  # at the strength it fails
        friction = np.where(self.free, np.inf, np.where(self.was_sliding, slips + slack, left))
        distances = [np.where(np.isnan(friction), np.inf, friction), self.closure.contact(self.strain[:, -1])]
        return np.stack(distances, axis=1)

    def flipped(self, chosen: Bools) -> dict[str, Floats]:
        """The history with the chosen sections (n,) sliding the way of their trial traction if they stuck, else sticking."""
        starts = ~self.was_sliding & (self.size > 0.0)
        other = np.where(starts[:, None], self.shear / np.where(self.size > 0.0, self.size, 1.0)[:, None], 0.0)
        return {**self.history, "sliding": np.where(chosen[:, None], other, self.history["sliding"])}

    def response(
        self,
        slides: Bools,
        carried: Floats,
        by_size: Floats | float,
        by_normal: Floats,
        strength: Floats,
        margin: Floats,
        coupled: bool,
    ) -> JointResponse:
        """The response; all (n,).

        carried    shear traction of a section that slides, against its trial
        by_size    d carried / d size of the trial
        by_normal  d carried / d f_n, used where the section is pressed and the tangent is ``coupled``
        strength   to report
        """
        sections, dim = self.strain.shape
        latch, size, free, crushed, k_s = self.history["sliding"], self.size, self.free, self.crushed, self.k_s
        held = np.where(slides, carried, 0.0)
        divisor = np.where(size > 0.0, size, 1.0)
        backwards = self.was_sliding & (self.along <= 0.0)
        direction = np.where(((size > 0.0) & ~backwards)[:, None], self.shear / divisor[:, None], latch)
        f_s = np.where(slides[:, None], held[:, None] * direction, np.where(free[:, None], 0.0, self.shear))
        plastic = self.history["plastic_slip"] + (self.shear - f_s) / k_s[:, None]

        tangent = np.zeros((sections, dim, dim))
        ratio = np.where(slides, held / divisor, np.where(free, 0.0, 1.0)) * k_s
        outer = slides[:, None, None] * direction[:, :, None] * direction[:, None, :]
        tangent[:, :-1, :-1] = ratio[:, None, None] * (np.eye(dim - 1) - outer) + (by_size * k_s)[:, None, None] * outer
        tangent[:, -1, -1] = self.k_n
        if coupled:
            slope = np.where(slides & (self.f_n < 0.0) & ~crushed, by_normal, 0.0)
            tangent[:, :-1, -1] = (slope * np.where(crushed, 0.0, self.k_n))[:, None] * direction

        new_history = {
            "plastic_slip": np.where(crushed[:, None], self.history["plastic_slip"], plastic),
            "sliding": np.where(crushed[:, None], latch, slides[:, None] * direction),
        }
        squares = np.einsum("ni,ni->n", f_s, f_s) - np.einsum("ni,ni->n", self.f_s0, self.f_s0)
        return JointResponse(
            traction=np.concatenate([f_s, self.f_n[:, None]], axis=1),
            tangent=tangent,
            stored=self.normal_energy + squares / (2.0 * k_s),
            inelastic=np.concatenate([new_history["plastic_slip"], np.zeros((sections, 1))], axis=1),
            strength=strength,
            utilisation=np.where(slides, 1.0, _quotient(np.linalg.norm(f_s, axis=-1), strength)),
            is_sliding=slides,
            is_open=self.is_open,
            margin=margin,
            history=new_history,
        )


class FrictionLaw(JointLaw):
    """A joint that closes by a hyperbola and slides: the part common to all friction.

    Its ``history`` has plastic_slip and sliding.
    """

    normal_stiffness: Parameter
    shear_stiffness: Parameter
    aperture: Parameter
    initial_normal_traction: Parameter
    initial_shear_traction: Parameter
    strength_when_open: bool

    status: ClassVar[tuple[str, ...]] = ("sliding",)
    slides: ClassVar[bool] = True
    opens: ClassVar[bool] = True

    @property
    def closure(self) -> NormalClosure:
        """The normal law."""
        return NormalClosure(self.normal_stiffness, self.aperture, self.initial_normal_traction)

    def has_changed(self, old: History, new: History) -> Bools:
        """Whether sections (n,) began or ended to slide, or slide the other way; turning while sliding is no change."""
        if np.array_equal(old["sliding"], new["sliding"]):
            return np.zeros(len(old["sliding"]), dtype=bool)
        same_way = np.einsum("ni,ni->n", old["sliding"], new["sliding"]) > 0.0
        return np.asarray((old["sliding"].any(axis=1) | new["sliding"].any(axis=1)) & ~same_way)

    def step_limit(self, strain: Floats, increment: Floats) -> Floats:
        """Fraction (n,) of an increment (n, dim) to the boundary -d0 of the closure."""
        return self.closure.step_limit(strain, increment)

    def change_at(self, strain: Floats, increment: Floats) -> Floats:
        """Fraction (n,) of an increment (n, dim) at which the walls part or meet."""
        return self.closure.change_at(strain, increment)

    def with_other_status(self, strain: Floats, history: History, chosen: Bools) -> dict[str, Floats]:
        """``history`` with the chosen sections (n,) sliding the way of their trial traction if they stuck, else sticking."""
        return Trial.of(self, strain, history).flipped(chosen)


def _quotient(size: Floats, peak: Floats) -> Floats:
    """Size over peak; 0 where size is 0, inf where only the peak is."""
    positive = peak > 0.0
    return np.where(positive, size / np.where(positive, peak, 1.0), np.where(size > 0.0, np.inf, 0.0))
