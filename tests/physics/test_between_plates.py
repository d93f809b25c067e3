"""Between rigid plates that move: a film of fluid that is squeezed out, and a strip with a fault that is sheared to and fro."""

import math

import pytest
from scipy.optimize import brentq

pytestmark = pytest.mark.serial

FILM = """
output.pictures = false
rock.rock = {youngs_modulus = 3e12, poissons_ratio = 0.2, density = 2500}
fluid.viscosity = 1e-2
fracture.film = {law = "linear", normal_stiffness = 1e3, shear_stiffness = 1e3, aperture = 1e-3}
geometry = {domain = [0, 0, 2, 2], size = 0.1, fracture = [{name = "film", points = [[0, 1], [2, 1]]}]}
well = [
  {name = "left", at = {fracture = "film", end = "start"}, pressure = 0},
  {name = "right", at = {fracture = "film", end = "end"}, pressure = 0},
]
probe = [{name = "off", at = [0.7, 1], on = "film"}]
support = [{on = "south"}, {on = "north", displacement = {x = 0, y = [[0, 0], [1, -5e-4]]}}]
stage = [{kind = "quasi-static", end = 1, time_step = 0.25}]
"""


def test_a_plate_that_sinks_to_half_the_aperture(run_scene):
    """(h^3 p'/12 mu)' = dh/dt = -V: p = 6 mu V x (L - x)/h^3; all the volume V t L leaves by the ends."""
    found = run_scene(FILM)
    gap = 1e-3 - 5e-4 * found.history["time"]
    exact = 6e-2 * 5e-4 * 0.7 * 1.3 / gap**3
    assert found.probe("off", "pressure")[1:] == pytest.approx(exact[1:], rel=1e-3)  # rock of 3 TPa gives way by 6e-4
    out = found.history["well/left/volume"] + found.history["well/right/volume"]
    assert out[-1] == pytest.approx(-1e-3, rel=1e-3) and found.closes()


STRIP = """
output.pictures = false
rock.rock = {youngs_modulus = "30 GPa", poissons_ratio = 0.25, density = 2600}
initial_stress = {xx = -8e6, yy = -1e7, xy = 1e6}
geometry = {domain = [0, 0, 7, 4], size = 2, fracture = [{name = "fault", points = [[0, 1.7], [7, 1.7]]}]}
tie = [{on = ["west", "east"]}]
support = [{on = "south"}, {on = "north", displacement = {x = [[0, 0], [1, 8e-3], [2, 0]], y = 0}}]
probe = [{name = "fault", at = [3.1, 1.7]}]
stage = [{kind = "quasi-static", end = 2, time_step = 0.25}]
[fracture.fault]
normal_stiffness = 2e10
shear_stiffness = 1e10
aperture = 1e-3
friction_coefficient = 0.5
cohesion = 2e5
dilation_angle_deg = 6
dilation_distance = 0.01
"""


class Strip:
    """The strip as springs in series: what its support was moved to and back, at one plastic slip and its path."""

    def __init__(self):
        shear = 30e9 / 2.5
        self.along, self.across = shear / 4, 3 * shear / 4  # c_p^2 = 3 c_s^2; over the height 4
        self.plastic = self.path = 0.0

    def opened(self, path):
        s = min(path, 0.01)
        return math.tan(math.radians(6)) * (s - s * s / 0.02)

    def normal(self, path):
        """Opening and normal traction; it is held in height, so that walls that ride up close by as much as rock gives."""

        def traction(closure):
            return -1e7 + 2e10 * closure / (1 + min(closure, 0.0) / 1e-3)

        rise = self.opened(path)
        opening = brentq(lambda e: -1e7 - self.across * e - traction(e - rise), rise - 9e-4, rise + 4e-4, xtol=1e-18)
        return opening, traction(opening - rise)

    def sheared(self, moved, plastic):
        """Slip and shear traction."""
        slip = (self.along * moved + 1e10 * plastic) / (self.along + 1e10)
        return slip, 1e6 + self.along * (moved - slip)

    def move(self, moved):
        """Slip, opening, shear and normal traction."""

        def excess(more):
            here = self.sheared(moved, self.plastic + way * more)[1]
            return way * here - (2e5 - 0.5 * self.normal(self.path + more)[1])

        way = math.copysign(1.0, self.sheared(moved, self.plastic)[1])
        if excess(0.0) > 0.0:
            more = brentq(excess, 0.0, 8e-3, xtol=1e-18)
            self.plastic, self.path = self.plastic + way * more, self.path + more
        slip, shear = self.sheared(moved, self.plastic)
        return slip, *self.normal(self.path)[:1], shear, self.normal(self.path)[1]


def test_a_periodic_strip_sheared_to_and_fro_between_rigid_plates(run_scene):
    """Friction with cohesion, dilation that closes the joint along its hyperbola, and slip that turns, in one scene."""
    found, springs = run_scene(STRIP), Strip()
    exact = [springs.move(8e-3 * min(step, 1000 - step) / 500) for step in range(1001)][::125]
    quantities = "slip", "opening", "shear_traction", "normal_traction"
    for name, values in zip(quantities, zip(*exact, strict=True), strict=True):
        got = found.probe("fault", name).reshape(-1)
        assert got == pytest.approx(values, rel=1e-9, abs=1e-9 * max(map(abs, values)))
    assert springs.path > abs(springs.plastic) > 0.0 and found.closes()
