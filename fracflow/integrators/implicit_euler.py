"""Backward Euler with inertia: of first order, and damps every motion that dt does not resolve within a step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from fracflow.integrators.newmark import Alphas, Balance, HasMotion, Stepper, checked


@dataclass(frozen=True)
class ImplicitEuler(Stepper):
    """v_new = (d_new - d)/dt, a_new = (v_new - v)/dt: an oscillation is multiplied by 1/(1 + i omega dt) in a step."""

    order: ClassVar[int] = 1
    damps: ClassVar[bool] = True
    balance: ClassVar[Balance] = "end"

    def alphas(self, time_step: float, last: float | None = None) -> Alphas:
        """alpha_0 = 1/dt^2, alpha_1 = alpha_2 = 1/dt, the rest zero; time_step [time], positive."""
        dt = checked(time_step)
        return Alphas(a0=1.0 / dt**2, a1=1.0 / dt, a2=1.0 / dt)

    def local_error(self, time_step: float, old: HasMotion, new: HasMotion) -> Any:
        """dt^2 a_new/2."""
        return 0.5 * time_step**2 * new.acceleration
