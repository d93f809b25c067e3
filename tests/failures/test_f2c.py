"""F2c: a slot pinches shut between well and outlet and opens again; what loses its outlet is named, and keeps its fluid."""

from pathlib import Path

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.errors import SolveError
from fracflow.output import read_history
from fracflow.run import run
from fracflow.scene import load

SCENE = Path(__file__).parents[2] / "meshes" / "failures" / "f2c_pinched" / "scene.toml"


def test_it_goes_on_and_says_so(shared_tmp):
    """Up and down the same way: closed, the left slot gives back what it took up, for its fluid is incompressible."""
    run(load(SCENE, ["output.pictures=false"]), shared_tmp / "run")
    MPI.COMM_WORLD.barrier()
    found = read_history(shared_tmp / "run" / "history.h5")
    middle, pressure = found["probe/middle/aperture"], found["probe/in/pressure"]
    assert np.flatnonzero(middle < 0.0).tolist() == [3, 4, 5]
    assert np.diff(middle)[2:4] == pytest.approx(np.diff(middle)[5:3:-1] * -1, rel=1e-9)
    assert pressure[6:8] == pytest.approx(pressure[2:0:-1], rel=1e-9)
    flow = found["probe/in/flow_rate"]
    assert flow[[1, 2, 6, 7, 8, 9]] == pytest.approx(1e-5, rel=1e-9)
    assert np.abs(flow[3:6]).max() < 1e-8 * 1e-5
    largest = max(np.abs(v).max() for k, v in found.items() if k.startswith("energy/"))
    assert np.abs(found["energy/residual"]).max() <= 1e-10 * largest
    log = (shared_tmp / "run" / "log.txt").read_text()
    assert "time 3: slot pinched shut; the network has 7 parts" in log
    assert "time 3: no pressure is prescribed in cut, slot (3 nodes around (0.5, 0))" in log
    assert "time 6: slot conducts again" in log


def test_pumping_on_is_named(shared_tmp):
    with pytest.raises(SolveError, match=r"time 3: flow rates of in add up to 1e-05 m\*\*3/s in cut, slot \(3 nodes"):
        run(load(SCENE, ["output.pictures=false", "well.in.flow_rate=1e-5"]), shared_tmp / "run")


def test_a_least_aperture_keeps_it_open_and_is_counted(shared_tmp):
    """Two elements of 0.5 m at 1e-5 m carry the whole flow at a drop of 12 mu L q/d^3 = 1.2e8 Pa."""
    least = "fracture.slot.minimum_hydraulic_aperture=1e-5"
    run(load(SCENE, ["output.pictures=false", least, "well.in.flow_rate=1e-12"]), shared_tmp / "run")
    MPI.COMM_WORLD.barrier()
    found = read_history(shared_tmp / "run" / "history.h5")
    count, flow = found["step/minimum_aperture"], found["step/minimum_aperture_flow"]
    assert count[[0, 1, 2, 8, 9]].tolist() == [0] * 5 and count[4] == 4
    assert flow[4] == pytest.approx(1e-12, rel=1e-6)
    assert found["probe/in/pressure"][4] == pytest.approx(12e-3 * 1.0 * 1e-12 / 1e-15, rel=1e-4)
    assert "conducted by minimum_hydraulic_aperture" in (shared_tmp / "run" / "log.txt").read_text()
