"""Initial tractions along a fault that are not those of the stress around: refused, or carried by the rock."""

import numpy as np
import pytest

from fracflow.errors import InputError

from .conftest import JOINT, ROCK

SCENE = (
    ROCK
    + JOINT
    + """
[geometry]
domain = [0, 0, 8, 4]
size = 0.125
cells = "quads"
fracture = [{name = "fault", points = [[2, 2], [6, 2]]}]
[initial_stress]
yy = -10e6
xy = 3e6
[[support]]
on = ["south", "north", "west", "east"]
[[probe]]
name = "middle"
at = [4, 2]
[[stage]]
kind = "dynamic"
time_step = 1e-4
steps = 10
"""
)


def _tractions(middle):
    """A patch of 1 m around the middle."""
    along, value = [0, 1.4, 1.5, 2.5, 2.6, 4], [3e6, 3e6, middle, middle, 3e6, 3e6]
    return f"fracture.fault.initial_shear_traction={{along = {along}, value = {value}}}"


CARRIED = "initial_stress.unbalanced=carried"


def test_refused_by_name_unless_carried(run_scene):
    with pytest.raises(InputError, match=r"out of balance .* at .*fault.*unbalanced"):
        run_scene(SCENE, _tractions(4e6))


def test_rests_where_it_is_below_its_strength(run_scene):
    found = run_scene(SCENE, _tractions(5e6), CARRIED)
    assert np.abs(found.probe("middle", "displacement")).max() < 1e-12 * 5e6 / 10e9
    assert found.probe("middle", "shear_traction") == pytest.approx(5e6)


def test_slips_from_the_first_instant_where_it_is_past_it(run_scene):
    """Strength 10 tan 30 = 5.77 MPa; the patch has 7."""
    found = run_scene(SCENE, _tractions(7e6), CARRIED)
    strength = 10e6 * np.tan(np.radians(30))
    assert found.probe("middle", "shear_traction")[1:4] == pytest.approx(strength, rel=1e-5)
    slip = found.probe("middle", "slip")
    assert np.all(np.diff(np.abs(slip[:6])) > 0.0) and min(event["start"] for event in found.events) <= 1e-4
    assert found.closes()
    # the drop in the middle starts two plane shear waves: slip rate 2 drop/(rho c_s)
    shear_speed = np.sqrt(10e9 / 2.5 / 2500)
    at = np.argmin(np.abs(found.history["time"] - 3e-4))
    assert abs(slip[at]) / 3e-4 == pytest.approx(2 * (7e6 - strength) / (2500 * shear_speed), rel=0.1)
