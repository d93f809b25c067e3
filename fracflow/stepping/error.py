"""What one step adds to the error, estimated from the motions at its ends, on arrays."""

from __future__ import annotations

from typing import Any

from .newmark import HasMotion, Stepper


def local_error(stepper: Stepper, time_step: float, old: HasMotion, new: HasMotion) -> Any:
    """About the error in displacement that a step adds, of either sign.

    With inertia, (beta - 1/6) dt^2 (a_new - a) (Zienkiewicz and Xie 1991), or dt^2 a_new/2 of first order; else that of
    backward Euler, dt (v_new - v)/2, which is more than the rules of second order add.
    """
    if stepper.inertia:
        if stepper.order == 1:
            return 0.5 * time_step**2 * new.acceleration
        share = 1.0 / (stepper.alphas(time_step).a0 * time_step**2) - 1.0 / 6.0  # a0 = 1/(beta dt^2)
        return share * time_step**2 * (new.acceleration - old.acceleration)
    return 0.5 * time_step * (new.velocity - old.velocity)
