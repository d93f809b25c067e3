"""A rate-dependent law that only the tests have: exact steady states at the level of the law, and whole runs."""

from __future__ import annotations

import numpy as np
import pytest
from laws.rate_and_state import RateAndState, steady_friction

from fracflow.laws import LawStep

pytestmark = pytest.mark.serial

F_N, SLOW, FAST, D_C = 1e6, 1e-6, 1e-5, 1e-5
LAW = RateAndState(
    normal_stiffness=2e10,
    shear_stiffness=5e10,
    aperture=1e-3,
    friction_coefficient=0.6,
    direct_effect=0.010,
    evolution_effect=0.015,
    state_distance=D_C,
    reference_rate=SLOW,
    initial_state=D_C / SLOW,
    initial_normal_traction=-F_N,
    initial_shear_traction=0.6 * F_N,
)


def driven(law, history, slip, rates, dt, dim=2):
    """Tractions and histories while a section is driven at these rates, a step of length dt each."""
    responses = []
    for rate in rates:
        slip = slip + rate * dt
        strain = np.zeros((1, dim))
        strain[:, 0] = slip
        responses.append(law.evaluate(strain, history, LawStep(dt=dt)))
        history = responses[-1].history
    return responses, slip


def test_steady_state_after_a_step_of_the_rate():
    """f0 + (a - b) ln(V/V0) before and after, and between them a ln(V2/V1) at once: exact but for the spring."""
    slow, slip = driven(LAW, LAW.initial_history(1, 2), 0.0, [SLOW] * 400, 0.1 * D_C / SLOW)
    assert slow[-1].traction[0, 0] / F_N == pytest.approx(steady_friction(LAW, SLOW), rel=1e-9)
    fast, _ = driven(LAW, slow[-1].history, slip, [FAST] * 4000, 0.01 * D_C / FAST)
    frictions = np.array([each.traction[0, 0] / F_N for each in fast])
    assert frictions[-1] == pytest.approx(steady_friction(LAW, FAST), rel=1e-9)
    assert fast[-1].history["state"][0] == pytest.approx(D_C / FAST, rel=1e-9)
    peak = steady_friction(LAW, SLOW) + LAW.direct_effect * np.log(FAST / SLOW)
    assert peak - 0.004 < frictions.max() < peak, "the direct effect, less what evolves while the spring is loaded"


def test_contacts_age_while_nothing_slips():
    held, _ = driven(LAW, LAW.initial_history(1, 2), -1e-3, [0.0], 1e3)
    freed = LAW.evaluate(np.array([[-1.2e-5, 0.0]]), LAW.initial_history(1, 2), LawStep(dt=1e3))
    assert freed.history["state"][0] == pytest.approx(D_C / SLOW + 1e3, rel=1e-6)
    assert held[0].traction[0, 0] < 0.0, "it slips the other way where it is driven there"


@pytest.mark.parametrize("dim", [2, 3])
def test_tangent_is_the_derivative(dim):
    rng, step = np.random.default_rng(1), 1e-11
    strain = rng.uniform(-2e-5, 2e-5, (60, dim))
    strain[:, 0] += 1e-5
    history, ahead = LAW.initial_history(60, dim), LawStep(dt=1.0)
    response = LAW.evaluate(strain, history, ahead)
    assert (np.linalg.norm(response.inelastic, axis=1) > 0.0).all()
    for column in range(dim):
        move = np.zeros(dim)
        move[column] = step
        after, before = (LAW.evaluate(strain + sign * move, history, ahead).traction for sign in (1.0, -1.0))
        assert np.allclose((after - before) / (2.0 * step), response.tangent[:, :, column], rtol=1e-4, atol=2e5)


def test_at_once_nothing_slips():
    strain, history = np.array([[1e-3, 0.0]]), LAW.initial_history(1, 2)
    response = LAW.evaluate(strain, history, LawStep(dt=0.0))
    assert response.traction[0, 0] == pytest.approx(0.6 * F_N + 5e10 * 1e-3)
    assert all(np.array_equal(response.history[name], history[name]) for name in history)
