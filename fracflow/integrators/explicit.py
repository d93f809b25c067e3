"""Central differences for the rock, the trapezoidal rule for joints, flow and loads: the algebra of a step, on arrays.

With r = R - G' W t, the loads and the total traction of joints and fluid at both walls, and S = dt^2/4,
u_new = u + dt v + dt^2/2 a + S M^-1 (r_new - r),   v_new = v + dt/2 (a + a_new),   M a = r - K_s u,
which is (M + S J)(u_new - 2 u + u_old) + dt^2 (K_s + J) u = 0 of joints of stiffness J. It is stable while dt^2 K_s < 4 M,
however stiff the joints are.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

from fracflow.integrators.newmark import Alphas, Balance, HasMotion, Newmark, Stepper, checked, error_by_jerk

# of coordinates, by which a time step may pass the critical one: noise grows by 1e-5 a step there
STEP_ROUND_OFF = 2e-11


@dataclass(frozen=True)
class Explicit(Stepper):
    """Velocity Verlet with a lumped mass; joints, flow and loads by Newmark's beta = 1/4, gamma = 1/2."""

    order: ClassVar[int] = 2
    balance: ClassVar[Balance] = "step"
    explicit: ClassVar[bool] = True

    def alphas(self, time_step: float, last: float | None = None) -> Alphas:
        """(4.3) Those of held unknowns and of flow, which follow the trapezoidal rule; time_step [time], positive."""
        return Newmark().alphas(time_step)

    def local_error(self, time_step: float, old: HasMotion, new: HasMotion) -> Any:
        """dt^2 (a_new - a)/6 of the rock, whose beta is 0; half as much where joints pull. Of a part, or of all in a row."""
        return error_by_jerk(-1.0 / 6.0, time_step, old, new)


def predicted(motion: HasMotion, dt: float) -> Any:
    """Change of displacement in a step under the present forces of loads, joints and fluid."""
    return dt * motion.velocity + 0.5 * dt**2 * motion.acceleration


def joint_share(dt: float) -> float:
    """S: what a change of the pull at the end of a step adds to the displacement, times M^-1 [time^2]."""
    return 0.25 * dt**2


def velocity_after(motion: HasMotion, acceleration: Any, dt: float) -> Any:
    """Velocity at the end of a step, from the ``acceleration`` there."""
    return motion.velocity + 0.5 * dt * (motion.acceleration + acceleration)


def scheme_energy(dt: float, before: float, after: float) -> float:
    """Change of -dt^2/8 a M a, from ``before`` to ``after`` in a M a: what the scheme takes up beside ``scheme_work``.

    A step dissipates d M (a + a_new)/2 less the change of v M v/2. By the above its displacement d is dt (v + v_new)/2 +
    dt^2/4 (a - a_new) + S M^-1 (r_new - r), so that this is the change of -dt^2/8 a M a, and dt^2/8 (r_new - r) (a + a_new).
    Without r, v M v/2 + u K u/2 - dt^2/8 a M a stays as it is.
    """
    return -0.125 * dt**2 * (after - before)


def scheme_work(dt: float, push: float) -> float:
    """The part of it that a change of outer forces makes, by ``push`` = (r_new - r) (a + a_new)."""
    return 0.125 * dt**2 * push


def critical_step(eigenvalue: float) -> float:
    """2/omega of the largest eigenvalue omega^2 of M^-1 K_s [1/time^2]; infinite where no rock deforms [time]."""
    return 2.0 / math.sqrt(eigenvalue) if eigenvalue > 0.0 else math.inf


def damped_rate(ratio: float) -> float:
    """Squared frequency that a damped vibration seems to have to the critical step, over its own.

    ``ratio`` is that of its damping, whose force takes the mean velocity of the step before: 4 = dt^2 omega^2 +
    4 ratio dt omega, so that dt is sqrt(1 + ratio^2) - ratio of 2/omega.
    """
    return (math.sqrt(1.0 + ratio**2) + ratio) ** 2


def parts(time_step: float, critical: float) -> int:
    """Least number of equal parts of a time step that are no longer than the critical one."""
    return max(1, math.ceil(checked(time_step) / critical * (1.0 - STEP_ROUND_OFF)))
