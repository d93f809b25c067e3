"""R02: the block of 5.2 whose strength drops; of second order where events are located, see tests/reference."""

import numpy as np
import pytest
from figures_time.events import exact, harmonic

pytestmark = pytest.mark.serial

STEPS = (0.2, 0.05)


def errors(ran, push, *overrides):
    """Largest error of the displacement over its largest value, for each of the steps."""
    times = np.linspace(0.0, push.end, round(push.end / STEPS[-1]) + 1)  # every time step falls on one of these
    table = [[float(t), float(push.force(t))] for t in times]
    found = []
    for dt in STEPS:
        pushed = (f"load.0.traction=[{table}, 0]", f"stage.0.time_step={dt}", f"stage.0.end={push.end}")
        history = ran("report_5_2", *pushed, f"fracture.default.stick_slip_ratio={push.ratio}", *overrides).history
        right = exact(history["time"], push)
        found.append(np.abs(history["probe/block/displacement"][:, 0] - right).max() / np.abs(right).max())
    return np.array(found)


def order(found):
    """Slope of the errors over the steps."""
    return np.polyfit(np.log(STEPS), np.log(found), 1)[0]


def test_first_order_only_where_drops_wait_for_the_end_of_a_step(ran):
    found, located = (errors(ran, harmonic(0.9, 20.0), f"method.events={how}") for how in ("at-step-ends", "located"))
    assert order(found) < 1.5 and found[-1] > 10 * located[-1], (found, located)
