"""Where a step's first event lies, on made-up paths: cubics through both ends' strains and rates, with known roots."""

from types import SimpleNamespace

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.advance.events import first_event

pytestmark = pytest.mark.serial
DT = 0.25


class Thresholds:
    """Sections whose friction changes where the first strain reaches a threshold, and contact where the second leaves 0."""

    massless = None

    def __init__(self, thresholds, by_rate=False):
        self.thresholds, self.by_rate = np.array(thresholds), by_rate
        self.weights = np.ones(len(thresholds))
        self.jump = SimpleNamespace(getComm=lambda: SimpleNamespace(tompi4py=lambda: MPI.COMM_SELF))

    def strain(self, velocity):
        return velocity

    def approach(self, strain, change, history, step):
        friction = change[:, 0] if self.by_rate else self.thresholds - strain[:, 0]
        return np.stack([friction, strain[:, 1]], axis=1)


def _ends(strains, rates):
    """The states at both ends, from strains and their changes a step, each (2, s, 2)."""
    return [
        SimpleNamespace(
            time=0.0,
            sections=SimpleNamespace(strain=np.array(strain, float), history=()),
            motion=SimpleNamespace(velocity=np.array(rate, float) / DT),
        )
        for strain, rate in zip(strains, rates, strict=True)
    ]


def _sliding(start, end, left, right):
    """Walls apart by -1; the first strain goes from start to end with those rates a step."""
    return _ends([[[start, -1.0]], [[end, -1.0]]], [[[left, 0.0]], [[right, 0.0]]])


@pytest.mark.parametrize(
    "ends, threshold, root",
    [
        ((0.0, 1.0, 0.0, 3.0), 0.125, 0.5),  # x^3
        ((0.0, 1.0, 3.0, 0.0), 0.875, 0.5),  # 1 - (1 - x)^3
        ((0.0, 1.0, 2.0, 0.0), 0.51, 0.3),  # 2x - x^2
        ((0.0, 0.0, 1.0, -2.0), 0.192, 0.2),  # x - x^3: there and back, the first time counts
        ((0.5, 1.5, 1.0, 1.0), 0.75, 0.25),  # straight
    ],
)
def test_the_rates_of_both_ends_bend_the_path(ends, threshold, root):
    found = first_event(Thresholds([threshold]), *_sliding(*ends), DT)
    assert found.fraction == pytest.approx(root, abs=1e-9) and found.sections.tolist() == [True]


def test_the_rate_falls_through_zero_where_the_cubic_turns():
    """x - x^3 turns at 1/sqrt(3)."""
    found = first_event(Thresholds([0.0], by_rate=True), *_sliding(0.0, 0.0, 1.0, -2.0), DT)
    assert found.fraction == pytest.approx(1.0 / np.sqrt(3.0), abs=1e-9)


def test_walls_meet_or_part_where_their_distance_is_none():
    """x^3 - 1/8 either way; no friction changes with it."""
    for sign in (1.0, -1.0):
        strains = np.array([[[0.0, -0.125]], [[0.0, 0.875]]]) * sign
        found = first_event(Thresholds([9.0]), *_ends(strains, np.array([[[0.0, 0.0]], [[0.0, 3.0]]]) * sign), DT)
        assert found.fraction == pytest.approx(0.5, abs=1e-9) and not found.sections.any()


def test_beyond_the_end_the_cubic_goes_on():
    ends = _sliding(0.0, 1.0, 0.0, 3.0)
    assert first_event(Thresholds([1.331]), *ends, DT) is None
    assert first_event(Thresholds([1.331]), *ends, DT, until=1.2).fraction == pytest.approx(1.1, abs=1e-9)


def test_the_first_comes_with_those_just_behind_it():
    """x^3 in three sections: 0.5, 0.5005 and 0.6 of the step."""
    ends = _ends([[[0.0, -1.0]] * 3, [[1.0, -1.0]] * 3], [[[0.0, 0.0]] * 3, [[3.0, 0.0]] * 3])
    found = first_event(Thresholds([0.6**3, 0.5005**3, 0.125]), *ends, DT)
    assert found.fraction == pytest.approx(0.5005, abs=1e-9) and found.sections.tolist() == [False, True, True]
