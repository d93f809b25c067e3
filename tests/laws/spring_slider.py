"""A block on a spring with rate-and-state friction: by the joint law in steps, by linear theory, and by a stiff ODE solver."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

from fracflow.laws import LawStep, RateAndState

A, B, D_C, SIGMA, V0, F0 = 0.010, 0.015, 1e-4, 1e7, 1e-6, 0.6
CRITICAL = (B - A) * SIGMA / D_C
"""Stiffness below which steady slip is unstable."""
STIFF = 1e12
"""Of the joint [stress/length], beside which the spring is soft."""


def steady(rate):
    """Shear traction of steady slip [stress]."""
    return SIGMA * (F0 + (A - B) * np.log(rate / V0))


def friction(rate, **changed):
    """The law of joints that slip steadily at a rate, number or (n,)."""
    given = dict(
        normal_stiffness=STIFF,
        shear_stiffness=STIFF,
        aperture=1e-3,
        friction_coefficient=F0,
        reference_slip_rate=V0,
        direct_effect=A,
        evolution_effect=B,
        characteristic_slip=D_C,
        initial_slip_rate=rate,
        initial_normal_traction=-SIGMA,
        initial_shear_traction=steady(rate),
    )
    return RateAndState(**{**given, **changed})


@dataclass(frozen=True)
class Sliders:
    """Blocks (n,) on springs whose ends move at a ``rate`` of some stiffness [stress/length]."""

    law: RateAndState
    stiffness: np.ndarray
    rate: np.ndarray

    def drive(self, until, share, shortest, most=20000):
        """Times and rates of slip (steps, n) in steps of at most ``share`` D_c/V, and at least ``shortest``."""
        law, count = self.law, len(self.stiffness)
        history, start = law.initial_history(count, 2), law.initial_shear_traction
        slip, time, dt, rows = np.zeros(count), np.zeros(count), share * D_C / history["sliding_rate"], []
        for _ in range(most):
            new, strain = slip + history["sliding_rate"] * dt, np.zeros((count, 2))
            for _ in range(20):
                strain[:, 0] = new
                answer = law.evaluate(strain, history, LawStep(0.0, dt))
                left = answer.traction[:, 0] - start - self.stiffness * (self.rate * (time + dt) - new)
                if (np.abs(left) <= 1e-11 * SIGMA).all():
                    break
                new = new - left / (answer.tangent[:, 0, 0] + self.stiffness)
            far = (np.abs(left) > 1e-11 * SIGMA) | (answer.history["sliding_rate"] * dt > 1.2 * share * D_C)
            if (far & (dt > shortest)).any():
                dt = np.where(far, 0.5 * dt, dt)
                continue
            slip, time, history = new, time + dt, answer.history
            rows.append((time - 0.5 * dt, history["sliding_rate"]))
            if (time > until).all():
                break
            fits = share * law.state_length(history) / history["sliding_rate"]
            dt = np.minimum(np.maximum(fits, shortest), 2.0 * dt)
        return np.moveaxis(np.array(rows), 1, 0)


def onsets(times, rates, fast):
    """Times at which rates (steps,) rise through ``fast``, of lines of their logarithms."""
    size, level = np.log(rates), np.log(fast)
    n = np.flatnonzero((size[:-1] < level) & (size[1:] >= level))
    return times[n] + (level - size[n]) / (size[n + 1] - size[n]) * (times[n + 1] - times[n])


def reference(stiffness, rate, first, until, fast, impedance):
    """The same onsets of one block by LSODA; it begins in steady slip at ``first``."""
    soft = stiffness * STIFF / (stiffness + STIFF)

    def slides(t, y):
        v, theta = np.exp(y)
        z = y[0] - np.log(2.0 * V0) + (F0 + B * np.log(theta * V0 / D_C)) / A
        direct, grows = SIGMA * A / np.sqrt(1.0 + np.exp(-2.0 * z)), 1.0 / theta - v / D_C
        return [(soft * (rate - v) - direct * B / A * grows) / (direct + impedance * v), grows]

    def rises(t, y):
        return y[0] - np.log(fast)

    rises.direction = 1.0
    start = [np.log(first), np.log(D_C / first)]
    return solve_ivp(slides, (0.0, until), start, method="LSODA", rtol=1e-10, atol=1e-12, events=rises).t_events[0]
