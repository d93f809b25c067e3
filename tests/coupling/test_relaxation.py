"""Relaxation of linear cycles whose errors are known, against what theory promises of each rule."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fracflow.solve.fixed_point.relaxation import DEPTH, RELAXATIONS, Cycles, aitken, anderson, least_squares, plain

pytestmark = pytest.mark.serial


def alone(values):
    return values


def cycles_needed(rule, factors, start, predicted, most=3000):
    """Cycles until an error with modes of the given factors -rho_i has fallen by 1e-8; the solution is 0."""
    pressure, cycles = start.copy(), Cycles(predicted)
    for number in range(1, most + 1):
        cycles = cycles.then(pressure, -(1.0 + factors) * pressure)
        step, share = rule(cycles, alone)
        cycles = cycles.taking(share)
        pressure = pressure + step
        if np.linalg.norm(pressure) <= 1e-8 * np.linalg.norm(start):
            return number
        if not np.linalg.norm(pressure) < 1e12:
            break
    return np.inf


def test_plain_needs_as_many_cycles_as_its_factor_says():
    start = np.ones(1)
    for rho in (0.2, 0.5, 0.9):
        assert cycles_needed(plain, np.array([rho]), start, rho) == int(np.ceil(np.log(1e-8) / np.log(rho)))
    assert cycles_needed(plain, np.array([1.1]), start, 1.1) == np.inf


def test_one_mode_is_found_at_once():
    """Aitken's share for one mode is exact, 1/(1 + rho): the third pressure is right; Anderson's too."""
    for rho in (0.5, 200.0, 1e6):
        assert cycles_needed(aitken, np.array([rho]), np.ones(1), 0.1 * rho) <= 3
        assert cycles_needed(anderson, np.array([rho]), np.ones(1), 0.1 * rho) <= 3


@given(st.lists(st.floats(0.0, 3.0), min_size=1, max_size=DEPTH), st.integers(0, 99))
def test_anderson_ends_after_as_many_cycles_as_modes(exponents, seed):
    """With no more modes than it looks back it is GMRES: modes + 1 cycles, and a few for round-off."""
    factors = 10.0 ** np.array(exponents) - 1.0
    start = np.random.default_rng(seed).uniform(0.5, 1.0, len(factors))
    assert cycles_needed(anderson, factors, start, factors.max()) <= len(factors) + 6


def test_many_modes():
    """where-methods-fail 2, 64 modes of a film, the longest at rho = 57: plain diverges, the others do not."""
    start = np.random.default_rng(3).standard_normal(64)
    factors = 57.0 / np.arange(1, 65) ** 2
    assert cycles_needed(plain, factors, start, 57.0) == np.inf
    assert cycles_needed(aitken, factors, start, 57.0) <= 130
    assert cycles_needed(anderson, factors, start, 57.0) <= 65
    assert set(RELAXATIONS) == {"plain", "aitken", "anderson", "added-storage"}


@given(st.integers(1, 5), st.integers(0, 999))
def test_least_squares_is_that_of_numpy(count, seed):
    random = np.random.default_rng(seed)
    columns, target = random.standard_normal((count, 9)), random.standard_normal(9)
    found = least_squares(list(columns), target, alone)
    assert np.allclose(found, np.linalg.lstsq(columns.T, target, rcond=None)[0], atol=1e-9)
    twice = least_squares([columns[0], *columns], target, alone)  # the older of two that are alike gives way
    assert twice[0] == 0.0 and np.allclose(twice[1:], found, atol=1e-9)
