"""F3b: a free vibration over a graded film that only a coupling out of balance with itself can make grow."""

from pathlib import Path

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.output import read_history
from fracflow.scene.scene import load
from fracflow.simulation.run import run

pytestmark = pytest.mark.serial  # books on several ranks: physics/test_film_rules.py
SCENE = Path(__file__).parents[2] / "meshes" / "failures" / "graded_fracture" / "scene.toml"


@pytest.mark.parametrize("storage, steps", [("report", 800), ("consistent-lumped", 100), ("lumped", 300)])
def test_the_books_close_and_name_what_comes_from_nothing(shared_tmp, storage, steps):
    comm = MPI.COMM_WORLD
    options = [f"method.storage={storage}", f"stage.0.steps={steps}", "method.coupling=whole-lu"]
    run(load(SCENE, [*options, "output.pictures=false"]), shared_tmp / "run", comm)
    found = None
    if comm.rank == 0:
        found = read_history(shared_tmp / "run" / "history.h5"), (shared_tmp / "run" / "log.txt").read_text()
    history, log = comm.bcast(found)
    energy = {key[len("energy/") :]: values for key, values in history.items() if key.startswith("energy/")}
    held = sum(energy[name] for name in ("kinetic", "rock_strain", "joint_normal", "joint_shear"))
    largest = max(np.abs(values).max() for values in energy.values())
    # the initial energy: v^2/2 of a unit layer in which v falls from 1e-3 at the film to none at the top, masses lumped
    assert held[0] == pytest.approx(0.5 * 1e-6 * 6.86 / 2, rel=1e-9)
    assert np.abs(energy["residual"]).max() <= 1e-10 * largest
    assert np.all(np.diff(energy["viscous"]) >= -1e-15 * largest)
    assert np.abs(energy["scheme"]).max() <= 1e-12 * largest  # the trapezoidal rule has none
    if storage == "lumped":
        assert np.diff(held).max() <= 1e-13 * largest
        assert held[0] - held == pytest.approx(energy["viscous"], abs=1e-10 * largest)
        assert not energy["spurious"].any() and "spurious" not in log
        return
    assert held[0] - held == pytest.approx(energy["viscous"] + energy["spurious"], abs=1e-10 * largest)
    assert np.abs(energy["spurious"]).max() > 1e-3 * largest
    assert 'spurious work of method.storage = "' + storage + '" is' in log
    if storage == "report":
        assert held[-1] > 2 * held[0]
        assert -energy["spurious"][-1] > 3 * held[0]
