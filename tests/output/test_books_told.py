"""The summary of a run on its energy balance: an alarm where it is open, none where all of it is round-off."""

import numpy as np
import pytest
from rich.console import Console

from fracflow._petsc import MPI
from fracflow.cli.app import main
from fracflow.cli.report import report
from fracflow.output import HistoryFile, read_history
from fracflow.output.history import read_rows
from fracflow.scene.scene import load
from fracflow.simulation.run import run

pytestmark = pytest.mark.serial
STILL = """
method.stepper = "explicit"
output.pictures = false
rock.rock = {youngs_modulus = "30 GPa", poissons_ratio = 0.25, density = 2700}
initial_stress = {xx = "-13 MPa", yy = "-25 MPa", zz = "-15 MPa", xy = "3 MPa"}
fracture.default.aperture = "0.2 mm"
fracture.default.friction_coefficient = 0.6
fracture.default.normal_stiffness = "50 GPa/m"
fracture.default.shear_stiffness = "20 GPa/m"
support = [{on = "side1"}]
load = [{on = ["side2", "side3", "side4"], traction = "initial-stress"}]
stage = [{kind = "dynamic", time_step = 1e-4, steps = 10}]
[geometry]
domain = [[0, 0], [97, 11], [90, 83], [-7, 71]]
size = 15
fracture = [{name = "a", points = [[20, 20], [70, 60]]}, {name = "b", points = [[60, 10], [40, 70]]}]
"""


@pytest.fixture
def still(tmp_path):
    """A run in which nothing moves but round-off."""
    (tmp_path / "scene.toml").write_text(STILL)
    run(load(tmp_path / "scene.toml"), tmp_path / "out", MPI.COMM_SELF)
    return tmp_path / "out"


def told(folder):
    console = Console(width=200, record=True, quiet=False, file=(folder / "told").open("w"))
    report(folder, console)
    return console.export_text()


def test_round_off_is_no_open_book(still):
    history = read_history(still / "history.h5")
    entries = {key: np.abs(values).max() for key, values in history.items() if key.startswith("energy/")}
    assert entries["energy/residual"] > 1e-6 * max(entries.values())  # open, were the largest entry the scale
    said = told(still)
    assert "! energy balance" not in said and "all entries are round-off" in said


def test_advice_has_the_keys_of_the_stages(still):
    """Neither pressure, which nothing here pumps, nor increment_per_step of controls, which a stage auto does not have."""
    assert ": more steps may reach it" in told(still)
    longer = STILL.replace("steps = 10", "end = 1e-3").replace('kind = "dynamic"', 'kind = "auto"')
    (still / "scene.toml").write_text(longer)
    assert ": a later end may reach it" in told(still)


def test_a_run_is_replaced_only_by_a_scene_that_can_run(still, monkeypatch, capfd):
    """Notes on unusual values stand on the terminal and in the log."""
    scene = still.parent / "scene.toml"
    words = ["fracflow", "run", str(scene), "-o", str(still), "--set", "stage.0.steps=1"]
    words += ["--set", "rock.rock.youngs_modulus=50 MPa"]
    for more, is_told in ((["--set", "load=[]"], False), ([], True)):
        monkeypatch.setattr("sys.argv", words + more)
        with pytest.raises(SystemExit) as end:
            main()
        said = capfd.readouterr()
        assert (end.value.code or 0) == (0 if is_told else 2), said.err
        assert said.out.count("is replaced") == is_told
    unusual = "! rock.rock.youngs_modulus = 5e+07 N/m^2 is unusually small: is its unit right?"
    assert unusual in said.out and unusual in (still / "log.txt").read_text()


def test_what_is_larger_is_told(still):
    """A millijoule that is missing of an energy of 10 J, beside 7e7 J that the initial stresses store."""
    rows, about = read_rows(still / "history.h5", len(read_history(still / "history.h5")["time"]))
    rows["energy/rock_strain"][-1], rows["energy/residual"][-1] = 10.0, 1e-3
    HistoryFile.after(still / "history.h5", rows, about).close()
    said = told(still)
    assert "! energy balance: 1.0e-04 of the largest entry is left over" in said and "round-off" not in said
