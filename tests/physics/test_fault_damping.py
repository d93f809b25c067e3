"""Damping of the cells at faults in explicit steps: what it cures, where it acts, what it costs, what stays as it was."""

from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

from fracflow._petsc import MPI
from fracflow.cli.app import app
from fracflow.diagnostics import pre_run_checks
from fracflow.integrators.explicit import damped_rate
from fracflow.model.mass import cell_rates
from fracflow.model.terms.fault_damping import asymmetry, damping_at_faults, few_cells, is_sudden
from fracflow.reduction.prepare import prepare
from fracflow.scene.advice import advice
from fracflow.scene.scene import load

FAULT = """
[output]
pictures = false
[method]
stepper = "explicit"
[rock.rock]
youngs_modulus = "80 GPa"
poissons_ratio = 0.25
density = 2670
[initial_stress]
xx = "-120 MPa"
yy = "-120 MPa"
xy = "70 MPa"
unbalanced = "carried"
[[absorbing]]
on = ["west", "east", "south", "north"]
[fracture.main]
law = "slip-weakening"
normal_stiffness = "1000 GPa/m"
shear_stiffness = "1000 GPa/m"
aperture = "1 m"
friction_coefficient = 0.677
dynamic_friction_coefficient = 0.525
slip_weakening_distance = "0.4 m"
[fracture.main.initial_shear_traction]
along = ["0 km", "3.499 km", "3.501 km", "6.499 km", "6.501 km", "10 km"]
value = ["70 MPa", "70 MPa", "81.6 MPa", "81.6 MPa", "70 MPa", "70 MPa"]
[[probe]]
name = "left"
at = ["-2.5 km", 0]
on = "main"
[[probe]]
name = "middle"
at = [0, 0]
on = "main"
[[probe]]
name = "right"
at = ["2.5 km", 0]
on = "main"
[[stage]]
kind = "dynamic"
time_step = "10 ms"
end = "3.2 s"
"""
TRIANGLES = """
[geometry]
domain = ["-8 km", "-4 km", "8 km", "4 km"]
size = "500 m"
size_at_fractures = "125 m"
[[geometry.fracture]]
name = "main"
points = [["-5 km", 0], ["5 km", 0]]
"""
QUADRILATERALS = """
[mesh]
file = "fault.geo"
"""
GEO = """
h = 125;
For j In {{0:2}}
  Point(4*j + 1) = {{-8000, 4000*(j - 1), 0}}; Point(4*j + 2) = {{-5000, 4000*(j - 1), 0}};
  Point(4*j + 3) = {{5000, 4000*(j - 1), 0}}; Point(4*j + 4) = {{8000, 4000*(j - 1), 0}};
  For i In {{1:3}}
    Line(10*j + i) = {{4*j + i, 4*j + i + 1}};
    Transfinite Curve{{10*j + i}} = (i == 2 ? 80 : 24) + 1;
  EndFor
EndFor
For i In {{1:4}}
  Line(100 + i) = {{i, i + 4}}; Transfinite Curve{{100 + i}} = 16 + 1 Using Progression 1/1.06;
  Line(110 + i) = {{i + 4, i + 8}}; Transfinite Curve{{110 + i}} = {above} + 1 Using Progression 1.06;
EndFor
For i In {{1:3}}
  Curve Loop(i) = {{i, 101 + i, -(10 + i), -(100 + i)}}; Plane Surface(i) = {{i}};
  Curve Loop(10 + i) = {{10 + i, 111 + i, -(20 + i), -(110 + i)}}; Plane Surface(10 + i) = {{10 + i}};
EndFor
Transfinite Surface "*";
Recombine Surface "*";
Physical Surface("rock") = {{1, 2, 3, 11, 12, 13}};
Physical Curve("main") = {{12}};
Physical Curve("south") = {{1, 2, 3}}; Physical Curve("north") = {{21, 22, 23}};
Physical Curve("west") = {{101, 111}}; Physical Curve("east") = {{104, 114}};
"""
ONLY_OF_SLIP = ("friction", "dynamic_friction", "slip_weakening", "aperture")
PLACES = ("left", "middle", "right")


def model(folder, text, *overrides):
    (folder / "scene.toml").write_text(text, encoding="utf-8")
    return prepare(load(folder / "scene.toml", list(overrides)), MPI.COMM_SELF)


@pytest.mark.serial
def test_a_rupture_on_triangles_slips_as_on_quadrilaterals(run_scene, shared_tmp):
    """Behind the front, from 0.3 s on, the normal traction keeps its value; undamped it is out by 1 % rms, 3 % at worst."""
    (shared_tmp / "fault.geo").write_text(GEO.format(above=16))
    even, found = run_scene(FAULT + QUADRILATERALS), run_scene(FAULT + TRIANGLES)
    for place in PLACES:
        slip, time = np.abs(found.probe(place, "slip")), found.history["time"]
        off = found.probe(place, "normal_traction")[time > time[np.argmax(slip > 1e-3)] + 0.3] / -120e6 - 1.0
        assert np.sqrt(np.mean(off**2)) < 0.004 and np.abs(off).max() < 0.012, place
        assert slip[-1] == pytest.approx(np.abs(even.probe(place, "slip"))[-1], rel=0.02), place
    assert found.closes(1e-12)
    assert 0.0 < found.history["energy/damping"][-1] < 0.01 * found.history["energy/friction"][-1]
    assert not even.history["energy/damping"].any()


@pytest.mark.serial
@pytest.mark.parametrize(("above", "is_damped"), [(16, False), (20, True)])
def test_only_walls_that_are_no_mirror_images_are_damped(tmp_path, above, is_damped):
    (tmp_path / "fault.geo").write_text(GEO.format(above=above))
    made = model(tmp_path, FAULT + QUADRILATERALS)
    ops = made.operators
    assert (asymmetry(ops.blocks, made.scene).max() > 1e-3) == is_damped
    found = damping_at_faults(ops, made.scene)
    assert (None if found is None else found.ratio) == (0.25 if is_damped else None)
    given = model(tmp_path, FAULT + QUADRILATERALS, "method.fault_damping=0.1")
    found = damping_at_faults(given.operators, given.scene)
    assert found.ratio == 0.1
    assert (found.scale > 1.0).sum() == 2 * 3 * (80 + 2 * 3)  # three layers all around


@pytest.mark.serial
@pytest.mark.parametrize("override", ["model=report", "method.fault_damping=0", "fracture.main.law=linear"])
def test_none_where_none_is_wanted(tmp_path, override):
    text = FAULT + TRIANGLES
    if "linear" in override:
        text = "\n".join(line for line in text.splitlines() if not line.startswith(ONLY_OF_SLIP))
    made = model(tmp_path, text, override, "method.storage=lumped")
    assert damping_at_faults(made.operators, made.scene) is None


SQUARES = """
units = "none"
method = {stepper = "explicit", fault_damping = 0.1}
rock.rock = {youngs_modulus = 2.5, poissons_ratio = 0.25, density = 4}
mesh = {file = "squares.geo"}
stage = [{kind = "dynamic", time_step = 0.1, end = 1}]
[fracture.main]
law = "slip-weakening"
normal_stiffness = 10
shear_stiffness = 10
aperture = 1
friction_coefficient = 0.6
dynamic_friction_coefficient = 0.5
slip_weakening_distance = 1
"""
SQUARES_GEO = """
h = 0.5; n = 8;
For j In {0:2}
  Point(2*j + 1) = {0, 3*(j - 1)*h, 0}; Point(2*j + 2) = {n*h, 3*(j - 1)*h, 0};
  Line(10 + j) = {2*j + 1, 2*j + 2}; Transfinite Curve{10 + j} = n + 1;
EndFor
For j In {0:1}
  Line(20 + j) = {2*j + 1, 2*j + 3}; Line(30 + j) = {2*j + 2, 2*j + 4}; Transfinite Curve{20 + j, 30 + j} = 3 + 1;
  Curve Loop(j + 1) = {10 + j, 30 + j, -(11 + j), -(20 + j)}; Plane Surface(j + 1) = {j + 1};
EndFor
Transfinite Surface "*";
Recombine Surface "*";
Physical Surface("rock") = {1, 2};
Physical Curve("main") = {11};
"""


@pytest.mark.serial
def test_squares_that_expand_lose_what_the_ratio_says(tmp_path):
    """Power per area of v = a (x, y), all cells damped: 4 a^2 (lambda + mu) 2 xi/omega, omega^2 = 8 (lambda + mu)/(rho h^2)."""
    (tmp_path / "squares.geo").write_text(SQUARES_GEO)
    made = model(tmp_path, SQUARES)
    damping, block = damping_at_faults(made.operators, made.scene), made.operators.blocks.solid
    speed, force = (made.operators.layout.solid_vector() for _ in range(2))
    rate, ratio, side, density, lame = 3.0, 0.1, 0.5, 4.0, 2.0  # of E = 2.5, nu = 1/4: lambda = mu = 1
    speed.getArray()[block.unknown] = rate * block.points
    damping.matrix.mult(speed, force)
    fastest = np.sqrt(8.0 * lame / density) / side
    assert speed.dot(force) == pytest.approx(48 * side**2 * 4.0 * rate**2 * lame * 2.0 * ratio / fastest, rel=1e-12)


@pytest.mark.serial
@pytest.mark.parametrize(
    ("keys", "sudden"),
    [
        ({"pressure": [[0, 0], [1, 0.039]]}, False),
        ({"pressure": [[0, 0], [8, 0], [10, -0.082]]}, True),
        ({"pressure": 9}, False),
        ({"stick_slip_ratio": 0.9}, False),
    ],
)
def test_mirror_images_are_damped_where_strength_falls_at_once(tmp_path, keys, sudden):
    """By a pressure that changes by over 1e-3 of a traction of 10 in 1/omega = 0.25 of the squares."""
    (tmp_path / "squares.geo").write_text(SQUARES_GEO)
    text = f"fluid = {{viscosity = 1, specific_weight = 1}}\ninitial_stress = {{yy = -10}}{SQUARES}"
    if "stick_slip_ratio" in keys:
        text = "\n".join(line for line in text.splitlines() if not line.startswith(("law", "dynamic", "slip_w"))) + "\n"
    text += "\n".join(f"{key} = {value}" for key, value in keys.items())
    made = model(tmp_path, text, "method.fault_damping=auto")
    ops = made.operators
    assert asymmetry(ops.blocks, made.scene).max() < 1e-9
    assert np.array_equal(is_sudden(ops, made.scene, cell_rates(ops.blocks, made.scene)), np.full(8, sudden))
    found = damping_at_faults(ops, made.scene)
    assert (None if found is None else found.ratio) == (0.45 if sudden else None)


@pytest.mark.serial
@pytest.mark.parametrize("ratio", [0.0, 0.1, 0.25, 1.0])
def test_the_critical_step_of_a_damped_vibration(ratio):
    """u_new - 2 u + u_old + dt^2 u + 2 ratio dt (u - u_old) = 0 stays bounded up to the step that damped_rate tells."""
    limit = 2.0 / np.sqrt(damped_rate(ratio))
    for share, bounded in ((0.999, True), (1.001, False)):
        dt = share * limit
        roots = np.roots([1.0, -2.0 + dt**2 + 2.0 * ratio * dt, 1.0 - 2.0 * ratio * dt])
        assert (np.abs(roots).max() <= 1.0 + 1e-12) == bounded


@pytest.mark.serial
@pytest.mark.parametrize(
    ("override", "warns"), [("method.fault_damping=0", True), ("method.stepper=newmark", True), ("title=x", False)]
)
def test_a_rupture_that_nothing_damps_is_told(tmp_path, override, warns):
    (tmp_path / "scene.toml").write_text(FAULT + TRIANGLES, encoding="utf-8")
    lines = advice(load(tmp_path / "scene.toml", [override]))
    assert any("normal traction rings" in line for line in lines) == warns


@pytest.mark.serial
@pytest.mark.parametrize(
    ("cells", "stepper", "tells"),
    [(QUADRILATERALS, "newmark", True), (QUADRILATERALS, "explicit", False), (TRIANGLES, "newmark", False)],
)
def test_the_rule_that_is_cheaper_for_a_rupture_is_told_on_mirrored_walls(tmp_path, cells, stepper, tells):
    (tmp_path / "fault.geo").write_text(GEO.format(above=16))
    (tmp_path / "scene.toml").write_text(FAULT + cells, encoding="utf-8")
    lines = advice(load(tmp_path / "scene.toml", [f"method.stepper={stepper}"]))
    assert any('"explicit" has the same error in 0.4' in line for line in lines) == tells


@pytest.mark.serial
@pytest.mark.parametrize(
    ("overrides", "warns"),
    [
        (["geometry.growth=0.3"], True),
        (["geometry.growth=0.1"], False),
        ([], False),
        (["geometry.growth=0.3", "fracture.main.law=hyperbolic-coulomb"], False),
    ],
)
def test_cells_that_grow_too_fast_beside_a_rupture_are_told(tmp_path, overrides, warns):
    text = FAULT + TRIANGLES
    if "hyperbolic" in "".join(overrides):
        weakens = ("dynamic_friction", "slip_weakening")
        text = "\n".join(line for line in text.splitlines() if not line.startswith(weakens))
    (tmp_path / "scene.toml").write_text(text, encoding="utf-8")
    lines = advice(load(tmp_path / "scene.toml", overrides))
    assert any("geometry.growth = 0.3" in line for line in lines) == warns


AUTO = ('kind = "dynamic"\ntime_step = "10 ms"', 'kind = "auto"\ntime_step = "1 s"\ndynamic_time_step = "10 ms"')


@pytest.mark.serial
@pytest.mark.parametrize(("stepper", "warns"), [("newmark", True), ("explicit", False)])
def test_a_rupture_of_a_stage_auto_that_nothing_damps_is_told_too(tmp_path, stepper, warns):
    (tmp_path / "scene.toml").write_text((FAULT + TRIANGLES).replace(*AUTO), encoding="utf-8")
    lines = advice(load(tmp_path / "scene.toml", [f"method.stepper={stepper}"]))
    assert any("normal traction rings" in line for line in lines) == warns


@pytest.mark.serial
@pytest.mark.parametrize(
    ("change", "override", "told"),
    [
        (("", ""), "title=x", "probe.left and 2 more: behind sharp fronts slip_rate rings"),
        (("", ""), "geometry.refine=1", f"= {8 * 62.5 / np.sqrt(32e9 / 2670.0):.3g} s"),  # mu = 32 GPa
        (("", ""), "geometry.size_at_fractures=100", f"= {8 * 100.0 / np.sqrt(32e9 / 2670.0):.3g} s"),
        (AUTO, "title=x", "probe.left and 2 more"),
        (('on = "main"', 'on = "main"\nquantities = ["slip"]'), "title=x", ""),
        (('kind = "dynamic"', 'kind = "quasi-static"'), "method.stepper=newmark", ""),
    ],
)
def test_slip_rates_that_are_not_to_be_read_are_told(tmp_path, change, override, told):
    (tmp_path / "scene.toml").write_text((FAULT + TRIANGLES).replace(*change), encoding="utf-8")
    lines = [line for line in advice(load(tmp_path / "scene.toml", [override])) if "slip_rate" in line]
    assert len(lines) == bool(told) and all(told in line for line in lines)


@pytest.mark.serial
def test_the_time_over_which_rates_are_to_be_read_needs_a_size(tmp_path):
    (tmp_path / "fault.geo").write_text(GEO.format(above=16))
    (tmp_path / "scene.toml").write_text(FAULT + QUADRILATERALS, encoding="utf-8")
    (line,) = (line for line in advice(load(tmp_path / "scene.toml")) if "slip_rate" in line)
    assert "at least 8 h/c_s, kept" in line


@pytest.mark.serial
def test_notes_of_a_run_name_tables_whole(tmp_path):
    (tmp_path / "scene.toml").write_text(FAULT + TRIANGLES, encoding="utf-8")
    (tmp_path / "taken").write_text("no folder", encoding="utf-8")
    words = ["run", str(tmp_path / "scene.toml"), "-o", str(tmp_path / "taken"), "--set", "method.stepper=newmark"]
    said = " ".join(CliRunner().invoke(app, words).output.split())
    assert "or a [mesh] that mirrors itself" in said and "by the sizes of [geometry]" in said


@pytest.mark.serial
@pytest.mark.parametrize(
    ("over", "override", "warns"),
    [
        ("[[0, 0], [9, 1]]", "method.stepper=newmark", True),
        ("[[0, 0], [9, 1]]", "method.fault_damping=0", True),
        ("[[0, 0], [9, 1]]", "title=x", False),
        ("[[0, 0], [11, 1]]", "method.stepper=newmark", False),
        ("1", "method.stepper=newmark", False),
    ],
)
def test_pressures_that_change_at_once_are_told_where_nothing_damps(tmp_path, over, override, warns):
    """By more than a hundredth of what they change by in a step of 0.1."""
    text = f"fluid = {{viscosity = 1, specific_weight = 1}}{SQUARES}pressure = {over}\n"
    (tmp_path / "scene.toml").write_text(text, encoding="utf-8")
    lines = advice(load(tmp_path / "scene.toml", [override]))
    assert any("fracture.main.pressure changes within a step" in line for line in lines) == warns


@pytest.mark.serial
@pytest.mark.parametrize(
    ("over", "override", "warns"),
    [
        ("5", "title=x", True),
        ("5", "method.stepper=implicit-euler", False),
        ("5", "fluid.initial_pressure=5", False),
        ("[[0, 0], [1, 5]]", "title=x", False),
        ("[[0, 0], [1, 5]]", "fluid.initial_pressure=5", True),
    ],
)
def test_pressures_that_jump_as_waves_begin_are_told(tmp_path, over, override, warns):
    text = f"fluid = {{viscosity = 1, specific_weight = 1}}{SQUARES}pressure = {over}\n"
    (tmp_path / "scene.toml").write_text(text, encoding="utf-8")
    lines = advice(load(tmp_path / "scene.toml", [override]))
    assert any("in the first instant" in line for line in lines) == warns


@pytest.mark.serial
def test_faults_with_few_cells_are_told():
    """The part of slip that damping takes falls as the number of cells along a fault grows (``scripts/bench few_cells``)."""
    joints = SimpleNamespace(fracture=np.repeat([0, 1, 2], [5, 20, 10]), fractures=("short", "long", "half"))
    blocks, all_of_them = SimpleNamespace(comm=MPI.COMM_SELF, joints=joints), np.ones(35, dtype=bool)
    told = few_cells(blocks, all_of_them)
    assert "short (5 cells, about 20 %), half (10 cells, about 10 %);" in told and "long (" not in told
    assert few_cells(blocks, joints.fracture == 1) == ""


@pytest.mark.serial
@pytest.mark.parametrize(("middle", "warns"), [("71 MPa", False), ("81.6 MPa", True)])
def test_a_start_past_the_strength_of_a_law_without_slip_length_is_told(tmp_path, middle, warns):
    """On mirrored squares of 125, 62 and 31 m, damped by 0.45, such a patch slips 1.26, 1.84 and 1.08 m: rely on none."""
    falls = FAULT[FAULT.index("friction_coefficient") : FAULT.index("[fracture.main.initial_shear")]
    text = FAULT.replace(falls, "friction_coefficient = 0.6\n").replace('"slip-weakening"', '"hyperbolic-coulomb"')
    text = text.replace("81.6 MPa", middle).replace('"70 MPa"', '"62 MPa"')
    values = []
    for each in (text, FAULT):
        made = model(tmp_path, each + TRIANGLES)
        numbers = pre_run_checks(made.stated, made.mesh, made.placed.wells)
        values += [number for number in numbers if number.name == "start over strength"]
    assert values[0].value == pytest.approx(float(middle.split()[0]) / 72.0)
    assert [value.out_of_range for value in values] == [warns, False] and values[1].value is None
