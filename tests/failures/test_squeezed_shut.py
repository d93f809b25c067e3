"""A fracture of a micrometre between walls that move by centimetres: its flow is known to few digits, which is no failure."""

import numpy as np

from fracflow._petsc import MPI
from fracflow.output import read_history
from fracflow.scene.scene import Scene
from fracflow.simulation.run import run

SCENE = {
    "rock": {"granite": {"youngs_modulus": "50 GPa", "poissons_ratio": 0.25, "density": 2700}},
    "initial_stress": {"xx": "-10 MPa", "yy": "-10 MPa", "zz": "-10 MPa"},
    "fluid": {"viscosity": 1e-3, "specific_weight": 9810, "initial_pressure": "5 MPa"},
    "geometry": {
        "domain": [0, 0, 40, 20],
        "size": 6,
        "size_at_fractures": 4,
        "fracture": [{"name": "Ada", "points": [[0, 10], [40, 10]]}],
    },
    "fracture": {
        "default": {
            "normal_stiffness": "50 GPa/m",
            "shear_stiffness": "20 GPa/m",
            "aperture": "1 um",
            "friction_coefficient": 0.6,
        }
    },
    "support": [
        {"on": "south"},
        {"on": ["west", "east"], "components": ["x"]},
        {"on": "north", "displacement": {"x": 0, "y": [[0, 0], [100, "-40 mm"]]}},
    ],
    "well": [
        {"name": "in", "at": {"fracture": "Ada", "end": "start"}, "flow_rate": "1e-6 L/s"},
        {"name": "out", "at": {"fracture": "Ada", "end": "end"}, "pressure": "initial"},
    ],
    "probe": [{"name": "middle", "at": [20, 10], "on": "Ada"}],
    "stage": [{"kind": "quasi-static", "time_step": 5, "steps": 20}],
    "output": {"pictures": False},
}


def test_squeezed_shut(shared_tmp):
    run(Scene.from_data(SCENE, shared_tmp / "scene.toml"), shared_tmp / "run", MPI.COMM_WORLD)
    MPI.COMM_WORLD.barrier()
    found = read_history(shared_tmp / "run" / "history.h5")
    aperture, pressure = found["probe/middle/aperture"], found["probe/middle/pressure"]
    assert len(aperture) == 21 and 0.99e-6 < aperture[-1] < 1e-6  # the fluid cannot leave, and takes the load
    assert (np.diff(pressure) > 0.0).all() and pressure[-1] > 1e8
    largest = max(np.abs(values).max() for name, values in found.items() if name.startswith("energy/"))
    assert np.abs(found["energy/residual"]).max() <= 1e-10 * largest
