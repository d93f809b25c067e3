"""Report, Section 5.2 and Fig. 12: a block between two joints, pushed for 3.4 s."""

import numpy as np
import pytest

MODELS = ["default", "report"]
END_OF_LOAD = 3.4


def _free(history):
    """Times after the load, and the block's displacement there."""
    after = history["time"] > END_OF_LOAD + 1e-9
    return history["time"][after], history["probe/block/displacement"][after, 0]


def _centre_and_amplitude(time, displacement):
    """Least-squares fit of a + A cos(wt) + B sin(wt), w of the trapezoidal rule."""
    dt = time[1] - time[0]
    omega = 2.0 / dt * np.arctan(dt / 2.0)
    basis = np.stack([np.ones_like(time), np.cos(omega * time), np.sin(omega * time)], axis=1)
    (centre, a, b), *_ = np.linalg.lstsq(basis, displacement, rcond=None)
    return centre, np.hypot(a, b), np.abs(basis @ [centre, a, b] - displacement).max()


@pytest.mark.parametrize("model", MODELS)
def test_linear_amplitude(ran, model):
    """K = m = 1: without a law that slips the block swings about 0 with 4.3."""
    history = ran("report_5_2", f"model={model}", "fracture.default.law=linear").history
    centre, amplitude, misfit = _centre_and_amplitude(*_free(history))
    assert round(amplitude, 1) == 4.3
    assert round(np.abs(_free(history)[1]).max(), 1) == 4.3
    assert abs(centre) < 1e-9 and misfit < 1e-9


@pytest.mark.parametrize("model", MODELS)
def test_elastic_plastic_amplitude_is_two_about_a_permanent_displacement(ran, model):
    """The strength 2 over the stiffness 1; u_p = u - F/K is what the joints have slipped for good.

    The trapezoidal rule overshoots the strength in a step, so later cycles slip a little: 1e-3.
    """
    result = ran("report_5_2", f"model={model}")
    time, displacement = _free(result.history)
    last = time > 9.0
    centre, amplitude, _ = _centre_and_amplitude(time[last], displacement[last])
    assert amplitude == pytest.approx(2.0, abs=2e-3)
    first = sum(e["slip"] for e in result.events if e["node"] == 2)
    assert abs(centre) == pytest.approx(abs(first), abs=2e-3)
    assert abs(centre) > 1.5


@pytest.mark.parametrize("model", MODELS)
def test_energy_is_eight_and_stays(ran, model):
    history = ran("report_5_2", f"model={model}").history
    total = sum(history[f"energy/{name}"] for name in ("kinetic", "joint_shear", "joint_normal", "friction"))
    after = total[history["time"] >= END_OF_LOAD - 1e-9]
    assert after == pytest.approx(8.0, rel=0.01)
    assert after[0] == pytest.approx({"default": 8.0193, "report": 8.0129}[model], abs=1e-4)  # as README has it
    assert np.ptp(after) < 1e-10 * after[0]
