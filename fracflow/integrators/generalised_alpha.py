"""Generalised-alpha (Chung and Hulbert 1993): inertia and forces each at a place of their own between the ends of a step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from fracflow.integrators.newmark import Alphas, HasMotion, Stepper, error_by_jerk, newmark_alphas, weighed
from fracflow.integrators.parameters import parameter


@dataclass(frozen=True)
class GeneralisedAlpha(Stepper):
    """M ((1 - alpha_m) a_new + alpha_m a) + (1 - alpha_f) S_new + alpha_f S = 0, of the least damping for a rho_infinity.

    alpha_m = (2 rho - 1)/(rho + 1), alpha_f = rho/(rho + 1), beta = (1 - alpha_m + alpha_f)^2/4, gamma = 1/2 - alpha_m
    + alpha_f. Second order, unconditionally stable; rho_infinity is the spectral radius for dt without end. InputError
    for one outside [0, 1].
    """

    rho: float = parameter(
        0.8,
        "rho_infinity",
        "what generalised-alpha leaves in a step of motions that dt does not resolve [1]: 1 all of it, 0 nothing",
        at_least=0.0,
        at_most=1.0,
    )

    order: ClassVar[int] = 2

    @property
    def damps(self) -> bool:
        """Below rho_infinity = 1."""
        return self.rho < 1.0

    def alphas(self, time_step: float, last: float | None = None) -> Alphas:
        """(4.3) with the weights of the old acceleration and the old balance; time_step [time], positive."""
        of_inertia, of_forces = (2.0 * self.rho - 1.0) / (self.rho + 1.0), self.rho / (self.rho + 1.0)
        late = of_forces - of_inertia
        motion = newmark_alphas(time_step, (1.0 + late) ** 2 / 4.0, 0.5 + late)
        return weighed(motion, of_inertia, of_forces)

    def local_error(self, time_step: float, old: HasMotion, new: HasMotion) -> Any:
        """(beta - 1/6) dt^2 (a_new - a)."""
        beta = 1.0 / (self.rho + 1.0) ** 2  # (1 - alpha_m + alpha_f)^2/4
        return error_by_jerk(beta - 1.0 / 6.0, time_step, old, new)
