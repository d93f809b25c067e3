"""Slip that reverses within single steps: friction takes too little then, and the run says so."""

from types import SimpleNamespace

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.model.energy import work_missed

SCENE = """
[output]
pictures = false
[geometry]
domain = [-150, -100, 150, 100]
size = 40
size_at_fractures = 9.0909
fracture = [{name = "f", points = [[-50, 0], [50, 0]]}]
[rock.rock]
youngs_modulus = "40 GPa"
poissons_ratio = 0.25
density = 2700
[initial_stress]
xx = -30e6
yy = -30e6
xy = 17e6
unbalanced = "carried"
[fracture.f]
law = "slip-weakening"
normal_stiffness = 1e12
shear_stiffness = 1e12
aperture = 1e-3
friction_coefficient = 0.6
dynamic_friction_coefficient = 0.4
slip_weakening_distance = 1e-3
initial_shear_traction = 19e6
dilation_angle_deg = 5
dilation_distance = 1
[[absorbing]]
on = ["west", "east", "south", "north"]
[method]
stepper = "newmark"
events = "at-step-ends"
[[probe]]
name = "middle"
at = [0, 0]
on = "f"
[[stage]]
kind = "dynamic"
time_step = 2e-3
end = 0.08
"""


def at(shear, slip):
    """Sections under a shear traction, after a slip."""
    return SimpleNamespace(
        traction=np.stack([shear, np.full(len(shear), -1.0)], axis=1),
        inelastic=np.stack([slip, np.zeros(len(slip))], axis=1),
    )


@pytest.mark.serial
def test_work_missed_is_that_of_sections_whose_slip_turns():
    before = at(np.array([2.0, 2.0, -2.0, 0.0]), np.zeros(4))
    after = at(np.array([2.0, -2.0, -2.0, -2.0]), np.array([0.1, -0.1, -0.1, -0.1]))
    assert work_missed(np.array([1.0, 3.0, 5.0, 7.0]), before, after) == pytest.approx(3.0 * 0.5 * 2.0 * 0.1)


@pytest.mark.parametrize("rule", ["newmark", "generalised-alpha"])
def test_a_fault_whose_slip_turns_from_step_to_step_is_told(run_scene, shared_tmp, rule):
    """The rule without damping lets slip run on once the fault has come to rest, and says so; the one with it does neither."""
    damps = ["method.stepper=generalised-alpha", "method.rho_infinity=0.5"] if rule != "newmark" else []
    found = run_scene(SCENE, *damps)
    if MPI.COMM_WORLD.rank:
        return
    slip, rate = found.probe("middle", "slip"), found.probe("middle", "velocity")
    assert (np.abs(rate[-5:]).max() > 0.3) == (rule == "newmark"), (slip, rate)
    assert ("slip reverses within single steps" in (shared_tmp / "run1" / "log.txt").read_text()) == (rule == "newmark")
