"""Slip begins where Mohr's circle touches the strength: inclined fractures under a stress with shear, against closed forms."""

import math

import numpy as np
import pytest

from fracflow.errors import InputError, SolveError

pytestmark = pytest.mark.serial

XX, YY, XY, FRICTION, COHESION = -13e6, -22e6, 2.1e6, 0.55, 0.4e6
MORE = 1e6  # compression that the control adds


def scene(degrees):
    """A fracture through the middle of a square that is pressed along the axis which is nearer to it; no rock bulges."""
    along = np.array([math.cos(math.radians(degrees)), math.sin(math.radians(degrees))])
    reach = 2.0 * along / np.abs(along).max()
    ends = [[*(2.0 - reach)], [*(2.0 + reach)]]
    held, pushed, others = (
        ("west", "east", ["north", "south"]) if degrees > 45 else ("south", "north", ["east", "west"])
    )
    text = f"""
output.pictures = false
rock.rock = {{youngs_modulus = "40 GPa", poissons_ratio = 0, density = 2500}}
initial_stress = {{xx = {XX}, yy = {YY}, xy = {XY}}}
geometry = {{domain = [0, 0, 4, 4], size = 1, fracture = [{{name = "cut", points = {np.array(ends).tolist()}}}]}}
control.push = {{increment = 1.0}}
load = [{{on = {[pushed, *others]}, traction = "initial-stress"}}, {{on = "{pushed}", pressure = {MORE}, control = "push"}}]
support = [{{on = "{held}"}}]
stage = [{{kind = "steady", until = "incipient", control = "push", tolerance = 1e-9}}]
[fracture.cut]
normal_stiffness = "30 GPa/m"
shear_stiffness = "7 GPa/m"
aperture = "1 mm"
friction_coefficient = {FRICTION}
cohesion = {COHESION}
"""
    normal = np.array([-along[1], along[0]])
    axis = np.array([1.0, 0.0]) if degrees > 45 else np.array([0.0, 1.0])
    stress, more = np.array([[XX, XY], [XY, YY]]), -MORE * np.outer(axis, axis)
    return text, [(along @ part @ normal, normal @ part @ normal) for part in (stress, more)]


@pytest.mark.parametrize("degrees", [41.9, 59.1])
def test_the_load_at_failure_is_that_of_mohr_and_coulomb(run_scene, degrees):
    """|tau + c dtau| = C - (sigma + c dsigma) tan phi."""
    text, ((shear, normal), (more_shear, more_normal)) = scene(degrees)
    at = [
        (COHESION - FRICTION * normal - sign * shear) / (sign * more_shear + FRICTION * more_normal) for sign in (1, -1)
    ]
    found = run_scene(text).history["step/control/push"][-1]
    assert found == pytest.approx(min(each for each in at if each > 0), rel=1e-6)


def test_a_load_that_never_makes_it_slip_is_told(run_scene):
    """More compression brings |f_s|/f_sy to |dtau|/(-dsigma tan phi), below 1."""
    text, (_, (shear, normal)) = scene(3.7)
    limit = abs(shear) / (-normal * FRICTION)
    with pytest.raises(SolveError, match=r"rises no further: this control brings no fracture to its strength") as stop:
        run_scene(text)
    assert f"|f_s|/f_sy = {limit:.4f}"[:-1] in str(stop.value)


def test_a_load_in_numbers_is_no_part_of_the_initial_state(run_scene):
    text, _ = scene(41.9)
    with pytest.raises(InputError, match="in numbers comes on top of the initial state"):
        run_scene(text, 'load=[{on="north", traction=[2.1e6, -22e6], control="push"}]')
