"""The time that laws are told: a clock in the history of every section, in every kind of step."""

from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.laws import JOINT_LAWS, HistoryVariable
from fracflow.laws.base import INSTANT
from fracflow.output import read_history
from fracflow.output.checkpoint import read_arrays
from fracflow.scene.scene import load
from fracflow.simulation.run import run
from physics.test_books import CRACK, DYNAMIC, QUASI
from physics.test_supports import PERIODIC

MESHES = Path(__file__).parents[2] / "meshes"
SLIPPING = PERIODIC.replace("xx = -1e6", "xx = -1e6\nxy = 0.8e6").split("[[stage]]")[0]
SLIDE = """
[[stage]]
kind = "equilibrate"
steps = 2
[[stage]]
kind = "dynamic"
time_step = 1e-5
steps = 4
"""
TIED = ["support.1={on = 'north', displacement_gradient = [[0, 0], [0, 0]]}"]
STRAIGHT = ["well.in.pressure=[[0, 2e6], [2.7e-4, 2e6], [2.7e-4, 3e6]]"]
# scene, overrides, what must have happened for the case to say anything
CASES = {
    "halved": ("failures/closing_joint", ["accuracy.max_iterations=6"], "step/rejected"),
    "rejected by its error": (
        CRACK + QUASI + DYNAMIC,
        ["method.flow_integrator=bdf2", "accuracy.tolerance=0.05"],
        "step/rejected",
    ),
    "cut at a jump": (CRACK + QUASI + DYNAMIC, STRAIGHT, "step/dt"),
    "located events": (
        "report_5_2",
        ["stage.0.end=5", "method.events=located", "fracture.default.stick_slip_ratio=0.9"],
        "step/located",
    ),
    "search, drop and slip": ("report_5_3", ["stage.failure.steps=4"], "step/dt"),
    "equilibrate": (SLIPPING + SLIDE, TIED, "step/dt"),
    "condensed": (CRACK + DYNAMIC, ["method.coupling=condensed"], "step/dt"),
    "explicit in parts": (CRACK + DYNAMIC, ["method.stepper=explicit", "stage.0.time_step=6e-4"], "step/dt"),
    "fixed point": (CRACK + QUASI, ["method.coupling=fixed-point", "method.fixed_point=added-storage"], "step/dt"),
}


def with_clock(law):
    """The law with the time of each section in its history; ``late`` is how far a call's beginning was from it at most."""

    class Clocked(law):
        history: ClassVar = {**law.history, "clock": HistoryVariable("scalar", "time", "time since the start")}
        late: ClassVar = [0.0]
        steps: ClassVar = set()

        def _see(self, history, step):
            if len(history["clock"]) and step.time is not INSTANT.time:
                begun = np.abs(np.asarray(step.time) - step.dt - history["clock"])
                self.late[0] = max(self.late[0], float(begun.max()))
                self.steps.add((bool(step.inertia), bool(np.max(step.dt) > 0.0)))

        def evaluate(self, strain, history, step=INSTANT):
            self._see(history, step)
            response = law.evaluate(self, strain, history, step)
            response.history["clock"] = history["clock"] + step.dt
            return response

        def approach(self, strain, change, history, step=INSTANT):
            self._see(history, step)
            return law.approach(self, strain, change, history, step)

    return Clocked


@pytest.mark.parametrize("case", CASES)
def test_laws_are_told_the_time_since_their_history_was_accepted(shared_tmp, monkeypatch, case):
    scene, overrides, happened = CASES[case]
    path, comm = MESHES / scene / "scene.toml" if len(scene) < 99 else shared_tmp / "scene.toml", MPI.COMM_WORLD
    if comm.rank == 0 and path.parent == shared_tmp:
        path.write_text(scene, encoding="utf-8")
    comm.barrier()
    law = with_clock(JOINT_LAWS["hyperbolic-coulomb"])
    monkeypatch.setitem(JOINT_LAWS, "hyperbolic-coulomb", law)
    run(load(path, ["output.pictures=false", *overrides]), shared_tmp / "out", comm)
    late = comm.allreduce(law.late[0], op=MPI.MAX)
    steps = set().union(*comm.allgather(law.steps))
    if comm.rank:
        return
    history = read_history(shared_tmp / "out" / "history.h5")
    times, clocks = history["time"], read_arrays(shared_tmp / "out" / "checkpoint.h5")["past/0/clock"]
    near = 1e-12 * times[-1]
    assert times[-1] > 0.0 and np.any(history[happened] > 0)
    assert late <= near, "a call began at another time than that of the history it was given"
    assert np.allclose(clocks, times[-1], rtol=0.0, atol=near)
    inertia = history["step/kind"][1:] == 2
    assert {(bool(kind), True) for kind in inertia[history["step/dt"][1:] > 0.0]} <= steps
