"""The vibration that very short parts follow: its amplitude and period from what a node does, part by part."""

import math

import numpy as np
import pytest

from fracflow.steps.vibration import Vibration, swing_of

pytestmark = pytest.mark.serial


def seen(displacement, times):
    """What parts between those times see of a motion u(t), from its exact accelerations."""
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
