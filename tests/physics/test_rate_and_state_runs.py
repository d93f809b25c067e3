"""Rate-and-state friction in whole runs: a slider up to its instability, and an event with inertia."""

from __future__ import annotations

import re
import subprocess
import sys

import numpy as np
import pytest
from _launch import without_ranks
from laws.spring_slider import onsets, reference

from fracflow._petsc import MPI
from fracflow.errors import InputError, Interrupted
from fracflow.output import read_events, read_history
from fracflow.reduction.prepare import prepare
from fracflow.scene.advice import advice
from fracflow.scene.scene import load
from fracflow.simulation.run import resume, run

from .test_leapfrog import SCENE as BETWEEN
from .test_leapfrog import write_mesh

SCENE = """
output = {pictures = false, vtkhdf = false, checkpoint_every = 10}
rock.rock = {youngs_modulus = 0.6e9, poissons_ratio = 0, density = 2700}
initial_stress = {xx = -1e7, yy = -1e7, xy = 6e6}
support = [{on = "south"}, {on = "north", displacement = {x = [[0, 0], [1000, 1e-2]], y = 0}}]
tie = [{on = ["west", "east"]}]
probe = [{name = "middle", at = [1, 1], on = "seam", quantities = ["sliding_rate", "state", "plastic_slip"]}]
[method]
stepper = "implicit-euler"
[geometry]
domain = [0, 0, 2, 2]
size = 1
cells = "quads"
fracture = [{name = "seam", points = [[0, 1], [2, 1]]}]
[fracture.seam]
law = "rate-and-state"
normal_stiffness = 1e12
shear_stiffness = 1e12
aperture = 1e-3
friction_coefficient = 0.6
reference_slip_rate = 1e-6
direct_effect = 0.010
evolution_effect = 0.015
characteristic_slip = 1e-4
initial_slip_rate = 1e-6
"""
SLOW = '[[stage]]\nname = "load"\nkind = "quasi-static"\ntime_step = 8\nend = 81.5\n'
AUTO = '[[stage]]\nkind = "auto"\ntime_step = 8\ndynamic_time_step = 1e-3\nend = 82\n'
STIFFNESS, IMPEDANCE = 1.5e8, 0.5 * np.sqrt(2700 * 3e8)  # of two blocks in series, of one rock on both sides
RATE = 1e-5
NETWORK = [
    "output.pictures=false", "output.vtkhdf=false", "geometry.domain=[-14, -14, 14, 14]", "geometry.size_at_fractures=0.8",
    "geometry.growth=0.4", "method.stepper=generalised-alpha", "method.rho_infinity=0.8", "stage.injection.end=0.9 h",
    "stage.injection.dynamic_time_step=0.5 ms",
]  # fmt: skip
MEAN = 4.5  # iterations of a step
PUSH = '[[load]]\non = "west"\ntraction = [1, 0]\ncontrol = "push"\n'
STILL = '[[stage]]\nkind = "quasi-static"\ntime_step = 1\nsteps = 1\n'


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Runs of the slider up to its instability, and stopped on the way; and with inertia as it slips."""
    home = tmp_path_factory.mktemp("slider")
    for name, stages in (("slow", SLOW), ("auto", AUTO)):
        (home / f"{name}.toml").write_text(SCENE + stages)
        run(load(home / f"{name}.toml"), home / name)
    left = [60]

    def stop(_):
        left[0] -= 1
        if not left[0]:
            raise KeyboardInterrupt

    with pytest.raises((KeyboardInterrupt, Interrupted)):
        run(load(home / "slow.toml"), home / "cut", progress=stop)
    resume(home / "cut")
    return home


def history(folder, name):
    return read_history(folder / name / "history.h5")


pytestmark = pytest.mark.serial


def test_waves_leave_by_the_rocks_on_both_sides(tmp_path):
    """Impedances rho c_s of unlike rocks, one after the other: 1/(1/Z + 1/Z')."""
    write_mesh(tmp_path / "mixed.msh")
    seam = SCENE[SCENE.index("[fracture.seam]") :].replace("seam", "fault")
    (tmp_path / "scene.toml").write_text(BETWEEN[: BETWEEN.index("[fracture.fault]")] + seam + STILL)
    model = prepare(load(tmp_path / "scene.toml"), MPI.COMM_SELF)
    soft, hard = np.sqrt(2500 * 20e9 / 2.4), np.sqrt(2700 * 40e9 / 2.5)
    (group,) = model.operators.joints.laws
    inside = np.asarray(group.law.wave_impedance)[2:-2]  # at a tip a node belongs to both rocks
    assert inside == pytest.approx(soft * hard / (soft + hard), rel=1e-12)


def test_it_runs_away_when_an_ode_solver_says_so(folder):
    kept = history(folder, "slow")
    middle = kept["time"][1:] - 0.5 * np.diff(kept["time"])
    rates = kept["probe/middle/sliding_rate"][1:]
    for fast in (1e-5, 1e-4, 3e-4):
        exact = reference(STIFFNESS, RATE, 1e-6, 90.0, fast, IMPEDANCE)
        assert onsets(middle, rates, fast)[:1] == pytest.approx(exact[:1], rel=2e-3)
    assert kept["step/newton"][1:].mean() < MEAN, "each begins at the rate of the step before"
    assert (rates * np.diff(kept["time"]) <= 0.1 * 1e-4 * (1 + 1e-9)).all(), "no step slips over a tenth of D_c"


def test_its_energy_closes_and_what_it_radiates_is_booked(folder):
    for name in ("slow", "auto"):
        kept = history(folder, name)
        largest = max(np.abs(values).max() for key, values in kept.items() if key.startswith("energy/"))
        assert np.abs(kept["energy/residual"]).max() <= 1e-10 * largest
    kept = history(folder, "slow")
    sent = 2.0 * IMPEDANCE * np.sum(kept["probe/middle/sliding_rate"][1:] ** 2 * np.diff(kept["time"]))
    assert kept["energy/radiated"][-1] == pytest.approx(sent, rel=1e-9), "a seam 2 m long"


def test_creep_is_no_event_and_what_runs_away_is_one_with_inertia(folder):
    assert read_events(folder / "slow" / "events.csv") == [], "it creeps"
    rows, kept = read_events(folder / "auto" / "events.csv"), history(folder, "auto")
    event = [row for row in rows if row["kind"] == "event"]
    assert len(event) == 1 and event[0]["slip"] > 5e-3 and event[0]["end"] is not None
    moving = kept["step/kind"] == 2
    before = kept["probe/middle/sliding_rate"][np.flatnonzero(moving)[0] - 1]
    assert IMPEDANCE * before == pytest.approx(1e-3 * 6e6, rel=0.5), "inertia comes in as a thousandth is radiated"
    lines = re.findall(r"! .*a step with inertia slips (\S+) times", (folder / "auto" / "log.txt").read_text())
    far = (kept["probe/middle/sliding_rate"][1:] * np.diff(kept["time"]))[moving[1:]].max() / 1e-4
    told = float(lines[-1])
    assert 1.0 < told <= 1.001 * far < 2.01 * told, "steps with inertia do not follow the rate of slip"
    still = history(folder, "auto")["energy/radiated"][moving]
    assert np.ptp(still) == 0.0, "waves carry it then"


@pytest.mark.parametrize("kind", ["dynamic", "auto"])
def test_steps_with_inertia_follow_the_rate_of_slip_where_a_scene_asks(kind, tmp_path):
    """V dt of 0.5 D_c at most: shorter than the scene's while slip is fast."""
    lengths = "time_step = 1e-3" if kind == "dynamic" else "time_step = 8\ndynamic_time_step = 1e-3"
    stage = f'[[stage]]\nkind = "{kind}"\n{lengths}\nend = 0.015\n[accuracy]\ndynamic_slip_share = 0.5\n'
    (tmp_path / "scene.toml").write_text(SCENE.replace("initial_slip_rate = 1e-6", "initial_slip_rate = 0.02") + stage)
    assert not [line for line in run(load(tmp_path / "scene.toml"), tmp_path / "run").doubts if "with inertia" in line]
    with pytest.raises(InputError, match=r"accuracy\.dynamic_slip_share = 0\.5: contradicts"):
        load(tmp_path / "scene.toml", ["method.stepper=explicit"])
    with pytest.raises(InputError, match=r"accuracy\.dynamic_slip_share = 0\.5: bounds steps with inertia"):
        load(tmp_path / "scene.toml", ["stage=[{kind='quasi-static', time_step=1, steps=1}]"])
    kept = history(tmp_path, "run")
    moving = kept["step/kind"][1:] == 2
    far = (kept["probe/middle/sliding_rate"][1:] * np.diff(kept["time"]))[moving] / 1e-4
    steps = np.diff(kept["time"])[moving]
    assert 0.25 < far.max() <= 0.5 * (1.0 + 1e-9)
    assert steps.max() <= 1e-3 * (1.0 + 1e-9) and steps[steps > 0.0].min() < 0.1e-3


def test_a_run_that_was_stopped_goes_on_to_the_last_bit(folder):
    one, other = history(folder, "slow"), history(folder, "cut")
    assert one.keys() == other.keys()
    assert all(np.array_equal(one[key], other[key], equal_nan=True) for key in one)


def test_slip_that_waves_limit_is_told_where_there_is_no_inertia(folder):
    told = run(load(folder / "slow.toml", ["accuracy.slip_share=0.5", "stage.load.end=83"]), folder / "fast").doubts
    assert len(told) == 1 and "slip of seam is so fast that waves limit it" in told[0] and 'kind = "auto"' in told[0]


@pytest.mark.starts_ranks
def test_two_ranks_agree(folder):
    clean = without_ranks()
    words = [sys.executable, "-m", "fracflow", "run", str(folder / "slow.toml"), "-o", str(folder / "two")]
    words += ["--set", "stage.load.end=64"]
    subprocess.run(["mpirun", "-n", "2", *words], check=True, capture_output=True, env=clean, timeout=300)
    one, two = history(folder, "slow"), history(folder, "two")
    steps = len(two["time"])
    assert steps > 15 and np.array_equal(one["time"][:steps], two["time"])
    assert two["probe/middle/sliding_rate"] == pytest.approx(one["probe/middle/sliding_rate"][:steps], rel=1e-6)


def test_crossing_faults_slip_slowly_and_fast_in_one_run(tmp_path):
    """meshes/ten_faults on joints twice as long, up to its first event: 1.72e8 N m/m on its own joints."""
    run(load("meshes/ten_faults/scene.toml", NETWORK), tmp_path)
    rows, kept = read_events(tmp_path / "events.csv"), history(tmp_path, "")
    (event,) = [row for row in rows if row["kind"] == "event"]
    assert event["fracture"] == "H3" and event["moment"] == pytest.approx(1.72e8, rel=0.1)
    fastest = {
        f"{fault}{n}": np.abs(kept[f"probe/{fault}{n}/sliding_rate"]).max() for fault in "GH" for n in range(1, 6)
    }
    assert fastest.pop("H3") > 0.1, "it weakens, under the well"
    assert 1e-11 < min(fastest.values()) and max(fastest[f"G{n}"] for n in range(1, 6)) < 1e-4, (
        "they strengthen: they creep"
    )
    slip = np.abs(kept["probe/H3/plastic_slip"])
    before = slip[np.flatnonzero(kept["step/kind"] == 2)[0] - 1]
    assert 1e-6 < before < 0.1 * slip[-1], "it creeps, and then breaks"
    assert np.abs(kept["energy/residual"]).max() <= 1e-10 * kept["energy/friction"].max()


@pytest.mark.serial
def test_stages_without_time_are_told_or_refused(tmp_path):
    """Friction of rate and state lets nothing slip at once: 61 doublings of a control ended by asking for wells."""
    file, steady = tmp_path / "scene.toml", '[[stage]]\nkind = "steady"\n'
    file.write_text(SCENE + steady + "steps = 1\n")
    (line,) = [line for line in advice(load(file)) if "takes no time" in line]
    assert line.startswith("stage steady: ") and "fracture.seam does not slip" in line
    assert not [line for line in advice(load(file, ["stage.0.time_step=1"])) if "takes no time" in line]
    search = 'until = "incipient"\ncontrol = "push"\n[control.push]\n' + PUSH
    other = "[fracture.other]\nnormal_stiffness = 1e12\nshear_stiffness = 1e12\naperture = 1e-3\nfriction_coefficient = 0.6\n"
    fractures = 'fracture = [{name = "other", points = [[0, 0.5], [2, 0.5]]}, '
    file.write_text(
        SCENE.replace("fracture = [", fractures).replace("[fracture.seam]", other + "[fracture.seam]") + steady + search
    )
    assert [
        line
        for line in advice(load(file))
        if "fracture.seam does not slip" in line and "of the other fractures" in line
    ]
    file.write_text(SCENE + steady + search)
    with pytest.raises(InputError, match=r"stage.0.until.* slip at any stress"):
        load(file)
