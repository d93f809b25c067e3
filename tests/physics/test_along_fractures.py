"""Properties tabled along a trace, given conductances and prescribed pressures, against closed forms."""

import numpy as np
import pytest

from fracflow.errors import SolveError

from .conftest import HELD, ROCK

RIGID = (
    HELD.replace("steps = 1", "steps = 2")
    + """
[geometry]
domain = [0, 0, 3, 2]
size = 0.5
[[geometry.fracture]]
name = "slot"
points = [[0, 1], [3, 1]]
[fracture.slot]
normal_stiffness = 1e12
shear_stiffness = 1e12
aperture = {along = [0, 3], value = ["1 mm", "0.25 mm"]}
friction_angle_deg = 30
cohesion = 1e9
[initial_stress]
yy = -1e6
[[probe]]
name = "quarter"
at = [0.75, 1]
on = "slot"
"""
)
ENDS = """
[[well]]
name = "in"
at = {fracture = "slot", end = "start"}
pressure = 1e4
[[well]]
name = "out"
at = {fracture = "slot", end = "end"}
pressure = 0
"""


def test_flow_through_a_slot_that_tapers(run_scene):
    """Lubrication: q = dp / (12 mu int ds/d^3) = dp 2 d1^2 d2^2 / (12 mu L (d1 + d2)), whatever the mesh."""
    found = run_scene(RIGID + ENDS)
    d1, d2 = 1e-3, 0.25e-3
    q = 1e4 * 2 * d1**2 * d2**2 / (d1 + d2) / (12 * 1e-3 * 3)
    assert found.probe("quarter", "flow_rate")[-1] == pytest.approx(q, rel=1e-9)


def test_conductance_of_the_scene_replaces_the_cubic_law(run_scene):
    """q = c dp / L, over a depth of 5; no aperture is needed by a linear joint."""
    found = run_scene(
        RIGID + ENDS,
        "fracture.slot={law='linear', normal_stiffness=1e12, shear_stiffness=1e12, conductance=3e-9}",
        "fluid.flow_depth=5",
    )
    assert found.probe("quarter", "flow_rate")[-1] == pytest.approx(5 * 3e-9 * 1e4 / 3, rel=1e-9)


def test_pressure_prescribed_along_and_in_time(run_scene):
    """p(s, t) bilinear in the table; the element carries what its gradient drives."""
    table = "{along = [0, 1, 3], time = [0, 2], value = [[0, 0, 0], [4e4, 2e4, 0]]}"
    found = run_scene(RIGID, f"fracture.slot.pressure={table}", "fracture.slot.conductance=3e-9")
    for step, factor in ((1, 0.5), (2, 1.0)):
        pressure = found.probe("quarter", "pressure")[step]
        assert pressure == pytest.approx(factor * np.interp(0.75, [0, 1, 3], [4e4, 2e4, 0]), rel=1e-12)
    assert found.closes()


def test_strength_along_a_trace(run_scene):
    """Cohesion on one half only: under uniform shear the weak half slips, the strong one does not."""
    found = run_scene(
        ROCK
        + """
[geometry]
domain = [0, 0, 8, 4]
size = 0.5
[[geometry.fracture]]
name = "fault"
points = [[0, 2], [8, 2]]
[fracture.fault]
normal_stiffness = 50e9
shear_stiffness = 20e9
aperture = "1 mm"
friction_angle_deg = {along = [0, 8], value = [30, 30]}
cohesion = {along = [0, 3.9, 4.1, 8], value = [0, 0, 5e6, 5e6]}
[initial_stress]
xx = -1e6
yy = -1e6
[[support]]
on = "south"
[[support]]
on = ["north", "east", "west"]
displacement_gradient = [[0, 3e-4], [0, 0]]
[[stage]]
kind = "steady"
time_step = 1
steps = 1
"""
    )
    slid = np.array([event["x"] for event in found.events])
    assert len(slid) >= 4 and slid.max() < 4.1


def test_a_stage_auto_of_what_cannot_move_says_what_to_give(run_scene):
    stage = 'kind = "auto"\ntime_step = 1\nend = 2\n'
    with pytest.raises(SolveError, match=r"no longest period of vibration .*: give a density to a rock"):
        run_scene(RIGID.replace('kind = "steady"\ntime_step = 1\nsteps = 2\n', stage) + ENDS)
