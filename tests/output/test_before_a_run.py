"""The picture of a scene before its run: numbers on the traces, and a command that never needs a solve."""

import re

import numpy as np
import pytest
from matplotlib.image import imread
from typer.testing import CliRunner

from fracflow.cli import picture
from fracflow.cli.app import app
from fracflow.cli.picture import _network
from fracflow.diagnostics.criticality import criticality
from fracflow.errors import InputError
from fracflow.reduction.prepare import read_split
from fracflow.scene.scene import load

pytestmark = pytest.mark.serial

SCENE = """
title = "Cost $5 \\\\ of $x_1$"
rock.rock = {youngs_modulus = "50 GPa", poissons_ratio = 0.25, density = "2700 kg/m^3"}
initial_stress = {xx = "-13 MPa", yy = "-25 MPa", zz = "-15 MPa"}
fluid = {viscosity = "1e-3 Pa s", initial_pressure = "5 MPa", flow_depth = "1 m"}
support = [{on = ["west", "east", "south"]}]
absorbing = [{on = "north"}]
geometry = {domain = [0, 0, 100, 100], size = 30, size_at_fractures = 15, fracture = [
  {name = "a $ b", points = [[30, 20], [50, 54.64101615137754]]},
  {name = "flat", points = [[10, 80], [60, 80]]},
  {name = "glued", points = [[80, 20], [80, 60]]},
  {name = "tied", points = [[20, 90], [90, 90]]},
]}
well = [{name = "w\\\\{}", at = {fracture = "a $ b", end = "start"}, pressure = "6 MPa"}]
stage = [{kind = "quasi-static", time_step = "1 h", steps = 1}]

[fracture.default]
normal_stiffness = "50 GPa/m"
shear_stiffness = "20 GPa/m"
aperture = "0.2 mm"
friction_coefficient = 0.6

[fracture.glued]
cohesion = "3 MPa"
initial_shear_traction = "1 MPa"
initial_normal_traction = "-4 MPa"

[fracture.tied]
law = "linear"
"""


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "odd $name.toml"
    path.write_text(SCENE)
    return path


def of(name, values, mesh):
    return values[mesh.joint_fracture == mesh.fractures.index(name)]


def test_criticality_is_that_of_mohrs_circle(scene):
    """A trace at 60 degrees: sigma' = 16 - 6 cos 120 deg + ... as on the circle, p_c = sigma' - tau/mu."""
    given = load(scene)
    mesh = read_split(given)
    found = criticality(given, mesh)
    centre, radius, angle = 19.0 - 5.0, 6.0, np.deg2rad(60.0)
    pressed, shear = centre + radius * np.cos(2.0 * angle), radius * np.sin(2.0 * angle)
    assert of("a $ b", found.tendency, mesh) == pytest.approx(shear / pressed)
    assert of("a $ b", found.rise, mesh) == pytest.approx(1e6 * (pressed - shear / 0.6))
    assert of("flat", found.tendency, mesh) == pytest.approx(0.0, abs=1e-12)
    assert of("flat", found.rise, mesh) == pytest.approx(20e6)  # it opens
    assert of("glued", found.tendency, mesh) == pytest.approx(0.25)
    assert of("glued", found.rise, mesh) == pytest.approx(4e6)  # cohesion holds until it opens
    assert np.isnan(of("tied", found.rise, mesh)).all()
    deep = criticality(load(scene, ["fluid.pressure_gradient='10 kPa/m'", "fluid.datum=100"]), mesh)
    assert of("flat", deep.rise, mesh) == pytest.approx(20e6 - 20 * 10e3)  # it lies at y = 80
    points = mesh.points[mesh.joint_bottom[mesh.joint_fracture == mesh.fractures.index("a $ b")]]
    below = 0.01 * (100.0 - points[..., 1])
    assert of("a $ b", deep.tendency, mesh) == pytest.approx(shear / (pressed - below))
    assert of("a $ b", deep.rise, mesh) == pytest.approx(1e6 * (pressed - below - shear / 0.6))


def test_rate_and_state_counts_by_its_reference_coefficient(scene, monkeypatch):
    law = "{law='rate-and-state', direct_effect=0.01, evolution_effect=0.014, characteristic_slip=1e-3,"
    given = load(scene, [f'fracture."a $ b"={law} reference_slip_rate=1e-6, initial_slip_rate=1e-12}}'])
    mesh = read_split(given)
    same, found = criticality(load(scene), mesh), criticality(given, mesh)
    assert of("a $ b", found.rise, mesh) == pytest.approx(of("a $ b", same.rise, mesh))
    drawn = []
    monkeypatch.setattr(picture, "save", lambda figure, _: drawn.append([a.get_title("left") for a in figure.axes[:2]]))
    for each in (load(scene), given):
        picture.picture_of_scene(each, scene.with_suffix(".png"))
    for (left, right), (shear, slip) in zip(
        drawn, (("Slip tendency", "to slip"), ("Shear over", "at V₀")), strict=True
    ):
        assert left.startswith(shear) and right.endswith(slip)


def test_a_fault_past_its_strength_has_no_rise_left(scene):
    given = load(scene, ["fracture.glued.cohesion=0", "fracture.glued.initial_shear_traction=3e6"])
    mesh = read_split(given)
    assert np.all(of("glued", criticality(given, mesh).rise, mesh) == 0.0)
    frictionless = load(scene, ["fracture.flat.friction_coefficient=0", "fracture.flat.cohesion=1e6"])
    assert of("flat", criticality(frictionless, mesh).rise, mesh) == pytest.approx(20e6)


def test_a_scene_is_drawn_before_its_run(scene, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(app, ["picture", str(scene), "--set", "geometry.size=25"])
    assert done.exit_code == 0, done.output
    path = tmp_path / done.output.strip()
    assert path.name == "odd $name-before.png" and path.parent.name == "runs"
    image = imread(path)[..., :3]
    assert image.shape[1] > 2000 and image.std() > 0.02


def test_held_and_absorbing_sides_are_told_apart(scene):
    given = load(scene)
    sides = _network(given, read_split(given), {}).sides
    assert np.linalg.norm(np.diff(sides["support"], axis=1), axis=-1).sum() == pytest.approx(300.0)
    assert np.ptp(sides["absorbing side"][..., 0]) == 100.0 and np.all(sides["absorbing side"][..., 1] == 100.0)


def test_what_cannot_be_drawn_is_said(scene, tmp_path):
    for words, says in (
        ([str(scene), "-o", "there.pdf"], "is no file for a picture"),
        ([str(tmp_path), "-o", "there.png"], "-o and --set are for scenes"),
        ([str(tmp_path / "none")], "none"),
    ):
        done = CliRunner().invoke(app, ["picture", *words])
        assert isinstance(done.exception, InputError) and re.search(says, str(done.exception))


def test_wells_that_cannot_stand_are_left_out_and_said(scene, tmp_path):
    """A steady stage that pumps into a fracture without an outlet is refused; it is drawn all the same."""
    text = scene.read_text().replace('pressure = "6 MPa"', 'flow_rate = "1 L/s"').replace("quasi-static", "steady")
    scene.write_text(text)
    done = CliRunner().invoke(app, ["picture", str(scene), "-o", str(tmp_path / "there.png")])
    assert done.exit_code == 0 and "note: wells and probes are not drawn" in done.output
    assert (tmp_path / "there.png").stat().st_size > 0
