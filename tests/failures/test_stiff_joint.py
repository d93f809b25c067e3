"""F4e: k_n h/E = 100 at the critical step of the rock, h/c."""

from pathlib import Path

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.output import read_history
from fracflow.scene.scene import load
from fracflow.simulation.run import run

SCENE = Path(__file__).parents[2] / "meshes" / "failures" / "stiff_joint" / "scene.toml"
STORED = ("kinetic", "rock_strain", "joint_normal", "joint_shear")


def _ran(folder, *overrides):
    comm = MPI.COMM_WORLD
    run(load(SCENE, ["output.pictures=false", *overrides]), folder, comm)
    return comm.bcast(read_history(folder / "history.h5") if comm.rank == 0 else None)


@pytest.mark.parametrize("stiffness", [0.0, 100.0, 1e4])
def test_the_joint_does_not_limit_the_step(shared_tmp, stiffness):
    """Five crossings of both bars: the energy stays below that of the pulse, 2 x (1/4)^2 x 4, and nothing moves further."""
    joint = [f"fracture.joint.{key}_stiffness={max(stiffness, 1e-9)}" for key in ("normal", "shear")]
    history = _ran(shared_tmp / "run", "stage.0.end=200", *joint)
    assert "critical time step of the rock 1, whatever" in (shared_tmp / "run" / "log.txt").read_text()
    later = history["time"] > 8.0
    held = sum(history[f"energy/{name}"] for name in STORED)[later]
    assert 0.4 <= held.min() <= held.max() <= 0.5 + 1e-9
    assert held + history["energy/scheme"][later] == pytest.approx(history["energy/work_boundaries"][later], abs=1e-12)
    assert np.abs(history["energy/residual"]).max() <= 1e-12
    assert np.abs(history["probe/behind/displacement"]).max() <= 1.0 + 1e-9


def test_a_longer_step_is_taken_in_parts(shared_tmp):
    """Three parts of 5/6 at most: what is on record every 2.5 is what steps of 5/6 leave there."""
    coarse = _ran(shared_tmp / "coarse", "stage.0.time_step=2.5", "stage.0.end=50")
    fine = _ran(shared_tmp / "fine", f"stage.0.time_step={5 / 6}", "stage.0.end=50")
    log = (shared_tmp / "coarse" / "log.txt").read_text()
    assert "time_step 2.5 is taken in 3 parts of 0.833333; events are taken at the ends of parts" in log
    assert len(coarse["time"]) == 21
    assert coarse["probe/behind/velocity"] == pytest.approx(fine["probe/behind/velocity"][::3], abs=1e-10)
