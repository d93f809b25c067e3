"""Waves that pass cells damped at faults, from the first slip on: what is taken, what is told, and stages in two."""

import numpy as np
import pytest

from fracflow.errors import InputError
from fracflow.scene.advice import advice
from fracflow.scene.scene import load

WAVE = """
[output]
pictures = false
[method]
stepper = "explicit"
[geometry]
domain = [0, 0, 60, 40]
size = 5
size_at_fractures = 2
[[geometry.fracture]]
name = "main"
points = [[18, 9], [40, 31]]
[rock.rock]
youngs_modulus = 30e9
poissons_ratio = 0.22
density = 2600
[initial_stress]
xx = -6e6
yy = -5e6
[[absorbing]]
on = "west"
wave = {kind = "p", velocity = [[0, 0], [4e-3, 0.3], [8e-3, 0]]}
[[absorbing]]
on = "east"
[[support]]
on = ["south", "north"]
components = ["y"]
[fracture.main]
law = "hyperbolic-coulomb"
normal_stiffness = 50e9
shear_stiffness = 20e9
aperture = 3e-4
friction_coefficient = 0.1
[[probe]]
name = "behind"
at = [50, 20]
[[stage]]
kind = "dynamic"
time_step = 1e-3
steps = 20
"""


STICKS = ["fracture.main.friction_coefficient=0.9", "stage.0.time_step=2.5e-4", "stage.0.steps=80"]


@pytest.mark.serial
def test_waves_pass_faults_that_stick_undamped(run_scene):
    """To the bit, where both take the same steps."""
    damped, undamped = run_scene(WAVE, *STICKS), run_scene(WAVE, *STICKS, "method.fault_damping=0")
    for key, values in undamped.history.items():
        if key.startswith(("energy/", "probe/", "time")):
            assert np.array_equal(damped.history[key], values, equal_nan=True), key
    assert damped.history["energy/kinetic"].max() > 0.0 == damped.history["energy/damping"].max()


def test_damping_begins_with_the_first_slip(run_scene):
    """In the step of the first slip, on whichever rank that is: before that all is as without damping."""
    slips = ["stage.0.time_step=2.5e-4", "stage.0.steps=80"]
    damped, undamped = run_scene(WAVE, *slips), run_scene(WAVE, *slips, "method.fault_damping=0")
    (first, *_), (begun, *_) = (np.flatnonzero(damped.history[f"energy/{key}"]) for key in ("friction", "damping"))
    assert first == begun > 10
    one, other = (each.history["energy/kinetic"] for each in (damped, undamped))
    assert one[: first - 1] == pytest.approx(other[: first - 1], rel=1e-13) and one[-1] < 0.95 * other[-1]
    assert damped.closes()


def test_a_stage_in_two_is_one_stage(run_scene):
    """The damped force is that of the last step's mean motion: a stage that begins anew from the instant's would kick."""
    stage = "[[stage]]\nkind = 'dynamic'\ntime_step = 1e-3\nend = 0.02\n"
    whole, parted = run_scene(WAVE), run_scene(WAVE.replace("steps = 20", "steps = 11") + stage)
    assert whole.history["energy/damping"][11] > 0.1 * whole.history["energy/damping"][-1]
    for key in [key for key in whole.history if key.startswith(("energy/", "probe/", "time"))]:
        of = "energy/kinetic" if key.startswith("energy/") else key
        wrong = np.abs(parted.history[key] - whole.history[key]).max()
        assert wrong <= 1e-12 * np.abs(whole.history[of]).max(), key


@pytest.mark.serial
def test_waves_that_damped_cells_take_are_told(run_scene, shared_tmp):
    """A wave of some cells. Without the damping there is no line."""
    damped, _ = run_scene(WAVE), run_scene(WAVE, "method.fault_damping=0")
    logs = [(shared_tmp / name / "log.txt").read_text(encoding="utf-8") for name in ("run1", "run2")]
    assert "too weak" not in logs[1]
    shares = [float(line.split(" %")[0].split()[-1]) for line in logs[0].splitlines() if "too weak" in line]
    taken, *others = (damped.history[f"energy/{name}"] for name in ("damping", "kinetic", "radiated"))
    all_shares = 100.0 * np.divide(taken, taken + sum(others), out=np.zeros(21), where=taken > 0.0)
    first = all_shares[np.argmax(all_shares > 3.0)]
    assert shares == pytest.approx([first, all_shares[np.argmax(all_shares > 2.0 * first)]], rel=0.06)
    assert damped.history["energy/damping"][-1] > 0.05 * damped.history["energy/work_incident"][-1]
    assert damped.closes()


@pytest.mark.serial
@pytest.mark.parametrize(
    ("override", "warns"),
    [
        ("title=x", True),
        ("method.fault_damping=0", False),
        ("method.stepper=newmark", False),
        ("absorbing.0={on='west'}", False),
    ],
)
def test_waves_that_come_in_to_damped_cells_are_told_before_a_run(tmp_path, override, warns):
    (tmp_path / "scene.toml").write_text(WAVE, encoding="utf-8")
    lines = advice(load(tmp_path / "scene.toml", [override]))
    assert any("waves that come in" in line for line in lines) == warns


@pytest.mark.serial
@pytest.mark.parametrize(
    ("overrides", "told"),
    [
        ([], ""),
        (["stage.0.kind=quasi-static"], "and no stage has inertia"),
        (
            ["stage=[{kind='quasi-static', time_step=1, steps=2}, {kind='dynamic', steps=1, time_step=1e-3}]"],
            "begins at 2 s",
        ),
    ],
)
def test_waves_that_no_stage_sees_are_told(tmp_path, overrides, told):
    (tmp_path / "scene.toml").write_text(WAVE, encoding="utf-8")
    lines = [line for line in advice(load(tmp_path / "scene.toml", overrides)) if "its wave is over" in line]
    assert len(lines) == bool(told) and all(told in line for line in lines)


@pytest.mark.serial
@pytest.mark.parametrize(("end", "told"), [(1.0, True), (1e6, False)])
def test_a_wave_that_lasts_longer_than_the_run_is_told(tmp_path, end, told):
    """Also one that is at its last value as the run ends; its times may be milliseconds that were written as seconds."""
    (tmp_path / "scene.toml").write_text(WAVE, encoding="utf-8")
    stage = f"stage=[{{kind='dynamic', time_step={end / 10}, steps=10}}]"
    scene = load(tmp_path / "scene.toml", [stage, "absorbing.0.wave.velocity=[[0, 0], [1, 0], [2, 1e-3], [3, 0]]"])
    assert any("absorbing.0.wave.velocity: its table goes on to 3 s" in line for line in advice(scene)) == told


def test_a_wave_that_points_out_of_its_side_is_refused(run_scene):
    with pytest.raises(InputError, match=r"direction = \[-1.0, 0.0\] points out .* \[1.0, 0.0\] points in"):
        run_scene(WAVE, "absorbing.0.wave.direction=[-1, 0]")
