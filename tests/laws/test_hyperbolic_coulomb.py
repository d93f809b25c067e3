"""(2.11)-(2.12), Figs. 3 and 4."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad

from fracflow.laws import HyperbolicCoulomb

pytestmark = pytest.mark.serial

LAW = HyperbolicCoulomb(
    normal_stiffness=1e8,
    shear_stiffness=1e8,
    aperture=0.01,
    friction_coefficient=np.tan(np.radians(40.0)),
    initial_normal_traction=-2e5,
    stick_slip_ratio=0.9,
)
CONTACT_LOST = 2e-3


def at(law, slip, opening, past=None):
    return law.evaluate(np.array([[slip, opening]]), law.initial_history(1, 2) if past is None else past)


def fig_3(e, f_n0=-2e5, k_n0=1e8, d0=0.01):
    if e < 0:
        return f_n0 + k_n0 * e / (1 + e / d0)
    return min(f_n0 + k_n0 * e, 0.0)


@pytest.mark.parametrize("opening", [-0.0099, -0.006, -1e-3, -2e-6, -1e-8, 0.0, 5e-4, CONTACT_LOST, 3e-3])
def test_closure_and_energy(opening):
    response = at(LAW, 0.0, opening)
    assert response.traction[0, 1] == pytest.approx(fig_3(opening), rel=1e-12, abs=1e-9)
    points = [CONTACT_LOST] if opening > CONTACT_LOST else None
    area = quad(fig_3, 0.0, opening, points=points, epsabs=1e-10, epsrel=1e-11)[0]
    assert response.stored[0] == pytest.approx(area, rel=1e-9, abs=1e-12)
    stiffness = 0.0 if opening > CONTACT_LOST else 1e8 / (1 + min(opening, 0.0) / 0.01) ** 2
    assert response.tangent[0, 1, 1] == pytest.approx(stiffness)


def test_energy_without_initial_traction_does_not_cancel():
    law = replace(LAW, initial_normal_traction=0.0)
    for x in (1e-7, 9.9e-4, 1.01e-3):
        e = -x * 0.01
        series = 0.5 * x**2 + x**3 / 3 + x**4 / 4 + x**5 / 5
        assert at(law, 0.0, e).stored[0] == pytest.approx(1e8 * 0.01**2 * series, rel=1e-9)


@pytest.mark.parametrize("opening", [-0.01, -0.011, -5.0])
def test_walls_never_pass_through_each_other(opening):
    past = at(LAW, 0.01, 0.0).history
    response = at(LAW, 0.01, opening, past)
    assert not np.isfinite(response.traction[0, 1]) and not response.traction[0, 1] > 0
    assert not np.isnan(response.margin).any()
    for name in past:
        assert np.array_equal(response.history[name], past[name])


def test_step_limit():
    strain, increment = np.array([[0.0, -0.004]] * 3), np.array([[0.0, -0.012], [0.0, 0.1], [5.0, 0.0]])
    assert LAW.step_limit(strain, increment) == pytest.approx([0.45, np.inf, np.inf])


def test_stick_slip_drop():
    """The traction rises to the peak and falls to alpha times it; energy (1 - alpha^2) f^2 / 2 k is freed."""
    peak = 2e5 * LAW.friction_coefficient
    below, above = at(LAW, peak / 1e8 * (1 - 1e-9), 0.0), at(LAW, peak / 1e8 * (1 + 1e-9), 0.0)
    assert below.traction[0, 0] == pytest.approx(peak) and not below.is_sliding[0]
    assert above.traction[0, 0] == pytest.approx(0.9 * peak) and above.is_sliding[0]
    assert below.utilisation[0] == pytest.approx(1.0) and above.utilisation[0] == 1.0
    assert below.stored[0] - above.stored[0] == pytest.approx((1 - 0.9**2) * peak**2 / 2e8, rel=1e-6)
    assert above.inelastic[0, 0] == pytest.approx(0.1 * peak / 1e8, rel=1e-6)


def test_sliding_follows_the_normal_traction_until_it_reverses():
    past = at(LAW, 0.01, 0.0).history
    onward = at(LAW, 0.011, 1e-3, past)
    assert onward.traction[0] == pytest.approx([0.9 * 1e5 * LAW.friction_coefficient, -1e5])
    back = at(LAW, 0.011 - 1e-5, 1e-3, onward.history)
    assert not back.is_sliding[0] and np.all(back.history["sliding"] == 0)
    assert back.traction[0, 0] == pytest.approx(onward.traction[0, 0] - 1e8 * 1e-5)
    healed = at(LAW, 0.011 + 5e-5, 1e-3, back.history)
    assert not healed.is_sliding[0], "the peak is restored"
    assert healed.traction[0, 0] == pytest.approx(onward.traction[0, 0] + 1e8 * 5e-5)


def test_a_resting_sliding_section_stays_sliding():
    for slip in np.linspace(0.003, 7.0, 301):
        past = at(LAW, slip, 1e-4).history
        for _ in range(5):
            response = at(LAW, slip, 1e-4, past)
            assert response.is_sliding[0]
            past = response.history


def test_re_stick_is_elastic_even_past_the_peak():
    past = at(LAW, 0.01, 0.0).history
    response = at(LAW, -0.01, 0.0, past)
    assert response.traction[0, 0] == pytest.approx(1e8 * (-0.01 - past["plastic_slip"][0, 0]))
    assert not response.is_sliding[0] and response.margin[0] > 0


def test_without_traction_and_strength_nothing_is_near_its_threshold():
    """Where a fracture under gravity daylights; any compression or traction counts."""
    law = replace(LAW, initial_normal_traction=0.0, cohesion=0.0)
    assert at(law, 0.0, 0.0).margin[0] == np.inf
    assert np.isfinite([at(law, 0.0, -1e-12).margin[0], at(law, 1e-12, 0.0).margin[0]]).all()


def test_open_section():
    past = at(LAW, 0.01, 0.0).history
    response = at(LAW, 0.02, 3e-3, past)
    assert response.is_open[0] and not response.is_sliding[0]
    assert np.all(response.traction == 0) and np.all(response.tangent == 0) and response.utilisation[0] == 0
    assert response.margin[0] == pytest.approx(0.5)
    closed = at(LAW, 0.02 + 1e-5, 1e-3, response.history)
    assert closed.traction[0] == pytest.approx([1e3, -1e5]) and not closed.is_sliding[0]


def test_opening_loses_the_initial_shear_energy():
    law = replace(LAW, initial_shear_traction=1e5)
    response = at(law, 0.0, 3e-3)
    assert response.stored[0] == pytest.approx(-(2e5**2) / 2e8 - 1e5**2 / 2e8)
    assert at(law, 0.0, 1e-3, response.history).traction[0, 0] == pytest.approx(0.0, abs=1e-6)


def test_strength_when_open():
    """(2.12) as printed: strength C when f_n >= 0."""
    law = replace(LAW, cohesion=1e4, strength_when_open=True)
    response = at(law, 0.01, 3e-3)
    assert response.traction[0] == pytest.approx([0.9e4, 0.0]) and response.is_open[0]
    closed_unloaded = replace(LAW, initial_normal_traction=0.0, cohesion=1e4)
    assert at(closed_unloaded, 5e-5, 0.0).traction[0] == pytest.approx([5e3, 0.0])
    assert at(closed_unloaded, 5e-5, 1e-9).traction[0, 0] == 0.0


def test_decoupled_tangent():
    response, report = at(LAW, 0.01, 0.0), at(replace(LAW, coupled_tangent=False), 0.01, 0.0)
    assert response.tangent[0, 0, 1] == pytest.approx(-0.9 * LAW.friction_coefficient * 1e8)
    assert report.tangent[0, 0, 1] == 0.0 and report.tangent[0, 0, 0] == response.tangent[0, 0, 0] == 0.0
    assert np.array_equal(response.traction, report.traction)


@pytest.mark.parametrize(
    "changes", [{"cohesion": np.inf}, {"friction_coefficient": 0.0}, {"initial_normal_traction": 0.0}]
)
@pytest.mark.parametrize("strain", [(0.0, 0.0), (1.0, 0.0), (-1.0, -0.005), (0.1, 0.1), (0.1, -0.02)])
def test_margins_are_never_nan(changes, strain):
    law = replace(LAW, **changes)
    with np.errstate(all="raise"):
        response = at(law, *strain)
        again = at(law, *strain, past=response.history)
    for each in (response, again):
        assert each.margin[0] >= 0 and each.utilisation[0] >= 0
        assert not np.isnan(each.traction).any() and not np.isnan(each.tangent).any()
