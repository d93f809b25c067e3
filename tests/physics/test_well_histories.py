"""Histories of wells: pressure, rate, volume and injectivity; and the volumes of the whole network."""

import numpy as np
import pytest
from resealed import changed_notes

import fracflow
from fracflow.errors import InputError
from fracflow.output import HistoryFile, read_history
from fracflow.output.history import read_attributes
from fracflow.scene.scene import load
from fracflow.simulation.run import resume, run

from .conftest import JOINT
from .test_books import CRACK, DYNAMIC, QUASI, STEADY
from .test_places import END, START, channel, turned
from .test_wells import PUMPED, RESISTANCE

LENGTH = float(np.linalg.norm(END - START))
PER_LENGTH = (1e-3) ** 3 / (12 * 1e-3)  # d^3 / 12 mu
RATED = CRACK.replace('pressure = "initial"', "flow_rate = [[0, 0], [2e-4, 2e-4], [6e-4, 1e-4]]")
PUMPING = 'flow_rate = 2e-4\ncontrol = "pumping"\n[control.pumping]\ninitial = 1.0'
RAMPED = CRACK.replace('pressure = "initial"', PUMPING)
RAMP = 'control = "pumping"\nincrement_per_step = 0.2\n'
assert 'aperture = "1 mm"' in JOINT


def test_wells_of_a_channel(run_scene):
    """q = dp d^3/(12 mu L) over the depth, in at one end and out at the other; J = q/p from an initial pressure of zero."""
    found = run_scene(channel(turned(0, False)), "fluid.flow_depth=7", "stage.0.steps=3")
    rate = 7 * 2e4 * PER_LENGTH / LENGTH
    of = {key: values for key, values in found.history.items() if key.startswith(("well/", "volume/"))}
    assert of["well/in/pressure"][1:] == pytest.approx(3e4) and of["well/out/pressure"][1:] == pytest.approx(1e4)
    for name, sign, pressure in (("in", 1.0, 3e4), ("out", -1.0, 1e4)):
        assert of[f"well/{name}/rate"][1:] == pytest.approx(sign * rate, rel=1e-9)
        assert of[f"well/{name}/volume"] == pytest.approx(sign * rate * np.arange(4.0), rel=1e-9)
        assert of[f"well/{name}/injectivity"][1:] == pytest.approx(sign * rate / pressure, rel=1e-9)
    assert of["volume/injected"][-1] == of["well/in/volume"][-1]
    assert of["volume/withdrawn"][-1] == -of["well/out/volume"][-1]
    assert np.all(of["volume/stored"] == 0.0)


def test_a_well_between_two_drains(run_scene):
    """p - p0 = q s (L - s)/L / (d^3/12 mu) at s; each drain takes the share of the other's distance."""
    at = '[[well]]\nname = "mid"\nat = {fracture = "slot", fraction = 0.317}\nflow_rate = 2e-3\n'
    found = run_scene(channel(turned(37, True), at), "well.in.pressure=1e4")
    rise = 2e-3 * 0.317 * 0.683 * LENGTH / PER_LENGTH
    assert found.history["well/mid/pressure"][-1] == pytest.approx(1e4 + rise, rel=1e-9)
    assert found.history["well/mid/rate"][-1] == pytest.approx(2e-3, rel=1e-12)
    assert found.history["well/mid/injectivity"][-1] == pytest.approx(2e-3 / (1e4 + rise), rel=1e-9)
    assert found.history["well/in/rate"][-1] == pytest.approx(-2e-3 * 0.683, rel=1e-9)
    assert found.history["well/out/rate"][-1] == pytest.approx(-2e-3 * 0.317, rel=1e-9)


THIN = "fluid.compressibility=4.5e-10"
TWINS = CRACK + '[[well]]\nname = "twin"\nat = [0, 1]\npressure = 2e6\n'  # at the node of "in"
RATED_TWINS = (
    RATED + '[[well]]\nname = "twin"\nat = [4, 2]\nflow_rate = [[0, 0], [2.5e-4, 3e-4], [6e-4, 0]]\n'
)  # of "out"


@pytest.mark.parametrize(
    ("scene", "stages", "settings"),
    [
        (TWINS, QUASI, ["method.flow_integrator=backward-euler", "fluid.flow_depth=3"]),
        (CRACK, QUASI, ["method.flow_integrator=bdf2", THIN]),
        (RATED, QUASI, ["method.flow_integrator=bdf2"]),
        (RATED, QUASI, ["method.flow_integrator=trapezoid"]),
        (CRACK, QUASI + DYNAMIC + QUASI, ["method.flow_integrator=bdf2"]),
        (RATED, STEADY + DYNAMIC, [THIN, "stage.0.time_step=1e-4"]),
        (RATED_TWINS, DYNAMIC, []),  # within a step the rates bend: what enters besides is of both
        (RAMPED, STEADY + DYNAMIC + RAMP, ["method.stepper=explicit"]),
        (RAMPED, STEADY + DYNAMIC + RAMP, ["method.stepper=explicit", THIN, "stage.0.time_step=1e-4"]),
    ],
)
def test_the_volumes_of_all_wells_are_what_the_network_stores(run_scene, scene, stages, settings):
    """To round-off at every step, whatever the rule; the rate times dt adds up to the volume. Twins bring half each."""
    found = run_scene(scene + stages, *settings).history
    size = found["volume/injected"].max() + found["volume/withdrawn"].max()
    assert size > 0.0 and np.abs(found["volume/stored"]).max() > 0.0
    assert np.abs(found["volume/unaccounted"]).max() <= 1e-9 * size
    for name in ("in", "out"):
        steps = found[f"well/{name}/rate"] * found["step/dt"]
        assert found[f"well/{name}/volume"] == pytest.approx(np.cumsum(np.r_[0.0, steps[1:]]), abs=1e-12 * size)
    if scene is TWINS:
        assert found["well/twin/volume"][-1] == found["well/in/volume"][-1] == found["volume/injected"][-1] / 2


def test_a_well_at_its_limit_brings_what_it_can(run_scene):
    """q = min(asked, p_max/R): the rate of the history is that which flows."""
    found = run_scene(PUMPED).history
    expected = np.minimum(np.interp(found["time"], [0, 3, 6], [0, 3e-3, 0]), 5e4 / RESISTANCE)
    assert found["well/in/rate"] == pytest.approx(expected, rel=1e-9, abs=1e-17)
    assert found["well/out/rate"] == pytest.approx(-expected, rel=1e-9, abs=1e-15)
    assert found["well/in/pressure"].max() == pytest.approx(5e4)


def test_a_prescribed_pressure_of_a_fracture_counts_too(run_scene):
    """It brings what the walls take up, and what a well beside it draws."""
    other = """[[geometry.fracture]]
name = "branch"
points = [[2, 1.5], [2, 2.5]]
[initial_stress]"""
    well = '[[well]]\nname = "far"\nat = [2, 2.5]\nflow_rate = -1e-5\n'
    head, tail = CRACK.split("[[well]]", 1)
    text = head.replace("[initial_stress]", other) + well + "[[probe]]" + tail.split("[[probe]]")[1]
    found = run_scene(text + QUASI, "fracture.crack.pressure=2e6").history
    size = found["volume/by_fracture_pressures"][-1]
    assert found["well/far/volume"][-1] == pytest.approx(-5e-9, rel=1e-9)
    assert found["volume/stored"][-1] > 1e-6
    assert np.abs(found["volume/unaccounted"]).max() <= 1e-9 * size


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A scene by a rule that remembers what went through its wells, and its run."""
    folder = tmp_path_factory.mktemp("whole")
    file = folder / "scene.toml"
    file.write_text(RATED + QUASI + "[method]\nflow_integrator = 'bdf2'\n", encoding="utf-8")
    scene = load(file, ["output.checkpoint_every=1", "stage.0.steps=6"])
    run(scene, folder / "run")
    return scene, read_history(folder / "run" / "history.h5")


def cut(scene, folder):
    """The same, ended from outside after three steps."""

    def stop(step):
        if step.state.time > 2.9e-4:
            raise InterruptedError

    with pytest.raises(InterruptedError):
        run(scene, folder, progress=stop)
    return folder


@pytest.mark.serial
def test_wells_go_on_after_a_stop(whole, tmp_path):
    """Their histories are those of the run that was not stopped, to the last bit."""
    folder = cut(whole[0], tmp_path / "run")
    resume(folder)
    found = read_history(folder / "history.h5")
    keys = [key for key in found if key.startswith(("well/", "volume/"))]
    assert len(keys) == 2 * 4 + 5
    assert all(np.array_equal(found[key], whole[1][key], equal_nan=True) for key in keys)


@pytest.mark.serial
def test_a_run_of_a_version_without_them_goes_on_without(whole, tmp_path):
    """All else is as it was."""
    folder = cut(whole[0], tmp_path / "run")
    history, checkpoint = folder / "history.h5", folder / "checkpoint.h5"
    old = {key: rows for key, rows in read_history(history).items() if not key.startswith(("well/", "volume/"))}
    with changed_notes(checkpoint) as notes:
        old = {key: rows[: notes["totals"]["steps"]] for key, rows in old.items()}
        with HistoryFile.after(history, old, read_attributes(history)) as writer:
            notes["seals"]["history"] = writer.seal
        del notes["volumes"]
    resume(folder)
    found = fracflow.open(folder)
    assert found.wells == () and found.volumes == {}
    assert found.history.keys() == old.keys()
    assert np.array_equal(found.history["probe/middle/pressure"], whole[1]["probe/middle/pressure"])


@pytest.mark.serial
def test_wells_from_python_and_as_tables(whole, tmp_path):
    """By name, with units in the heads of columns."""
    run(whole[0], tmp_path / "run")
    found = fracflow.open(tmp_path / "run")
    assert found.wells == ("in", "out")
    assert sorted(found.well("in")) == ["injectivity", "pressure", "rate", "volume"]
    assert found.volumes["injected"][-1] == found.well("in")["volume"][-1] + found.well("out")["volume"][-1]
    with pytest.raises(InputError, match=r"has no well 'no' \(it has: in, out\)"):
        found.well("no")
    tables = {path.stem: path.read_text().splitlines() for path in found.export_csv(tmp_path / "csv")}
    assert tables["well_in"][0] == "time [s],injectivity [m^5/N/s],pressure [N/m^2],rate [m^3/s],volume [m^3]"
    assert len(tables["well_in"]) == len(tables["volume"]) == 8
