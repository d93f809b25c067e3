"""F6a: one joint closed hard, P = -5 |f_n0| from e_0 = 0.999 of the open side, d_0 = 0.1; and steps taken in halves.

e / (1 + e / d_0) + k_r e = P with k_n0 = |f_n0| = 1, k_r = d_0 = 0.1: e^2 + (1.1 - 10 P) e - P = 0 while closed.
"""

from pathlib import Path

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.errors import SolveError
from fracflow.output import read_history
from fracflow.scene.scene import load
from fracflow.simulation.run import run

SCENE = Path(__file__).parents[2] / "meshes" / "failures" / "closing_joint" / "scene.toml"
AT_ONCE = ["load.1.force=[0, -5]", "stage.0.end=1"]


def opening(force):
    """The root above -d_0 for P < 0."""
    b = 1.1 - 10.0 * np.asarray(force)
    return 2.0 * np.asarray(force) / (b + np.sqrt(b**2 + 4.0 * np.asarray(force)))


def _ran(folder, *overrides):
    comm = MPI.COMM_WORLD
    run(load(SCENE, ["output.pictures=false", *overrides]), folder, comm)
    return comm.bcast(read_history(folder / "history.h5") if comm.rank == 0 else None)


def test_the_barrier_ends_right_within_18_iterations(shared_tmp):
    history = _ran(shared_tmp / "run")
    found = history["probe/joint/opening"]
    assert found[1] == pytest.approx(0.999, abs=1e-12)
    assert found[2] == pytest.approx(opening(-5.0), abs=1e-10)
    assert found.min() > -0.1
    assert history["step/newton"][2] <= 18
    assert history["step/dt"].tolist() == [0.0, 1.0, 1.0]


@pytest.mark.parametrize("kind", ["steady", "quasi-static"])
@pytest.mark.parametrize("overrides", [[], AT_ONCE], ids=["ramp", "at once"])
def test_halves_end_where_the_whole_step_does(shared_tmp, overrides, kind):
    """Six iterations are too few for the whole step; a load that is there at once comes in parts too."""
    history = _ran(shared_tmp / "run", "accuracy.max_iterations=6", f"stage.0.kind={kind}", *overrides)
    end = 1.0 if overrides else 2.0
    time, dt = history["time"], history["step/dt"]
    parts = time > end - 1.0
    assert parts.sum() > 2
    assert np.all(np.log2(dt[parts]) == np.round(np.log2(dt[parts])))
    assert dt[parts].sum() == 1.0
    assert time[-1] == end
    force = -5.0 * time if overrides else 1.0989 - 6.0989 * (time - 1.0)
    closed = parts & (force < 0.0)
    assert history["probe/joint/opening"][closed] == pytest.approx(opening(force[closed]), abs=1e-9)
    assert np.abs(history["energy/residual"]).max() < 1e-10
    log = (shared_tmp / "run" / "log.txt").read_text()
    assert "step halved: time" in log


def test_halving_ends_and_the_reason_stays(shared_tmp):
    with pytest.raises(SolveError, match=r"did not converge in 1 iterations .*after 2 halvings of the step"):
        _ran(shared_tmp / "run", "accuracy.max_iterations=1", "accuracy.max_halvings=2")
