"""Orders, period error, and that steppers need no more than +, - and *."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import pytest

from fracflow.errors import InputError
from fracflow.stepping import STEPPERS, Alphas, Newmark, acceleration, velocity


@dataclass(frozen=True)
class Motion:
    displacement: Any
    velocity: Any
    acceleration: Any


def advance(stepper, motion, dt, mass, damping, stiffness):
    """One step of m a + c v + k d = 0, scalars."""
    a = stepper.alphas(dt)
    still = acceleration(a, 0.0, motion), velocity(a, 0.0, motion)
    d = -(mass * still[0] + damping * still[1]) / (a.a0 * mass + a.a1 * damping + stiffness)
    return Motion(d, velocity(a, d, motion), acceleration(a, d, motion))


def order_of(errors):
    return np.polyfit(np.log(0.5) * np.arange(len(errors)), np.log(errors), 1)[0]


@pytest.mark.parametrize("name", [n for n, s in STEPPERS.items() if s.inertia])
@pytest.mark.parametrize("damping", [0.0, 0.3])
def test_order_on_the_oscillator(name, damping):
    stepper, end, errors = STEPPERS[name](), 3.0, []
    decay, omega = damping / 2, np.sqrt(1 - damping**2 / 4)
    exact = np.exp(-decay * end) * (np.cos(omega * end) + decay / omega * np.sin(omega * end))
    for steps in (40, 80, 160, 320):
        motion = Motion(1.0, 0.0, -1.0)
        for _ in range(steps):
            motion = advance(stepper, motion, end / steps, 1.0, damping, 1.0)
        errors.append(abs(motion.displacement - exact))
    assert order_of(errors) == pytest.approx(stepper.order, abs=0.05)


@pytest.mark.parametrize("name", [n for n, s in STEPPERS.items() if s.storage and not s.inertia])
def test_order_on_a_decaying_film(name):
    stepper, errors = STEPPERS[name](), []
    for steps in (40, 80, 160, 320):
        motion = Motion(1.0, -1.0, 0.0)
        for _ in range(steps):
            motion = advance(stepper, motion, 1.0 / steps, 0.0, 1.0, 1.0)
        errors.append(abs(motion.displacement - np.exp(-1.0)))
    assert order_of(errors) == pytest.approx(stepper.order, abs=0.05)


@pytest.mark.parametrize("frequency", [0.1, 0.5, 1.0, 10.0])
def test_trapezoidal_rule_has_the_known_period_and_no_damping(frequency):
    """Numerical frequency times dt is 2 atan(omega dt / 2)."""
    motion, angle = Motion(1.0, 0.0, -(frequency**2)), 2 * np.arctan(frequency / 2)
    for n in range(1, 501):
        motion = advance(Newmark(), motion, 1.0, 1.0, 0.0, frequency**2)
        assert motion.displacement == pytest.approx(np.cos(n * angle), abs=1e-9)


def test_newmark_satisfies_its_formulas():
    """(4.1a) for any beta, gamma."""
    rng = np.random.default_rng(0)
    beta, gamma, dt = 0.3, 0.6, 0.7
    old, new = Motion(*rng.normal(size=(3, 5))), rng.normal(size=5)
    alphas = Newmark(beta, gamma).alphas(dt)
    a, v = acceleration(alphas, new, old), velocity(alphas, new, old)
    d = old.displacement + dt * old.velocity + dt**2 * ((0.5 - beta) * old.acceleration + beta * a)
    assert np.allclose(d, new)
    assert np.allclose(v, old.velocity + dt * ((1 - gamma) * old.acceleration + gamma * a))


def test_flags_and_coefficients():
    assert Newmark().alphas(0.1) == Alphas(pytest.approx(400), pytest.approx(20), pytest.approx(40), 1.0, 1.0, 0.0)
    assert STEPPERS["steady"]().alphas(0.1) == Alphas()
    assert STEPPERS["backward-euler"]().alphas(0.1) == Alphas(a1=10.0)
    for stepper in STEPPERS.values():
        alphas = stepper().alphas(0.1)
        assert stepper.inertia == (alphas.a0 != 0) and stepper.storage == (alphas.a1 != 0)
        assert all(isinstance(getattr(alphas, f.name), float) for f in fields(alphas))


@pytest.mark.parametrize("name", STEPPERS)
def test_arguments_are_left_alone(name):
    old, new = Motion(*np.random.default_rng(0).normal(size=(3, 4))), np.ones(4)
    kept = [old.displacement.copy(), old.velocity.copy(), old.acceleration.copy()]
    alphas = STEPPERS[name]().alphas(0.1)
    for result in (velocity(alphas, new, old), acceleration(alphas, new, old)):
        assert not any(np.shares_memory(result, x) for x in (new, *vars(old).values()))
    assert all(np.array_equal(x, y) for x, y in zip(kept, vars(old).values(), strict=True))


@pytest.mark.parametrize(
    "wrong", [lambda: Newmark(beta=0.0), lambda: Newmark(gamma=0.4), lambda: Newmark().alphas(0.0)]
)
def test_bad_input(wrong):
    with pytest.raises(InputError, match="must be"):
        wrong()
