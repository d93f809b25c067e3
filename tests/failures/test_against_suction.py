"""Walls that part suck fluid through a slot that is all but shut: backward Euler has a root wherever it is, and it is found.

A rigid block of length L over a slot of n elements, drained at both ends (Stefan): with lumped storage the pressures at the
nodes are those of a parabola, and d' = d^3 (F - k L (d - d_0)) / (mu L^3 (1 - 1/n^2)).
"""

import numpy as np
import pytest

from failures.test_pinched_fracture import TWO_BLOCKS
from fracflow._petsc import MPI
from fracflow.output import read_history
from fracflow.scene.scene import load
from fracflow.simulation.run import run

LENGTH, PIECES, START = 3.0, 6, 0.1
STEPS = ((1e-3, 20.0), (0.1, 120.0), (1.0, 120.0), (0.1, 200.0), (1.0, 400.0), (1.0, 1600.0), (10.0, 1e4))
SCENE = """
units = "none"
mesh.file = "two.geo"
output.pictures = false
accuracy.max_halvings = 0
rock = {lower.rigid = true, upper.rigid = true}
fluid.viscosity = 1
fracture.slot = {law = "linear", shear_stiffness = 1, aperture = 0.1, initial_normal_traction = 0, normal_stiffness = 1}
support = [{on = "lower", components = ["x", "y", "rotation"]}, {on = "upper", components = ["x", "rotation"]}]
load = [{on = "upper", force = [0, 3]}]
probe = [{name = "middle", at = {fracture = "slot", end = "start"}, quantities = ["aperture"]}]
[[well]]
name = "left"
at = {fracture = "slot", end = "start"}
pressure = 0
[[well]]
name = "right"
at = {fracture = "slot", end = "end"}
pressure = 0
"""


@pytest.mark.parametrize("coupling", ["auto", "monolithic"])
@pytest.mark.parametrize("stiffness, step", STEPS)
def test_a_root_is_found_wherever_it_is(shared_tmp, stiffness, step, coupling):
    comm = MPI.COMM_WORLD
    if comm.rank == 0:
        (shared_tmp / "two.geo").write_text(TWO_BLOCKS)
        stage = f'stage = [{{kind = "quasi-static", time_step = {step}, steps = 3}}]\n'
        (shared_tmp / "scene.toml").write_text(stage + SCENE)
    comm.barrier()
    given = [f"fracture.slot.normal_stiffness={stiffness}", f"method.coupling={coupling}"]
    run(load(shared_tmp / "scene.toml", given), shared_tmp / "run")
    comm.barrier()
    d = read_history(shared_tmp / "run" / "history.h5")["probe/middle/aperture"]
    rate = d**3 * (3.0 - stiffness * LENGTH * (d - START)) / (LENGTH**3 * (1.0 - PIECES**-2))
    assert np.diff(d) == pytest.approx(step * rate[1:], rel=1e-7, abs=1e-9 * d[-1])
    assert np.all(np.diff(d) >= 0.0) and d[-1] > 1.01 * START
