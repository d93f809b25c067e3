"""Statistics of a catalogue against samples whose answer is known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fracflow.run_report.statistics import completeness, front_diffusivity, gutenberg_richter, largest_moment

pytestmark = pytest.mark.serial


def sample(b, count, least, seed=3):
    """Magnitudes of Gutenberg and Richter's law from ``least`` on."""
    return least - np.log10(np.random.default_rng(seed).uniform(size=count)) / b


@pytest.mark.parametrize("b", [0.8, 1.0, 1.5])
def test_b_is_that_of_the_law_within_its_error(b):
    found = gutenberg_richter(sample(b, 4000, 1.2))
    assert found.completeness == pytest.approx(1.2) and found.count == 4000
    assert abs(found.b - b) < 2.5 * found.error
    assert found.error == pytest.approx(b / math.sqrt(4000), rel=0.1)  # Aki's error of an ideal sample
    assert found.number(1.2) == pytest.approx(4000)


def test_events_below_completeness_do_not_count():
    """Half of the small ones were missed."""
    whole = sample(1.0, 20000, 0.0)
    dice = np.random.default_rng(4)
    seen = whole[(whole > 1.0) | (dice.uniform(size=len(whole)) < 0.05)]
    found = gutenberg_richter(seen)
    assert found.completeness == pytest.approx(1.0)
    assert abs(found.b - 1.0) < 3.0 * found.error
    assert gutenberg_richter(seen, 10.0).b < 0.8  # one bin for all: what completeness is for


def test_b_by_hand():
    """Ten events, 0.1 to 1.0 above 2: mean excess 0.55 over the bin that begins at 2.1, of ten the lowest."""
    values = 2.0 + 0.1 * np.arange(1, 11)
    found = gutenberg_richter(values)
    assert completeness(values) == pytest.approx(2.1)
    assert found.b == pytest.approx(math.log10(math.e) / 0.45)
    assert found.error == pytest.approx(2.302585 * found.b**2 * math.sqrt(0.825 / 90.0), rel=1e-6)


@pytest.mark.parametrize(
    "values", [[], [1.0] * 30, np.linspace(0, 1, 9), [math.nan] * 20], ids=["none", "one", "few", "nan"]
)
def test_too_few_or_equal_magnitudes_have_no_b(values):
    assert gutenberg_richter(values) is None


def test_the_bound_of_the_moment_is_modulus_times_volume():
    assert largest_moment(30e9, [-1.0, 0.0, 1e4]).tolist() == [0.0, 0.0, 3e14]


def test_a_front_gives_its_diffusivity_and_a_cloud_none():
    dice = np.random.default_rng(5)
    time = dice.uniform(1e4, 1e6, 2000)
    behind = np.sqrt(4 * math.pi * 0.5 * time * dice.uniform(size=2000))  # r^2/(4 pi t) is even between 0 and 0.5
    assert front_diffusivity(behind, time) == pytest.approx(0.475, rel=0.03)
    assert front_diffusivity(dice.uniform(0, 500, 40), np.sort(time[:40])) is None
    assert front_diffusivity(behind[:9], time[:9]) is None
