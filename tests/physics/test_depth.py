"""Stress and pressure that grow with depth: a heavy rock with fluid in its fractures is at rest and stays so."""

import numpy as np
import pytest

from fracflow.errors import InputError

from .conftest import JOINT, ROCK

HEAVY = (
    ROCK
    + JOINT
    + """
[geometry]
domain = [0, 0, 10, 8]
size = 1.5
size_at_fractures = 0.7
[[geometry.fracture]]
name = "steep"
points = [[3, 0], [6, 8]]
[[geometry.fracture]]
name = "flat"
points = [[1, 3], [8, 5]]
[initial_stress]
datum = 8
xx = -1e5
yy = -2e5
gradient = {xx = -15e3, yy = -24.525e3}
[body_force]
gravity = 9.81
[fluid]
viscosity = 1e-3
initial_pressure = 1e4
pressure_gradient = 9.81e3
datum = 8
[[support]]
on = "south"
[[load]]
on = ["east", "west", "north"]
traction = "initial-stress"
[[well]]
name = "out"
at = {fracture = "steep", end = "end"}
pressure = "initial"
[[probe]]
name = "deep"
at = {fracture = "steep", end = "start"}
[[stage]]
kind = "quasi-static"
time_step = 1
steps = 2
[[stage]]
kind = "dynamic"
time_step = 1e-3
steps = 5
"""
)


@pytest.mark.parametrize("given", ["model=default", "model=report", "initial.pressure=1e4"])
def test_lithostatic_and_hydrostatic_state_stays(run_scene, given):
    """rho g = 2500 * 9.81 = 24525 Pa/m balances the gradient of sigma_yy; nothing moves, nothing flows.

    A start at the same pressure at the datum is the same start: it has the gradient too.
    """
    found = run_scene(HEAVY, given)
    natural = 4e5 / 50e9  # largest stress over normal stiffness
    assert np.abs(found.fields["rock"]["displacement"]).max() <= 1e-9 * natural
    assert not found.events
    assert found.probe("deep", "pressure") == pytest.approx(1e4 + 9.81e3 * 8, rel=1e-12)
    drive = 1e4 * (1e-3) ** 3 / (12 * 1e-3 * 0.7)  # flow that p0 itself would drive through one element
    assert np.abs(found.fields["fractures"]["flow_rate"]).max() <= 1e-9 * drive
    stress = found.fields["rock"]["stress"].reshape(-1, 3, 3)
    assert stress[:, 1, 1].max() <= -2e5 and stress[:, 1, 1].min() >= -2e5 - 24.525e3 * 8


def test_shear_stress_that_grows_with_depth(run_scene):
    """sigma_xy = g (datum - y) pulls with -g along x: a body force g holds it, and tractions follow (2.14)."""
    slope = ["initial_stress.gradient.xy=2e3", "body_force.x=2e3"]
    loads = "stage=[{kind = 'steady', time_step = 1, steps = 1}]"
    found = run_scene(HEAVY, *slope, loads, "probe.deep.at={fracture = 'flat', end = 'start'}")
    assert np.abs(found.fields["rock"]["displacement"]).max() <= 1e-9 * 4e5 / 50e9
    stress, s = found.fields["rock"]["stress"].reshape(-1, 3, 3), np.array([7, 2]) / np.hypot(7, 2)
    assert 0.0 < stress[:, 0, 1].min() < 2e3 and 14e3 < stress[:, 0, 1].max() < 16e3
    depth, n = 8 - 3, np.array([-s[1], s[0]])
    sigma = np.array([[-1e5 - 15e3 * depth, 2e3 * depth], [2e3 * depth, -2e5 - 24.525e3 * depth]])
    assert found.probe("deep", "shear_traction")[-1] == pytest.approx(s @ sigma @ n, rel=1e-9)
    with pytest.raises(InputError, match="out of balance"):
        run_scene(HEAVY, slope[0], "body_force.x=-2e3", loads)


@pytest.mark.parametrize("given", ["normal_traction=-250e3", "shear_traction=1e3"])
def test_tractions_that_the_stress_does_not_imply_are_refused(run_scene, given):
    """A flat fracture at half the depth: f_n0 = -298100 + 49240 = -248860 Pa and no shear; other than that is named."""
    flat = ["geometry.fracture.flat.points=[[1, 4], [9, 4]]", "geometry.fracture.steep.points=[[5, 0], [5, 8]]"]
    right = ["fracture.flat={initial_normal_traction=-248860, initial_shear_traction=0}"]
    found = run_scene(HEAVY, *flat, *right)
    assert np.abs(found.fields["rock"]["displacement"]).max() <= 1e-9 * 4e5 / 50e9
    with pytest.raises(InputError, match=r"out of balance .* at .*flat"):
        run_scene(HEAVY, *flat, *right, f"fracture.flat.initial_{given}")


def test_weight_that_the_stress_does_not_carry_is_refused(run_scene):
    with pytest.raises(InputError, match="out of balance"):
        run_scene(HEAVY, "body_force.gravity=9")


def test_weight_of_the_fluid_sets_the_initial_tractions(run_scene):
    """(2.14): f_n0 = sigma_n + p0 at the depth of the section, n the normal of the trace."""
    found = run_scene(HEAVY)
    n = np.array([-8.0, 3.0]) / np.hypot(8, 3)
    sigma = np.diag([-1e5 - 15e3 * 8, -2e5 - 24.525e3 * 8])
    assert found.probe("deep", "normal_traction") == pytest.approx(n @ sigma @ n + 1e4 + 9.81e3 * 8, rel=1e-9)
