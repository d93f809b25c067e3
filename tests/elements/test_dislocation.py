"""Jumps in unbounded rock: the energy of pairs of segments, and displacements and stresses around them."""

import numpy as np
import pytest
from scipy.special import zeta

from fracflow.elements.dislocation import AT_TIP, at_tips, displacements, energies, mean_along, stresses

POISSON, MODULUS = 0.25, 2.0
PLACES, WEIGHTS = np.polynomial.legendre.leggauss(60)
PLACES, WEIGHTS = (1 + PLACES) / 2, WEIGHTS / 2
ONE = ((0.0, 0.0), (1.0, 0.0))
PAIRS = {
    "straight on": (ONE, ((1.0, 0.0), (1.3, 0.0))),
    "bend": (ONE, ((1.0, 0.0), (1.6, 0.8))),
    "sharp": (ONE, ((1.6, 0.05), (1.0, 0.0))),
    "near": (ONE, ((0.2, 0.07), (0.9, 0.4))),
    "beside": (ONE, ((1.8, 0.5), (2.4, 0.1))),
    "far": (ONE, ((30.0, 40.0), (30.5, 39.0))),
}


def by_points(one, other):
    """The mean over both segments: exact along the one; points crowd at the ends of the other, where it is steep."""
    start, end = np.array(other)
    total = np.zeros(3)
    for first, last in ((0.0, 0.5), (1.0, 0.5)):
        share = first + (last - first) * PLACES**4
        values = mean_along(start + share[:, None] * (end - start), *np.array(one))
        total += (WEIGHTS * 4 * PLACES**3) @ values / 2
    return total


@pytest.mark.parametrize("name", PAIRS)
def test_energy_of_a_pair(name):
    pair = np.array(PAIRS[name])
    found = energies(pair, np.arange(2))
    np.testing.assert_allclose(found[0, 1], by_points(*pair), rtol=0, atol=1e-9)
    np.testing.assert_array_equal(found[0, 1], found[1, 0])
    np.testing.assert_array_equal(energies(pair, np.array([1]))[0, 0], found[0, 1])  # on another rank


def test_energy_of_a_segment_with_itself():
    found = energies(np.array([[[2.0, 1.0], [2.0, 3.0]]]), np.arange(1))[0, 0]
    np.testing.assert_allclose(found, [np.log(2) - 1.5, np.log(2) - 2.5, 0.0], atol=1e-15)


def test_what_a_tip_adds_solves_the_equation_of_wiener_and_hopf():
    """(1/4 - S)/(5/4 - S) e^g; the sum over n of |t + 2 pi n|^-3 is that of Hurwitz' zeta functions."""
    t = (np.arange(1 << 16) + 0.5) * 2 * np.pi / (1 << 16)
    share = t / (2 * np.pi)
    symbol = np.pi * (2 * np.sin(t / 2)) ** 3 * (zeta(3, share) + zeta(3, 1 - share)) / (2 * np.pi) ** 3
    mean, slope = np.log(symbol).mean(), np.mean(np.log(np.pi / symbol) / (2 * np.sin(t / 2)) ** 2)
    assert pytest.approx(np.exp(mean) * (0.25 - slope) / (1.25 - slope), abs=2e-7) == AT_TIP


def test_equal_joints_along_a_crack_have_order_two():
    """Jumps 4 sqrt(1 - x^2) p/E', and the volume 2 pi p/E'; 0.2 and 0.5 % off at 100 joints if tips add nothing."""
    errors = []
    for count in (50, 100):
        nodes = np.linspace(-1.0, 1.0, count + 1)
        ends = np.stack([nodes, 0 * nodes], axis=1)
        ends = np.stack([ends[:-1], ends[1:]], axis=1)
        change = np.eye(count, count - 1) - np.eye(count, count - 1, -1)
        stiffness = -change.T @ energies(ends, np.arange(count), at_tips(ends))[:, :, 1] @ change / (4 * np.pi)
        jumps = np.linalg.solve(stiffness, np.full(count - 1, 2 / count))
        exact, inner = 4 * np.sqrt(1 - nodes[1:-1] ** 2), np.abs(nodes[1:-1]) < 0.9
        errors.append([np.abs(jumps - exact)[inner].max() / 4, abs(2 / count * jumps.sum() / (2 * np.pi) - 1)])
    assert max(errors[1]) < 1e-3 and np.all(np.log2(np.divide(*errors)) > 1.9)
    first, *next_ones = (jumps / exact - 1)[:10]  # linear jumps of the root's volume lie above it beside the tip
    assert first == pytest.approx(0.14, abs=2e-3) and np.abs(next_ones).max() < 0.008


def test_waves_along_equal_joints_meet_less_stress_by_a_sixth_of_their_square():
    """The mean of k^2 in the stress in the middle of a jump exp(-x^2/w^2), sqrt(pi)^-1/w without h, is 4/w^2."""
    for width in (8.0, 16.0):  # joints
        nodes = np.arange(-8.0 * width, 8.0 * width + 1.0)
        line = np.stack([nodes, 0.0 * nodes], axis=1)
        beside = len(nodes) // 2 - np.array([1, 0])
        means = energies(np.stack([line[:-1], line[1:]], axis=1), beside)[:, :, 0]
        before, behind = means @ np.diff(np.exp(-((nodes / width) ** 2))) / (4.0 * np.pi)
        lack = 1.0 - (behind - before) * 2.0 * np.sqrt(np.pi) * width
        assert lack == pytest.approx(4.0 / width**2 / 6.0, rel=2.0 / width**2 + 0.1 / width)


def test_a_tip_is_an_end_of_one_segment():
    ends, _ = crack(3)
    np.testing.assert_allclose(at_tips(ends) / AT_TIP, [0, 0, 1] * 3, atol=1e-14)


@pytest.mark.parametrize("gap", [1.0, 0.8, 0.7, 0.6, 0.5, 0.1])
def test_the_rock_between_tips_side_by_side_has_a_positive_energy(gap):
    """Four cracks one over the other, so many joints apart: at 0.8 and less the whole addition makes some negative."""
    count, cracks = 10, 4
    nodes = np.stack([np.arange(count + 1.0), np.zeros(count + 1)], axis=1)
    one = np.stack([nodes[:-1], nodes[1:]], axis=1)
    ends = np.concatenate([one + np.array([0.0, k * gap]) for k in range(cracks)])
    change = np.kron(np.eye(cracks), np.eye(count, count - 1) - np.eye(count, count - 1, -1))
    means = energies(ends, np.arange(len(ends)), at_tips(ends))
    xx, yy, xy = (-change.T @ means[:, :, k] @ change for k in range(3))
    assert np.linalg.eigvalsh(np.block([[xx, xy], [xy, yy]]))[0] > 0.0


def test_a_tip_beside_another_trace_has_less_of_it():
    """By the distance over its own joint, even where the middle of the other one is far."""
    for gap, share in ((0.3, 0.0), (0.6, 0.2), (0.75, 0.5), (1.1, 1.0)):
        ends = np.array([[[-1.0, 0.0], [0.0, 0.0]], [[-2.0, 0.0], [-1.0, 0.0]], [[-2.0, gap], [30.0, gap]]])
        np.testing.assert_allclose(at_tips(ends)[:2] / AT_TIP, share, atol=1e-12)


def crack(count=40):
    """Segments of a bent crack with a branch, and jumps that add up to none where they meet."""
    along = np.linspace(0.0, 1.0, count + 1)[:, None]
    stem, left, right = (np.array(end) for end in ((-1.0, 0.1), (0.8, 0.5), (0.6, -0.7)))
    jump = np.array([0.3, 1.0])
    ends, jumps = [], []
    for end, share in ((stem, -1.0), (left, 0.4), (right, 0.6)):
        nodes, values = along * end, share * (1 - along**2) * jump
        ends.append(np.stack([nodes[:-1], nodes[1:]], axis=1))
        jumps.append(np.stack([values[:-1], values[1:]], axis=1))
    return np.concatenate(ends), np.concatenate(jumps)


def test_stresses_are_those_of_the_displacements():
    ends, jumps = crack()
    places, step = np.array([[0.3, 0.9], [-0.2, -0.4], [0.5, 0.05], [2.0, 1.0]]), 1e-4
    slopes = [
        (displacements(places + step * unit, ends, jumps, POISSON) - displacements(places - step * unit, ends, jumps, POISSON))
        / (2 * step)
        for unit in np.eye(2)
    ]  # fmt: skip
    young = MODULUS * (1 - POISSON**2)
    shear, lame = young / (2 * (1 + POISSON)), young * POISSON / ((1 + POISSON) * (1 - 2 * POISSON))
    xx, yy, xy = slopes[0][:, 0], slopes[1][:, 1], slopes[0][:, 1] + slopes[1][:, 0]
    right = np.stack([lame * (xx + yy) + 2 * shear * xx, lame * (xx + yy) + 2 * shear * yy, shear * xy], axis=1)
    np.testing.assert_allclose(stresses(places, ends, jumps, MODULUS), right, rtol=1e-5, atol=1e-6)


def test_displacements_jump_across_segments_and_vanish_far_away():
    ends, jumps = crack()
    middle, step = ends.mean(axis=1), ends[:, 1] - ends[:, 0]
    left = 1e-6 * np.stack([-step[:, 1], step[:, 0]], axis=1)
    found = displacements(middle + left, ends, jumps, POISSON) - displacements(middle - left, ends, jumps, POISSON)
    np.testing.assert_allclose(found, jumps.mean(axis=1), atol=1e-5)
    far = displacements(np.array([[1e6, 2e6]]), ends, jumps, POISSON)
    assert np.abs(far).max() < 1e-6


def test_no_stress_of_a_block_that_moves_as_one():
    corners = np.array([[0.0, 0.0], [2.0, 0.3], [1.5, 1.7], [-0.3, 1.2]])
    ends = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
    turn = np.stack([-ends[..., 1], ends[..., 0]], axis=2)
    jumps, places = np.array([0.4, -0.2]) + 0.1 * turn, np.array([[0.9, 0.8], [4.0, 1.0], [-0.5, -0.2]])
    found = displacements(places, ends, jumps, POISSON)  # blocks are to the left of walls that run counter-clockwise
    np.testing.assert_allclose(found[0], [0.4 - 0.08, -0.2 + 0.09], atol=1e-14)
    np.testing.assert_allclose(found[1:], 0.0, atol=1e-14)
    assert np.abs(stresses(places, ends, jumps, MODULUS)).max() < 1e-14
