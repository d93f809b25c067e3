"""HHT-alpha (Hilber, Hughes and Taylor 1977): Newmark's motion, forces between the ends of a step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from fracflow.integrators.newmark import Alphas, HasMotion, Stepper, error_by_jerk, newmark_alphas, weighed
from fracflow.integrators.parameters import parameter


@dataclass(frozen=True)
class HHT(Stepper):
    """M a_new + (1 + alpha) S_new - alpha S = 0, beta = (1 - alpha)^2/4, gamma = 1/2 - alpha: damps what dt does not resolve.

    Second order, unconditionally stable; spectral radius (1 + alpha)/(1 - alpha) for dt without end. InputError for
    alpha outside [-1/3, 0].
    """

    alpha: float = parameter(
        -0.1,
        "hht_alpha",
        "alpha of the stepper hht [1]: 0 is the trapezoidal rule, -1/3 damps most",
        at_least=-1.0 / 3.0,
        at_most=0.0,
    )

    order: ClassVar[int] = 2

    @property
    def damps(self) -> bool:
        """Below alpha = 0."""
        return self.alpha < 0.0

    @property
    def beta(self) -> float:
        """That of Newmark's motion."""
        return (1.0 - self.alpha) ** 2 / 4.0

    def alphas(self, time_step: float, last: float | None = None) -> Alphas:
        """(4.3) with the weights of the old balance; time_step [time], positive."""
        motion = newmark_alphas(time_step, self.beta, 0.5 - self.alpha)
        return weighed(motion, of_inertia=0.0, of_forces=-self.alpha)

    def local_error(self, time_step: float, old: HasMotion, new: HasMotion) -> Any:
        """(beta - 1/6) dt^2 (a_new - a)."""
        return error_by_jerk(self.beta - 1.0 / 6.0, time_step, old, new)
