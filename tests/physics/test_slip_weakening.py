"""Slip weakening in the program: a layer sheared over a joint, two springs in series with a strength that falls with slip."""

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.errors import InputError, SolveError
from fracflow.reduction.prepare import prepare
from fracflow.scene.scene import load

K_S, ROCK = 2e9, 5e9 / 2.0  # of the joint; of the rock, G over its height [Pa/m]
K = 1.0 / (1.0 / K_S + 1.0 / ROCK)
D_C, F_N, COHESION = 2e-3, 1e6, 5e4
PEAK, LOW = COHESION + 0.7 * F_N, COHESION + 0.2 * F_N
FALL = (PEAK - LOW) / D_C
LAYER = """
[output]
pictures = false
[geometry]
domain = [0, 0, 2, 2]
size = 0.5
cells = "quads"
fracture = [{name = "seam", points = [[0, 1], [2, 1]]}]
[rock.rock]
youngs_modulus = "10 GPa"
poissons_ratio = 0
density = 2700
[initial_stress]
yy = "-1 MPa"
[fracture.seam]
law = "slip-weakening"
normal_stiffness = "20 GPa/m"
shear_stiffness = "2 GPa/m"
aperture = "1 mm"
friction_coefficient = 0.7
dynamic_friction_coefficient = 0.2
slip_weakening_distance = "2 mm"
cohesion = "50 kPa"
[[support]]
on = "south"
[[support]]
on = "north"
displacement = {x = [[0, 0], [1, 4e-3], [1.5, 3.8e-3]], y = 0}
[[tie]]
on = ["west", "east"]
[[probe]]
name = "middle"
at = [1, 1]
on = "seam"
[[stage]]
kind = "quasi-static"
time_step = 0.05
end = 1.5
"""


def traction_of(pull):
    plastic = np.clip((K * pull - PEAK) / (K - FALL), 0.0, None)
    return np.where(K * pull <= PEAK, K * pull, np.where(plastic < D_C, PEAK - FALL * plastic, LOW))


def test_springs_in_series_follow_the_falling_strength(run_scene):
    """There through the weakening and past it, and elastically back; the books close and hold the closed-form work."""
    ran = run_scene(LAYER)
    there = ran.history["time"] <= 1.0 + 1e-9
    pull = 4e-3 * ran.history["time"][there]
    expected = traction_of(pull)
    assert (expected < PEAK).any() and expected[-1] == LOW  # all of it is met
    assert ran.probe("middle", "shear_traction")[there] == pytest.approx(expected, rel=1e-9, abs=1e-3)
    plastic = pull - expected / K
    assert ran.probe("middle", "plastic_slip")[there] == pytest.approx(plastic, rel=1e-9, abs=1e-12)
    work = np.sum(0.5 * (expected[1:] + expected[:-1]) * np.diff(plastic))
    assert ran.history["energy/friction"][there][-1] == pytest.approx(2.0 * work, rel=1e-9)
    assert ran.closes()
    assert ran.probe("middle", "shear_traction")[-1] == pytest.approx(LOW - K * 0.2e-3, rel=1e-9)


def test_the_distance_changes_along_the_trace(shared_tmp):
    file = shared_tmp / "scene.toml"
    if MPI.COMM_WORLD.rank == 0:
        file.write_text(LAYER, encoding="utf-8")
    MPI.COMM_WORLD.barrier()
    table = "{along = [0, 2], value = ['2 mm', '4 mm']}"
    ops = prepare(load(file, [f"fracture.seam.slip_weakening_distance={table}"]), MPI.COMM_WORLD).operators
    along = ops.blocks.joints.along.ravel()  # sections of the nodal rule are the ends of joints
    (group,) = ops.joints.laws
    assert group.law.slip_weakening_distance == pytest.approx(2e-3 + 1e-3 * along[group.sections])


OF = "fracture.seam"
BARE = "normal_stiffness = 1, shear_stiffness = 1, aperture = 1, friction_angle_deg = 30, dynamic_friction_coefficient = 0.1"
REFUSED = {
    f"{OF}.slip_weakening_distance=0.2 mm": r"seam: .* 1\.25 times as fast as its shear_stiffness .* 1\.25 times",
    f"{OF}.dynamic_friction_coefficient=0.8": r"coefficient = 0\.8: must not exceed friction_coefficient",
    f"{OF}.stick_slip_ratio=0.9": r'ratio = 0\.9: is no key of law = "slip-weakening", but of hyperbolic-coulomb',
    f"{OF}.law=hyperbolic-coulomb": r'dynamic_friction_coefficient = 0\.2: is no key of law = "hyperbolic-coulomb"',
    f"{OF}={{law = 'slip-weakening', {BARE}}}": r"slip_weakening_distance: missing; the law slip-weakening needs it",
}


@pytest.mark.parametrize(("setting", "said"), REFUSED.items())
def test_what_is_refused(run_scene, setting, said):
    with pytest.raises(InputError, match=said):
        run_scene(LAYER, setting)


def test_springs_take_a_scene_that_keeps_its_friction(run_scene):
    ran = run_scene(LAYER, "fracture.seam.law=linear", "stage.0.end=0.5")
    assert ran.probe("middle", "shear_traction")[-1] == pytest.approx(K * 2e-3, rel=1e-9)


def test_a_joint_that_gets_too_steep_in_a_run_is_named(run_scene):
    """Pressed ten times as hard, k_s D_c = 4 MPa is less than the drop of 5 MPa."""
    with pytest.raises(SolveError, match=r"fracture seam: .* 1\.2\d* times as fast as its shear_stiffness"):
        run_scene(
            LAYER,
            "support=[{on = 'south'}, {on = 'north', components = ['x'], displacement = {x = [[0, 0], [1, 0], [2, 20e-3]]}}]",
            'load=[{on = "north", traction = "initial-stress"}, {on = "north", traction = [0, [[0, 0], [1, -9e6]]]}]',
            "stage.0.end=2",
        )
