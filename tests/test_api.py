"""The program from Python, and the histories that it writes as CSV."""

import csv
import importlib
import pkgutil
import subprocess
import sys

import numpy as np
import pytest

import fracflow
from fracflow.errors import InputError

# A block under a known shear: u_x = 0.01 t y / 1 ft, in feet and pounds.
SCENE = """
units = "ft-lbf-s"
title = "sheared"
[rock.rock]
youngs_modulus = 1e6
poissons_ratio = 0.25
density = 5
[geometry]
domain = [0, 0, 2, 1]
size = 0.5
[[support]]
on = ["south", "north", "east", "west"]
displacement_gradient = [[0, {time = [0, 4], value = [0, 0.04]}], [0, 0]]
[[probe]]
name = "top/left, \\u00e9"
at = [0, 1]
[[probe]]
name = "right"
at = [2, 1]
quantities = ["stress"]
[[stage]]
kind = "quasi-static"
time_step = 1
steps = 4
"""
SHEAR = 1e6 / 2.5  # G = E / 2(1 + nu)


@pytest.fixture
def scene(shared_tmp, comm):
    """The scene's file, on all ranks."""
    if comm.rank == 0:
        (shared_tmp / "sheared.toml").write_text(SCENE, encoding="utf-8")
    comm.barrier()
    return shared_tmp / "sheared.toml"


def test_a_scene_is_loaded_run_and_opened(scene, shared_tmp):
    given = fracflow.load(scene, ["stage.0.steps=3"])
    assert (given.title, given.name, given.stage[0].steps) == ("sheared", "sheared", 3)
    done = fracflow.run(given, shared_tmp / "out")
    for run in (done, fracflow.open(shared_tmp / "out")):
        assert run.folder == shared_tmp / "out"
        np.testing.assert_allclose(run.times, [0, 1, 2, 3])
        top = run.probe("top/left, é")
        np.testing.assert_allclose(top["displacement"], np.outer(run.times, [0.01, 0.0]), atol=1e-12)
        np.testing.assert_allclose(top["strain"][:, 3], 0.005 * run.times, atol=1e-12)
        np.testing.assert_allclose(
            run.probe("right")["stress"], np.outer(run.times, [0, 0, 0, SHEAR * 0.01]), atol=1e-6
        )
        np.testing.assert_allclose(
            run.energy["rock_strain"], 0.5 * SHEAR * (0.01 * run.times) ** 2 * 2, rtol=1e-9, atol=1e-9
        )
        assert set(run.probe("right")) == {"stress"} and run.probes == ("right", "top/left, é")
        assert set(run.regimes) == {"quasi-static"}
        assert run.steps["dt"].tolist() == [0, 1, 1, 1] and run.history["step/dt"].shape == (4,)
        assert run.events.shape == (0,) and run.events["start"].dtype == float
        assert {"part", "left_out"} <= set(run.plan[0])
        assert run.units == {"length": "ft", "force": "lbf", "time": "s"}
        assert run.scene.stage[0].steps == 3
        with pytest.raises(InputError, match=r"has no probe 'left' .it has: right, top/left, é"):
            run.probe("left")


def test_a_run_goes_to_its_own_folder_by_default(scene, shared_tmp, monkeypatch):
    monkeypatch.chdir(shared_tmp)
    assert fracflow.run(fracflow.load(scene)).folder.resolve() == shared_tmp.resolve() / "runs" / "sheared"
    assert (shared_tmp / "runs" / "sheared" / "history.h5").is_file()


def table(path):
    with path.open(encoding="utf-8", newline="") as file:
        heads, *rows = csv.reader(file)
    return {head: np.array(column, float) for head, column in zip(heads, zip(*rows, strict=True), strict=True)}


def test_histories_as_csv(scene, shared_tmp, comm):
    run = fracflow.run(fracflow.load(scene), shared_tmp / "out")
    if comm.rank:
        return
    files = {path.name: table(path) for path in run.export_csv()}
    assert files.keys() == {"steps.csv", "energy.csv", "probe_right.csv", "probe_top_left, é.csv"}
    assert all(path.exists() for path in (shared_tmp / "out" / "csv").iterdir())
    stress = files["probe_right.csv"]
    assert list(stress) == ["time [s]", *(f"stress_{part} [lbf/ft^2]" for part in ("xx", "yy", "zz", "xy"))]
    np.testing.assert_allclose(stress["stress_xy [lbf/ft^2]"], SHEAR * 0.01 * np.arange(5), atol=1e-6)
    top = files["probe_top_left, é.csv"]
    np.testing.assert_array_equal(top["velocity_x [ft/s]"], run.probe("top/left, é")["velocity"][:, 0])
    assert {"acceleration_y [ft/s^2]", "strain_xy", "displacement_x [ft]"} <= set(top)
    np.testing.assert_array_equal(files["energy.csv"]["rock_strain [lbf ft/ft]"], run.energy["rock_strain"])
    assert {"dt [s]", "newton"} <= set(files["steps.csv"])

    (one,) = run.export_csv(shared_tmp / "all.csv")
    whole = table(one)
    np.testing.assert_array_equal(whole["energy/rock_strain [lbf ft/ft]"], run.energy["rock_strain"])
    assert len(whole) == sum(len(columns) - 1 for columns in files.values()) + 1


@pytest.mark.serial
def test_export_from_the_command_line(tmp_path):
    def export(*words):
        return subprocess.run([sys.executable, "-m", "fracflow", "export", *words], capture_output=True, text=True)

    for words, told in (((str(tmp_path), "--csv"), "history.h5: no such file"), ((str(tmp_path),), "give --csv")):
        done = export(*words)
        assert done.returncode == 2 and told in done.stderr and done.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_what_is_no_run_is_refused(tmp_path):
    with pytest.raises(InputError, match="holds no run"):
        fracflow.open(tmp_path)


@pytest.mark.serial
def test_the_package_is_light_and_run_stays_the_function():
    """Opening a run needs no PETSc; importing the module fracflow.run leaves the function of that name."""
    code = """
import sys, fracflow
heavy = {"numpy", "h5py", "pydantic", "mpi4py", "petsc4py"}
assert not heavy & sys.modules.keys()
fracflow.open, fracflow.Run
assert not {"mpi4py", "petsc4py"} & sys.modules.keys()
function = fracflow.run
from fracflow.simulation.run import run as loop, resume
import fracflow.simulation.run
assert fracflow.run is function is fracflow.api.run and loop is not function
assert set(fracflow.__all__) <= {name for name in fracflow.__all__ if getattr(fracflow, name)}
"""
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.serial
def test_packages_have_all_that_they_say_they_have():
    names = [each.name for each in pkgutil.walk_packages(fracflow.__path__, "fracflow.") if each.ispkg]
    packages = [fracflow, *map(importlib.import_module, names)]
    said = [(each.__name__, name) for each in packages for name in getattr(each, "__all__", ())]
    assert len(said) > 30
    assert [pair for pair in said if not hasattr(sys.modules[pair[0]], pair[1])] == []
