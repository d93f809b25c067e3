"""A network that closes in places and opens again: a solver that found its matrix singular goes on with the next one."""

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.output import read_history
from fracflow.scene.scene import load
from fracflow.simulation.run import run

SCENE = """
rock.rock = {youngs_modulus = "10 GPa", poissons_ratio = 0.25}
fluid = {viscosity = "1e-3 Pa s", flow_depth = "1 m"}
support = [{on = ["west", "east"], components = ["x"]}, {on = "south"}]
load = [{on = "north", traction = [0, [[0, 0], [4, "-6 MPa"], [8, 0], [12, "-5 MPa"], [16, 0]]]}]
well = [
  {name = "in", at = [6, 6.1], flow_rate = 0},
  {name = "b1", at = {fracture = "b", end = "start"}, flow_rate = "1e-9 m^3/s"},
  {name = "b2", at = {fracture = "b", end = "end"}, flow_rate = "-1e-9 m^3/s"},
  {name = "out", at = {fracture = "c", end = "end"}, pressure = 0},
]
probe = [{name = "place", at = [7.8, 6.145], on = "a", quantities = ["pressure", "aperture"]}]
stage = [{kind = "quasi-static", time_step = 1, steps = 16}]
output.pictures = false
[geometry]
domain = [0, 0, 12, 12]
size = 2
size_at_fractures = 0.4
fracture = [
  {name = "a", points = [[2, 6], [10, 6.2]]},
  {name = "b", points = [[4, 3], [4.3, 9]]},
  {name = "c", points = [[8, 3], [7.6, 9]]},
]
[fracture]
default = {law = "linear", normal_stiffness = "5 GPa/m", shear_stiffness = "2 GPa/m", aperture = "0.6 mm"}
b = {law = "linear", normal_stiffness = "5 GPa/m", shear_stiffness = "2 GPa/m", aperture = "2 mm"}
"""


def test_it_ends_alike_on_ranks(shared_tmp):
    """Fracture a closes beside c at 4 s, opens again at 6 s, and closes once more."""
    comm = MPI.COMM_WORLD
    if comm.rank == 0:
        (shared_tmp / "scene.toml").write_text(SCENE)
    comm.barrier()
    run(load(shared_tmp / "scene.toml"), shared_tmp / "run", comm)
    run(load(shared_tmp / "scene.toml"), shared_tmp / f"alone{comm.rank}", MPI.COMM_SELF)
    comm.barrier()
    found, right = (read_history(shared_tmp / name / "history.h5") for name in ("run", f"alone{comm.rank}"))
    widths = right["probe/place/aperture"]
    assert right["time"][-1] == pytest.approx(16.0) and widths[4] < 0.01 * widths[0] < 0.1 * widths[-1]
    for name in ("pressure", "aperture"):
        values = right[f"probe/place/{name}"]
        np.testing.assert_allclose(found[f"probe/place/{name}"], values, rtol=0, atol=1e-7 * np.abs(values).max())
