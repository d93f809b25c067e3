"""Explicit steps of a fault in a corner: most ranks have no joint, and nothing that damps."""

from copy import deepcopy

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.output import read_history
from fracflow.scene.scene import Scene
from fracflow.simulation.run import run

SCENE = {
    "output": {"pictures": False},
    "rock": {"rock": {"youngs_modulus": 5e10, "poissons_ratio": 0.25, "density": 2700}},
    "initial_stress": {"xx": -22e6, "yy": -41e6, "zz": -30e6},
    "fluid": {"viscosity": 1e-3, "initial_pressure": 0.0},
    "absorbing": [{"on": ["west", "east", "south", "north"]}],
    "method": {"stepper": "explicit", "fault_damping": 0.3},
    "geometry": {
        "domain": [0, 0, 2000, 2000], "size": 100, "size_at_fractures": 25,
        "fracture": [{"name": "fault", "points": [[150, 150], [250, 250]]}],
    },
    "fracture": {
        "fault": {
            "law": "slip-weakening", "friction_coefficient": 0.32, "dynamic_friction_coefficient": 0.2,
            "slip_weakening_distance": 5e-3, "normal_stiffness": 20e9, "shear_stiffness": 20e9, "aperture": 1e-4,
            "pressure": [[0, 0], [0.005, 5e6]],
        }
    },
    "probe": [{"name": "fault", "at": [200, 200], "on": "fault"}],
    "stage": [{"kind": "dynamic", "time_step": 5e-4, "steps": 40}],
}  # fmt: skip
PATCH = [9.5e6, 9.5e6, 10.3e6, 10.3e6, 9.5e6, 9.5e6]  # strength is 10.1e6


@pytest.mark.parametrize("is_pressed", [True, False], ids=["pressed", "in a row"])
def test_ranks_without_joints_take_explicit_steps(shared_tmp, comm, is_pressed):
    """Under a pressure that changes, and without, where loops take steps in a row: then the fault slips from the start."""
    data = deepcopy(SCENE)
    if not is_pressed:
        del data["fracture"]["fault"]["pressure"], data["fluid"]
        data["initial_stress"]["unbalanced"] = "carried"
        data["fracture"]["fault"]["initial_shear_traction"] = {"along": [0, 40, 41, 100, 101, 142], "value": PATCH}
    scene = Scene.from_data(data, shared_tmp / "scene.toml")
    run(scene, shared_tmp / "all", comm)
    if comm.rank == 0:
        run(scene, shared_tmp / "alone", MPI.COMM_SELF)
        found, sought = (read_history(shared_tmp / name / "history.h5") for name in ("all", "alone"))
        slip = sought["probe/fault/slip"]
        assert np.abs(slip).max() > 1e-4
        assert np.abs(found["probe/fault/slip"] - slip).max() <= 1e-11 * np.abs(slip).max()
    comm.barrier()
