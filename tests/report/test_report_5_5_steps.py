"""Application 5.5 with pumping raised at 1 % per 0.01 s: first slips by half the time step, and by explicit steps."""

import numpy as np
import pytest

pytestmark = pytest.mark.serial


def _first_slips(ran, step, *overrides):
    """Start and slip of each node's first slip within 0.6 s."""
    stage = {"time_step": step, "steps": round(0.6 / step), "increment_per_step": step}
    found = {}
    for event in ran(
        "report_5_5", *(f"stage.failure.{key}={value}" for key, value in stage.items()), *overrides
    ).events:
        if event["kind"] == "slip" and event["end"] is not None:
            found.setdefault(event["probe"], (event["start"], abs(event["slip"])))
    return found


@pytest.mark.parametrize("step, stepper", [(0.005, "newmark"), (0.005, "explicit")])
def test_slips_to_one_per_cent_and_starts_to_a_hundredth(ran, step, stepper):
    once, again = _first_slips(ran, 0.01), _first_slips(ran, step, f"method.stepper={stepper}")
    assert sorted(once) == sorted(again) == ["node3", "node4", "node5"]
    values, others = (np.array([found[node] for node in sorted(found)]) for found in (once, again))
    assert np.abs(values[:, 0] - others[:, 0]).max() <= 0.01
    assert others[:, 1] == pytest.approx(values[:, 1], rel=0.01)
