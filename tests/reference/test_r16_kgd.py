"""The similarity solution of a fracture that a viscous fluid drives: it converges, and another integral confirms it."""

import numpy as np
import pytest
from figures_verification.cases.r16 import inlet, similarity
from scipy.integrate import quad

pytestmark = pytest.mark.serial


def at_inlet(terms):
    """Coefficients of half length, opening and net pressure."""
    found = similarity(terms)
    w, p = (profile[0] for profile in found.profiles(np.zeros(1)))
    return np.array([found.extent, found.extent * w, p])


def test_digits_stay_when_the_terms_double():
    coarse, middle, fine = (at_inlet(terms) for terms in (6, 12, 24))
    assert np.abs(fine / middle - 1).max() < 1e-5
    assert np.abs(middle / coarse - 1).max() < 1e-4
    assert inlet(1.0, 1.0 / 12.0, 1.0, 1.0) == pytest.approx(tuple(fine), rel=1e-12)


def test_printed_digits():
    length, opening, pressure = at_inlet(24)
    assert length == pytest.approx(0.6152, rel=5e-4)  # the printed fourth digit is 0.03 % lower
    assert opening**2 / length == pytest.approx(2.1, abs=0.05)
    assert opening * pressure == pytest.approx(0.62, rel=0.012)
    assert (length, opening**2 / length, opening * pressure) == pytest.approx((0.61541, 2.0596, 0.61337), rel=3e-5)


@pytest.mark.parametrize("place", [0.1, 0.9])
def test_pressure_opens_the_walls_as_elasticity_has_it(place):
    found = similarity(12)

    def integrand(s):
        own, other = np.sqrt(1 - place**2), np.sqrt(1 - s**2)
        return found.profiles(np.array([s]))[1][0] * np.log(abs((own + other) / (own - other)))

    near = quad(integrand, 0.0, place, limit=200, epsabs=1e-8)[0]
    end = (1.0 - place) ** (1 / 3)
    far = quad(lambda t: integrand(1 - t**3) * 3 * t**2, 1e-6, end, limit=200, epsabs=1e-8)[0]
    assert found.profiles(np.array([place]))[0][0] == pytest.approx(4 / np.pi * (near + far), rel=1e-6)


@pytest.mark.parametrize("place", [0.05, 0.7])
def test_flow_is_that_of_the_volume_beyond(place):
    found, step = similarity(24), 1e-4
    at = place
    opening, pressure = found.profiles(np.array([at - step, at, at + step]))
    beyond = quad(lambda t: found.profiles(np.array([1 - t**3]))[0][0] * 3 * t**2, 0.01, (1 - at) ** (1 / 3))[0]
    slope = (pressure[2] - pressure[0]) / (2 * step)
    assert opening[1] ** 3 * slope == pytest.approx(-beyond - 2 / 3 * at * opening[1], rel=1e-3)


def test_tip_is_that_of_a_fluid_without_toughness():
    x = np.array([1e-3, 1e-4])
    opening = similarity(24).profiles(1 - x)[0]
    assert opening / x ** (2 / 3) == pytest.approx(2 ** (1 / 3) * 3 ** (5 / 6) * (2 / 3) ** (1 / 3), rel=5e-3)
