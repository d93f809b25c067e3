"""Friction that falls with slip: the strength drop with a length of its own.

``friction.h`` has a compiled copy, which ``tests/laws/test_compiled.py`` holds to it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar

import numpy as np

from fracflow.laws.base import INSTANT, Floats, History, JointResponse, LawStep, Parameter, key, per_section
from fracflow.laws.friction import PLASTIC_SLIP, SLIDING, SLIP_PATH, FrictionLaw, Trial


@dataclass(frozen=True, eq=False)
class SlipWeakening(FrictionLaw):
    """(2.11) with Coulomb friction whose coefficient falls linearly with slip (Ida 1972, Andrews 1976).

    normal_stiffness             k_n0 [stress/length], > 0
    shear_stiffness              k_s [stress/length], > 0
    aperture                     d0 [length], > 0: closure can approach, never reach it
    friction_coefficient         mu_p of a joint that has not slid
    dynamic_friction_coefficient mu_d <= mu_p after D_c of slip
    slip_weakening_distance      D_c [length], > 0
    cohesion                     C [stress], does not weaken
    initial_normal_traction      f_n0 [stress], <= 0, effective
    initial_shear_traction       f_s0 [stress]
    coupled_tangent              False: without d f_s / d eps_n
    strength_when_open           True: strength C when f_n >= 0; False: none once strictly open

    Parameters are numbers or arrays (n,), f_s0 may be (n, dim-1); joint frame, tension positive.
    Strength C - f_n mu(D), mu = mu_p - (mu_p - mu_d) min(D/D_c, 1), at the present f_n.

    History: ``plastic_slip`` [length], ``slip_path`` D [length], the length of its path, and ``sliding``, the unit
    direction of the sliding traction, zero while sticking. Nothing heals: a section that re-sticks, or opens and closes
    again, keeps its D. It re-sticks where the plastic increment would reverse, as with "hyperbolic-coulomb". The return
    to the strength is exact: within the weakening, past D_c, and across it in one call.

    Where |f_n| (mu_p - mu_d)/D_c >= k_s the spring cannot unload as fast as the strength falls (``steepness``): the
    traction then jumps past D_c at the onset of slip.
    """

    normal_stiffness: Parameter
    shear_stiffness: Parameter
    aperture: Parameter
    friction_coefficient: Parameter = field(
        metadata=key("mu_p, before any slip [1]; or give friction_angle_deg", at_least=0.0)
    )
    dynamic_friction_coefficient: Parameter = field(
        metadata=key("mu_d, after a slip of D_c [1]", at_least=0.0, not_above="friction_coefficient")
    )
    slip_weakening_distance: Parameter = field(
        metadata=key("D_c, slip over which friction falls from mu_p to mu_d", "length", above=0.0)
    )
    cohesion: Parameter = field(default=0.0, metadata=key("C of (2.12)", "force/length**2", at_least=0.0))
    initial_normal_traction: Parameter = 0.0
    initial_shear_traction: Parameter = 0.0
    coupled_tangent: bool = True
    strength_when_open: bool = False

    history: ClassVar = {"plastic_slip": PLASTIC_SLIP, "slip_path": SLIP_PATH, "sliding": SLIDING}
    weakens_over: ClassVar[str] = "slip_weakening_distance"
    compiled: ClassVar[int | None] = 2

    def friction(self, slip_path: Floats) -> tuple[Floats, Floats]:
        """Mu of slip paths D (n,), and by how much it falls with further slip [1/length], 0 from D_c on."""
        peak, dynamic, distance = self._parameters(len(slip_path))
        weakens = slip_path < distance
        falls = np.where(weakens, (peak - dynamic) / distance, 0.0)
        return np.where(weakens, peak - falls * slip_path, dynamic), falls

    def _parameters(self, sections: int) -> Iterator[Floats]:
        """mu_p, mu_d and D_c (n,)."""
        given = (self.friction_coefficient, self.dynamic_friction_coefficient, self.slip_weakening_distance)
        return (per_section(v, sections) for v in given)

    def evaluate(self, strain: Floats, history: History, step: LawStep = INSTANT) -> JointResponse:
        """(2.12), (2.22), (2.26) Response to strain (n, dim) after ``history``, at most one change of status.

        With ``step.hold`` sticking sections stick, and sliding ones slide; those that would go back then carry the strength
        that they have. Opening at or past -d0 gives a normal traction of -inf and leaves the history as it was.
        """
        trial, path = Trial.of(self, strain, history), history["slip_path"]
        cohesion, k_s, f_n = per_section(self.cohesion, len(strain)), trial.k_s, trial.normal_traction()
        mu, falls = self.friction(path)
        strength = np.where(trial.free, 0.0, cohesion - f_n * mu)
        slides = trial.slides(strength, strength, step.hold)

        excess = np.where(trial.was_sliding & (trial.along <= 0.0), 0.0, np.maximum(trial.size - strength, 0.0))
        stiff = k_s + f_n * falls  # of spring and weakening, <= 0 where the joint jumps
        slip = np.where(stiff > 0.0, excess / np.where(stiff > 0.0, stiff, 1.0), np.inf)
        distance = per_section(self.slip_weakening_distance, len(strain))
        crosses = (falls > 0.0) & (path + np.where(excess > 0.0, slip, 0.0) >= distance)
        lower = cohesion - f_n * per_section(self.dynamic_friction_coefficient, len(strain))
        slip = np.where(excess > 0.0, np.where(crosses, (trial.size - lower) / k_s, slip), 0.0)
        softens = slides & (falls > 0.0) & ~crosses & (slip > 0.0)
        share = np.where(softens, k_s / np.where(softens, stiff, 1.0), 1.0)
        now, _ = self.friction(path + slip)
        unmoved = strength if step.hold else np.minimum(strength, trial.size)
        carried = np.where(slip > 0.0, cohesion - f_n * now, unmoved)
        slid = slides & ~trial.crushed
        response = trial.response(
            slides=slides,
            carried=carried,
            by_size=1.0 - share,
            by_normal=-now * share,
            strength=np.where(slid & (slip > 0.0), carried, strength),
            margin=trial.margin(strength, strength),
            coupled=self.coupled_tangent,
        )
        return replace(response, history={**response.history, "slip_path": path + np.where(slid, slip, 0.0)})

    def steepness(self, traction: Floats, history: History) -> Floats:
        """|f_n| (mu_p - mu_d)/(D_c k_s) (n,) at traction (n, dim) while friction falls; 0 once it has."""
        return self.softening(traction, history) / per_section(self.shear_stiffness, len(traction))

    def most_steepness(self, compression: float) -> float:
        """Largest (mu_p - mu_d)/(D_c k_s) of all sections, times the ``compression`` [stress]."""
        return compression * self._steepest if self._steepest > 0.0 else 0.0  # of an infinite one, too

    @cached_property
    def _steepest(self) -> float:
        drop = np.subtract(self.friction_coefficient, self.dynamic_friction_coefficient)
        return float(np.max(drop / np.multiply(self.slip_weakening_distance, self.shear_stiffness), initial=0.0))

    def softening(self, traction: Floats, history: History) -> Floats:
        """|f_n| (mu_p - mu_d)/D_c (n,) at traction (n, dim) while friction falls; 0 once it has [stress/length]."""
        path, f_n = history["slip_path"], traction[:, -1]
        peak, dynamic, distance = self._parameters(len(path))
        pressed = np.where((f_n < 0.0) & (f_n > -np.inf) & (path < distance), -f_n, 0.0)
        found: Floats = pressed * ((peak - dynamic) / distance)
        return found

    def strength_drop(self, compression: Floats) -> Floats:
        """Drop of strength (n,): the compression (n,) times mu_p - mu_d [stress]."""
        peak, dynamic, _ = self._parameters(len(compression))
        return compression * (peak - dynamic)

    def slip_length(self, sections: int) -> Floats:
        """Slip (n,) over which strength falls, D_c [length]."""
        return per_section(self.slip_weakening_distance, sections)

    def approach(self, strain: Floats, change: Floats, history: History, step: LawStep = INSTANT) -> Floats:
        """Distances (n, 2) from the next event at strain (n, dim), which moves by ``change`` (n, dim) in a step."""
        mu, _ = self.friction(history["slip_path"])
        trial = Trial.of(self, strain, history)
        return trial.approach(change, per_section(self.cohesion, len(strain)) - trial.f_n * mu, mu)
