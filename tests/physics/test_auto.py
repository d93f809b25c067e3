"""A stage auto: a slider pushed slowly lets go again and again; it goes as far, and as often, as in closed form."""

import numpy as np
import pytest
from scipy.linalg import eigh

from fracflow._petsc import MPI
from fracflow.advance.initial_state import equilibrium_state
from fracflow.advance.regime import EventState
from fracflow.errors import InputError
from fracflow.output import read_events, read_history
from fracflow.reduction.prepare import prepare
from fracflow.scene.scene import load
from fracflow.simulation.run import resume, run
from fracflow.solve.period import longest_period

STIFF, SPRING, DAMPING, DROP, RATE = 50.0, 1.0, 1.0, 0.6, 1.0 / 4000.0
TOLD = "20 longest periods"
SCENE = "meshes/failures/two_modes/scene.toml"
ONE = (
    "support.1={on = ['slider', 'mass'], components = ['y']}",
    "fracture.fault={normal_stiffness = 10, shear_stiffness = 50, aperture = 1, friction_coefficient = 0.5,"
    " stick_slip_ratio = 0.4}",
    "rock.slider.youngs_modulus=1e4",  # its vent resists by rho c_p L = 1
    "rock.mass.youngs_modulus=1e4",
    "fracture.above.shear_stiffness=1e6",
    "load.1.force=[[[0, 0], [8000, 2]], 0]",
    "output.pictures=false",
    "stage.push.end=6500",
    "stage.push.time_step=500",
    "output.event_length=2",
)


class Stop(Exception):
    """Out of a run, as a fault would."""


def test_a_slider_goes_as_far_and_as_often_as_its_spring_and_dashpot_say(shared_tmp):
    """m = 1, k, c: a drop D takes it D/k (1 + exp(-pi zeta/sqrt(1 - zeta^2))) in pi/omega_d; its joint unloads by D/k_s."""
    run(load(SCENE, ONE), shared_tmp, MPI.COMM_WORLD)
    MPI.COMM_WORLD.barrier()
    history, rows = read_history(shared_tmp / "history.h5"), read_events(shared_tmp / "events.csv")
    events = [row for row in rows if row["kind"] == "event"]
    zeta = 0.5 * DAMPING / np.sqrt(SPRING)
    swing = np.sqrt(SPRING * (1.0 - zeta**2))
    slip = DROP / SPRING * (1.0 + np.exp(-np.pi * zeta / np.sqrt(1.0 - zeta**2))) + DROP / STIFF
    assert [event["slip"] for event in events] == pytest.approx([slip, slip, slip], rel=5e-3)
    # the strength 1 is reached from 0.9 first, then from where the last event left it
    first = 0.1 * (SPRING + STIFF) / STIFF / RATE
    starts = [first + n * SPRING * slip / RATE for n in range(3)]
    assert [event["start"] for event in events] == pytest.approx(starts, rel=5e-3)
    for event in events:
        assert event["end"] - event["start"] == pytest.approx(np.pi / swing, rel=0.01)
        left = SPRING * slip * STIFF / (SPRING + STIFF)  # statics: what slip s takes from the joint
        assert event["stress_drop"] == pytest.approx(left, rel=1e-2)
        assert event["dissipated"] == pytest.approx(0.4 * slip + 0.5 * DROP**2 / STIFF, rel=5e-3)  # it slides at 0.4
        assert event["length"] == pytest.approx(1.0) and event["moment"] > 0.0 and event["unclosed"] <= 1e-6
        assert event["magnitude"] is None  # a scene without units
    assert history["time"][-1] == pytest.approx(6500.0)
    assert len(history["time"]) < 1000  # steps of 0.05 would be 130 000
    assert TOLD not in (shared_tmp / "log.txt").read_text()


def test_a_pulse_shorter_than_a_slow_step_is_not_stepped_over(shared_tmp):
    """Strength is reached where the pulse has 0.1 (k + k_s)/k_s; the event is over long before the pulse is."""
    pulse = ("load.1.force=[[[0, 0], [100, 0], [250, 0.25], [400, 0]], 0]", "stage.push.end=500")
    run(load(SCENE, [*ONE, *pulse]), shared_tmp, MPI.COMM_WORLD)
    MPI.COMM_WORLD.barrier()
    history, rows = read_history(shared_tmp / "history.h5"), read_events(shared_tmp / "events.csv")
    (event,) = [row for row in rows if row["kind"] == "event"]
    assert event["start"] == pytest.approx(100.0 + 600.0 * 0.1 * (SPRING + STIFF) / STIFF, rel=5e-3)
    at_rest = history["time"][history["step/kind"] == 1]
    assert all(np.abs(at_rest - kink).min() < 1e-9 for kink in (100.0, 250.0, 400.0))


@pytest.mark.serial
def test_pulses_in_time_with_the_rock_are_no_slow_load(tmp_path):
    """Three pushes of 0.09 of the strength, a period apart, swing the slider past it; at rest each would be far from it."""
    period = float(2.0 * np.pi / np.sqrt(SPRING + STIFF))
    times, values = [0.0, 5.0], [0.0, 0.8 / 1.02]
    for n in range(3):
        times += [10.0 + n * period, 10.0 + (n + 0.25) * period, 10.0 + (n + 0.5) * period]
        values += [values[1], values[1] + 0.09, values[1]]
    push = f"load.1.force=[{[list(pair) for pair in zip(times, values, strict=True)]}, 0]"
    slips = {}
    for name, change in (
        ("auto", ("stage.push.dynamic_time_step=0.02",)),
        ("dynamic", ("stage.0={kind = 'dynamic', time_step = 0.02, end = 18}",)),
    ):
        scene = load(SCENE, [*ONE, push, "stage.push.end=18", *change])
        run(scene, tmp_path / name)
        slips[name] = read_history(tmp_path / name / "history.h5")["probe/fault/plastic_slip"][-1]
    assert slips["dynamic"] > 0.5
    assert slips["auto"] == pytest.approx(slips["dynamic"], rel=5e-3)


WAVE = """
[output]
pictures = false
[geometry]
domain = [[0, 0], [40, 0], [40, 80], [0, 80]]
size = 10
[[geometry.fracture]]
name = "joint"
points = [[0, 40], [40, 40]]
[rock.rock]
youngs_modulus = "10 GPa"
poissons_ratio = 0.25
density = 2500
[initial_stress]
xx = "-2 MPa"
yy = "-2 MPa"
zz = "-2 MPa"
[fracture.default]
normal_stiffness = "50 GPa/m"
shear_stiffness = "20 GPa/m"
aperture = "1 mm"
friction_coefficient = 0.2
stick_slip_ratio = 0.9
[[support]]
on = ["west", "east"]
components = ["y"]
[[load]]
on = ["west", "east"]
traction = "initial-stress"
[[absorbing]]
on = "south"
wave = {kind = "s", velocity = [[0, 0], [5, 0], [5.04, 0.3], [5.08, 0]], direction = [0, 1]}
[[absorbing]]
on = "north"
[[probe]]
name = "middle"
at = [20, 40]
on = "joint"
"""
AUTO = """[[stage]]
kind = "auto"
end = 6
time_step = 4
dynamic_time_step = 2e-3
"""
BY_HAND = """[[stage]]
kind = "quasi-static"
time_step = 4.99
steps = 1
[[stage]]
kind = "dynamic"
time_step = 2e-3
end = 5.6
"""


@pytest.mark.serial
def test_a_wave_that_comes_in_is_an_event(tmp_path):
    found = {}
    for name, stages in (("auto", AUTO), ("by hand", BY_HAND)):
        (tmp_path / f"{name}.toml").write_text(WAVE + stages)
        run(load(tmp_path / f"{name}.toml"), tmp_path / name)
        found[name] = read_history(tmp_path / name / "history.h5")
    auto, hand = found["auto"], found["by hand"]
    assert hand["probe/middle/plastic_slip"][-1] > 1e-4
    assert auto["probe/middle/plastic_slip"][-1] == pytest.approx(hand["probe/middle/plastic_slip"][-1], rel=1e-3)
    assert auto["energy/work_incident"][-1] == pytest.approx(hand["energy/work_incident"][-1], rel=1e-3)
    events = [row for row in read_events(tmp_path / "auto" / "events.csv") if row["kind"] == "event"]
    assert len(events) == 1 and 5.0 < events[0]["start"] < 5.1  # its first slip
    assert "time 5 s: an event begins: a wave comes in" in (tmp_path / "auto" / "log.txt").read_text()
    assert auto["time"][-1] == pytest.approx(6.0) and (auto["step/kind"] == 1).sum() >= 3


def test_an_event_under_way_has_a_row_without_end_that_going_on_replaces(shared_tmp):
    """It starts at 408 and lasts 3.6: cut at 409 it has slipped a part of what it does in the end."""

    def stop(step):
        if step.state.time > 409.0:
            raise Stop

    every = ("output.checkpoint_every=1", "stage.push.end=450")
    with pytest.raises(Stop):
        run(load(SCENE, [*ONE, *every]), shared_tmp, MPI.COMM_WORLD, stop)
    MPI.COMM_WORLD.barrier()
    (begun,) = [row for row in read_events(shared_tmp / "events.csv") if row["kind"] == "event"]
    MPI.COMM_WORLD.barrier()
    resume(shared_tmp, MPI.COMM_WORLD)
    MPI.COMM_WORLD.barrier()
    (event,) = [row for row in read_events(shared_tmp / "events.csv") if row["kind"] == "event"]
    assert begun["end"] is None and event["end"] == pytest.approx(event["start"] + 3.63, rel=0.01)
    assert begun["start"] == event["start"] and 0.0 < begun["slip"] < 0.5 * event["slip"]
    assert begun["unclosed"] <= 1e-6 and abs(begun["dropped"]) <= 1e-9 and begun["moment"] < 0.5 * event["moment"]


def test_an_event_that_nothing_damps_is_told_of_once(shared_tmp):
    """m = 1, k = 1: without its dashpot the slider swings on past twenty periods of 2 pi."""
    undamped = ("absorbing=[]", "stage.push.end=550", "stage.push.dynamic_time_step=0.5")
    run(load(SCENE, [*ONE, *undamped]), shared_tmp, MPI.COMM_WORLD)
    MPI.COMM_WORLD.barrier()
    (told,) = [line for line in (shared_tmp / "log.txt").read_text().splitlines() if TOLD in line]
    assert "[[absorbing]]" in told and "generalised-alpha" in told


@pytest.mark.serial
def test_the_line_on_a_long_event_names_no_remedy_that_the_scene_has():
    course = EventState(0.1, 1.0, 10.0)
    assert (
        course.is_unstable(20.5, 21.0, absorbs=False, damps=False) == "" != course.is_unstable(19.0, 20.5, False, False)
    )
    damped, both = course.is_unstable(19.0, 20.5, False, True), course.is_unstable(19.0, 20.5, True, True)
    assert "[[absorbing]]" in damped and "generalised-alpha" not in damped
    assert both.endswith("it never is: raise at_rest")


def test_the_longest_period_is_that_of_two_masses_on_three_springs(comm):
    model = prepare(load(SCENE, ["rock.slider.youngs_modulus=1e6", "rock.mass.youngs_modulus=1e6"]), comm)
    state = equilibrium_state(model)
    found = longest_period(model.operators, model.loads, state.sections)
    state.destroy()
    stiffness, mass = np.array([[51.0, -1.0], [-1.0, 1.3]]), np.diag([1.0, 4.0])
    assert found == pytest.approx(
        2.0 * np.pi / np.sqrt(np.linalg.eigvals(np.linalg.solve(mass, stiffness)).min()), rel=1e-3
    )


def test_the_longest_period_of_a_square_with_modes_alike(shared_tmp, comm):
    """Held at all sides, nearly square: its two lowest frequencies lie close together. SciPy has them all."""
    square = (
        "rock.rock = {youngs_modulus = 1e9, poissons_ratio = 0.25, density = 2500}\n"
        'support = [{on = ["south", "north", "west", "east"]}]\n'
        "geometry = {domain = [0, 0, 1, 1.03], size = 0.125}\n"
        'stage = [{kind = "dynamic", time_step = 1, steps = 1}]\n'
    )
    if comm.rank == 0:
        (shared_tmp / "square.toml").write_text(square, encoding="utf-8")
    comm.barrier()
    model = prepare(load(shared_tmp / "square.toml"), MPI.COMM_SELF)
    operators, state = model.operators, equilibrium_state(model)
    found = longest_period(operators, model.loads, state.sections)
    state.destroy()
    free = np.setdiff1d(np.arange(operators.stiffness.getSize()[0]), model.loads.standing().held)
    stiffness, mass = (matrix[:, :][np.ix_(free, free)] for matrix in (operators.stiffness, operators.mass))
    lowest = eigh(stiffness, mass, eigvals_only=True)[:2]
    assert lowest[1] < 1.1 * lowest[0]  # close together, where inverse iteration is slow
    assert found == pytest.approx(2.0 * np.pi / np.sqrt(lowest[0]), rel=1e-10)


SLOW = """
title = "a fault that creeps"
output.pictures = false
rock.rock = {youngs_modulus = "10 GPa", poissons_ratio = 0.25, density = 2500}
initial_stress = {xx = "-2 MPa", yy = "-2 MPa", xy = "0.5 MPa"}
support = [{on = "south"}, {on = "north", displacement = {x = [[0, 0], [1e6, "1 mm"]], y = 0}}]
load = [{on = ["west", "east"], traction = "initial-stress"}]
geometry = {domain = [0, 0, 4, 4], size = 1, fracture = [{name = "fault", points = [[0, 2], [4, 2]]}]}
stage = [{kind = "auto", time_step = 1e5, end = 1e6}]
[fracture.fault]
normal_stiffness = "50 GPa/m"
shear_stiffness = "20 GPa/m"
aperture = "1 mm"
friction_coefficient = 0.5
"""


def test_slow_slip_that_is_stable_stays_without_inertia(shared_tmp):
    """A strength that does not drop: the far side moves 1 mm, the fault with it, but for what the rock and it hold."""
    file = shared_tmp / "slow.toml"
    if MPI.COMM_WORLD.rank == 0:
        file.write_text(SLOW)
    MPI.COMM_WORLD.barrier()
    run(load(file), shared_tmp / "out", MPI.COMM_WORLD)
    MPI.COMM_WORLD.barrier()
    history, rows = read_history(shared_tmp / "out/history.h5"), read_events(shared_tmp / "out/events.csv")
    assert set(history["step/kind"]) == {1} and len(history["time"]) < 20
    assert history["step/slipping"][-1] > 0 and all(row["kind"] == "slip" for row in rows)


@pytest.mark.serial
@pytest.mark.parametrize(
    ("override", "says"),
    [
        ("stage.push.steps=4", "steps"),
        ("stage.push.control=x", "control"),
        ("stage.push.kind=dynamic", "dynamic_time_step"),
    ],
)
def test_keys_that_a_stage_auto_does_not_have_are_refused(override, says):
    with pytest.raises(InputError, match=says):
        load(SCENE, [override])
