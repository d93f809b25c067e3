"""Loads that change and supports that move, where loops take explicit steps in a row; faults end on such sides."""

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.output import read_history
from fracflow.scene.scene import Scene
from fracflow.simulation.run import resume, run
from fracflow.solve.leapfrog import in_a_row, steps
from fracflow.solve.leapfrog.compiled import library

from .test_leapfrog import assert_alike

RAMP = {"time": [0, 0.041, 0.0823], "value": [0, 1e-6, -2e-6]}
LAW = {
    "law": "slip-weakening", "friction_coefficient": 0.27, "dynamic_friction_coefficient": 0.2,
    "slip_weakening_distance": 5e-3, "normal_stiffness": 200e9, "shear_stiffness": 200e9, "aperture": 1e-3,
}  # fmt: skip
SCENE = {
    "output": {"pictures": False},
    "rock": {"rock": {"youngs_modulus": 5e10, "poissons_ratio": 0.25, "density": 2700}},
    "initial_stress": {"xx": -41e6, "yy": -30e6, "zz": -30e6, "xy": 9e6, "unbalanced": "carried"},
    "geometry": {
        "domain": [0, 0, 1000, 1000], "size": 100, "size_at_fractures": 60,
        "fracture": [
            {"name": "fault", "points": [[480, 0], [520, 1000]]}, {"name": "branch", "points": [[300, 0], [700, 400]]},
        ],
    },
    "fracture": {"fault": LAW, "branch": LAW | {"friction_coefficient": 0.6}},
    "control": {"push": {"initial": 1.0}},
    "absorbing": [{"on": ["west"]}],
    "support": [
        {
            "on": "south", "displacement": {"x": [[0, 0], [0.05, 1e-3]]},
            "displacement_gradient": [[RAMP, 0], [[[0, 0], [0.05, 2e-6]], RAMP]],
        },
        {"on": "east", "components": ["y"]},
    ],
    "load": [
        {"on": ["north", "east"], "traction": "initial-stress"},
        {"on": ["north"], "traction": [{"time": [0, 0.0207, 0.06], "value": [0, 4e6, 5e5]}, 0]},
        {"on": ["north"], "pressure": {"time": [0, 0.0203], "value": [0, 1e6], "interpolation": "step"}},
        {"on": ["east"], "pressure": {"time": [0, 0.01, 0.05], "value": [0, 0, 4e6]}, "control": "push"},
    ],
    "method": {"stepper": "explicit", "fault_damping": 0.3},
    "probe": [
        {"name": "fault", "at": [500, 500], "on": "fault"}, {"name": "top", "at": [520, 1000], "on": "fault"},
        {"name": "rock", "at": [300, 900]},
    ],
    "stage": [
        {"kind": "dynamic", "time_step": 0.03, "end": 0.12, "control": "push", "increment_per_step": 0.5},
        {"kind": "dynamic", "time_step": 0.02, "end": 0.16},
    ],
}  # fmt: skip


def stop(step):
    if step.state.time > 0.05:
        raise KeyboardInterrupt


@pytest.mark.skipif(library() is None, reason="loops are not compiled here")
def test_loads_and_supports_in_a_row(shared_tmp, comm, taken, monkeypatch):
    """Each rank has loads or supports at ends of joints of another; tables are in pieces, and runs go on to the bit."""
    scene = Scene.from_data(SCENE, shared_tmp / "scene.toml")
    monkeypatch.setattr(in_a_row, "MOST_KEPT", 120)
    run(scene, shared_tmp / "rows", comm)
    left = [count - done for count, done in taken]  # but the one in which damping begins, with the first slip
    assert sum(left) == max(left) == 1 and all(done > 2 for _, done in taken)
    with pytest.raises(KeyboardInterrupt):
        run(Scene.from_data(SCENE | {"output": {"pictures": False, "checkpoint_every": 1}}, shared_tmp / "scene.toml"),
            shared_tmp / "parts", comm, progress=stop)  # fmt: skip
    resume(shared_tmp / "parts", comm)
    monkeypatch.setattr(steps, "steps_in_a_row", lambda *given: None)
    if comm.rank == 0:
        run(scene, shared_tmp / "single", MPI.COMM_SELF)
        assert_alike(shared_tmp / "single", shared_tmp / "rows", 1e-12)
        rows, parts = (read_history(shared_tmp / name / "history.h5") for name in ("rows", "parts"))
        for name, values in rows.items() if comm.size < 3 else ():  # forces of two others add up as they arrive
            assert np.array_equal(values, parts[name], equal_nan=True), name
        largest = max(np.abs(values).max() for name, values in rows.items() if name.startswith("energy/"))
        assert np.abs(rows["energy/residual"]).max() < 1e-10 * largest
        for name in ("kinetic", "radiated", "damping", "friction", "work_boundaries"):
            assert np.abs(rows[f"energy/{name}"]).max() > 1e-6 * largest, name  # all of them act
    comm.barrier()
