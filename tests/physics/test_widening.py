"""A narrow fracture that widens by what flows through it: a long step may be at a solution far from the true one."""

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.output import read_history
from fracflow.run import run
from fracflow.scene import load

from .test_books import CRACK

NARROW = (
    CRACK.split('[[well]]\nname = "out"')[0].replace("pressure = 2e6", "pressure = [[0, 1e6], [1, 4e6], [9, 4e6]]")
    + """
[[probe]]
name = "middle"
at = [2, 1.5]
[[stage]]
kind = "quasi-static"
"""
)
SOFT = ["fracture.default.aperture='30 um'", "fracture.default.normal_stiffness='1 GPa/m'"]


def _ran(folder, name, step, count):
    comm, file = MPI.COMM_WORLD, folder / f"{name}.toml"
    if comm.rank == 0:
        file.write_text(NARROW + f"time_step = {step}\nsteps = {count}\n", encoding="utf-8")
    comm.barrier()
    run(load(file, [*SOFT, "fracture.default.shear_stiffness='1 GPa/m'"]), folder / name)
    found = None
    if comm.rank == 0:
        history = read_history(folder / name / "history.h5")
        last = history["probe/middle/aperture"][np.isclose(history["time"], 3.0)][-1]
        found = last, history["step/widening"].max(), (folder / name / "log.txt").read_text(encoding="utf-8")
    return comm.bcast(found)


def test_a_step_in_which_an_aperture_doubles_is_told(shared_tmp):
    """In steps of 1 s the middle opens by half; in steps of 0.1 s it stays, within a hundredth of steps of 0.02 s."""
    wide, grown, told = _ran(shared_tmp, "long", 1.0, 3)
    assert grown > 2.0 and told.count("times as wide in one step") == 1 and "crack at (0.666667, 1.16667)" in told
    right, grown, told = _ran(shared_tmp, "short", 0.1, 30)
    assert grown < 1.5 and "times as wide" not in told
    assert right == pytest.approx(3.0e-5, rel=0.01) and wide > 1.5 * right
