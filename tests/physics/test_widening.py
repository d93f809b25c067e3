"""A narrow fracture that widens by what flows through it: a long step may be at a solution far from the true one."""

from dataclasses import replace

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.advance.explicit import of_substeps
from fracflow.advance.initial_state import equilibrium_state, refuse_imbalance
from fracflow.advance.step import Step
from fracflow.model.state import StepReport
from fracflow.output import read_history
from fracflow.reduction.decision import ReductionInput
from fracflow.reduction.prepare import prepare
from fracflow.scene.scene import load
from fracflow.simulation.recorder import Recorder
from fracflow.simulation.run import run

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


def _ran(folder, name, step, count, scene=NARROW):
    comm, file = MPI.COMM_WORLD, folder / f"{name}.toml"
    if comm.rank == 0:
        file.write_text(scene + f"time_step = {step}\nsteps = {count}\n", encoding="utf-8")
    comm.barrier()
    run(load(file, [*SOFT, "fracture.default.shear_stiffness='1 GPa/m'"]), folder / name)
    found = None
    if comm.rank == 0:
        history = read_history(folder / name / "history.h5")
        last = history["probe/middle/aperture"][np.isclose(history["time"], step * count)][-1]
        found = last, history["step/widening"].max(), (folder / name / "log.txt").read_text(encoding="utf-8")
    return comm.bcast(found)


def test_a_step_in_which_an_aperture_doubles_is_told(shared_tmp):
    """In steps of 1 s the middle opens by half; in steps of 0.1 s it stays, within a hundredth of steps of 0.02 s."""
    wide, grown, told = _ran(shared_tmp, "long", 1.0, 3)
    assert grown > 2.0 and told.count("times as wide in one step") == 1 and "crack at (0.666667, 1.16667)" in told
    right, grown, told = _ran(shared_tmp, "short", 0.1, 30)
    assert grown < 1.5 and "times as wide" not in told
    assert right == pytest.approx(3.0e-5, rel=0.01) and wide > 1.5 * right


def test_a_prescribed_pressure_that_lifts_its_place_open_is_not_told(shared_tmp):
    """It gives the aperture there at once, in steps of any length; the joints beside it have not widened yet."""
    jump = NARROW.replace("[1, 4e6]", "[1e-4, 4e6]").replace('{fracture = "crack", end = "start"}', "[2, 1.5]")
    wide, grown, told = _ran(shared_tmp, "jump", 1e-3, 3, jump)
    assert wide > 2.0 * 3e-5 and grown > 2.0 and "times as wide" not in told


def test_a_step_is_told_once_it_is_on_record(shared_tmp):
    """Not where it was tried and thrown away; and a run that is resumed knows what it told."""
    comm, file = MPI.COMM_WORLD, shared_tmp / "scene.toml"
    if comm.rank == 0:
        file.write_text(NARROW + "time_step = 1\nsteps = 3\n", encoding="utf-8")
    comm.barrier()
    model = prepare(load(file), comm)
    refuse_imbalance(model)
    step = Step(equilibrium_state(model), 0, 1.0, StepReport(widening=5.0, widest="crack at (1, 1)"), {"fresh": 1.0})
    recorder = Recorder(model, ReductionInput(model.scene), shared_tmp / "run", comm)
    for grown in (1.0, 5.0, 6.0, 11.0):
        recorder.record(replace(step, report=replace(step.report, widening=grown)))
    assert recorder.totals.widening == 11.0
    recorder.close()
    if comm.rank == 0:
        told = (shared_tmp / "run" / "log.txt").read_text(encoding="utf-8")
        assert told.count("times as wide in one step") == 2 and "an aperture of crack at (1, 1) grew 5 times" in told


def test_equal_parts_of_a_step_keep_the_most():
    total = of_substeps([StepReport(newton=2, widening=each, widest=f"part {each}") for each in (1.1, 3.0, 1.2)])
    assert (total.widening, total.widest, total.newton) == (3.0, "part 3.0", 6)
