"""Rock without a mesh until an event needs inertia: jumps, tractions and energy go on through the change of rock."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.advance.event_rock import as_traction, handed_over
from fracflow.advance.initial_state import equilibrium_state
from fracflow.advance.step import Stepping, stepper_of
from fracflow.api import Run
from fracflow.cli.answer import LONGEST_NOTE
from fracflow.errors import InputError, Interrupted, SolveError
from fracflow.mesh import around
from fracflow.mesh.data import is_unmeshed
from fracflow.mesh.store import load_mesh
from fracflow.model.balance import static_balance_of
from fracflow.output import list_steps, read_events, read_history
from fracflow.output.reader import load_run_data
from fracflow.output.status import FAILED, read_status
from fracflow.reduction.event_mesh import before_events, event_scene, stress_left_frozen, with_event_mesh
from fracflow.reduction.prepare import prepare, with_sizes
from fracflow.remarks import bare, has_mark
from fracflow.scene.scene import load
from fracflow.simulation.recorder import Recorder
from fracflow.simulation.rocks import Rocks
from fracflow.simulation.run import resume, run
from fracflow.solve.request import StepRequest

SCENE = """
title = "pressure lets a fault go"
output = {pictures = false, event_length = 1}
rock.rock = {youngs_modulus = 30e9, poissons_ratio = 0.25, density = 2700}
initial_stress = {xx = -20e6, yy = -20e6, zz = -20e6, xy = 10e6}
load = [{stress.xy = [[0, 0], [100, 1e6], [1000, 1e6]]}]
fluid = {viscosity = 1e-3, initial_pressure = 0}
method = {stepper = "generalised-alpha", rho_infinity = 0.6, events = "at-step-ends"}
probe = [
  {name = "middle", at = [0, 0], on = "fault", quantities = ["slip", "opening", "shear_traction", "normal_traction"]},
  {name = "rock", at = [10, 20], quantities = ["stress"]},
]
stage = [{kind = "auto", end = 421, time_step = 10, dynamic_time_step = "3 ms", at_rest = 0.1}]
[geometry]
domain = "unbounded"
size_at_fractures = 10
size = 25
growth = 0.3
event_margin = 100
fracture = [{name = "fault", points = [[-50, 0], [50, 0]]}, {name = "beside", points = [[60, 30], [90, 40]]}]
[fracture.default]
friction_coefficient = 0.6
stick_slip_ratio = 0.9
normal_stiffness = "50 GPa/m"
shear_stiffness = "20 GPa/m"
aperture = "0.2 mm"
[fracture.fault]
pressure = [[0, 0], [1000, 4e6]]
[fracture.beside]
friction_coefficient = 0.9
"""
"""Pressure and a far stress act on the fault; the other fracture sticks, and has pressures that flow."""


@pytest.fixture
def scene(shared_tmp):
    file = shared_tmp / "scene.toml"
    if MPI.COMM_WORLD.rank == 0:
        file.write_text(SCENE)
    MPI.COMM_WORLD.barrier()
    return file


def history_of(folder):
    MPI.COMM_WORLD.barrier()
    return dict(read_history(folder / "history.h5"))


def handed(history):
    """The rows (n,) that changes of rock have added."""
    return np.flatnonzero(np.diff(history["energy/change_of_rock"])) + 1


def stepped(model, *times):
    """The state after steps without inertia to those times."""
    state, still = equilibrium_state(model), stepper_of(model.scene, model.scene.stage[0], "quasi-static")
    stepping = Stepping(model)
    for time in times:
        request = StepRequest(time, time - state.time, state.controls, stepping.model.loads)
        before, (state, _) = state, stepping.step(state, request, still)
        before.destroy()
    stepping.destroy()
    return state


@pytest.mark.serial
def test_the_mesh_of_an_event_is_no_coarser_beside_joints_than_a_stated_one(scene):
    """A stated growth holds; else fine joints have cells that grow more slowly, as in a box. Near sides are told."""
    fine, box = "geometry.size_at_fractures=0.5", ("geometry.domain=[-150,-100,190,140]", "geometry.size=25")
    assert event_scene(load(scene, [fine])).geometry.growth == 0.3
    left_open = scene.with_name("open.toml")
    left_open.write_text(scene.read_text().replace("growth = 0.3\n", "").replace("event_margin = 100\n", ""))
    margin, sides = "geometry.event_margin=100", 'absorbing=[{on=["west","east","south","north"]}]'
    of_event = event_scene(load(left_open, [fine, margin])).geometry
    of_box = with_sizes(load(left_open, [fine, *box, sides, "load=[]"]), MPI.COMM_SELF).geometry
    assert of_event.growth == of_box.growth == 0.13
    assert event_scene(load(left_open, [margin])).geometry.growth == 0.3
    (usual,), (near, _) = (before_events(load(scene, [f"geometry.event_margin={m}"])) for m in (200, 5))
    assert has_mark(usual) and not has_mark(near) and "event_margin = 5 m" in near and "for 280 m" in near
    assert "by about 12 %" in usual[:LONGEST_NOTE]  # (70 m/200 m)^2 of slip and opening beside held sides


def test_nothing_slips_by_the_change_of_rock(scene, comm):
    """Walls have the jumps of before, and the frozen traction leaves nothing out of balance."""
    model = prepare(load(scene), comm)
    state = stepped(model, 150.0, 300.0)
    new = with_event_mesh(model, comm)
    found = handed_over(model, new, state)
    back = handed_over(new, model, found.state)
    jumps = []
    for ops, at in ((model.operators, state), (new.operators, found.state), (model.operators, back.state)):
        joints, strain = ops.blocks.joints, ops.joints.strain(at.motion.displacement)
        rows = strain.reshape(len(joints.ids), 2 * ops.joints.dim)
        jumps.append(comm.bcast(ops.blocks.gather(joints.ids, rows, ops.blocks.sizes.joints)))
    for after in jumps[1:]:
        np.testing.assert_allclose(after, jumps[0], rtol=0.0, atol=1e-12 * np.abs(jumps[0]).max())
    assert back.most < 1e-12 * model.operators.scales.stiffness, "what the mesh had frozen is gone with it"
    assert back.energy == pytest.approx(-found.energy, rel=1e-9)
    assert back.state.energy == pytest.approx(state.energy, rel=1e-12, abs=1e-9 * abs(found.energy))
    back.state.destroy()
    left = static_balance_of(new.operators, found.state)
    new.loads.standing().release(left)
    assert left.norm() < 1e-12 * new.operators.scales.force
    assert 0.0 < found.mean < found.most < 5e4
    push, joints = left.duplicate(), new.operators.joints
    push.set(0.0)
    joints.force(np.tile([0.0, 5.0], (len(joints.weights), 1)), push)
    assert as_traction(new.operators, push)[1] == pytest.approx(5.0), "across the fault, everywhere"
    for each in (state, found.state, left, push):
        each.destroy()


CREEPING = (
    SCENE.replace("stick_slip_ratio = 0.9", 'leak_off = {permeability = "1e-17 m^2", storage = "1e-10 1/Pa"}')
    .replace("[fracture.beside]", "[fracture.beside]\npressure = [[0, 0], [20, 30e6], [1000, 30e6]]")
    .replace(
        "[fracture.fault]",
        """[fracture.fault]
law = "rate-and-state"
friction_coefficient = 0.5
reference_slip_rate = 1e-6
direct_effect = 0.010
evolution_effect = 0.015
characteristic_slip = 1e-3
initial_slip_rate = 1e-6""",
    )
)
"""The fault creeps; the other fracture is open, and leaks."""


def remembered(model, state):
    """Rows (j, ...) of what joints remember, by their numbers in the mesh, on every rank."""
    joints, block, comm = model.operators.joints, model.operators.blocks, model.operators.layout.comm
    parts = {name: getattr(state.sections, name) for name in ("strain", "traction", "inelastic", "tangent")}
    parts |= {"friction": state.friction, "rate": joints.strain(state.motion.velocity)}
    for number, (group, past) in enumerate(zip(joints.laws, state.sections.history, strict=True)):
        for name, values in past.items():
            parts[f"{number}/{name}"] = np.zeros((len(joints.weights), *values.shape[1:]))
            parts[f"{number}/{name}"][group.sections] = values
    parts |= state.memory
    ids, count = block.joints.ids, block.sizes.joints
    return {k: comm.bcast(block.gather(ids, np.reshape(v, (len(ids), -1)), count)) for k, v in parts.items()}


def test_joints_remember_their_past(shared_tmp, comm):
    """The state of friction, slip that has gone, the rate of slip, an open wall, and fluid that has leaked off."""
    if comm.rank == 0:
        (shared_tmp / "creeping.toml").write_text(CREEPING)
    comm.barrier()
    model = prepare(load(shared_tmp / "creeping.toml"), comm)
    state = stepped(model, 10.0, 20.0, 30.0)
    new = with_event_mesh(model, comm)
    found = handed_over(model, new, state)
    back = handed_over(new, model, found.state)
    then = remembered(model, state)
    for now in (remembered(new, found.state), remembered(model, back.state)):
        assert then.keys() == now.keys()
        for name, values in then.items():
            np.testing.assert_allclose(now[name], values, rtol=0.0, atol=1e-12 * np.abs(values).max(), err_msg=name)
    assert {name for name, values in then.items() if not values.any()} == {"0/sliding"}
    assert then["strain"][:, 1].max() > 1e-3  # open
    for each in (state, found.state, back.state):
        each.destroy()


def test_jumps_and_tractions_and_energy_go_on(scene, shared_tmp):
    """Tips are corrected: they store energy in the mesh of an event alone. That stress which an event leaves frozen is told."""
    totals = run(load(scene), shared_tmp / "run")
    history = history_of(shared_tmp / "run")
    now, back = handed(history)
    for name in ("slip", "opening", "shear_traction", "normal_traction"):
        values = history[f"probe/middle/{name}"]
        np.testing.assert_allclose(values[[now, back]], values[[now - 1, back - 1]], rtol=1e-12)
    entries = (history[f"energy/{name}"] for name in ("rock_strain", "tips", "change_of_rock", "work_boundaries"))
    stored, tips, change, work = (np.diff(each)[[now - 1, back - 1]] for each in entries)
    rock = np.abs(history["energy/rock_strain"][[now, back]])
    np.testing.assert_allclose(stored + tips + change - work, 0.0, atol=1e-12 * rock.max())
    assert np.all(np.abs(change) > 0.0) and np.all(np.abs(change) < 0.01 * rock)
    assert tips[0] < 0.0 == history["energy/tips"][back]
    assert work[0] == 0.0 and work[1] != 0.0, "sides that the event has moved"
    record = Run(shared_tmp / "run").plan  # as the run's page and its reader have it
    (made,) = (row for row in record if row["part"] == "mesh of events")
    cells = len(load_mesh(shared_tmp / "run" / "event_mesh.h5").cells)
    when = load(scene).time_text(history["time"][now])
    said = (shared_tmp / "run" / "log.txt").read_text()
    assert ": rock without cells, 28 nodes, 14 joints" in said and f"meshed rock: {cells} cells, " in said
    assert made["value"].startswith(f"{cells} cells") and made["value"].endswith(f"made at time {when}")
    assert (
        float(made["error"].partition("at most ")[2].split()[0]) > 0.0
        and load_run_data(shared_tmp / "run").is_meshed is False
    )
    assert made["verdict"] == "added" and len(made["saves"]) > len("nothing: ")
    (left,) = re.findall(r"event leaves frozen is (\S+) of its stress drop", said)
    assert 0.05 < float(left) < 0.15  # nearly three times as much with plain tips
    when = load(scene).time_text(history["time"][back])
    assert f"note: time {when}: the stress that this event leaves" in said and not totals.doubts
    much, endless = (bare(stress_left_frozen(load(scene), "1 s", share)) for share in (0.2, np.inf))
    assert much.startswith("time 1 s: the stress that this event leaves frozen is 0.2 of its stress drop")
    assert "joints of 5 m, half as long (geometry.size_at_fractures)" in much
    assert "stands beside no drop of stress" in endless and "a smaller geometry.size_at_fractures" in endless
    largest = max(np.abs(history[key]).max() for key in history if key.startswith("energy/"))
    assert np.abs(history["energy/residual"]).max() < 1e-10 * largest
    kinds = history["step/kind"]
    assert set(kinds[: now + 1]) == set(kinds[back - 1 :]) == {1} and set(kinds[now:back]) == {1, 2}
    assert [number for number, _ in list_steps(shared_tmp / "run", "rock_of_events")] == [back - 1]
    assert said.count("values of probes in the rock jump here (rock): ") == 2
    assert len(list_steps(shared_tmp / "run", "rock")) == 2 and not list_steps(shared_tmp / "run", "rock_before")
    stress = history["probe/rock/stress"]  # that of the far load is not in the motion of meshed rock
    assert np.abs(stress[now] - stress[now - 1]).max() < 0.02 * 1e6


BOX = (
    "geometry.domain=[-150, -100, 190, 140]",
    "absorbing=[{on=['west', 'east', 'south', 'north']}]",
    "load=[]",
    "model=full",
)


@pytest.mark.serial
def test_the_event_is_that_of_a_run_with_a_mesh_from_the_start(scene, shared_tmp):
    """Its sides are held before the event, which comes later by what they carry. Steps of 3 ms change its slip by 5 %."""
    here = ("load=[]", "initial_stress.xy=11e6", "stage.0.dynamic_time_step=1 ms", "method.tips=corrected")
    run(load(scene, here), shared_tmp / "later")
    (shared_tmp / "box.toml").write_text(SCENE.replace("event_margin = 100\n", ""))
    run(load(shared_tmp / "box.toml", [*here, *BOX]), shared_tmp / "meshed")
    events = [
        [row for row in read_events(shared_tmp / name / "events.csv") if row["kind"] == "event"]
        for name in ("later", "meshed")
    ]
    (later,), (meshed,) = events
    for key, near in {"start": 2e-3, "slip": 0.03, "moment": 0.03, "stress_drop": 0.03, "dissipated": 0.03}.items():
        assert later[key] == pytest.approx(meshed[key], rel=near), key


def test_a_run_that_stops_in_either_rock_goes_on(scene, shared_tmp, monkeypatch):
    """Equal to the last bit on one rank; on others MUMPS sums in order of arrival. Both events have one mesh."""
    sooner = "fracture.fault.pressure=[[0, 0], [425, 1.7e6], [427, 4e6], [1000, 4e6]]"
    keys = [
        sooner,
        "stage.0.end=426.75",
        "stage.0.at_rest=0.5",
        "stage.0.dynamic_time_step=6 ms",
        "output.fields_every=20",
    ]
    run(load(scene, keys), shared_tmp / "whole")
    whole, folder = history_of(shared_tmp / "whole"), shared_tmp / "halves"
    assert is_unmeshed(load_mesh(folder.with_name("whole") / "mesh.h5").cells)
    assert not is_unmeshed(load_mesh(folder.with_name("whole") / "event_mesh.h5").cells)
    now, back, again = handed(whole)[:3]
    asked, stops = load(scene, [*keys, "output.checkpoint_every=4"]), list(whole["time"][[now, now + 6, back + 2]])

    def stop_there(step):
        if stops and step.state.time >= stops[0] * (1.0 - 1e-9):
            stops.pop(0)
            raise Interrupted("by hand")

    def is_killed(*given):
        raise Interrupted("on all ranks, with nothing saved")

    with monkeypatch.context() as while_the_mesh_is_made, pytest.raises(Interrupted):
        while_the_mesh_is_made.setattr(Rocks, "_with_mesh", is_killed)
        run(asked, folder)
    for go_on in [lambda: resume(folder, progress=stop_there)] * 3:
        with pytest.raises(Interrupted):
            go_on()
    resume(folder)
    halves, is_alone = history_of(folder), MPI.COMM_WORLD.size == 1
    assert list(handed(halves)[:3]) == [now, back, again]
    for key in ("probe/middle/slip", "probe/middle/shear_traction", "energy/rock_strain", "energy/kinetic", "time"):
        near = 0.0 if is_alone else 1e-8 * np.abs(whole[key]).max()
        np.testing.assert_allclose(halves[key], whole[key], rtol=0.0, atol=near)
    if is_alone:
        assert halves["step/rejected"].sum() == whole["step/rejected"].sum() > 0
    for family in ("rock", "rock_before", "rock_of_events", "fractures"):
        numbers = [[number for number, _ in list_steps(each, family)] for each in (folder, shared_tmp / "whole")]
        assert numbers[0] == numbers[1]
        assert numbers[0] or family == "rock_of_events"
        assert family != "rock" or back - 1 in numbers[0], "the last of the first event is kept"
    is_same = (load_mesh(each / "event_mesh.h5").points.tolist() for each in (folder, shared_tmp / "whole"))
    assert next(is_same) == next(is_same)


@pytest.mark.serial
def test_no_event_needs_no_mesh(scene, shared_tmp, monkeypatch):
    def refuse(job, what):
        raise InputError("geometry: Gmsh: cannot")

    monkeypatch.setattr(around, "run_worker", refuse)
    run(load(scene, ["stage.0.end=100"]), shared_tmp / "quiet")
    assert not (shared_tmp / "quiet" / "event_mesh.h5").exists()
    assert not history_of(shared_tmp / "quiet")["energy/change_of_rock"].any()
    folder = shared_tmp / "asked"
    with pytest.raises(SolveError, match=r"an event needs a mesh: .*Gmsh: cannot$"):
        run(load(scene), folder)
    status = read_status(folder)
    assert status.word == FAILED and "Gmsh: cannot" in status.line and "fracflow resume" in status.line
    assert "Gmsh: cannot" in (folder / "log.txt").read_text()
    monkeypatch.undo()

    def is_killed(self, *given):
        hand_over(self, *given)
        raise KeyboardInterrupt

    hand_over = Recorder.hand_over
    monkeypatch.setattr(Recorder, "hand_over", is_killed)
    with pytest.raises(KeyboardInterrupt):
        resume(folder)  # the state before was saved
    monkeypatch.undo()
    resume(folder)
    for family in ("rock", "rock_of_events"):
        known = list_steps(folder, family)
        assert (folder / f"{family}.xdmf").read_text().count("<Time ") == len(known)
    assert not (folder / "rock_before.xdmf").exists()


@pytest.mark.serial
def test_an_event_is_priced_by_the_mesh_that_it_gets(monkeypatch):
    """With its rock condensed, as it runs: less than 3 times as dear with 3.3 times the cells, as it was measured (2.5)."""
    monkeypatch.syspath_prepend(Path(__file__).parents[2] / "scripts" / "benches")
    from event_mesh import foreseen

    near, far = (foreseen(margin) for margin in (200.0, 400.0))
    assert 0.5 * 5.7 < near < 2.0 * 5.7 and 0.5 * 14.4 < far < 2.0 * 14.4  # CPU s of scripts/bench event_mesh
    assert 1.5 < far / near < 3.0
