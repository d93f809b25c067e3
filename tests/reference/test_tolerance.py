"""``accuracy.tolerance``: the true error of what time steps made is of its size, and falls with it in proportion."""

import re

import numpy as np
import pytest
import winkler
from figures_verification.cases.r05 import LINEAR, injection
from figures_verification.runs import solve

from fracflow import SolveError, run
from fracflow import open as opened
from fracflow.scene.scene import load

pytestmark = pytest.mark.serial  # tests/resume has one on ranks

TOLERANCES = (1e-2, 1e-3, 1e-4)
N, END = 8, 0.4  # elements of the film, and the end of its stage, which is one step


def proportional(errors, tolerances, most):
    shares = np.divide(errors, tolerances)
    assert shares.max() <= most and shares.max() <= 3.0 * shares.min(), shares


def modes(pressure, time):
    """(times, nodes) p = 1 - sum c_j sin(k_j x) exp(-s_j t), as in R05: no error of the mesh is left."""
    k = (np.arange(N) + 0.5) * np.pi
    rate = 2 * (1 - np.cos(k / N)) * N**2
    x = np.linspace(0, 1, N + 1)
    return pressure * (1 - (np.exp(-np.outer(time, rate)) / (N * np.tan(k / 2 / N))) @ np.sin(np.outer(k, x)))


def history_of_film(text, well, *options):
    """Times (n,), pressures (n, N + 1) along the film, and the largest gap of the energy balance."""
    x = np.linspace(0, 1, N + 1)
    probes = "".join(f'[[probe]]\nname = "{i}"\nat = [{at!r}, 0]\non = "film"\n' for i, at in enumerate(x.tolist()))
    found = solve(text + injection(well, END, 1) + probes, *options, "method.coupling=whole-lu", mesh=winkler.mesh(x))
    pressures = np.stack([found.history[f"probe/{i}/pressure"] for i in range(N + 1)], axis=1)
    return found.history["time"], pressures, found.open_books


def error_of_film(text, pressure, *options):
    """Largest error in time and along the film, and of the volume that is in a wrong place, of the largest there is."""
    times, found, _ = history_of_film(text, f"pressure = {pressure}", *options)
    wrong = np.abs(found - modes(pressure, times))[1:] / pressure
    return wrong.max(), wrong[:, 1:] @ np.array([1.0] * (N - 1) + [0.5]) / N


@pytest.mark.parametrize(
    "rule, tolerances", [("backward-euler", (1e-1, 1e-2)), ("bdf2", TOLERANCES), ("trapezoid", TOLERANCES[:2])]
)
def test_pressure_that_diffuses_from_a_jump(rule, tolerances):
    found = [
        error_of_film(LINEAR, 1.0, f"method.flow_integrator={rule}", f"accuracy.tolerance={each}")
        for each in tolerances
    ]
    proportional([largest for largest, _ in found], tolerances, 2.0)
    proportional([volume.max() for _, volume in found], tolerances, 1.0)


def test_of_a_fluid_that_is_stored_by_compression_alone():
    """c_f d = 1 in place of 1/k_n = 1."""
    text = LINEAR.replace("normal_stiffness = 1", "normal_stiffness = 1e7")
    text = text.replace("viscosity = 1", "viscosity = 1\ncompressibility = 0.1")
    tolerances, rule = (1e-2, 1e-3), "method.flow_integrator=bdf2"
    found = [error_of_film(text, 1e-4, rule, f"accuracy.tolerance={each}")[0] for each in tolerances]
    proportional(found, tolerances, 2.0)


@pytest.mark.parametrize(
    "rule, tolerances", [("backward-euler", (1e-1,)), ("bdf2", TOLERANCES), ("trapezoid", (1e-2,))]
)
def test_a_small_pumping_after_a_large_one(rule, tolerances):
    """A hundredth more pressure, in a stage of its own: the error is of what that brings. The stage after it is long."""
    steady, small = 10.0, 0.01
    well = f"pressure = [[0, 1], [{steady}, 1], [{steady}, {1 + small}]]"
    stages = [f'{{kind="quasi-static", time_step={each}, steps=1}}' for each in (steady, END, 1e3)]
    found = []
    for each in tolerances:
        given = (f"stage=[{', '.join(stages)}]", f"method.flow_integrator={rule}", f"accuracy.tolerance={each}")
        times, pressures, open_books = history_of_film(LINEAR, well, *given)
        late = times > steady
        wrong = np.abs(pressures - 1.0 - modes(small, np.maximum(times - steady, 0.0)))[late & (times <= steady + END)]
        found.append(wrong.max() / small)
        assert open_books < 1e-9 and np.sum(times > steady + END) < 200
    proportional(found, tolerances, 2.0)


@pytest.mark.parametrize("tolerance", [1e-1, 1e-2])
@pytest.mark.parametrize(
    "rate", ["[[0, 0], [0.2, 0], [0.21, 1], [0.22, 0]]", "[[0.2, 0], [0.2, 1], [0.21, 1], [0.21, 0]]"]
)
def test_pulse_of_a_well_within_the_only_step(rate, tolerance):
    """The injected volume, 0.01, is there in the end: all of it stays in the fracture."""
    *_, last = history_of_film(
        LINEAR, f"flow_rate = {rate}", "method.flow_integrator=bdf2", f"accuracy.tolerance={tolerance}"
    )[1]
    assert (last.sum() - last[[0, -1]].mean()) / N == pytest.approx(0.01, rel=tolerance)


@pytest.mark.parametrize("rule, tolerances", [("backward-euler", (1e-1,)), ("bdf2", TOLERANCES[:2])])
def test_pressure_that_jumps_within_the_only_step(rule, tolerances):
    """It is exact as from the start: parts end at the jump, and the rule begins anew there."""
    jump = 0.15
    for each in tolerances:
        well, given = (
            f"pressure = [[0, 0], [{jump}, 0], [{jump}, 1]]",
            (f"method.flow_integrator={rule}", f"accuracy.tolerance={each}"),
        )
        times, found, open_books = history_of_film(LINEAR, well, *given)
        exact = np.where((times > jump)[:, None], modes(1.0, np.maximum(times - jump, 0.0)), 0.0)
        assert times[1] == jump and np.abs(found - exact).max() <= 2.0 * each and open_books < 1e-9


def test_a_ramp_far_shorter_than_a_step_is_a_jump():
    """At a step's end it has no time to act. A longer one acts in the whole step, by backward Euler."""
    steep, slow = (
        history_of_film(LINEAR, f"pressure = [[0, 0], [{END - ramp}, 0], [{END}, 1]]")[1][-1] for ramp in (1e-4, 1e-2)
    )
    assert steep[0] == slow[0] == 1.0 and steep[2] < 1e-3 and slow[2] > 0.1


def oscillation(folder, *options):
    """Times and error of the block of R02, u'' + u = 1 from rest, over its largest displacement, 2."""
    given = ["output.pictures=false", "fracture.default.law=linear", "load.0.traction=[1, 0]", "stage.0.end=4"]
    found = run(load("meshes/report_5_2/scene.toml", [*given, "stage.0.time_step=1.5", *options]), folder)
    moved = found.probe("block")["displacement"][:, 0]
    return found.times, np.abs(moved - (1.0 - np.cos(found.times))).max() / 2.0


@pytest.mark.parametrize("stepper, tolerances", [("newmark", TOLERANCES), ("hht", TOLERANCES[:2])])
def test_oscillation_without_damping(shared_tmp, stepper, tolerances):
    errors = [
        oscillation(shared_tmp / str(each), f"accuracy.tolerance={each}", f"method.stepper={stepper}")[1]
        for each in tolerances
    ]
    proportional(errors, tolerances, 1.5)


@pytest.mark.parametrize("tolerance", TOLERANCES)
def test_a_small_push_after_a_large_one(shared_tmp, tolerance):
    """The block stands still at 1 as its oscillation by a hundredth begins, which has an error of its own size."""
    stages = [
        '{kind="quasi-static", time_step=0.5, steps=2}',
        '{kind="dynamic", time_step=1.5, end=4}',
    ]
    given = ["output.pictures=false", "fracture.default.law=linear", f"accuracy.tolerance={tolerance}"]
    given += ["load.0.traction=[[[0, 1], [1, 1], [1, 1.01]], 0]", f"stage=[{', '.join(stages)}]"]
    found = run(load("meshes/report_5_2/scene.toml", given), shared_tmp / "run")
    late = found.times > 1.0
    moved = found.probe("block")["displacement"][:, 0] - 1.0
    assert np.abs(moved - 0.01 * (1.0 - np.cos(found.times - 1.0)))[late].max() <= 1.5 * tolerance * 0.02


def spike(time, kinks, changes):
    """u'' + u = f from rest: each change c of the slope of f, at time a, adds c (s - sin s), s = time - a > 0."""
    since = np.maximum(np.subtract.outer(time, kinks), 0.0)
    return (since - np.sin(since)) @ changes


def test_whole_step_that_ends_on_a_short_spike(shared_tmp):
    """Its end is ten times as far as the block ever goes, so it is no measure of what is allowed; the log says what was."""
    given = ["load.0.traction=[[[0, 0], [0.98, 0], [1, 2], [1.02, 0]], 0]", "stage.0.time_step=1", "stage.0.end=3"]
    given += ["output.pictures=false", "fracture.default.law=linear", "accuracy.tolerance=1e-2"]
    found = run(load("meshes/report_5_2/scene.toml", given), shared_tmp / "run")
    exact = spike(found.times, [0.98, 1.0, 1.02], [100, -200, 100])
    error = np.abs(found.probe("block")["displacement"][:, 0] - exact).max() / exact.max()
    assert exact.max() == pytest.approx(0.04, rel=0.01) and error <= 2e-2
    told = re.findall(r"time steps made an error of (\S+) \(estimated\)", (shared_tmp / "run" / "log.txt").read_text())
    assert len(told) == 1 and error / 3.0 <= float(told[0]) <= 1e-2


@pytest.mark.parametrize("push", [[[0, 0], [0.48, 0], [0.5, 2], [0.52, 0]], "bell"])
def test_pulse_of_a_load_within_the_only_step(shared_tmp, push):
    """Of a table with corners, at which parts end, and of one of a hundred points, which is followed as far as asked."""
    if push == "bell":
        at = np.linspace(0.3, 0.7, 101)
        push = np.column_stack([at, np.cos(np.pi * (at - 0.5) / 0.4) ** 2]).tolist()
    given = [f"load.0.traction=[{push}, 0]", "stage.0.time_step=1", "stage.0.end=1", "output.pictures=false"]
    given += ["fracture.default.law=linear", "accuracy.tolerance=1e-2"]
    found = run(load("meshes/report_5_2/scene.toml", given), shared_tmp / "run")
    at, pushed = np.transpose([[0, 0], *push, [1, 0]])
    slopes = np.divide(np.diff(pushed), np.diff(at), out=np.zeros(len(at) - 1), where=np.diff(at) > 0)
    exact = spike(found.times, at, np.diff(slopes, prepend=0, append=0))
    assert np.abs(found.probe("block")["displacement"][:, 0] - exact).max() <= 1e-2 * exact.max()


def test_a_vibration_smaller_than_what_may_be_wrong_is_not_followed_without_end(shared_tmp):
    """Of 1e-7 across stiff joints, beside 2 along them: phases of 1e5 radians/time would need 2e6 parts; it says so."""
    given = ["output.pictures=false", "fracture.default.law=linear", "fracture.default.normal_stiffness=5e9"]
    given += ['support.1={on="block", components=["rotation"]}', "load.0.traction=[1, 1000]", "stage.0.end=4"]
    scene = load("meshes/report_5_2/scene.toml", [*given, "accuracy.tolerance=1e-2"])
    with pytest.raises(SolveError, match=r"gain nothing. They follow a vibration on (lower|upper) at") as told:
        run(scene, shared_tmp / "run")
    period, amplitude = (float(x) for x in re.findall(r"of period (\S+) and amplitude (\S+),", str(told.value))[0])
    assert period == pytest.approx(2.0 * np.pi / 1e5, rel=0.05) and amplitude == pytest.approx(1e-7, rel=0.1)
    assert len(opened(shared_tmp / "run").times) <= 600  # last good state and all


def test_what_a_step_may_add_takes_its_place(shared_tmp):
    alone, _ = oscillation(shared_tmp / "alone", "accuracy.step_error=1e-3")
    both, _ = oscillation(shared_tmp / "both", "accuracy.step_error=1e-3", "accuracy.tolerance=1e-6")
    assert np.array_equal(alone, both)


def test_steps_that_hold_nothing_stay_whole(shared_tmp):
    """Without inertia and fluid time has no error."""
    given = ["output.pictures=false", "stage.0.kind=quasi-static", "accuracy.tolerance=1e-6", "stage.0.end=2"]
    given += ["fracture.default.law=linear"]
    run(load("meshes/report_5_2/scene.toml", given), shared_tmp / "run")
    assert opened(shared_tmp / "run").times == pytest.approx(np.linspace(0.0, 2.0, 21))
