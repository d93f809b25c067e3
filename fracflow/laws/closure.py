"""Hyperbolic closure without tension: the normal law that laws with friction share.

``friction.h`` has a compiled copy, which ``tests/laws/test_compiled.py`` holds to it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from fracflow.laws.base import Bools, Floats, Parameter, per_section

STEP_FRACTION = 0.9  # of the gap that is left
NOISE = 1e-10  # of the aperture: no opening or closing


@dataclass(frozen=True, eq=False)
class NormalClosure:
    """(2.11), Fig. 3: hyperbola in compression, straight to f_n = 0, nothing beyond.

    normal_stiffness  k_n0 [stress/length], > 0
    aperture          d0 [length], > 0: closure can approach, never reach it
    initial_traction  f_n0 [stress], <= 0, effective

    Parameters are numbers or arrays (n,).
    """

    normal_stiffness: Parameter
    aperture: Parameter
    initial_traction: Parameter

    def evaluate(self, opening: Floats) -> tuple[Floats, Floats, Floats]:
        """(2.11) Normal traction f_n <= 0, stiffness k_n and energy int f_n d eps_n of openings (n,).

        At or past -d0: -inf, inf, inf, the limits of the hyperbola, so that no solver can accept the state.
        """
        k_n0, d0, f_n0 = self._parameters(len(opening))
        crushed = opening <= -d0
        closing = opening < 0.0
        eps = np.where(crushed, 0.0, np.minimum(opening, -f_n0 / k_n0))
        squeeze = 1.0 + np.minimum(eps, 0.0) / d0
        is_open = opening > -f_n0 / k_n0
        f_n = np.where(is_open, 0.0, np.minimum(f_n0 + k_n0 * eps / squeeze, 0.0))
        k_n = np.where(is_open, 0.0, k_n0 / squeeze**2)
        hyperbola = d0**2 * _minus_log(np.minimum(eps, 0.0) / d0)
        energy = f_n0 * eps + k_n0 * np.where(closing, hyperbola, 0.5 * eps**2)
        return np.where(crushed, -np.inf, f_n), np.where(crushed, np.inf, k_n), np.where(crushed, np.inf, energy)

    def is_open(self, opening: Floats) -> Bools:
        """Fig. 3: whether openings (n,) are strictly past that at which f_n vanishes."""
        k_n0, f_n0 = (np.asarray(v, dtype=float) for v in (self.normal_stiffness, self.initial_traction))
        return np.asarray(opening > -f_n0 / k_n0)

    def gap(self, opening: Floats) -> Floats:
        """Distance (n,) from the loss of contact, over |f_n0|/k_n0; inf where f_n0 = 0."""
        k_n0, _, f_n0 = self._parameters(len(opening))
        loaded = f_n0 < 0.0
        return np.where(loaded, np.abs(f_n0 + k_n0 * opening) / np.where(loaded, -f_n0, 1.0), np.inf)

    def contact(self, opening: Floats) -> Floats:
        """Opening past that at which f_n vanishes, over d0 (n,); 0 where it is no more than round-off."""
        k_n0, d0, f_n0 = self._parameters(len(opening))
        past_contact = (f_n0 / k_n0 + opening) / d0
        return np.where(np.abs(past_contact) > NOISE, past_contact, 0.0)

    def stress_scale(self, sections: int) -> Floats:
        """The joint's own stress (n,): the larger of |f_n0| and k_n0 d0."""
        k_n0, d0, f_n0 = self._parameters(sections)
        return np.maximum(np.abs(f_n0), k_n0 * d0)

    def step_limit(self, strain: Floats, increment: Floats) -> Floats:
        """Fraction (n,) of an increment (n, dim): a section may use 0.9 of the gap eps_n + d0 that is left."""
        gap = np.maximum(strain[:, -1] + per_section(self.aperture, len(strain)), 0.0)
        closure = -increment[:, -1]
        return np.where(closure > 0.0, STEP_FRACTION * gap / np.where(closure > 0.0, closure, 1.0), np.inf)

    def change_at(self, strain: Floats, increment: Floats) -> Floats:
        """Fraction (n,) of an increment (n, dim) at which the opening is that of Fig. 3 where f_n vanishes; inf if none."""
        k_n0, _, f_n0 = self._parameters(len(strain))
        gap, opening = -f_n0 / k_n0 - strain[:, -1], increment[:, -1]
        moves = opening != 0.0
        fraction = np.where(moves, gap / np.where(moves, opening, 1.0), np.inf)
        return np.where(fraction > 0.0, fraction, np.inf)

    def _parameters(self, sections: int) -> Iterator[Floats]:
        """k_n0, d0 and f_n0 (n,)."""
        return (per_section(v, sections) for v in (self.normal_stiffness, self.aperture, self.initial_traction))


def _minus_log(x: Floats) -> Floats:
    """Closed form x - log(1 + x), by its series where it would cancel; x (n,) in (-1, 0]."""
    series = x**2 * (0.5 - x * (1.0 / 3.0 - x * (0.25 - x * (0.2 - x / 6.0))))
    return np.where(np.abs(x) < 1e-3, series, x - np.log1p(np.where(x > -1.0, x, 0.0)))
