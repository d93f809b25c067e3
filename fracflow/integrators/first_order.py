"""Integrators of fracture flow without inertia: the storage rate by the walls at the end of a step, on arrays.

A flow mode that decays at the rate s is multiplied in a step by, with x = s dt,
backward Euler  1/(1 + x)                        order 1, monotone at any dt
trapezoid       (1 - x/2)/(1 + x/2)              order 2, dissipates nothing of its own, rings for x > 2
BDF2            roots of (3/2 + x) A^2 - 2 A + 1/2   order 2, damps every mode; they are complex for x > 1/2
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

import numpy as np

from fracflow.integrators.newmark import Alphas, Balance, HasMotion, Stepper, checked


@dataclass(frozen=True)
class Rates:
    """Rates of what is stored, around a step: at its start and its end, and the means of this step and of the last one.

    last  length of the last step, 0 where there was none [time]
    """

    old: Any
    new: Any
    mean: Any
    mean_last: Any
    last: float

    @property
    def bend_last(self) -> Any:
        """The second derivative that the rule itself had."""
        return 2.0 / self.last * (self.old - self.mean_last)

    def bend(self, dt: float) -> Any:
        """The second derivative over this step and the last one."""
        return 2.0 / (dt + self.last) * (self.mean - self.mean_last)


class FlowRule(Stepper, Protocol):
    """A rule with storage and without inertia."""

    inertia: ClassVar[bool] = False
    has_passing_error: ClassVar[bool] = False

    def local_error(self, time_step: float, old: HasMotion, new: HasMotion) -> Any:
        """The dt (v_new - v)/2 of backward Euler, without inertia: more than the rules of second order add."""
        return 0.5 * time_step * (new.velocity - old.velocity)

    def storage_error(self, time_step: float, rates: Rates) -> Any:
        """About the error in what is stored that a step adds after another one, of its own order and either sign."""
        ...

    def passing_error(self, time_step: float, rates: Rates) -> Any:
        """About the sum of such errors from rest on, by steps of this length, where it is nothing at rest again; else None."""
        return None


def storage_error(rule: FlowRule, dt: float, rates: Rates) -> Any:
    """About the error in storage by one step of fracture flow, either sign, of its own order.

    With divided differences for the derivatives: backward Euler leaves dt^2/2 of the second one, the trapezoid dt^3/12
    of the third, BDF2 dt^2 (dt + last)^2/(6 (2 dt + last)) of it (Hairer, Norsett and Wanner 1993, III.5). Rules with a
    memory begin by backward Euler. Of a stage's first step, whose rate at its start is unknown, it is about a third of
    the storage in it. It is a half where the rate rises evenly, 0.19 where a pressure jumps (erfc against its
    exponential).
    """
    return dt * (rates.new - rates.old) / 3.0 if rates.last == 0.0 else rule.storage_error(dt, rates)


@dataclass(frozen=True)
class BackwardEuler(FlowRule):
    """Storage in fractures without inertia: v_new = (d_new - d)/dt, monotone in pressure at any time step."""

    order: ClassVar[int] = 1
    balance: ClassVar[Balance] = "end"

    def alphas(self, time_step: float, last: float | None = None) -> Alphas:
        """alpha_1 = 1/dt, the rest zero; time_step [time], positive."""
        return Alphas(a1=1.0 / checked(time_step))

    def storage_error(self, time_step: float, rates: Rates) -> Any:
        """dt^2/2 of the second derivative."""
        return 0.5 * time_step**2 * rates.bend(time_step)


@dataclass(frozen=True)
class Trapezoid(FlowRule):
    """(v_new + v)/2 = (d_new - d)/dt without inertia: the Newmark rule's for flow; rings for dt > 2 tau_d."""

    order: ClassVar[int] = 2
    memory: ClassVar[bool] = True

    def alphas(self, time_step: float, last: float | None = None) -> Alphas:
        """alpha_1 = 2/dt, alpha_4 = 1, the rest zero; time_step [time], positive."""
        return Alphas(a1=2.0 / checked(time_step), a4=1.0)

    def storage_error(self, time_step: float, rates: Rates) -> Any:
        """dt^3/12 of the third derivative."""
        dt, last = time_step, rates.last
        return dt**3 / 6.0 / (dt + last) * ((rates.new - rates.old) / dt - rates.bend_last)


@dataclass(frozen=True)
class BDF2(FlowRule):
    """Second order from three instants: v_new = ((1 + 2r) w_new - r w)/(1 + r).

    w_new = (d_new - d)/dt and w are the mean velocities of this step and the last, r is the ratio of their lengths.
    Stable for r < 1 + sqrt(2) at any change of the step, always for steps that are equal or shrink.
    """

    order: ClassVar[int] = 2
    memory: ClassVar[bool] = True
    has_passing_error: ClassVar[bool] = True

    def alphas(self, time_step: float, last: float | None = None) -> Alphas:
        """alpha_1 and alpha_6; time_step [time], and ``last`` the length of the last one, None for as long; positive."""
        ratio = checked(time_step) / checked(time_step if last is None else last)
        return Alphas(a1=(1.0 + 2.0 * ratio) / (1.0 + ratio) / time_step, a6=ratio / (1.0 + ratio))

    def storage_error(self, time_step: float, rates: Rates) -> Any:
        """dt^2 (dt + last)^2/(6 (2 dt + last)) of the third derivative."""
        dt, last = time_step, rates.last
        share = dt**2 * (dt + last) ** 2 / (2.0 * (2.0 * dt + last) * (dt + 2.0 * last))
        return share * (rates.bend(dt) - rates.bend_last)

    def passing_error(self, time_step: float, rates: Rates) -> Any:
        """About dt (dt + last)^2/(6 (2 dt + last)) of the second derivative, whose changes ``storage_error`` counts."""
        dt, last = time_step, rates.last
        bend = np.maximum(np.abs(rates.bend(dt)), np.abs(rates.bend_last))
        return dt * (dt + last) ** 2 / (6.0 * (2.0 * dt + last)) * bend


def first(stepper: Stepper) -> Stepper:
    """The rule of a stage's first step: backward Euler for one that needs a step before it.

    Prescribed values at the beginning of such a stage arrive during that step, so its start need not be in balance.
    One step of first order leaves the order of the whole.
    """
    return BackwardEuler() if stepper.memory else stepper
