"""Orders, period error, and that steppers need no more than +, - and *."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import pytest
from figures_verification.cases.r12 import chung_hulbert, euler, hht, newmark

from fracflow.errors import InputError
from fracflow.integrators import (
    HHT,
    STEPPERS,
    Alphas,
    Explicit,
    GeneralisedAlpha,
    ImplicitEuler,
    Newmark,
    acceleration,
    first,
    keys_of,
    velocity,
)  # fmt: skip

pytestmark = pytest.mark.serial


@dataclass(frozen=True)
class Motion:
    displacement: Any
    velocity: Any
    acceleration: Any


def advance(stepper, motion, dt, mass, damping, stiffness):
    """One step of m a + c v + k d = 0, scalars, by the balance that ``Alphas`` describes."""
    a = stepper.alphas(dt)
    before = damping * motion.velocity + stiffness * motion.displacement
    given = a.inertia_old * mass * motion.acceleration + a.balance_old * before
    still = acceleration(a, 0.0, motion), velocity(a, 0.0, motion)
    given = given + a.inertia * mass * still[0] + damping * still[1]
    d = -given / (a.mass * mass + a.a1 * damping + stiffness)
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


FAMILY = {
    "trapezoid": Newmark(),
    "linear acceleration": Newmark(1 / 6, 0.5),
    "damped": Newmark(0.36, 0.7),
    "implicit Euler": ImplicitEuler(),
}


@pytest.mark.parametrize("name", FAMILY)
def test_local_error_is_that_of_a_step_and_of_its_order(name):
    """From exact cos t at any phase, to within a factor of two where it is largest, of (u, v/omega)."""
    stepper, told = FAMILY[name], []
    phase = np.linspace(0.0, np.pi, 200)
    old = Motion(np.cos(phase), -np.sin(phase), -np.cos(phase))
    for dt in (0.2, 0.1, 0.05, 0.025):
        new = advance(stepper, old, dt, 1.0, 0.0, 1.0)
        wrong = np.hypot(new.displacement - np.cos(phase + dt), new.velocity + np.sin(phase + dt)).max()
        told.append(np.abs(stepper.local_error(dt, old, new)).max())
        assert 0.5 < told[-1] / wrong < 2.0
    assert order_of(told) == pytest.approx(stepper.order + 1, abs=0.1)


@pytest.mark.parametrize("parts", [1, 2, 4])
def test_local_error_of_central_differences_is_that_of_all_parts_of_a_step(parts):
    """Of cos t; what is told by the length of a part and the ends of the step is what its parts add."""
    phase, told = np.linspace(0.0, np.pi, 200), []
    for step in (0.2, 0.1, 0.05):
        dt = step / parts
        old = now = Motion(np.cos(phase), -np.sin(phase), -np.cos(phase))
        for _ in range(parts):
            u = now.displacement + dt * now.velocity + dt**2 / 2 * now.acceleration
            now = Motion(u, now.velocity + dt / 2 * (now.acceleration - u), -u)
        wrong = np.hypot(now.displacement - np.cos(phase + step), now.velocity + np.sin(phase + step)).max()
        told.append(np.abs(Explicit().local_error(dt, old, now)).max())
        assert 0.8 < told[-1] / wrong < 1.3
    assert order_of(told) == pytest.approx(3, abs=0.1)


@pytest.mark.parametrize("gamma, order", [(0.5, 2), (0.51, 1), (0.7, 1)])
def test_newmark_is_of_second_order_for_one_gamma_only(gamma, order):
    errors, stepper = [], Newmark(0.36, gamma)
    for steps in (1000, 2000, 4000):
        motion = Motion(1.0, 0.0, -1.0)
        for _ in range(steps):
            motion = advance(stepper, motion, 3.0 / steps, 1.0, 0.0, 1.0)
        errors.append(abs(motion.displacement - np.cos(3.0)) + abs(motion.velocity + np.sin(3.0)))
    assert stepper.order == order and order_of(errors) == pytest.approx(order, abs=0.05)


FILM = [n for n, s in STEPPERS.items() if s.storage and not s.inertia]


def drained(stepper, rate, time_steps):
    """Displacements of v + rate d = 0 from 1, at rest before the first step."""
    motion, last, mean, found = Motion(1.0, 0.0, 0.0), None, 0.0, [1.0]
    for dt in time_steps:
        a = (stepper if last else first(stepper)).alphas(dt, last)
        d = -velocity(a, 0.0, motion, mean) / (a.a1 + rate)
        new = Motion(d, velocity(a, d, motion, mean), 0.0)
        motion, last, mean = new, dt, (d - motion.displacement) / dt
        found.append(d)
    return np.array(found)


@pytest.mark.parametrize("name", FILM)
@pytest.mark.parametrize("pattern", [(1.0,), (1.0, 0.5, 0.5, 1.0)], ids=["equal", "halved and doubled"])
def test_order_on_a_decaying_film(name, pattern):
    errors = []
    for times in (20, 40, 80, 160):
        lengths = np.tile(pattern, times)
        errors.append(abs(drained(STEPPERS[name](), 1.0, lengths / lengths.sum())[-1] - np.exp(-1.0)))
    assert order_of(errors) == pytest.approx(STEPPERS[name].order, abs=0.05)


@pytest.mark.parametrize("x", [1e-3, 0.1, 0.4, 1.0, 2.0, 10.0, 1e3])
def test_spectrum_of_the_rules_for_the_film(x):
    """Amplification by 1/(1+x); by (1-x/2)/(1+x/2), negative above 2; by the roots of (3/2+x) A^2 - 2 A + 1/2."""
    found = {name: drained(STEPPERS[name](), x, np.ones(8)) for name in FILM}
    assert found["backward-euler"] == pytest.approx((1 + x) ** -np.arange(9.0), rel=1e-14)
    rings = (1 - x / 2) / (1 + x / 2)
    assert found["trapezoid"][1:] == pytest.approx(rings ** np.arange(8) / (1 + x), rel=1e-12)
    one, two = np.roots([1.5 + x, -2.0, 0.5])
    # c1 one^n + c2 two^n through the start and the first step
    c1, c2 = np.linalg.solve([[1.0, 1.0], [one, two]], [1.0, 1 / (1 + x)])
    n = np.arange(9)
    assert found["bdf2"] == pytest.approx((c1 * one**n + c2 * two**n).real, rel=1e-9, abs=1e-14)
    assert max(abs(one), abs(two)) < 1.0 and (abs(one.imag) > 0) == (x > 0.5)


SCHEMES = [
    (Newmark(), newmark(0.25, 0.5), 1.0),
    (Newmark(0.3025, 0.6), newmark(0.3025, 0.6), 9 / 11),
    *[(HHT(a), hht(a), (1 + a) / (1 - a)) for a in (0.0, -0.05, -0.1, -0.3, -1 / 3)],
    *[(GeneralisedAlpha(r), chung_hulbert(r), r) for r in (0.0, 0.5, 0.8, 1.0)],
    (ImplicitEuler(), euler, 0.0),
]


def amplification(stepper, x, xi=0.0):
    """The result of a step from (u, dt v, dt^2 a), by the algebra of the program; omega = x, dt = 1."""
    columns = [advance(stepper, Motion(*unit), 1.0, 1.0, 2 * xi * x, x**2) for unit in np.eye(3)]
    return np.array([[m.displacement, m.velocity, m.acceleration] for m in columns]).T


@pytest.mark.parametrize("stepper, closed, radius", SCHEMES, ids=lambda s: repr(s) if hasattr(s, "order") else "")
def test_amplification_is_that_of_the_papers(stepper, closed, radius):
    """Matrix, spectral radius and period of the closed forms; the radius for a step without end; never above 1."""
    for x in (1e-2, 0.1, 0.5, 1.0, 3.0, 10.0, 100.0):
        for xi in (0.0, 0.2):
            found, right = amplification(stepper, x, xi), closed(x, xi)
            assert np.abs(found - right).max() <= 1e-12 * np.abs(right).max()
        ours, theirs = (np.linalg.eigvals(matrix) for matrix in (amplification(stepper, x), closed(x, 0.0)))
        assert np.abs(ours).max() <= 1 + 1e-7  # a double root has half the digits
        if x <= 3.0:
            one, other = (max(values, key=lambda z: (round(abs(z), 9), z.imag)) for values in (ours, theirs))
            assert abs(one) == pytest.approx(abs(other), rel=1e-12)
            assert np.angle(one) == pytest.approx(np.angle(other), rel=1e-12)
    far = np.abs(np.linalg.eigvals(amplification(stepper, 1e5))).max()
    assert far == pytest.approx(radius, abs=2e-3)


@pytest.mark.parametrize("x", [0.05, 0.1, 0.2])
def test_period_errors(x):
    """Omega/wbar dt - 1: x/(2 atan(x/2)) - 1 of the trapezoid; backward Euler x/atan(x) - 1 and |A| = 1/sqrt(1 + x^2)."""

    def of(stepper):
        return max(np.linalg.eigvals(amplification(stepper, x)), key=lambda z: z.imag)

    for trapezoid in (Newmark(), HHT(0.0), GeneralisedAlpha(1.0)):
        assert x / np.angle(of(trapezoid)) - 1 == pytest.approx(x / (2 * np.arctan(x / 2)) - 1, rel=1e-9)
        assert abs(of(trapezoid)) == pytest.approx(1.0, abs=1e-12)
    assert abs(of(ImplicitEuler())) == pytest.approx(1 / np.sqrt(1 + x**2), rel=1e-12)
    assert np.angle(of(ImplicitEuler())) == pytest.approx(np.arctan(x), rel=1e-12)


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
    assert STEPPERS["trapezoid"]().alphas(0.1) == Alphas(a1=pytest.approx(20.0), a4=1.0)
    assert STEPPERS["bdf2"]().alphas(0.1) == Alphas(a1=pytest.approx(15.0), a6=0.5)
    for stepper in STEPPERS.values():
        alphas = stepper().alphas(0.1)
        assert stepper.memory == (first(stepper()) != stepper()) and not first(stepper()).memory
        assert stepper.inertia == (alphas.a0 != 0) and stepper.storage == (alphas.a1 != 0)
        assert all(isinstance(getattr(alphas, f.name), float) for f in fields(alphas))


def test_parameters_are_keys_of_the_scene():
    """Every parameter of a rule is a key of [method] with the same default."""
    from fracflow.scene.method import Method

    keys = keys_of(STEPPERS)
    assert {"newmark_beta", "newmark_gamma", "hht_alpha", "rho_infinity"} <= set(keys)
    for key, (default, meaning, _) in keys.items():
        assert getattr(Method(), key) == default and meaning


@pytest.mark.parametrize("name", STEPPERS)
def test_arguments_are_left_alone(name):
    old, new = Motion(*np.random.default_rng(0).normal(size=(3, 4))), np.ones(4)
    kept = [old.displacement.copy(), old.velocity.copy(), old.acceleration.copy()]
    alphas = STEPPERS[name]().alphas(0.1)
    for result in (velocity(alphas, new, old), acceleration(alphas, new, old)):
        assert not any(np.shares_memory(result, x) for x in (new, *vars(old).values()))
    assert all(np.array_equal(x, y) for x, y in zip(kept, vars(old).values(), strict=True))


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: Newmark(beta=0.0),
        lambda: Newmark(gamma=0.4),
        lambda: HHT(-0.4),
        lambda: HHT(0.1),
        lambda: GeneralisedAlpha(1.1),
        lambda: GeneralisedAlpha(-0.1),
        lambda: Newmark().alphas(0.0),
        lambda: STEPPERS["bdf2"]().alphas(0.1, 0.0),
        lambda: STEPPERS["trapezoid"]().alphas(-1.0),
    ],
)
def test_bad_input(wrong):
    with pytest.raises(InputError, match="must be"):
        wrong()
