"""Steps with inertia begin from walls that go on as they move: fewer iterations, and the same results."""

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.advance import step
from fracflow.output import read_history
from fracflow.scene.scene import Scene
from fracflow.simulation.run import run
from fracflow.solve import accept

DATA = {
    "rock": {"rock": {"youngs_modulus": 10e9, "poissons_ratio": 0.25, "density": 2500}},
    "initial_stress": {"yy": -1e6},
    "geometry": {"domain": [0, 0, 10, 10], "size": 5, "fracture": [{"name": "joint", "points": [[0, 5], [10, 5]]}]},
    "fracture": {
        "default": {"normal_stiffness": 50e9, "shear_stiffness": 20e9, "aperture": 3e-4, "friction_angle_deg": 30}
    },
    "support": [{"on": ["south"]}],
    "load": [
        {"on": "north", "traction": "initial-stress"},
        {"on": "north", "traction": [{"time": [0, 0.02], "value": [0, 1e6]}, 0]},
    ],
    "probe": [{"name": "here", "at": [5, 5], "on": "joint"}],
    "stage": [{"kind": "dynamic", "time_step": 1e-3, "steps": 28}],
    "output": {"pictures": False},
}


@pytest.mark.serial
def test_walls_that_go_on_save_iterations(tmp_path, monkeypatch):
    """None is made where walls would come to the end of their closure, which the second run pretends."""
    made, whole = [], accept.first_guess

    def seen(*given):
        found = whole(*given)
        made[-1].append(found is not None)
        return found

    monkeypatch.setattr(step, "first_guess", seen)
    found = []
    for name, left in (("guessed", accept.LEFT), ("from rest", 1e-9)):
        monkeypatch.setattr(accept, "LEFT", left)
        made.append([])
        run(Scene.from_data(DATA, tmp_path / f"{name}.toml"), tmp_path / name, MPI.COMM_SELF)
        found.append(read_history(tmp_path / name / "history.h5"))
    guessed, sought = found
    assert all(made[0]) and sum(made[1]) <= 1  # the first one is from rest
    assert sought["step/slipping"].max() > 0
    for key in ("probe/here/slip", "probe/here/velocity"):
        np.testing.assert_allclose(guessed[key], sought[key], rtol=0.0, atol=1e-8 * np.abs(sought[key]).max())
    assert guessed["step/newton"].sum() < 0.9 * sought["step/newton"].sum()
