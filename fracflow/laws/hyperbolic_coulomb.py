"""The report's joint law: hyperbolic closure without tension, Coulomb friction with a strength drop.

``friction.h`` has a compiled copy, which ``tests/laws/test_compiled.py`` holds to it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from fracflow.laws.base import INSTANT, Floats, History, JointResponse, LawStep, Parameter, key, per_section
from fracflow.laws.friction import PLASTIC_SLIP, SLIDING, FrictionLaw, Trial


@dataclass(frozen=True, eq=False)
class HyperbolicCoulomb(FrictionLaw):
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
    sticking. A section that sticks slides once the trial traction passes the peak strength. A section that slides carries
    alpha times the peak of its present f_n until the plastic increment would reverse. Then it sticks, with its peak and
    cohesion restored, whatever its elastic traction. It may slide the other way in the next call. An open section has no shear
    traction and closes again sticking.
    """

    normal_stiffness: Parameter
    shear_stiffness: Parameter
    aperture: Parameter
    friction_coefficient: Parameter = field(
        default=0.0, metadata=key("tan phi of (2.12) [1]; or give friction_angle_deg", at_least=0.0)
    )
    cohesion: Parameter = field(default=0.0, metadata=key("C of (2.12)", "force/length**2", at_least=0.0))
    stick_slip_ratio: Parameter = field(
        default=1.0, metadata=key("alpha, strength while sliding over peak strength [1]", above=0.0, at_most=1.0)
    )
    initial_normal_traction: Parameter = 0.0
    initial_shear_traction: Parameter = 0.0
    coupled_tangent: bool = True
    strength_when_open: bool = False

    history: ClassVar = {"plastic_slip": PLASTIC_SLIP, "sliding": SLIDING}
    no_drop: ClassVar[str] = "stick_slip_ratio = 1"
    compiled: ClassVar[int | None] = 1

    def evaluate(self, strain: Floats, history: History, step: LawStep = INSTANT) -> JointResponse:
        """(2.12), (2.22), (2.26) Response to strain (n, dim) after ``history``, at most one change of status.

        With ``step.hold`` sticking sections stick and sliding ones slide whatever their trial traction is. Opening at
        or past -d0 gives a normal traction of -inf and leaves the history as it was. ``margin`` is that of the
        choice made from the status in ``history``.
        """
        trial = Trial.of(self, strain, history)
        tan_phi, cohesion, alpha = self._parameters(len(strain))
        peak = np.where(trial.free, 0.0, cohesion - trial.normal_traction() * tan_phi)
        residual = alpha * peak
        return trial.response(
            slides=trial.slides(peak, residual, step.hold),
            carried=residual if step.hold else np.minimum(residual, trial.size),
            by_size=0.0,
            by_normal=-alpha * tan_phi,
            strength=peak,
            margin=trial.margin(peak, residual),
            coupled=self.coupled_tangent,
        )

    def approach(self, strain: Floats, change: Floats, history: History, step: LawStep = INSTANT) -> Floats:
        """Distances (n, 2) from the next event at strain (n, dim), which moves by ``change`` (n, dim) in a step."""
        tan_phi, cohesion, alpha = self._parameters(len(strain))
        trial = Trial.of(self, strain, history)
        return trial.approach(change, cohesion - trial.f_n * tan_phi, alpha * tan_phi)

    def strength_drop(self, compression: Floats) -> Floats:
        """Drop of strength (n,): (1 - alpha) (C + compression tan phi), compression (n,) [stress]."""
        tan_phi, cohesion, alpha = self._parameters(len(compression))
        drops = alpha < 1.0
        return np.where(drops, np.where(drops, 1.0 - alpha, 1.0) * (cohesion + compression * tan_phi), 0.0)

    def _parameters(self, sections: int) -> Iterator[Floats]:
        """Tan phi, C and alpha (n,)."""
        return (per_section(v, sections) for v in (self.friction_coefficient, self.cohesion, self.stick_slip_ratio))

    def slip_length(self, sections: int) -> Floats:
        """Slip (n,) over which strength falls: 0, since the drop of alpha < 1 comes at once; inf without a drop [length]."""
        return np.where(per_section(self.stick_slip_ratio, sections) < 1.0, 0.0, np.inf)
