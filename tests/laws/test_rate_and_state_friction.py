"""Rate-and-state friction against its formulas, linear theory of a slider, and a stiff ODE solver."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from laws.spring_slider import CRITICAL, D_C, SIGMA, STIFF, V0, A, B, Sliders, friction, onsets, reference, steady
from scipy.integrate import solve_ivp

from fracflow._petsc import MPI
from fracflow.advance.slip_rate import slip_of_states
from fracflow.laws import LawStep
from fracflow.laws.rate_and_state import aged

pytestmark = pytest.mark.serial
RATE, IMPEDANCE = 1e-7, 4.6e6


@pytest.mark.parametrize("slips", [False, True], ids=["ageing", "slip"])
def test_the_state_of_a_constant_rate_is_exact(slips):
    rate, theta, time = np.array([1e-9, 1e-6, 1e-5, 1e-3]), np.array([1e4, 10.0, 300.0, 1e-3]), np.full(4, 30.0)
    law = np.full(4, slips)
    found, falls = aged(theta, rate, time, np.full(4, D_C), law)

    def grows(t, y):
        x = rate * np.exp(y) / D_C
        return -(rate / D_C) * np.log(x) if slips else np.exp(-y) - rate / D_C

    exact = np.exp(solve_ivp(grows, (0.0, 30.0), np.log(theta), "Radau", rtol=1e-10, atol=1e-12).y[:, -1])
    assert found == pytest.approx(exact, rel=1e-7)
    more, less = (np.log(aged(theta, rate * np.exp(by), time, np.full(4, D_C), law)[0]) for by in (1e-5, -1e-5))
    assert falls == pytest.approx((more - less) / 2e-5, rel=1e-6, abs=1e-9)


def test_the_first_state_is_that_of_public_tables():
    """SEAS BP6: psi = f0 + b ln(V0 theta/D_c) = 0.680708574 at 29.2 MPa and 1e-12 m/s, over a = 97.24408."""
    given = dict(
        direct_effect=0.007,
        evolution_effect=0.005,
        characteristic_slip=0.004,
        initial_normal_traction=-50e6,
        initial_shear_traction=29.2e6,
    )
    law = friction(1e-12, **given)
    theta = law.initial_history(1, 2)["state"][0]
    assert (0.6 + 0.005 * np.log(1e-6 * theta / 0.004)) / 0.007 == pytest.approx(97.24408, rel=1e-7)
    still = law.evaluate(np.zeros((1, 2)), law.initial_history(1, 2), LawStep(dt=1.0))
    assert still.history["sliding_rate"][0] == pytest.approx(1e-12, rel=1e-6), "it is in balance with it"
    lone = friction(1e-9, initial_shear_traction=0.0)
    assert lone.initial_history(1, 2)["state"][0] == pytest.approx(D_C / 1e-9), "without shear in steady state"


def test_the_slip_over_which_the_state_evolves():
    """D_c; by the slip law less, where V theta/D_c is far from 1: there d ln theta/d slip = -ln(V theta/D_c)/D_c."""
    past = {"state": np.array([1e4, D_C / RATE, 1.0]), "sliding_rate": np.array([1e-2, RATE, RATE])}
    away = np.abs(np.log(past["state"] * past["sliding_rate"] / D_C))
    assert away[0] > 1.0 and away[2] > 1.0
    assert friction(RATE).state_length(past) == pytest.approx(np.full(3, D_C))
    assert friction(RATE, state_law="slip").state_length(past) == pytest.approx(D_C / np.maximum(away, 1.0))


def strained(dim, seed=1, count=60):
    rng = np.random.default_rng(seed)
    strain = rng.uniform(-2e-5, 2e-5, (count, dim))
    strain[:, 0] += 3e-5
    strain[:, -1] *= 0.2
    return strain, rng


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("slips", ["ageing", "slip"])
@pytest.mark.parametrize("inertia", [False, True])
def test_tangent_is_the_derivative(dim, slips, inertia):
    law = friction(RATE, state_law=slips, shear_stiffness=5e11, wave_impedance=IMPEDANCE)
    strain, rng = strained(dim)
    past = law.evaluate(strain, law.initial_history(60, dim), LawStep(1.0, 1.0, inertia)).history
    strain, step = strain + rng.uniform(-1e-5, 1e-5, strain.shape) * 0.2, LawStep(1.3, 0.3, inertia)
    response, moved = law.evaluate(strain, past, step), 1e-10
    for column in range(dim):
        move = moved * np.eye(dim)[column]
        ahead, behind = (law.evaluate(strain + sign * move, past, step).traction for sign in (1.0, -1.0))
        assert np.allclose((ahead - behind) / (2.0 * moved), response.tangent[:, :, column], rtol=1e-5, atol=1e5)


def test_friction_holds_at_the_part_of_the_step_and_waves_take_the_rest():
    """|f_s| of the formula and eta V, each at the same instant; with inertia the formula alone."""
    strain, _ = strained(3)
    for inertia, radiates in ((False, True), (True, True), (False, False)):
        law = friction(RATE, shear_stiffness=5e11, wave_impedance=IMPEDANCE, radiates=radiates)
        past, step = law.initial_history(60, 3), LawStep(2.0, 2.0, inertia)
        now = law.evaluate(strain, past, step)
        weight = 0.5 + min((RATE * 2.0 / D_C) ** 2, 0.5)
        rate = now.history["sliding_rate"]
        theta, _ = aged(past["state"], rate, np.full(60, 2.0 * weight), np.full(60, D_C), np.zeros(60, dtype=bool))
        force = (1.0 - weight) * past["carried"] + weight * now.traction[:, :-1]
        pressed = (1.0 - weight) * past["pressed"] - weight * now.traction[:, -1]
        psi = 0.6 + B * np.log(V0 * theta / D_C)
        damped = IMPEDANCE * rate if radiates and not inertia else 0.0 * rate
        formula = pressed * A * np.arcsinh(rate / (2.0 * V0) * np.exp(psi / A)) + damped
        assert np.linalg.norm(force, axis=1) == pytest.approx(formula, rel=1e-10)
        slip = now.inelastic[:, :-1]
        along = np.einsum("ni,ni->n", slip, force)
        assert along == pytest.approx(np.linalg.norm(slip, axis=1) * np.linalg.norm(force, axis=1), rel=1e-9)
        assert law.radiated(rate * 2.0, step) == pytest.approx(damped * rate * 2.0, rel=1e-12)


def test_open_walls_carry_nothing_and_at_once_nothing_slips():
    law, past = friction(RATE), friction(RATE).initial_history(2, 2)
    strain = np.array([[1e-4, 2e-5], [1e-7, 0.0]])
    response = law.evaluate(strain, past, LawStep(dt=1.0))
    assert response.is_open.tolist() == [True, False]
    assert not response.traction[0].any() and response.traction[1, 0] > 0.0
    at_once = law.evaluate(strain, past)
    assert at_once.traction[1, 0] == pytest.approx(steady(RATE) + STIFF * 1e-7) and not at_once.inelastic[1].any()
    assert at_once.history["state"][1] == past["state"][1]


def test_slip_that_waves_limit_is_an_event_and_creep_is_none():
    law = friction(RATE, wave_impedance=IMPEDANCE)
    slow = law.evaluate(np.array([[RATE, 0.0]]), law.initial_history(1, 2), LawStep(dt=1.0))
    fast = law.evaluate(np.array([[1e-2, 0.0]]), law.initial_history(1, 2), LawStep(dt=0.1))
    assert not slow.is_sliding[0] and fast.is_sliding[0]
    assert IMPEDANCE * fast.history["sliding_rate"][0] > A * SIGMA


def growth(stiffness, dt, slips="ageing"):
    """Growth rates (2,) [1/time] of small perturbations of steady slip in steps of a length."""
    law, eps = friction(RATE, state_law=slips), 1e-4
    first, start = law.initial_history(4, 2), law.initial_shear_traction
    moves = eps * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])  # of f_s/(a sigma), of ln theta
    lag = moves[:, 0] * A * SIGMA / stiffness
    past = {**first, "state": first["state"] * np.exp(moves[:, 1]), "carried": start + moves[:, :1] * A * SIGMA}
    past["plastic_slip"] = -lag[:, None] - moves[:, :1] * A * SIGMA / STIFF  # both springs pull
    slip, strain = -lag + RATE * dt, np.zeros((4, 2))
    for _ in range(20):
        strain[:, 0] = slip
        now = law.evaluate(strain, past, LawStep(dt, dt))
        slip = slip - (now.traction[:, 0] - start - stiffness * (RATE * dt - slip)) / (now.tangent[:, 0, 0] + stiffness)
    ends = np.stack([(now.traction[:, 0] - start) / (A * SIGMA), np.log(now.history["state"] / first["state"])])
    matrix = np.stack([ends[:, 0] - ends[:, 1], ends[:, 2] - ends[:, 3]], axis=1) / (2.0 * eps)
    return np.log(np.linalg.eigvals(matrix).astype(complex)) / dt


def theory(stiffness):
    """Roots l of (a sigma/V) l^2 + (k - (b - a) sigma/D_c) l + k V/D_c = 0, spring and joint in series."""
    soft = stiffness * STIFF / (stiffness + STIFF)
    return np.roots([A * SIGMA / RATE, soft - CRITICAL, soft * RATE / D_C])


@pytest.mark.parametrize("slips", ["ageing", "slip"])
@pytest.mark.parametrize("share", [0.5, 0.99, 1.01, 2.0])
def test_perturbations_grow_as_linear_theory_says(slips, share):
    """To 1e-6 once the leading errors, of second order, are extrapolated away; they fade above the critical stiffness."""
    exact = theory(share * CRITICAL)
    exact = exact[np.argmax(exact.imag)]

    def found(steps):
        rates = growth(share * CRITICAL, D_C / RATE / steps, slips)
        return rates[np.argmax(rates.imag)]

    one, two, four = (found(steps) for steps in (40, 80, 160))
    errors = [abs(each - exact) for each in (one, two, four)]
    assert 1.9 < np.log2(errors[1] / errors[2]) < 2.3, "order 2, with a part of order 3 from the damping of long steps"
    third = (4.0 * four - two) / 3.0, (4.0 * two - one) / 3.0
    assert abs((8.0 * third[0] - third[1]) / 7.0 - exact) < 1e-6 * abs(exact) and errors[2] < 3e-6 * abs(exact)
    assert (third[0].real > 0.0) == (share < 1.0)


def test_a_cycle_has_the_period_of_an_ode_solver():
    """Quasi-dynamic stick-slip, from one event to the next."""
    stiffness, rate, fast = 0.6 * CRITICAL, 3e-8, 1e-4
    exact = np.diff(reference(stiffness, rate, 1.5 * rate, 2.1e5, fast, IMPEDANCE))[0]
    law = friction(np.full(1, 1.5 * rate), wave_impedance=IMPEDANCE)
    times, rates = Sliders(law, np.full(1, stiffness), np.full(1, rate)).drive(2.1e5, 0.05, 1e-5)
    assert np.diff(onsets(times[:, 0], rates[:, 0], fast))[0] == pytest.approx(exact, rel=1e-4)


def allowed(slip, before, after, comm=MPI.COMM_SELF):
    """Slip of a step over the allowed one, a tenth of D_c, at rates before it and after."""
    accuracy = SimpleNamespace(slip_share=0.1, tolerance=None)
    joints = SimpleNamespace(laws=(SimpleNamespace(law=friction(np.full(1, RATE)), sections=np.arange(1)),))
    operators = SimpleNamespace(joints=joints, layout=SimpleNamespace(comm=comm))
    states = (
        SimpleNamespace(
            sections=SimpleNamespace(
                inelastic=np.array([[far, 0.0]]), history=[{"state": np.ones(1), "sliding_rate": np.full(1, rate)}]
            )
        )
        for far, rate in ((0.0, before), (slip, after))
    )
    return slip_of_states(SimpleNamespace(operators=operators, scene=SimpleNamespace(accuracy=accuracy)), *states)


def test_steps_follow_slip_that_slows_down():
    """The larger of V dt/D_c and of the cube root of that by (ln V/V_old)^2, over the share."""
    assert allowed(0.05 * D_C, RATE, RATE) == pytest.approx(0.5)
    assert allowed(0.05 * D_C, RATE, RATE / np.e) == pytest.approx(0.05 ** (1 / 3) / 0.1)
    assert allowed(1e-9 * D_C, RATE, RATE / np.e) == pytest.approx(0.01), "what hardly slips needs no short steps"
    farther = SimpleNamespace(allreduce=lambda value, op: max(value, 7.0) if op == MPI.MAX else np.nan)
    assert allowed(0.05 * D_C, RATE, RATE, farther) == 7.0, "of another rank"
