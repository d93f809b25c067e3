"""The energy balance where a run changes its ways: pressure jumps, dropped motion, loads, damping steppers."""

import numpy as np
import pytest

from .conftest import JOINT, ROCK

CRACK = (
    ROCK
    + JOINT
    + """
[geometry]
domain = [0, 0, 4, 3]
size = 0.8
[[geometry.fracture]]
name = "crack"
points = [[0, 1], [4, 2]]
[initial_stress]
xx = -5e6
yy = -5e6
[fluid]
viscosity = 1e-3
initial_pressure = 1e6
[[support]]
on = ["south", "north", "east", "west"]
[[well]]
name = "in"
at = {fracture = "crack", end = "start"}
pressure = 2e6
[[well]]
name = "out"
at = {fracture = "crack", end = "end"}
pressure = "initial"
[[probe]]
name = "middle"
at = [2, 1.5]
"""
)
QUASI = """
[[stage]]
kind = "quasi-static"
time_step = 1e-4
steps = 5
"""
DYNAMIC = """
[[stage]]
kind = "dynamic"
time_step = 1e-4
steps = 5
"""
STEADY = """
[[stage]]
kind = "steady"
time_step = 1
steps = 2
"""


@pytest.mark.parametrize("stages", [QUASI, DYNAMIC, STEADY, STEADY + QUASI, QUASI + DYNAMIC + QUASI])
@pytest.mark.parametrize("storage", ["lumped", "report"])
def test_books_close_over_a_jump_of_pressure(run_scene, stages, storage):
    """A well held 1 MPa above the initial pressure from the first instant; what a switch drops is booked."""
    found = run_scene(CRACK + stages, f"method.storage={storage}")
    assert found.closes()
    assert found.probe("middle", "pressure")[-1] > 1e6 * (1 + 1e-6)
    kind, kinetic = found.history["step/kind"], found.history["energy/kinetic"]
    largest = max(np.abs(v).max() for k, v in found.history.items() if k.startswith("energy/"))
    assert np.all(np.abs(kinetic[kind != 2]) <= 1e-12 * largest)
    assert np.all(found.history["energy/viscous"][1:] > 0.0)


def test_motion_given_up_is_dropped(run_scene):
    """The kinetic energy of a bar goes to ``dropped`` when a stage without inertia begins; it ends at rest."""
    scene = (
        ROCK
        + """
[geometry]
domain = [0, 0, 4, 1]
size = 0.5
[initial]
velocity_gradient = [[3, 0], [0, 0]]
[[support]]
on = "west"
[[probe]]
name = "end"
at = [4, 1]
[[stage]]
kind = "dynamic"
time_step = 1e-4
steps = 3
[[stage]]
kind = "steady"
time_step = 1
steps = 1
"""
    )
    found = run_scene(scene)
    held = found.history["energy/kinetic"][3] + found.history["energy/rock_strain"][3]
    assert found.history["energy/kinetic"][0] == pytest.approx(0.5 * 2500 * 9 * 4**3 / 3, rel=0.05)
    assert found.history["energy/kinetic"][3] > 0.1 * held
    assert found.history["energy/dropped"][-1] == pytest.approx(held, rel=1e-9)
    assert found.history["energy/kinetic"][-1] == 0.0
    assert np.abs(found.probe("end", "displacement")[-1]).max() < 1e-12
    assert found.closes()


def test_pressure_on_a_side_pushes_inwards(run_scene):
    """Uniaxial strain with lateral stress free: nu = 0, u = -p h / E under a pressure p on the top."""
    found = run_scene(
        """
[output]
pictures = false
[rock.rock]
youngs_modulus = "10 GPa"
poissons_ratio = 0
[geometry]
domain = [0, 0, 2, 3]
size = 0.7
[[support]]
on = "south"
components = ["y"]
[[support]]
on = "west"
components = ["x"]
[[load]]
on = "north"
pressure = 2e6
[[probe]]
name = "top"
at = [2, 3]
[[stage]]
kind = "steady"
time_step = 1
steps = 1
"""
    )
    assert found.probe("top", "displacement")[-1] == pytest.approx([0, -2e6 * 3 / 10e9], rel=1e-9, abs=1e-15)
    assert found.closes()


def test_minimum_hydraulic_aperture_conducts_but_stores_nothing(run_scene):
    """A slot of 0.1 mm between rigid walls that conducts as if it were 0.2 mm: q = w^3 dp / (12 mu L)."""
    from .test_along_fractures import ENDS, RIGID

    narrow = ("fracture.slot.aperture=1e-4", "fracture.slot.minimum_hydraulic_aperture=2e-4")
    found = run_scene(RIGID + ENDS, *narrow)
    q = (2e-4) ** 3 * 1e4 / (12 * 1e-3 * 3)
    assert found.probe("quarter", "flow_rate")[-1] == pytest.approx(q, rel=1e-9)
    assert found.probe("quarter", "aperture")[-1] == pytest.approx(1e-4, rel=1e-12)


def test_newmark_with_gamma_above_a_half_damps(run_scene):
    """The scheme takes energy out of a bar let go, and the books say how much."""
    from .test_start import FREE

    found = run_scene(
        FREE,
        "initial={displacement_gradient = [[1e-4, 0], [0, 0]]}",
        "method={newmark_gamma = 0.7, newmark_beta = 0.36}",
        "stage.0.steps=30",
    )
    total = found.history["energy/kinetic"] + found.history["energy/rock_strain"]
    assert found.history["energy/scheme"][-1] > 0.05 * total[0]
    assert total[0] - total[-1] == pytest.approx(found.history["energy/scheme"][-1], rel=1e-9)
    assert found.closes()


@pytest.mark.parametrize("coupling", ["whole-lu", "condensed"])
def test_books_close_where_little_runs_beside_what_full_pressure_would_drive(run_scene, coupling):
    """A wide fracture, filled and then at rest: what each long step leaves of the flow works by the whole pressure.

    Full pressure would drive some 0.5 m^2/s; 1e-11 of that, which passed for balanced, opened the books by 1e-6 of their
    largest entry.
    """
    pressure = "well.in.pressure=[[0, 1e6], [0.4, 5.5e6], [100, 5.5e6]]"
    fills = "\n[[stage]]\nkind = 'quasi-static'\ntime_step = 0.1\nsteps = 4\n"
    rests = "\n[[stage]]\nkind = 'quasi-static'\ntime_step = 1\nsteps = 16\n"
    text = CRACK.split('[[well]]\nname = "out"')[0] + fills + rests
    assert run_scene(text, f"method.coupling={coupling}", pressure).closes(3e-11)
