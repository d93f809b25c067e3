"""Slow loads need no inertia: what is left out is small, and comes back where it is not."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from fracflow._petsc import PETSc
from fracflow.advance.excitation import swing
from fracflow.errors import Interrupted
from fracflow.model.state import Motion
from fracflow.output import read_history
from fracflow.reduction import inertia
from fracflow.reduction.inertia import kink_response
from fracflow.scene.scene import load
from fracflow.scene.time_table import TimeTable
from fracflow.simulation.run import resume, run

BLOCK = """
[output]
pictures = false
checkpoint_every = 0
[geometry]
domain = [[0, 0], [10, 0], [10, 10], [0, 10]]
size = 5
[[geometry.fracture]]
name = "joint"
points = [[0, 5], [10, 5]]
[rock.rock]
youngs_modulus = "10 GPa"
poissons_ratio = 0.25
density = 2500
[initial_stress]
yy = "-2 MPa"
[fracture.default]
normal_stiffness = "50 GPa/m"
shear_stiffness = "20 GPa/m"
aperture = "1 mm"
friction_angle_deg = 30
[[support]]
on = ["south"]
[[load]]
on = "north"
traction = "initial-stress"
[[load]]
on = "north"
traction = [{time = [0, RAMP], value = [0, 2e5]}, 0]
[[probe]]
name = "top"
at = [5, 10]
quantities = ["displacement", "stress"]
[[stage]]
name = "push"
kind = "dynamic"
time_step = STEP
steps = COUNT
"""


class Done:
    """The history and the plan of a run, on every rank."""

    def __init__(self, folder, comm):
        found = None
        if comm.rank == 0:
            found = read_history(folder / "history.h5"), json.loads((folder / "plan.json").read_text())["decisions"]
            found = (*found, (folder / "log.txt").read_text())
        self.history, self.plan, self.log = comm.bcast(found)
        self.time, self.top = self.history["time"], self.history["probe/top/displacement"][:, 0]

    def decision(self, part):
        return next(each for each in self.plan if each["part"] == part)


@pytest.fixture
def block(shared_tmp, comm):
    """Function (ramp, step, count, model, progress) -> folder of a run, ended or not. Collective."""
    counter = [0]

    def once(ramp, step, count, model="default", progress=None, change=("", "")):
        counter[0] += 1
        file, folder = shared_tmp / f"block{counter[0]}.toml", shared_tmp / f"run{counter[0]}"
        if comm.rank == 0:
            text = BLOCK.replace("RAMP", str(ramp)).replace("STEP", str(step)).replace("COUNT", str(count))
            file.write_text(f'model = "{model}"\n{text.replace(*change)}')
        comm.barrier()
        try:
            run(load(file), folder, comm, progress)
        except Interrupted:
            assert progress is not None
        return folder

    return once


@pytest.mark.serial
def test_kick_of_ramps_pulses_and_waves():
    """T/(pi T_load) of a ramp with its ends; a pulse adds three kinks; a sine 4 omega over its range in each period."""
    period = 0.1
    assert kink_response(TimeTable.constant(3.0), 0.0, 9.0, period) == 0.0
    assert kink_response(TimeTable((0.0, 2.0), (0.0, -5.0)), 0.0, 9.0, period) == pytest.approx(period / (np.pi * 2.0))
    assert kink_response(TimeTable((1.0, 1.01, 1.02), (0.0, 1.0, 0.0)), 0.0, 9.0, period) == pytest.approx(
        200.0 * period / np.pi
    )
    times = np.linspace(0.0, 40.0, 4001)  # of period 10, from rest: 1 - cos
    wave = TimeTable(tuple(times), tuple(1.0 - np.cos(2.0 * np.pi * times / 10.0)))
    assert kink_response(wave, 0.0, 40.0, period) == pytest.approx(4 * 2.0 * period / 10.0, rel=0.05)


def test_slow_ramp_goes_without_inertia_within_the_tolerance(block, comm):
    reduced, full = (Done(block(1.6, 3e-3, 560, model), comm) for model in ("default", "full"))
    said = reduced.decision("inertia")
    assert said["left_out"] and said["value"] < said["limit"] == 1e-2 and not full.decision("inertia")["left_out"]
    assert 8 * len(reduced.time) < len(full.time)
    assert reduced.time[-1] == pytest.approx(full.time[-1], rel=1e-12)
    error = np.abs(np.interp(full.time, reduced.time, reduced.top) - full.top).max()
    assert 0.0 < error < 1e-2 * np.abs(full.top).max()


def test_fast_ramp_keeps_inertia(block, comm):
    assert not Done(block(0.1, 2e-3, 3), comm).decision("inertia")["left_out"]


@pytest.fixture
def blind(monkeypatch):
    """The criterion is told that any ramp were slow; the steps tell otherwise."""
    monkeypatch.setattr(inertia, "kink_response", lambda *_: 1e-3)


def stop_after(time):
    """Function for the steps of a run, which it stops after a time, of each try where it begins anew."""

    def stop(step):
        if step.state.time > time:
            raise Interrupted("enough")

    return stop


def same_as(done, full, ranks):
    """Every number of the histories: on one rank to the last bit, on more, where sums are in any order, to 1e-9 of its size."""
    assert done.history.keys() == full.history.keys()
    for key in full.history:
        if (key.startswith("step/") and ranks > 1) or key == "step/factorisations":
            continue
        size = np.nanmax(np.abs(full.history[key]), initial=0.0) if ranks > 1 else 0.0
        if key.startswith("energy/") and ranks > 1:
            size = max(np.abs(values).max() for name, values in full.history.items() if name.startswith("energy/"))
        np.testing.assert_allclose(done.history[key], full.history[key], rtol=0.0, atol=1e-9 * size, err_msg=key)


def test_violated_decision_is_undone_and_the_run_is_that_with_inertia(block, comm, blind):
    """A ramp of half a period: the first step swings. So after a resume."""
    given = (0.02, 5e-4, 640)  # of so many steps fewer without inertia would be worth it
    enough = stop_after(0.08)
    full = Done(block(*given, "full", progress=enough), comm)
    whole = Done(block(*given, progress=enough), comm)
    folder = block(*given, progress=stop_after(0.01), change=("every = 0", "every = 7"))
    comm.barrier()
    with pytest.raises(Interrupted):
        resume(folder, comm, enough)
    for done in (whole, Done(folder, comm)):
        said = done.decision("inertia")
        assert not said["left_out"] and said["undone"].startswith("time 0: a vibration of ")
        assert float(said["undone"].split()[5]) > 1e-2
        assert "inertia, 0 (push): undone at time 0" in done.log
        assert len(done.time) > 160
        same_as(done, full, comm.size)


def test_what_slips_is_run_with_inertia_from_the_start(block, comm):
    """The shear traction reaches the strength, 1.155 MPa, in a slow ramp."""
    slips, given, enough = ("[0, 2e5]", "[0, 4e6]"), (1.6, 3e-3, 540), stop_after(0.6)
    full, done = (Done(block(*given, model, progress=enough, change=slips), comm) for model in ("full", "default"))
    said = done.decision("inertia")
    assert "joints slip or open" in said["undone"] and 0.0 < float(said["undone"][5:].partition(":")[0]) < 0.6
    assert done.history["step/slipping"].max() > 0 and len(done.time) > 200
    same_as(done, full, comm.size)


def test_swing_is_that_of_a_spring_and_mass_over_what_is_to_come(comm):
    """Whose rate changes by 3 swings by 3 T/(2 pi), twice; 5 are behind it, and 4 times the rate, 2, are to come."""

    def state(displacement, velocity):
        made = [PETSc.Vec().createMPI((len(values), None), comm=comm) for values in (displacement, velocity)]
        for vector, values in zip(made, (displacement, velocity), strict=True):
            vector.setArray(values)
        return SimpleNamespace(motion=Motion(*made, made[0].duplicate()))

    old, new, still = state([0.0, 0.0], [1.0, -1.0]), state([3.0, -5.0], [1.5, 2.0]), state([0.0, 0.0], [0.0, 0.0])
    assert swing(old, new, np.pi, 4.0) == pytest.approx(3.0 / (5.0 + 2.0 * 4.0), rel=1e-15)
    assert swing(old, still, np.pi, 4.0) == 0.0
    for each in (old, new, still):
        each.motion.destroy()


@pytest.mark.serial
@pytest.mark.parametrize(
    ("change", "why"),
    [
        (("quantities =", "#"), "probe top measures acceleration"),
        (('traction = "initial-stress"', 'traction = [0, "-2 MPa"]\n[[absorbing]]\non = ["west"]'), "absorbing sides"),
        (("{time = [0, RAMP], value = [0, 2e5]}", "[[0, 0], [0.5, 0], [0.5, 1e5]]"), "jumps"),
    ],
    ids=["rates", "absorbing", "jump"],
)
def test_what_inertia_is_kept_for(tmp_path, change, why):
    text = BLOCK.replace(*change).replace("RAMP", "1.6").replace("STEP", "3e-3").replace("COUNT", "560")
    (tmp_path / "scene.toml").write_text(text)
    scene = load(tmp_path / "scene.toml")
    ((number, _, start, end),) = inertia.spans(scene)
    assert why in inertia.why_not(scene, number, start, end)


@pytest.mark.parametrize("model", ["full", "report"])
def test_full_and_report_leave_nothing_out(block, comm, model):
    found = Done(block(1.6, 3e-3, 1, model), comm)
    assert not found.decision("inertia")["left_out"]
    assert not found.decision("new factors in every iteration")["left_out"]
    assert not found.decision("rock, condensed to its joints")["left_out"]
