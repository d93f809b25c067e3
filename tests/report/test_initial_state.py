"""A scene that cannot be at rest, or cannot be pumped, is refused in one line that says where."""

import pytest

from fracflow.errors import InputError


def _refusal(ran, *overrides):
    with pytest.raises(InputError) as caught:
        ran("report_5_3", *overrides)
    message = str(caught.value)
    assert "\n" not in message
    return message


def test_initial_stress_that_nothing_carries(ran):
    """The ends of 5.3 are free: without the tractions of the cut-off rock they are out of balance."""
    message = _refusal(ran, "load=[]")
    assert "out of balance" in message and "at fault, north (x, y), south (x, y): a side" in message


def test_fracture_past_its_strength(ran):
    """tan(30 deg) (2e5 - 0.3e5) = 0.98e5 is below the shear traction 1.4e5."""
    message = _refusal(ran, "fracture.fault.friction_angle_deg=30")
    assert "strength of fault" in message


def test_steady_pumping_that_nothing_drains(ran):
    message = _refusal(ran, 'well=[{name = "node2", at = [0, -1000], flow_rate = 1, control = "pumping"}]')
    assert "fault" in message and "node2" in message and "drains" in message
