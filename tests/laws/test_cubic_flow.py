"""Means of the cubed aperture, against quadrature."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad

from fracflow.laws import FLOW_LAWS
from fracflow.laws.cubic_flow import FrontCubic, conductance, exact_mean_cube, report_mean_cube

pytestmark = pytest.mark.serial

MEANS = {name: law.mean_cube for name, law in FLOW_LAWS.items()}
WALLS = [(1.0, 0.2), (0.3, 1.7), (1.0, 1.0), (2e-6, 5e-4)]


@pytest.mark.parametrize("d1,d2", WALLS)
def test_exact_mean_is_the_harmonic_one(d1, d2):
    resistance = quad(lambda x: (d1 + (d2 - d1) * x) ** -3, 0, 1, epsabs=0, epsrel=1e-11, limit=500)[0]
    assert exact_mean_cube(d1, d2)[0] * resistance == pytest.approx(1.0, rel=1e-8)


@pytest.mark.parametrize("d1,d2", WALLS)
def test_report_mean_is_the_arithmetic_one(d1, d2):
    assert report_mean_cube(d1, d2)[0] == pytest.approx(quad(lambda x: (d1 + (d2 - d1) * x) ** 3, 0, 1)[0])


@pytest.mark.parametrize("name", MEANS)
def test_derivatives_and_symmetry(name):
    d1, d2 = np.random.default_rng(1).uniform(1e-3, 1.0, (2, 50))
    mean, slope_1, slope_2 = MEANS[name](d1, d2)
    step = 1e-7
    assert np.allclose((MEANS[name](d1 + step, d2)[0] - MEANS[name](d1 - step, d2)[0]) / (2 * step), slope_1, atol=1e-7)
    assert np.allclose((MEANS[name](d1, d2 + step)[0] - MEANS[name](d1, d2 - step)[0]) / (2 * step), slope_2, atol=1e-7)
    swapped = MEANS[name](d2, d1)
    assert np.allclose(swapped[0], mean) and np.allclose(swapped[1], slope_2)
    assert np.allclose(MEANS[name](d1, d1)[0], d1**3)


@pytest.mark.parametrize("name", MEANS)
def test_closed_walls(name):
    with np.errstate(all="raise"):
        closed = MEANS[name](np.array([0.0, -1.0, -1.0]), np.array([0.0, -2.0, 0.5]))
    assert all(np.isfinite(part).all() for part in closed)
    assert np.all(np.array(closed)[:, :2] == 0)
    assert closed[1][2] == 0
    assert (closed[0][2] == 0) == (name != "report"), "only the report's mean conducts through a closed end"


def flow(mean, elements):
    d = np.linspace(1.0, 0.2, elements + 1)
    return 1.0 / np.sum(1.0 / conductance(mean(d[:-1], d[1:])[0], 1.0 / elements, 1.0 / 12.0))


def test_taper_five_to_one():
    exact = 2 * 1.0 * 0.2**2 / 1.2
    for elements in (1, 3, 16):
        assert flow(exact_mean_cube, elements) == pytest.approx(exact, rel=1e-13)
    expected = {1: 3.68, 2: 1.0923, 4: 0.326, 8: 0.0913, 16: 0.0239}
    for elements, excess in expected.items():
        assert flow(report_mean_cube, elements) / exact - 1 == pytest.approx(excess, rel=3e-3)


def two_ends(d0, opening):
    """Conductances of the default law at openings (n, 2), on elements of length 1 in a fluid that makes them mean cubes."""
    rest = np.full(np.shape(opening), d0)
    return FLOW_LAWS["front"](rest, 0.0 * rest, np.ones(len(rest)), 1.0 / 12.0).conductance(opening, 0.0 * rest, {})


def test_a_front_of_opening_lets_through_the_cube_of_the_middle():
    found = two_ends(1e-9, np.array([[1.0, 0.0], [0.0, 1.0]]))
    assert found.value == pytest.approx(1 / 8, rel=1e-6)
    where = np.linspace(0.0, 1.0, 100_001)  # of the front in the element, d as the power 2/3 of the distance to it
    assert np.mean(np.maximum(where - 0.5, 0.0) ** 2) / np.mean(where**2) == pytest.approx(1 / 8, rel=1e-3)


def test_nothing_is_added_where_walls_part_by_less_than_the_aperture_at_rest():
    opening = np.array([[0.0, 1.0], [-0.9, 0.1], [0.3, 0.3]])
    assert np.array_equal(two_ends(1.0, opening).value, exact_mean_cube(*(1.0 + opening.T))[0])


def test_derivatives_with_a_front():
    opening = np.random.default_rng(2).uniform(0.0, 10.0, (50, 2))
    found, step = two_ends(0.7, opening), 1e-6
    for end in (0, 1):
        change = step * np.eye(2)[end]
        by = (two_ends(0.7, opening + change).value - two_ends(0.7, opening - change).value) / (2 * step)
        assert np.allclose(by, found.by_opening[:, end], rtol=1e-6, atol=1e-6)


def test_walls_pressed_into_each_other_are_shut():
    """By however much. Shut elements beside a front conduct nothing."""
    opening = np.array([[2.0, -1.0], [2.0, -5.0], [-2.0, -5.0], [-1.0, -5.0], [-5.0, 9.0]])
    found = two_ends(1.0, opening)
    assert found.value == pytest.approx([2**4 / 3 / 8, 2**4 / 3 / 8, 0.0, 0.0, 9**4 / 10 / 8])
    assert np.isfinite(found.by_opening).all() and not found.by_opening[2:4].any()
    assert found.by_opening[1, 1] == 0.0 and found.by_opening[4, 0] == 0.0


class RidesUp(FrontCubic):
    """Walls that a slip of one component along the joint parts for the fluid by half of it."""

    knows_slip = True

    def hydraulic(self, opening, slip, history, step):
        width, by_opening, _ = super().hydraulic(opening, slip, history, step)
        return width + 0.5 * slip[:, :, 0], by_opening, np.full(slip.shape, 0.5)


def test_derivatives_by_slip_with_a_front():
    opening, slip = np.random.default_rng(3).uniform(0.0, 10.0, (2, 50, 2))
    law, step = RidesUp(np.full((50, 2), 0.7), np.zeros((50, 2)), np.ones(50), 1.0 / 12.0), 1e-6
    found = law.conductance(opening, slip[:, :, None], {})
    for end in (0, 1):
        change = step * np.eye(2)[end]
        more, less = (law.conductance(opening, (slip + by)[:, :, None], {}).value for by in (change, -change))
        assert np.allclose((more - less) / (2 * step), found.by_slip[:, end, 0], rtol=1e-6, atol=1e-6)
