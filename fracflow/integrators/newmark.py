"""(4.1)-(4.3) The Newmark family, and its limit without time, on arrays."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal, Protocol

import numpy as np

from fracflow.errors import InputError
from fracflow.integrators.parameters import check_parameters, parameter

Balance = Literal["both", "end", "step"]


@dataclass(frozen=True)
class Alphas:
    """(4.3) Coefficients of acceleration (a0, a2, a3) and velocity (a1, a4, a5) at the end of a step.

    a6 is that of the mean velocity of the last step, for rules of three instants. With S all of the balance of the rock
    but inertia, a step solves M (inertia a_new + inertia_old a) + S_new + balance_old S = 0.
    """

    a0: float = 0.0
    a1: float = 0.0
    a2: float = 0.0
    a3: float = 0.0
    a4: float = 0.0
    a5: float = 0.0
    a6: float = 0.0
    inertia: float = 1.0
    inertia_old: float = 0.0
    balance_old: float = 0.0

    @property
    def mass(self) -> float:
        """Coefficient of the mass matrix in the Jacobian."""
        return self.a0 * self.inertia

    @property
    def looks_back(self) -> bool:
        """Whether the balance of the step's start, or its acceleration, takes part in that of its end."""
        return self.inertia != 1.0 or self.inertia_old != 0.0 or self.balance_old != 0.0

    @property
    def gamma(self) -> float:
        """Weight of the acceleration at the end of a step in its velocity, with inertia."""
        return self.a1 / self.a2

    @property
    def is_difference(self) -> bool:
        """Whether the velocity is d/dt of the step alone."""
        return not (self.a4 or self.a5 or self.a6)

    @property
    def b1(self) -> float:
        """Coefficient of the change of what has a first rate only, as a pressure: 1/(gamma dt) of Newmark, else alpha_1."""
        return self.a0 / self.a1 if self.a0 else self.a1

    @property
    def b4(self) -> float:
        """That of its last rate: (1 - gamma)/gamma of Newmark, else alpha_4."""
        return self.a2 / self.a1 - 1.0 if self.a0 else self.a4


class HasMotion(Protocol):
    """Displacement, velocity and acceleration, all arrays or all numbers."""

    @property
    def displacement(self) -> Any:
        """Displacement [length]."""

    @property
    def velocity(self) -> Any:
        """Velocity [length/time]."""

    @property
    def acceleration(self) -> Any:
        """Acceleration [length/time^2]."""


class Stepper(Protocol):
    """A rule for velocity and acceleration at the end of a step; one that inherits it states what differs from here.

    order    order of accuracy in the time step; 0 where time does not enter
    inertia  the mass matrix takes part
    storage  wall velocities take part in the balance of fluid
    balance  instants at which the fluid's balance holds: both ends of a step, only its end, or the step as a whole, with the
             motion of walls
    memory   it needs a step before it in its stage; see ``first_order.first``
    explicit the rock goes by central differences, in steps no longer than the critical one; see ``solve.explicit``
    """

    inertia: ClassVar[bool] = True
    storage: ClassVar[bool] = True
    balance: ClassVar[Balance] = "both"
    memory: ClassVar[bool] = False
    explicit: ClassVar[bool] = False

    def __post_init__(self) -> None:
        """Raises InputError for parameters that are not stable, or that cannot be stepped implicitly."""
        check_parameters(self)

    @property
    def order(self) -> int:
        """Order of accuracy."""
        ...

    @property
    def damps(self) -> bool:
        """Whether motions that the time step does not resolve decay, so that waves die out by themselves."""
        return False

    def alphas(self, time_step: float, last: float | None = None) -> Alphas:
        """Coefficients of a step of that length, after one of length ``last`` in the same stage."""
        ...

    def local_error(self, time_step: float, old: HasMotion, new: HasMotion) -> Any:
        """About the error in displacement that a step adds, of order dt^(order + 1) and either sign; motions are arrays."""
        ...


def acceleration(alphas: Alphas, displacement_new: Any, motion_old: HasMotion) -> Any:
    """(4.2e) a_new = a0 (d_new - d) - a2 v - a3 a."""
    change = displacement_new - motion_old.displacement
    return alphas.a0 * change - alphas.a2 * motion_old.velocity - alphas.a3 * motion_old.acceleration


def driven_acceleration(gamma: float, dt: float, ahead: float, then: Any, before: Any, old: Any) -> Any:
    """Acceleration at the end of a step of what is prescribed, so that it ``then`` has a mean velocity in the next step.

    before, old  velocity that accelerations have brought, and the acceleration, where the step begins
    ahead        length of the next step [time]

    Forces are late by (gamma - 1/2) dt in rules of such a gamma, and so is this. In equal steps a share 1/(gamma + 1/2) of the
    change of the mean velocity comes at once, the rest later. Motion that masses share with it is then neither late
    nor too far.
    """
    return (then - before - (1.0 - gamma) * dt * old) / (gamma * dt + 0.5 * ahead)


def velocity(alphas: Alphas, displacement_new: Any, motion_old: HasMotion, mean_old: Any = 0.0) -> Any:
    """(4.2f) v_new = a1 (d_new - d) - a4 v - a5 a - a6 w, w = ``mean_old`` the mean velocity of the last step."""
    change, old = displacement_new - motion_old.displacement, motion_old
    return alphas.a1 * change - alphas.a4 * old.velocity - alphas.a5 * old.acceleration - alphas.a6 * mean_old


def first_rate(alphas: Alphas, new: Any, old: Any, rate_old: Any = 0.0, mean_old: Any = 0.0) -> Any:
    """p'_new = b1 (p_new - p) - b4 p' - a6 w of what has no second rate; w = ``mean_old`` is its mean in the last step.

    Newmark's p_new = p + dt ((1 - gamma) p' + gamma p'_new); the flow integrators' own, as for the walls.
    """
    return alphas.b1 * (new - old) - alphas.b4 * rate_old - alphas.a6 * mean_old


def checked(time_step: float) -> float:
    """The time step [time]. Raises InputError unless it is positive."""
    if not time_step > 0.0:
        raise InputError(f"time_step = {time_step}: must be positive")
    return time_step


def newmark_alphas(time_step: float, beta: float, gamma: float) -> Alphas:
    """(4.3) alpha_0 ... alpha_5 of (4.1a); time_step [time], positive."""
    dt = checked(time_step)
    return Alphas(
        a0=1.0 / (dt**2 * beta),
        a1=gamma / (dt * beta),
        a2=1.0 / (dt * beta),
        a3=1.0 / (2.0 * beta) - 1.0,
        a4=gamma / beta - 1.0,
        a5=dt * (gamma / (2.0 * beta) - 1.0),
    )


def weighed(alphas: Alphas, of_inertia: float, of_forces: float) -> Alphas:
    """The same for M ((1 - m) a_new + m a) + (1 - f) S_new + f S = 0, with m = ``of_inertia`` and f = ``of_forces``."""
    new = 1.0 - of_forces
    return replace(alphas, inertia=(1.0 - of_inertia) / new, inertia_old=of_inertia / new, balance_old=of_forces / new)


def error_by_jerk(share: float, time_step: float, old: HasMotion, new: HasMotion) -> Any:
    """A share of dt^2 (a_new - a): Newmark's beta - 1/6 leaves so much of dt^3 u''' (Zienkiewicz and Xie 1991).

    Never less than a share of 1/12: the trapezoidal rule for the velocity leaves dt^3 u''''/12, whatever beta.
    """
    return max(abs(share), 1.0 / 12.0) * time_step**2 * (new.acceleration - old.acceleration)


@dataclass(frozen=True)
class Newmark(Stepper):
    """(4.1a) Newmark with beta, gamma: 1/4, 1/2 is the trapezoidal rule, without numerical dissipation.

    Second order if gamma = 1/2, else first. InputError for beta <= 0 (explicit) or gamma < 1/2 (unstable).
    """

    beta: float = parameter(
        0.25, "newmark_beta", "beta of (4.1) [1]; 1/4 is the trapezoidal rule", above=0.0, at_most=0.5
    )
    gamma: float = parameter(0.5, "newmark_gamma", "gamma of (4.1) [1]; above 1/2 damps", at_least=0.5, at_most=1.0)

    @property
    def order(self) -> int:
        """2 of gamma = 1/2, else 1."""
        return 2 if self.gamma == 0.5 else 1

    @property
    def damps(self) -> bool:
        """Above gamma = 1/2."""
        return self.gamma > 0.5

    def alphas(self, time_step: float, last: float | None = None) -> Alphas:
        """(4.3) alpha_0 ... alpha_5; time_step [time], positive."""
        return newmark_alphas(time_step, self.beta, self.gamma)

    def local_error(self, time_step: float, old: HasMotion, new: HasMotion) -> Any:
        """That by beta, and (gamma - 1/2) dt (a_new - a) of velocity for the time 1/omega that it lasts, omega^2 = u'''/u'."""
        by_beta = np.abs(error_by_jerk(self.beta - 1.0 / 6.0, time_step, old, new))
        speed = np.maximum(np.abs(old.velocity), np.abs(new.velocity))
        lasting = np.sqrt(time_step * speed * np.abs(new.acceleration - old.acceleration))
        return by_beta + abs(self.gamma - 0.5) * time_step * lasting


@dataclass(frozen=True)
class Steady(Stepper):
    """(4.3) with all alpha_k = 0: equilibrium and steady flow, neither inertia nor storage."""

    order: ClassVar[int] = 0
    inertia: ClassVar[bool] = False
    storage: ClassVar[bool] = False
    balance: ClassVar[Balance] = "end"

    def alphas(self, time_step: float, last: float | None = None) -> Alphas:
        """All zero, whatever the time step."""
        return Alphas()

    def local_error(self, time_step: float, old: HasMotion, new: HasMotion) -> Any:
        """None: time has no part."""
        return 0.0 * new.displacement
