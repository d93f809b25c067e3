"""The report's joint law: hyperbolic closure without tension, Coulomb friction with a strength drop."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from .base import Bools, Floats, JointResponse, Kind, Parameter, Past, per_section, per_tangent, rest_history

STEP_FRACTION = 0.9  # of the gap that is left
ROUND_OFF = 1e-12
NOISE = 1e-10  # of the aperture: no opening or closing
TINY_STRENGTH = 1e-9  # of the joint's own stress scale: keeps margins finite where the strength is nil


@dataclass(frozen=True, eq=False)
class HyperbolicCoulomb:
    """(2.11)-(2.12), Figs. 3 and 4: hyperbolic closure, no tension, Coulomb friction with stick-slip ratio.

    normal_stiffness        k_n0 [stress/length], > 0
    shear_stiffness         k_s [stress/length], > 0
    aperture                d0 [length], > 0: closure can approach, never reach it
    friction_coefficient    tan(phi)
    cohesion                C [stress], inf for a joint that never fails
    stick_slip_ratio        alpha in (0, 1]: strength while sliding over peak strength
    initial_normal_traction f_n0 [stress], <= 0, effective
    initial_shear_traction  f_s0 [stress]
    coupled_tangent         False: the report's k_s and k_n only, without d f_s / d eps_n
    strength_when_open      True: (2.12) as printed, strength C when f_n >= 0; False: none once strictly open

    Parameters are numbers or arrays (n,), f_s0 may be (n, dim-1); joint frame, tension positive.

    History: ``plastic_slip`` [length] and ``sliding``, the unit direction of the sliding traction, zero while
    sticking. A section that sticks slides once the trial traction passes the peak strength. A section that
    slides carries alpha times the peak of its present f_n until the plastic increment would reverse; then it
    sticks, the peak restored with its cohesion, whatever the size of its elastic traction: the next call may
    let it slide the other way. An open section has no shear traction and closes again sticking.
    """

    normal_stiffness: Parameter
    shear_stiffness: Parameter
    aperture: Parameter
    friction_coefficient: Parameter = 0.0
    cohesion: Parameter = 0.0
    stick_slip_ratio: Parameter = 1.0
    initial_normal_traction: Parameter = 0.0
    initial_shear_traction: Parameter = 0.0
    coupled_tangent: bool = True
    strength_when_open: bool = False

    history: ClassVar[dict[str, Kind]] = {"plastic_slip": "shear", "sliding": "shear"}
    status: ClassVar[tuple[str, ...]] = ("sliding",)

    def rest(self, sections: int, dim: int) -> dict[str, Floats]:
        """No plastic slip, sticking."""
        return rest_history(self.history, sections, dim)

    def normal(self, opening: Floats) -> tuple[Floats, Floats, Floats]:
        """(2.11) Fig. 3: normal traction f_n <= 0, stiffness k_n and energy int f_n d eps_n of openings (n,).

        At or past -d0: -inf, inf, inf, the limits of the hyperbola, so that no solver can accept the state.
        """
        k_n0, d0, f_n0 = (
            per_section(v, len(opening)) for v in (self.normal_stiffness, self.aperture, self.initial_normal_traction)
        )
        crushed = opening <= -d0
        closing = opening < 0.0
        eps = np.where(crushed, 0.0, np.minimum(opening, -f_n0 / k_n0))
        squeeze = 1.0 + np.minimum(eps, 0.0) / d0
        f_n = np.minimum(f_n0 + k_n0 * eps / squeeze, 0.0)
        f_n[self._is_open(opening)] = 0.0
        k_n = np.where(self._is_open(opening), 0.0, k_n0 / squeeze**2)
        hyperbola = d0**2 * _minus_log(np.minimum(eps, 0.0) / d0)
        energy = f_n0 * eps + k_n0 * np.where(closing, hyperbola, 0.5 * eps**2)
        return (
            np.where(crushed, -np.inf, f_n),
            np.where(crushed, np.inf, k_n),
            np.where(crushed, np.inf, energy),
        )

    def respond(self, strain: Floats, past: Past, hold: bool = False) -> JointResponse:
        """(2.12), (2.22), (2.26) Response to strain (n, dim) after ``past``, at most one change of status.

        With ``hold`` sticking sections stick and sliding ones slide whatever their trial traction is. Opening at
        or past -d0 gives a normal traction of -inf and leaves the history as it was. ``margin`` is that of the
        choice made from the status in ``past``.
        """
        sections, dim = strain.shape
        k_s, tan_phi, cohesion, alpha = (
            per_section(v, sections)
            for v in (self.shear_stiffness, self.friction_coefficient, self.cohesion, self.stick_slip_ratio)
        )
        f_s0 = per_tangent(self.initial_shear_traction, sections, dim - 1)
        opening = strain[:, -1]
        f_n, k_n, normal_energy = self.normal(opening)
        crushed = ~np.isfinite(f_n)
        is_open = self._is_open(opening)
        free = is_open & (not self.strength_when_open)
        peak = np.where(free, 0.0, cohesion - np.where(crushed, 0.0, f_n) * tan_phi)
        residual = alpha * peak

        latch = past["sliding"]
        trial = self._trial(strain, past)
        size = np.linalg.norm(trial, axis=-1)
        was_sliding = latch.any(axis=-1)
        along = np.einsum("ni,ni->n", trial, latch)
        # a section that rests while sliding must not re-stick by round-off: with alpha < 1 it would heal
        slack = ROUND_OFF * (np.where(np.isfinite(peak), peak, 0.0) + k_s * np.abs(strain[:, :-1]).sum(axis=-1))
        persists = np.where(crushed, was_sliding, along >= residual - slack)
        slides = was_sliding & ~free if hold else np.where(was_sliding, persists, (size > peak) & ~crushed) & ~free

        held = np.where(slides, residual if hold else np.minimum(residual, size), 0.0)
        divisor = np.where(size > 0.0, size, 1.0)
        backwards = was_sliding & (along <= 0.0)
        direction = np.where(((size > 0.0) & ~backwards)[:, None], trial / divisor[:, None], latch)
        f_s = np.where(slides[:, None], held[:, None] * direction, np.where(free[:, None], 0.0, trial))
        plastic = past["plastic_slip"] + (trial - f_s) / k_s[:, None]

        tangent = np.zeros((sections, dim, dim))
        ratio = np.where(slides, held / divisor, np.where(free, 0.0, 1.0)) * k_s
        tangent[:, :-1, :-1] = ratio[:, None, None] * (
            np.eye(dim - 1) - slides[:, None, None] * direction[:, :, None] * direction[:, None, :]
        )
        tangent[:, -1, -1] = k_n
        if self.coupled_tangent:
            slope = np.where(slides & (f_n < 0.0) & ~crushed, -alpha * tan_phi, 0.0)
            tangent[:, :-1, -1] = (slope * np.where(crushed, 0.0, k_n))[:, None] * direction

        new_past = {
            "plastic_slip": np.where(crushed[:, None], past["plastic_slip"], plastic),
            "sliding": np.where(crushed[:, None], latch, slides[:, None] * direction),
        }
        shear_energy = (np.einsum("ni,ni->n", f_s, f_s) - np.einsum("ni,ni->n", f_s0, f_s0)) / (2.0 * k_s)
        return JointResponse(
            traction=np.concatenate([f_s, f_n[:, None]], axis=1),
            tangent=tangent,
            stored=normal_energy + shear_energy,
            inelastic=np.concatenate([new_past["plastic_slip"], np.zeros((sections, 1))], axis=1),
            strength=peak,
            utilisation=np.where(slides, 1.0, _quotient(np.linalg.norm(f_s, axis=-1), peak)),
            is_sliding=slides,
            is_open=is_open,
            margin=self._margin(opening, free, np.where(was_sliding, along - residual, size - peak), peak),
            past=new_past,
        )

    def has_changed(self, old: Past, new: Past) -> Bools:
        """Whether a section began or ended to slide, or slides the other way; turning while it slides is no change."""
        same_way = np.einsum("ni,ni->n", old["sliding"], new["sliding"]) > 0.0
        changed: Bools = (old["sliding"].any(axis=1) | new["sliding"].any(axis=1)) & ~same_way
        return changed

    def step_limit(self, strain: Floats, increment: Floats) -> Floats:
        """Fraction to the boundary: a section may use 0.9 of the gap eps_n + d0 that is left."""
        gap = np.maximum(strain[:, -1] + per_section(self.aperture, len(strain)), 0.0)
        closure = -increment[:, -1]
        return np.where(closure > 0.0, STEP_FRACTION * gap / np.where(closure > 0.0, closure, 1.0), np.inf)

    def change_at(self, strain: Floats, increment: Floats) -> Floats:
        """Fraction of the increment at which the opening is that of Fig. 3 where f_n vanishes."""
        k_n0, f_n0 = (per_section(v, len(strain)) for v in (self.normal_stiffness, self.initial_normal_traction))
        gap, opening = -f_n0 / k_n0 - strain[:, -1], increment[:, -1]
        moves = opening != 0.0
        fraction = np.where(moves, gap / np.where(moves, opening, 1.0), np.inf)
        return np.where(fraction > 0.0, fraction, np.inf)

    def approach(self, strain: Floats, change: Floats, past: Past) -> Floats:
        """Distances (n, 2) from the next event at strain (n, dim), which moves by ``change`` (n, dim) in a step.

        Friction [stress]: sticking, strength (2.12) less trial traction; sliding, k_s times the plastic slip of a step, the
        way it slides. Contact [1]: opening past that at which f_n vanishes, over d0. What round-off does is no event.
        """
        sections, opening = len(strain), strain[:, -1]
        k_s, tan_phi, alpha, k_n0, d0, f_n0 = (
            per_section(v, sections)
            for v in (
                self.shear_stiffness, self.friction_coefficient, self.stick_slip_ratio,
                self.normal_stiffness, self.aperture, self.initial_normal_traction,
            )
        )  # fmt: skip
        f_n, k_n, _ = self.normal(opening)
        peak, latch = per_section(self.cohesion, sections) - f_n * tan_phi, past["sliding"]
        slack = ROUND_OFF * (np.maximum(np.abs(f_n0), k_n0 * d0) + k_s * np.abs(strain[:, :-1]).sum(axis=-1))
        left = peak - np.linalg.norm(self._trial(strain, past), axis=-1)
        slips = k_s * np.einsum("ni,ni->n", change[:, :-1], latch) + alpha * tan_phi * k_n * change[:, -1]
        free = self._is_open(opening) & (not self.strength_when_open)
        friction = np.where(free, np.inf, np.where(latch.any(axis=-1), slips, left) + slack)
        contact = (f_n0 / k_n0 + opening) / d0
        distances = [np.where(np.isnan(friction), np.inf, friction), np.where(np.abs(contact) > NOISE, contact, 0.0)]
        return np.stack(distances, axis=1)

    def flip(self, strain: Floats, past: Past, chosen: Bools) -> dict[str, Floats]:
        """``past`` with the chosen sections (n,) sliding the way of their trial traction if they stuck, else sticking."""
        trial, latch = self._trial(strain, past), past["sliding"]
        size = np.linalg.norm(trial, axis=-1)
        starts = ~latch.any(axis=-1) & (size > 0.0)
        other = np.where(starts[:, None], trial / np.where(size > 0.0, size, 1.0)[:, None], 0.0)
        return {**past, "sliding": np.where(chosen[:, None], other, latch)}

    def _trial(self, strain: Floats, past: Past) -> Floats:
        """(n, dim-1) The shear traction if no plastic slip were added."""
        f_s0 = per_tangent(self.initial_shear_traction, len(strain), strain.shape[1] - 1)
        return f_s0 + per_section(self.shear_stiffness, len(strain))[:, None] * (strain[:, :-1] - past["plastic_slip"])

    def _is_open(self, opening: Floats) -> Bools:
        """Fig. 3: strictly past the opening at which f_n vanishes."""
        k_n0, f_n0 = (np.asarray(v, dtype=float) for v in (self.normal_stiffness, self.initial_normal_traction))
        past_contact: Bools = opening > -f_n0 / k_n0
        return past_contact

    def _margin(self, opening: Floats, free: Bools, excess: Floats, peak: Floats) -> Floats:
        """Distance from the threshold: shear excess over strength; if open, the gap over |f_n0|/k_n0."""
        k_n0, d0, f_n0 = (
            per_section(v, len(opening)) for v in (self.normal_stiffness, self.aperture, self.initial_normal_traction)
        )
        limited = np.isfinite(peak)
        scale = np.maximum(np.where(limited, peak, 1.0), TINY_STRENGTH * np.maximum(np.abs(f_n0), k_n0 * d0))
        shear = np.where(limited, np.abs(np.where(limited, excess, 0.0)) / scale, np.inf)
        loaded = f_n0 < 0.0
        gap = np.where(loaded, np.abs(f_n0 + k_n0 * opening) / np.where(loaded, -f_n0, 1.0), np.inf)
        return np.where(free, gap, shear)


def _minus_log(x: Floats) -> Floats:
    """Closed form x - log(1 + x), by its series where it would cancel; x (n,) in (-1, 0]."""
    series = x**2 * (0.5 - x * (1.0 / 3.0 - x * (0.25 - x * (0.2 - x / 6.0))))
    result: Floats = np.where(np.abs(x) < 1e-3, series, x - np.log1p(np.where(x > -1.0, x, 0.0)))
    return result


def _quotient(size: Floats, peak: Floats) -> Floats:
    """Size over peak; 0 where size is 0, inf where only the peak is."""
    positive = peak > 0.0
    return np.where(positive, size / np.where(positive, peak, 1.0), np.where(size > 0.0, np.inf, 0.0))
