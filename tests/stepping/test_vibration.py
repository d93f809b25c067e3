"""The vibration that very short parts follow: its amplitude and period from what a node does, part by part."""

import math

import numpy as np
import pytest

from fracflow.advance.error_control import WATCHED, ErrorEstimator
from fracflow.advance.step_error import Vibration, swing_of
from fracflow.errors import SolveError

pytestmark = pytest.mark.serial


def seen(displacement, times):
    """The values that parts between those times have of a motion u(t), from its exact accelerations."""
    h = 1e-4 * (times[1] - times[0])
    acceleration = (displacement(times + h) - 2.0 * displacement(times) + displacement(times - h)) / h**2
    jerk = np.diff(acceleration) / np.diff(times)
    found = Vibration()
    for before, after, change in zip(acceleration, acceleration[1:], jerk, strict=False):
        found = found.followed_by(Vibration(1, max(abs(before), abs(after)), abs(change), "here"))
    return found


def test_amplitude_and_period():
    """A sin w t, alone and on a slow motion a thousand times as large, which it rules the jerk of."""
    times = np.linspace(0.0, 4.0 * math.pi / 50.0, 201)
    alone = seen(lambda t: 1e-3 * np.sin(50.0 * t), times)
    assert alone.parts == 200 and alone.place == "here"
    assert swing_of(alone.acceleration, alone.jerk) == pytest.approx((1e-3, 2.0 * math.pi / 50.0), rel=0.02)
    both = seen(lambda t: 1e-3 * np.sin(50.0 * t) + np.sin(t), times)
    assert 1e-3 <= swing_of(both.acceleration, both.jerk)[0] <= 2e-3
    assert swing_of(0.0, 0.0) == (math.inf, math.inf)


def test_a_checkpoint_keeps_it():
    kept = Vibration(7, 2.0, 3.0, "there").as_progress()
    assert Vibration.of(kept) == Vibration(7, 2.0, 3.0) and Vibration.of({}) == Vibration()


def estimator(follows, of_flow=False):
    """One of a stage from 0 to 1, parts of 1e-7, a tolerance of 0.01 and a largest displacement of 1."""
    made = object.__new__(ErrorEstimator)
    given = {
        "of_flow": of_flow,
        "tolerance": 1e-2,
        "largest": 1.0,
        "guess": 0.0,
        "last": 1e-7,
        "start": 0.0,
        "length": 1.0,
    }
    vars(made).update(given, follows=follows)
    return made


def test_of_a_stage_that_needs_very_many_parts_it_says_how_many():
    """Once; and it stops where they follow a vibration whose double amplitude is less than what may be wrong."""
    w = 1e4
    large, small = (Vibration(WATCHED, a * w**2, a * w**3, "on joint at (1, 2)") for a in (1e-1, 4e-3))
    told = estimator(large).outlook(0.5)
    assert "substeps as short as 1e-07, about 5e+06 more of them. They follow a vibration on joint at (1, 2)" in told
    assert estimator(large.followed_by(Vibration(1))).outlook(0.5) == ""
    with pytest.raises(SolveError, match=r"gain nothing.*amplitude 0.004, 0.004 of the largest displacement"):
        estimator(small).outlook(0.5)
    film = estimator(Vibration(WATCHED), of_flow=True).outlook(0.5)
    assert film.endswith("of volume stored in fractures needs substeps as short as 1e-07, about 5e+06 more of them")
