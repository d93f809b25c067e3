"""Wells in parts of a network that never meet, and what all but meets, are reported before a run."""

from __future__ import annotations

import json

import pytest
from typer.testing import CliRunner

from fracflow.cli.app import app
from fracflow.remarks import bare

pytestmark = pytest.mark.serial

SCENE = """
rock.rock = {{youngs_modulus = "50 GPa", poissons_ratio = 0.25, density = "2700 kg/m^3"}}
initial_stress = {{xx = "-13 MPa", yy = "-25 MPa"}}
fluid = {{viscosity = "1e-3 Pa s", density = "1000 kg/m^3", initial_pressure = "5 MPa"}}
support = [{{on = ["west", "east", "south", "north"]}}]
well = [
  {{name = "in", at = {{fracture = "Anna", end = "start"}}, pressure = "5.1 MPa"}},
  {{name = "out", at = {{fracture = "Clara", end = "end"}}, pressure = "5 MPa"}},
]
stage = [{{name = "flow", kind = "steady", time_step = 1, steps = 1}}]
output.pictures = false
[geometry]
domain = [0, 0, 100, 100]
size = 20
fracture = [
  {{name = "Anna", points = [[10, 50], [50, 50]]}},
  {{name = "Bruno", points = [[30, 20], [30, 80]]}},
  {{name = "Clara", points = [[{start}, 50], [90, 50]]}},
]
[fracture.default]
normal_stiffness = "50 GPa/m"
shear_stiffness = "20 GPa/m"
aperture = "0.2 mm"
friction_coefficient = 0.6
"""
APART = [
    "wells: they are in 2 parts of the network that never meet: no fluid flows from one to another",
    "wells: part 1: in in Anna, Bruno (2 fractures, 100 long)",
    "wells: part 2: out in Clara (1 fracture, 39.6 long)",
    'wells: parts come nearest at fracture "Anna" and fracture "Clara", 0.4 m apart: move a well, or join them in the traces',
]
NEAR = [
    "near misses: 1 do not meet, by no more than 5 times geometry.snap",
    'near miss: fracture "Anna": end (50, 50) is 0.4 m short of fracture "Clara" at (50.4, 50); geometry.snap = 0.4 joins them',
]


@pytest.fixture
def scene(tmp_path):
    def write(start):
        file = tmp_path / "scene.toml"
        file.write_text(SCENE.format(start=start))
        return str(file)

    return write


def said(*words):
    done = CliRunner().invoke(app, list(words))
    assert done.exit_code == 0, done.output
    return [line.removeprefix("note: ").removeprefix("! ") for line in done.output.splitlines()]


def test_wells_that_no_fluid_can_join_are_told_with_their_parts(scene, tmp_path):
    file = scene(50.4)
    assert {*APART, *NEAR} <= {*said("check", file)} and {*APART, *NEAR} <= {*said("mesh", file)}
    found = said("run", file, "-o", str(tmp_path / "run"))
    assert [line for line in found if line.startswith(("wells:", "near miss"))] == [*NEAR[:4], *APART]
    assert any(line.startswith("sides: ") for line in found), "warnings of the log are printed, too"
    assert found.index(APART[0]) < next(k for k, line in enumerate(found) if "Energy balance" in line)
    log = map(bare, (tmp_path / "run" / "log.txt").read_text().splitlines())
    assert {*APART, *NEAR, "geometry.snap = 0.16 m: 0.4 % of the median length of traces"} <= {*log}
    assert "snap = 0.16\n" in (tmp_path / "run" / "scene.toml").read_text()


def test_check_gives_them_to_scripts(scene):
    told = json.loads("\n".join(said("check", scene(50.4), "--json")))
    assert {*NEAR, *APART} <= {*told["warnings"]} < {*told["notes"]}
    network = told["network"]
    (miss,), (one, other) = network["near_misses"], network["well_parts"]
    assert network["snap"] == pytest.approx(0.16) and miss["owners"] == ["Anna"] and miss["snap"] == 0.4
    assert miss["distance"] == pytest.approx(0.4) == one["apart"] and miss["other"] == 'fracture "Clara"'
    assert (one["wells"], one["fractures"], other["wells"]) == (["in"], ["Anna", "Bruno"], ["out"])


@pytest.mark.parametrize("setting", ["geometry.snap=0.4", "title=met"])
def test_wells_that_fluid_joins_are_not_told(scene, setting):
    lines = said("check", scene(50 if setting == "title=met" else 50.4), "--set", setting)
    assert not any(line.startswith(("wells:", "near miss")) for line in lines)


def test_a_well_that_is_nowhere_does_not_keep_a_mesh_from_being_looked_at(scene):
    lines = said("mesh", scene(50.4), "--set", "well.in.at=[5, 5]")
    assert any("well.in" in line for line in lines) and any(line.startswith("cells:") for line in lines)
