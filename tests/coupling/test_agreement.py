"""All couplings reach the same solution of the same steps, where the fixed point converges at all."""

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.errors import SolveError
from fracflow.output import read_history
from fracflow.scene.scene import load
from fracflow.simulation.run import run
from fracflow.solve import COUPLINGS

WIDE = ["fracture.fault.aperture=0.2 ft", "stage.failure.steps=20"]  # the factor falls with the aperture cubed


def _history(coupling, folder, overrides):
    scene = load("meshes/report_5_3/scene.toml", [f"method.coupling={coupling}", "output.pictures=false", *overrides])
    run(scene, folder / coupling, MPI.COMM_WORLD)
    MPI.COMM_WORLD.barrier()
    return read_history(folder / coupling / "history.h5")


def test_couplings_agree(shared_tmp):
    histories = {name: _history(name, shared_tmp, WIDE) for name in COUPLINGS}
    reference = histories["monolithic"]
    assert reference["step/coupling"].max() == 1
    assert histories["fixed-point"]["step/coupling"].max() > 1
    for name, history in histories.items():
        for field, natural in {"pressure": 3e4, "opening": 1.7e-3, "slip": 1.7e-3, "normal_traction": 1.7e5}.items():
            entry = f"probe/node2/{field}"
            size = max(np.abs(reference[entry]).max(), natural)  # p0, f_n0/k_n0, f_n0
            assert np.abs(history[entry] - reference[entry]).max() <= 1e-8 * size, (name, field)


def test_fixed_point_is_predicted_to_diverge_and_does(shared_tmp):
    with pytest.raises(SolveError, match=r"diverges: .* multiplied by \d.* a cycle \(predicted; .*measured"):
        _history("fixed-point", shared_tmp, ["stage.failure.steps=5"])
