"""A stage auto: slip at micrometres a second is no event, whatever strength pressure has left; a rupture is one."""

import re
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

from fracflow._petsc import MPI
from fracflow.advance.initial_state import equilibrium_state
from fracflow.advance.regime import transit
from fracflow.advance.slow_slip import RADIATED, slipped
from fracflow.advance.step import Stepping, stepper_of
from fracflow.cli.app import app
from fracflow.errors import Interrupted
from fracflow.output import read_events, read_history
from fracflow.reduction.prepare import prepare
from fracflow.scene.scene import load
from fracflow.simulation.observer import Observer
from fracflow.simulation.run import resume, run
from fracflow.solve.request import StepRequest

SCENE = """
title = "a fault that creeps past a crack that pressure opens"
output.pictures = false
rock.rock = {youngs_modulus = "10 GPa", poissons_ratio = 0.25, density = 2500}
initial_stress = {xx = "-2 MPa", yy = "-2 MPa", zz = "-2 MPa", xy = "1.15 MPa"}
fluid = {viscosity = "1e-3 Pa s", specific_weight = "9.81 kN/m^3", initial_pressure = 0, compressibility = "4.5e-10 1/Pa"}
support = [{on = "south"}, {on = "north", displacement = {x = [[0, 0], [500, "1 mm"]], y = 0}}]
load = [{on = ["west", "east"], traction = "initial-stress"}]
method = {stepper = "generalised-alpha", rho_infinity = 0.2, events = "at-step-ends"}
stage = [{name = "creep", kind = "auto", time_step = 200, end = 500}]
[geometry]
domain = [0, 0, 4, 4]
size = 0.8
fracture = [{name = "fault", points = [[0, 1.6], [4, 1.6]]}, {name = "crack", points = [[1, 2.8], [3, 2.8]]}]
[fracture.default]
law = "slip-weakening"
friction_coefficient = 0.6
dynamic_friction_coefficient = 0.5
slip_weakening_distance = "5 mm"
normal_stiffness = "50 GPa/m"
shear_stiffness = "20 GPa/m"
aperture = "1 mm"
[fracture.crack]
pressure = [[0, 0], [400, "2.2 MPa"]]
"""
RUPTURE = (
    "fracture.fault.slip_weakening_distance=0.1 mm",
    "stage.creep.end=37.05",
    "stage.creep.dynamic_time_step=0.5 ms",
)


@pytest.fixture
def scene(shared_tmp, comm):
    """The scene's file, on every rank."""
    file = shared_tmp / "scene.toml"
    if comm.rank == 0:
        file.write_text(SCENE)
    comm.barrier()
    return file


def test_creep_past_a_section_without_strength_takes_long_steps_and_no_event(scene, comm):
    """The far side moves at 2 um/s, and the fault at about that; pressure takes the crack's strength at 364 s."""
    folder = scene.parent / "out"
    run(load(scene), folder, comm)
    comm.barrier()
    history, rows = read_history(folder / "history.h5"), read_events(folder / "events.csv")
    assert set(history["step/kind"]) == {1} and len(history["time"]) < 20
    assert all(row["kind"] != "event" for row in rows)
    assert {row["fracture"] for row in rows if row["kind"] == "open"} == {"crack"}
    slid = max(row["slip"] for row in rows if row["fracture"] == "fault")
    assert 0.5e-3 < slid < 1e-3  # of the 1 mm; the rock and the sticking start hold the rest


def test_slip_radiates_by_what_moves_and_not_by_the_least_strength(scene, comm):
    """rho c_s v/2 of 2 um/s is 2e-6 of the strength, 1.2 MPa; of the crack's own strength, near nothing, it is any share."""
    model = prepare(load(scene), comm)
    stage = model.scene.stage[0]
    stepping, still = Stepping(model), stepper_of(model.scene, stage, "quasi-static")
    state, ends = equilibrium_state(model), (200.0, 350.0, 380.0, 400.0)
    for time in ends:
        new, _ = stepping.step(state, StepRequest(time, time - state.time, state.controls, stepping.model.loads), still)
        slip = slipped(model, state, new, time - state.time)
        least, before = new.sections.strength.min(), state
        state = new
        if time != ends[-1]:
            before.destroy()
    assert comm.allreduce(float(least), op=MPI.MIN) == 0.0
    assert 5e-7 < slip.radiated < 5e-6 and not slip.why_not()
    quick = slipped(model, before, state, 1e-4 * (state.time - before.time))  # the same slip in 2 ms
    assert quick.radiated == pytest.approx(1e4 * slip.radiated, rel=1e-9) and quick.radiated > RADIATED
    assert "radiates" in quick.why_not()
    for each in (before, state):
        each.destroy()
    stepping.destroy()


def test_a_rupture_is_an_event_and_its_trials_are_counted(scene, comm):
    """A fall of strength over 0.1 mm is steeper than the rock unloads, mu/H = 1 GPa/m: from 37.02 s there is no equilibrium."""
    folder, told = scene.parent / "out", []

    class Watch(Observer):
        def trial(self, time, length, why):
            told.append((time, length, why))

    totals = run(load(scene, RUPTURE), folder, comm, Watch())
    comm.barrier()
    history, log = read_history(folder / "history.h5"), (folder / "log.txt").read_text()
    events = [row for row in read_events(folder / "events.csv") if row["kind"] == "event"]
    assert [event["fracture"] for event in events] == ["fault"] and events[0]["start"] == pytest.approx(
        37.025, abs=2e-3
    )
    assert history["energy/kinetic"].max() > 10.0 and set(history["step/kind"]) == {1, 2}
    counts = totals.counts
    assert len(told) == counts["rejected"] == history["step/rejected"].sum() >= 12
    assert counts["wasted"] == history["step/wasted"].sum() > counts["rejected"]
    lengths = [length for _, length, _ in told]
    assert max(lengths) <= 200.0 and min(lengths) < 1e-3
    assert (
        f"besides {counts['rejected']} trials rejected, on which {counts['wasted']} Newton iterations were spent" in log
    )
    # one evaluation where an iteration begins, one after each: of rejected trials too
    assert totals.evaluations > counts["newton"] + counts["wasted"] and totals.factored > counts["factorisations"]
    assert f"work in all: {totals.evaluations} evaluations of the balances, {totals.factored} factorisations" in log
    (begins,) = re.findall("an event begins.*", log)
    assert "trials rejected" in begins and "does not resolve nucleation length / 5 in fault" in begins


def test_trials_survive_a_stop(scene, comm):
    """Stopped in the search for an onset and resumed, the history is the same, the trials with it."""
    until = (*RUPTURE, "stage.creep.end=37.026", "output.checkpoint_every=1")
    whole, cut = scene.parent / "whole", scene.parent / "cut"
    run(load(scene, until), whole, comm)

    def stop(step):
        if step.report.rejected and step.state.time > 30.0:
            raise Interrupted("enough")

    with pytest.raises(Interrupted):
        run(load(scene, until), cut, comm, stop)
    totals = resume(cut, comm)
    comm.barrier()
    full, again = read_history(whole / "history.h5"), read_history(cut / "history.h5")
    assert totals.counts["rejected"] == full["step/rejected"].sum() > 0
    for key in ("time", "step/rejected", "step/wasted", "energy/friction"):
        if comm.size == 1:
            assert np.array_equal(full[key], again[key]), key
        elif (
            key == "step/wasted"
        ):  # round-off, of messages that come in any order, ends a failing trial sooner or later
            assert np.array_equal(full[key] > 0, again[key] > 0) and np.abs(full[key] - again[key]).max() <= 5
        else:
            assert full[key] == pytest.approx(again[key], rel=1e-6, abs=1e-9), key


def test_one_small_cell_does_not_tell_how_long_steps_with_inertia_are(scene, comm):
    """A P wave, sqrt(1.2 E/rho) of nu = 1/4, through joints of which one is a thousandth of the others."""
    model = prepare(load(scene), comm)
    joints = model.operators.joints
    length = comm.allreduce(float(joints.weights.sum()))
    mean = length / comm.allreduce(len(joints.weights) // joints.points)
    assert transit(model) == pytest.approx(mean / np.sqrt(1.2 * 1e10 / 2500.0), rel=0.1)
    weights = joints.weights.copy()
    if comm.rank == 0:
        weights[: joints.points] *= 1e-3
    small = SimpleNamespace(weights=weights, points=joints.points)
    other = SimpleNamespace(operators=SimpleNamespace(joints=small, layout=model.operators.layout), scene=model.scene)
    assert transit(other) == pytest.approx(transit(model), rel=0.1)


@pytest.mark.serial
def test_check_foretells_events_and_slow_slip(tmp_path):
    (tmp_path / "scene.toml").write_text(SCENE)
    said = CliRunner().invoke(app, ["check", str(tmp_path / "scene.toml"), "--set", RUPTURE[0]])
    assert said.exit_code == 0
    (event,) = re.findall(
        r"each event in stage creep, about: (\d+) trials rejected before it, at least (\d+) steps", said.output
    )
    assert int(event[0]) == 21 and int(event[1]) >= 50  # 200 s to 0.14 ms; a period in fiftieths
    assert "slow slip in stage creep, up to: 20 steps more, where 2 fractures weaken" in said.output
    assert said.output.count("! nucleation length: how ") == 1 and "is not resolved: how slip" not in said.output
