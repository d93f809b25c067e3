"""R02: the block of 5.2 pushed until it slips: second order in the step, with a strength drop where events are located."""

import numpy as np
import pytest
from figures_time.events import exact, half_sine, harmonic

STEPS = (0.2, 0.1, 0.05, 0.025)


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


@pytest.mark.parametrize("events", ["located", "at-step-ends"])
def test_second_order_through_slip_without_a_drop(ran, events):
    found = errors(ran, half_sine(1.0, 12.0), f"method.events={events}")
    assert order(found) > 1.8, found
    assert found[0] < 2e-2 and found[-1] < 4e-4, found


@pytest.mark.parametrize("push", [half_sine(0.8, 12.0), harmonic(0.9, 20.0)], ids=lambda push: push.name)
def test_second_order_through_strength_drops(ran, push):
    found = errors(ran, push)
    assert order(found) > 1.9, found
    assert found[0] < 2e-2 and found[-1] < 4e-4, found


def test_first_order_only_where_drops_wait_for_the_end_of_a_step(ran):
    found, located = (errors(ran, harmonic(0.9, 20.0), f"method.events={how}") for how in ("at-step-ends", "located"))
    assert order(found) < 1.5 and found[-1] > 10 * located[-1], (found, located)
