"""Starts away from equilibrium: bodies that move, strains let go, faults past their strength."""

import numpy as np
import pytest

from fracflow.errors import InputError

from .conftest import JOINT, ROCK
from .test_supports import PERIODIC, G

FREE = (
    ROCK
    + """
[geometry]
domain = [0, 0, 4, 1]
size = 0.5
[[probe]]
name = "corner"
at = [4, 1]
[[stage]]
kind = "dynamic"
time_step = 1e-4
steps = 10
"""
)


def test_free_body_keeps_its_velocity(run_scene):
    found = run_scene(FREE, "initial={velocity = [1, -2]}")
    time = found.history["time"]
    assert found.probe("corner", "displacement") == pytest.approx(np.outer(time, [1, -2]), rel=1e-9, abs=1e-15)
    assert found.history["energy/kinetic"] == pytest.approx(0.5 * 2500 * 4 * 5, rel=1e-12)
    assert found.history["energy/work_initial"] == pytest.approx(0.5 * 2500 * 4 * 5, rel=1e-12)
    assert found.closes()


def test_stretched_bar_let_go_keeps_its_energy(run_scene):
    """Strain energy of the start: nu = 0, E eps^2/2 a volume."""
    found = run_scene(FREE, "initial={displacement_gradient = [[1e-4, 0], [0, 0]]}", "rock.rock.poissons_ratio=0")
    start = 0.5 * 10e9 * 1e-8 * 4
    total = found.history["energy/kinetic"] + found.history["energy/rock_strain"]
    assert found.history["energy/work_initial"] == pytest.approx(start, rel=1e-12)
    assert total == pytest.approx(start, rel=1e-10)
    assert found.history["energy/kinetic"].max() > 0.01 * start


def test_rigid_body_starts_moving(run_scene):
    """A rigid rock in two halves; each has its own velocity at its centre, and turns with the skew part."""
    found = run_scene(
        FREE,
        "rock.rock={rigid = true, density = 2500}",
        "initial={velocity_gradient = [[0, -1], [1, 0]]}",
        "stage.0.steps=1",
    )
    assert found.probe("corner", "velocity")[0] == pytest.approx([-1, 4], rel=1e-9)


def test_fault_past_its_strength_slips_to_equilibrium(run_scene):
    """Row between fixed walls: the traction falls from tau_0 to the strength f, slip (tau_0 - f) h/G: springs in series."""
    scene = PERIODIC.replace("displacement = {x = 1e-4, y = 0}", "").replace("xx = -1e6", "xx = -1e6\nxy = 0.8e6")
    with pytest.raises(InputError, match="strength of joint"):
        run_scene(scene)
    found = run_scene(scene, 'stage=[{kind = "equilibrate"}, {kind = "steady", time_step = 1, steps = 1}]')
    strength = np.tan(np.radians(30)) * 1e6
    for probe in ("middle", "edge"):
        assert found.probe(probe, "shear_traction")[-1] == pytest.approx(strength, rel=1e-9)
        assert found.probe(probe, "slip")[1] == pytest.approx((0.8e6 - strength) * 4 / G, rel=1e-8)
        assert found.probe(probe, "slip")[-1] == pytest.approx(found.probe(probe, "slip")[1], rel=1e-9)
    assert found.closes()


COLUMN = """
Point(1) = {0, 0, 0}; Point(2) = {3, 0, 0}; Point(3) = {3, 4, 0}; Point(4) = {0, 4, 0};
Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {3, 4}; Line(4) = {4, 1};
Curve Loop(1) = {1, 2, 3, 4}; Plane Surface(1) = {1};
Transfinite Curve {1, 3} = 4; Transfinite Curve {2, 4} = 5; Transfinite Surface {1}; Recombine Surface {1};
Physical Surface("rock") = {1}; Physical Curve("south") = {1};
"""


def test_weight_without_initial_stress_settles(run_scene, shared_tmp, comm):
    """Column of height h on a rigid floor, nu = 0: the top sinks by rho g h^2 / (2 E), in one increment or in four."""
    if comm.rank == 0:
        (shared_tmp / "column.geo").write_text(COLUMN)
    scene = (
        ROCK
        + """
[mesh]
file = "column.geo"
[body_force]
gravity = 9.81
[[support]]
on = "south"
[[probe]]
name = "top"
at = [1, 4]
[[stage]]
kind = "equilibrate"
"""
    )
    with pytest.raises(InputError, match="out of balance"):
        run_scene(scene, "stage=[{kind = 'steady', time_step = 1, steps = 1}]")
    for steps in (1, 4):
        found = run_scene(scene, f"stage.0.steps={steps}", "rock.rock.poissons_ratio=0")
        sunk = found.probe("top", "displacement")[:, 1]
        whole = -2500 * 9.81 * 4**2 / (2 * 10e9)
        assert sunk == pytest.approx(whole * np.arange(steps + 1) / steps, rel=1e-9)
        assert found.closes()


def test_initial_pressure_drains_to_the_kept_one(run_scene):
    """[initial] pressure starts away from p0; the well draws it down to p0."""
    scene = (
        ROCK
        + JOINT
        + """
[geometry]
domain = [0, 0, 4, 4]
size = 0.8
[[geometry.fracture]]
name = "crack"
points = [[1, 2], [3, 2]]
[initial_stress]
xx = -5e6
yy = -5e6
[initial]
pressure = 2e6
[fluid]
viscosity = 1e-3
initial_pressure = 1e6
[[support]]
on = ["south", "north", "east", "west"]
[[well]]
name = "out"
at = {fracture = "crack", end = "end"}
pressure = "initial"
[[probe]]
name = "far"
at = {fracture = "crack", end = "start"}
[[stage]]
kind = "quasi-static"
time_step = 1e-3
steps = 30
"""
    )
    pressure = run_scene(scene).probe("far", "pressure")
    assert pressure[0] == 2e6 and np.all(np.diff(pressure) <= 1e-6)
    assert pressure[1:] == pytest.approx(1e6, rel=1e-3)  # in the first step: walls that have not moved store nothing


def test_events_are_of_the_fracture_that_slips(run_scene):
    """Of two crossing fractures one is past its strength: no event names the other, a tip, or a probe of the other."""
    scene = (
        ROCK
        + JOINT
        + """
[geometry]
domain = [0, 0, 8, 8]
size = 1
fracture = [{name = "weak", points = [[2, 4], [6, 4]]}, {name = "strong", points = [[4, 2], [4, 6]]}]
[fracture.strong]
cohesion = "1 GPa"
[initial_stress]
xx = -5e6
yy = -5e6
xy = 4e6
[[support]]
on = ["west", "east", "south", "north"]
[[probe]]
name = "crossing"
at = [4, 4]
on = "strong"
[[stage]]
kind = "equilibrate"
[[stage]]
kind = "quasi-static"
time_step = 1
steps = 1
"""
    )
    found = run_scene(scene)
    assert len(found.events) >= 3
    assert {event["fracture"] for event in found.events} == {"weak"}
    assert {event["probe"] for event in found.events} == {""}
    assert all(2 < event["x"] < 6 for event in found.events)
