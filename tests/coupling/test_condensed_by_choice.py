"""The program condenses the rock of itself where that pays, known from the scene alone, and what it finds is the same."""

import math

import numpy as np
import pytest
from figures_work_precision.problems.w6 import PLACES, rupture

from fracflow.solve.condensed_cost import Condensing

pytestmark = pytest.mark.serial
ENDS = "method.events=at-step-ends"


def test_a_rupture_is_condensed_to_its_fault():
    chosen, full = rupture(375.0, 1.0, ENDS), rupture(375.0, 1.0, ENDS, "model=full", "method.contact=redistributed")
    assert chosen.history["step/factorisations"].sum() <= 3 < 30 < full.history["step/factorisations"].sum()
    for place in map(str, PLACES):
        slip = full.probe(place, "slip")
        assert np.abs(chosen.probe(place, "slip") - slip).max() <= 1e-10 * np.abs(slip).max()


def test_events_are_found_in_blocks_and_not_along_a_front():
    found = rupture(500.0, 1.0)
    sliding, located = found.history["step/slipping"], found.history["step/located"]
    assert located.sum() > 0 and not located[1:][sliding[:-1] >= 16].any()
    assert rupture(500.0, 1.0, "method.events=located").history["step/located"].sum() > located.sum()


@pytest.mark.parametrize(
    "steps, pays, worth", [(9.0, 5.0, False), (10.0, 5.0, True), (math.inf, 5.0, True), (math.inf, math.inf, False)]
)
def test_enough_steps_are_twice_those_that_pay(steps, pays, worth):
    """A search of unknown length is no reason to condense what never pays."""
    assert Condensing({(1.0, 0.0): steps}, pays).any_worth is worth
    assert not Condensing({(1.0, 0.0): steps}, pays).is_worth((2.0, 0.0))
