"""R02 A: the block of 5.2 under 2.25 for 3.4 s, through slip: a jump of load enters at its mean, so the order is two."""

import numpy as np
import pytest
from figures_time.events import Push, exact

pytestmark = pytest.mark.serial

PUSH, LASTS, END = 2.25, 3.4, 12.0
RECTANGLE = Push("rectangle", lambda t: PUSH if t < LASTS - 1e-12 else 0.0, (LASTS,), END, 1.0)
STEPS = np.array([0.1, 0.025])
STEP_TABLE = f'{{time = [0, {LASTS}], value = [{PUSH}, 0], interpolation = "step"}}'
TWO_ROWS = f"[[0, 0], [0, {PUSH}], [{LASTS}, {PUSH}], [{LASTS}, 0]]"


def _error(ran, dt, table, *overrides):
    history = ran("report_5_2", f"load.0.traction=[{table}, 0]", f"stage.0.time_step={dt}", *overrides).history
    seen = history["time"] < END
    right = exact(history["time"][seen], RECTANGLE)
    largest = max(np.abs(v).max() for k, v in history.items() if k.startswith("energy/"))
    assert np.abs(history["energy/residual"]).max() <= 1e-10 * largest
    return np.abs(history["probe/block/displacement"][seen, 0] - right).max() / np.abs(right).max()


def _order(errors):
    return np.polyfit(np.log(STEPS), np.log(errors), 1)[0]


CASES = {
    "on a step's end": ("newmark", 1.0, STEP_TABLE),
    "within a step": ("newmark", 0.97, STEP_TABLE),
    "two rows, weighed forces": ("generalised-alpha", 0.97, TWO_ROWS),
}


@pytest.mark.parametrize("stepper, stretch, table", CASES.values(), ids=CASES)
def test_second_order_through_jumps(ran, stepper, stretch, table):
    """A model of the rule alone has 2.8e-3, 7.0e-4, 1.8e-4 at these steps; one that samples one side 3e-2, 1.5e-2, 7.6e-3."""
    errors = [_error(ran, dt * stretch, table, f"stage.0.end={END}", f"method.stepper={stepper}") for dt in STEPS]
    assert _order(errors) > 1.8 and errors[0] < 2.8e-3 and errors[-1] < 1.8e-4, errors


def test_a_stage_that_ends_at_the_jump_changes_nothing_of_the_order(ran):
    """One stage up to the jump sees what is before it, the next one what is after."""
    stages = f'stage=[{{kind="dynamic", time_step=DT, end={LASTS}}}, {{kind="dynamic", time_step=DT, end={END}}}]'
    errors = []
    for dt in STEPS:
        table = f"load.0.traction=[{STEP_TABLE}, 0]"
        history = ran("report_5_2", table, stages.replace("DT", str(dt))).history
        right = exact(history["time"], RECTANGLE)
        errors.append(np.abs(history["probe/block/displacement"][:, 0] - right).max() / np.abs(right).max())
    assert _order(errors) > 1.8 and errors[0] < 2.8e-3, errors
