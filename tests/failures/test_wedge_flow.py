"""F7: a wedge from 1 to 0.1 in one element: the exact mean is exact, (3.14f) conducts 15.28 times as much."""

from pathlib import Path

import pytest

from fracflow._petsc import MPI
from fracflow.output import read_history
from fracflow.scene.scene import load
from fracflow.simulation.run import run

SCENE = Path(__file__).parents[2] / "meshes" / "failures" / "wedge_flow" / "scene.toml"
EXACT = 1.0 / (12.0 * 4.0 / 0.9 * 0.5 * (1.0 / 0.1**2 - 1.0))  # dp / integral of 12 mu / d^3
REPORT = (1.1 * 1.01 / 4.0) / (2.0 * 0.01 / 1.1)


@pytest.mark.parametrize("mean, factor", [("exact", 1.0), ("report", REPORT)])
def test_flow_through_a_wedge(shared_tmp, mean, factor):
    run(load(SCENE, ["output.pictures=false", f"method.conductance={mean}"]), shared_tmp / "run")
    MPI.COMM_WORLD.barrier()
    found = read_history(shared_tmp / "run" / "history.h5")
    assert found["probe/in/flow_rate"][-1] == pytest.approx(EXACT * factor, rel=1e-12)
    assert pytest.approx(1428, abs=1) == (REPORT - 1.0) * 100.0
