"""The table by fracture: means and largest values along each, its moment, and how it stands."""

import csv
import re
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from fracflow.cli.report import report
from fracflow.model.setup import read_sized
from fracflow.output.catalogue import fault_ends
from fracflow.output.export import export_csv
from fracflow.output.fracture_table import fracture_table
from fracflow.scene.scene import load
from fracflow.simulation.run import run

pytestmark = pytest.mark.serial

SCENE = """
rock.rock = {youngs_modulus = "25 GPa", poissons_ratio = 0.25, density = "2700 kg/m^3"}
initial_stress = {xx = "-10 MPa", yy = "-10 MPa", zz = "-10 MPa", xy = "3 MPa"}
fluid = {viscosity = "1e-3 Pa s", initial_pressure = "1 MPa", flow_depth = "1 m"}
support = [{on = ["west", "east", "south", "north"]}]
geometry = {domain = [0, 0, 100, 100], size = 40, size_at_fractures = 20, fracture = [
  {name = "x[1] $", points = [[20, 30], [80, 30]]},
  {name = "still", points = [[30, 70], [70, 70]]},
]}
stage = [{kind = "quasi-static", time_step = "1 d", steps = 3}]
output.pictures = false
fracture."x[1] $".pressure = [[0, "1 MPa"], ["3 d", "6 MPa"]]

[fracture.default]
normal_stiffness = "50 GPa/m"
shear_stiffness = "20 GPa/m"
aperture = "0.2 mm"
friction_coefficient = 0.6
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "scene.toml").write_text(SCENE)
    run(load(tmp_path / "scene.toml"), tmp_path / "out")
    return tmp_path / "out"


def test_a_row_a_fracture_on_the_terminal_and_as_csv(folder):
    found = fracture_table(folder)
    assert found.names == ["x[1] $", "still"] and found.state == ["slips", "sticks"]
    columns = found.columns
    assert columns["length"] == pytest.approx([60.0, 40.0])
    assert columns["largest_pressure"][0] == pytest.approx(6e6)
    slip = columns["largest_slip"]
    assert slip[0] > 1e-4 and slip[1] == 0.0
    assert 0.3 < columns["moment"][0] / (10e9 * slip[0] * 60.0) < 1.0 and columns["moment"][1] == 0.0
    assert np.all(columns["largest_aperture"] >= columns["mean_aperture"]) and np.isnan(columns["first_slip"][1])
    console = Console(width=200, record=True, quiet=False, file=open("/dev/null", "w"))
    report(folder, console)
    text = console.export_text()
    assert "Fractures at 3 days" in text and "x[1] $" in text and "first slip [days]" in text and "node" not in text
    (table,) = (path for path in export_csv(folder) if path.name == "fractures.csv")
    rows = list(csv.DictReader(table.open()))
    assert [row["fracture"] for row in rows] == found.names and float(rows[0]["length [m]"]) == pytest.approx(60.0)
    assert float(rows[0]["moment [N m/m]"]) == columns["moment"][0]
    events = folder / "events.csv"
    head, *rows = csv.reader(events.open())
    rows = [[cell if key != "start" else "0.0" for key, cell in zip(head, row, strict=True)] for row in rows]
    events.write_text("\n".join(",".join(row) for row in [head, *rows]) + "\n")
    report(folder, console)
    assert re.search(r"at time 0 +slips", console.export_text())


def test_a_table_without_scene_and_mesh_lacks_moments_only(folder):
    (folder / "mesh.h5").unlink()
    columns = fracture_table(folder).columns
    assert np.isnan(columns["moment"]).all() and np.isfinite(columns["largest_slip"]).all()


def test_a_folder_without_fields_has_no_table(tmp_path):
    assert fracture_table(tmp_path) is None


def test_a_joint_between_rigid_walls_has_no_bounded_modulus(recwarn):
    """Its moment has no meaning, and nobody is warned of a division by zero."""
    scene = load(Path(__file__).parents[2] / "meshes" / "failures" / "closing_joint" / "scene.toml")
    ends = fault_ends(scene, read_sized(scene), np.zeros(0, dtype=np.int64))
    assert len(ends.modulus) and not np.isfinite(ends.modulus).any() and not recwarn.list
