# ruff: noqa: E501 (messages stay whole)
import re

import pytest

from fracflow.errors import InputError
from fracflow.scene.scene import load

pytestmark = pytest.mark.serial

CASES = {
    "fracture.fault.normal_stifness=1e8": 'fracture.fault.normal_stifness = 1e8: unknown key; did you mean "normal_stiffness"?',
    "zzz=1": "zzz = 1: unknown key; allowed: absorbing, accuracy, body_force, control,",
    "well.node2.flowrate=3": 'well.node2.flowrate = 3: unknown key; did you mean "flow_rate"?',
    "well.node2.rate=3": 'well.node2.rate = 3: unknown key; did you mean "flow_rate"?',
    "stage.0.duration=3": 'duration = 3: unknown key; did you mean "end"?',
    "rock.granite.nu=0.2": 'rock.granite.nu = 0.2: unknown key; did you mean "poissons_ratio"?',
    "support.0.gradient=3": 'support.0.gradient = 3: unknown key; did you mean "displacement_gradient"?',
    "rock.granite.youngs_modulus=true": 'rock.granite.youngs_modulus = true: must be a number in N/m^2 or a string such as "30 GPa"',
    "rock.granite.youngs_modulus=30 m": 'rock.granite.youngs_modulus = "30 m": "m" is not a unit of force/length**2; must be',
    "rock.granite.youngs_modulus=30 gpaa": 'unknown unit "gpaa"; must be a number in N/m^2 or a string such as "30 GPa"',
    "rock.granite.youngs_modulus=30 gpa": 'unknown unit "gpa"; must be a number in N/m^2 or a string such as "30 GPa"; did you mean "GPa"?',
    "rock.granite.youngs_modulus=30 mPa": '"mPa" is a thousandth of a pascal, not a million; did you mean "MPa"?',
    "fracture.fault.normal_stiffness=30 mPa/mm": '"mPa/mm" is a thousandth of a pascal, not a million; did you mean "MPa/mm"?',
    "fluid.viscosity=1 mPa": 'fluid.viscosity = "1 mPa": "mPa" is not a unit of force*time/length**2; must be',
    "rock.granite.youngs_modulus='30'": "a string needs a unit",
    "rock.granite.youngs_modulus=-1": "rock.granite.youngs_modulus = -1: out of range; must be above 0",
    "rock.granite.youngs_modulus=nan": "must be finite",
    "rock.granite.poissons_ratio=0.5": "rock.granite.poissons_ratio = 0.5: out of range; must be above -1 and below 0.5",
    "rock.granite.poissons_ratio=0.5 m": "takes no unit; must be a plain number",
    "rock.granite.rigid=1": "rock.granite.rigid = 1: must be true or false",
    "title=3": "title = 3: must be a string",
    "units=cm-g-s": 'units = "cm-g-s": "g" is not a unit of force; use "SI", "none" or LENGTH-FORCE-TIME',
    "units=imperial": "units",
    "output.time_unit=fortnights": 'output.time_unit = "fortnights": unknown; allowed: "years", "days"',
    "units=none": "takes no unit; must be a plain number",
    "model=reprot": 'model = "reprot": unknown; allowed: "default", "report", "full"; did you mean "report"?',
    "method.quadrature=gauss": 'did you mean "gauss2"?',
    "method=3": "method = 3: must be a table",
    "rock=3": "rock = 3: must be a table",
    "rock.granite=3": "rock.granite = 3: must be a table",
    "stage=3": "stage = 3: must be an array of tables [[stage]]",
    "accuracy.max_iterations=1.5": "accuracy.max_iterations = 1.5: must be a whole number",
    "accuracy.max_iterations=0": "out of range; must be at least 1",
    "petsc.ksp_type=[1]": "petsc.ksp_type = [1]: must be a string, a number, or true or false",
    "geometry={domain=[0,0,1,1],size=1}": "contradicts [mesh]; give one of them",
    "fracture.fault.trace=[[20,20],[80,80]]": 'stands in geometry, as fracture = [{name = "fault", points = [[20, 20], [80, 80]]}]',
    "geometry.traces=map.csv": 'a file of traces stands in geometry, as fractures_csv = "map.csv" there',
    "traces=map.GeoJSON": 'a file of traces stands in geometry, as fractures_csv = "map.GeoJSON" there',
    "fracture.fault.points=3": 'stands in geometry, as fracture = [{name = "fault", points = [[x1, y1], [x2, y2]]}]',
    "fracture.fault.friction_coefficient=.6": "fracture.fault.friction_angle_deg = 30: contradicts friction_coefficient;",
    "fracture.fault={normal_stiffness=1,aperture=1,friction_angle_deg=1}": "fracture.fault.shear_stiffness: missing; required: k_s0",
    "fracture.fault={normal_stiffness=1,shear_stiffness=1,aperture=1}": "fracture.fault.friction_angle_deg: missing; give it or",
    "fracture.fault={normal_stiffness=1,shear_stiffness=1,friction_angle_deg=1}": "fracture.fault.aperture: missing",
    "fracture.fault={law='linear',normal_stiffness=1,shear_stiffness=1}": "fracture.fault.aperture: missing; the fluid needs it",
    "fracture.fault.law=coulomb": 'did you mean "hyperbolic-coulomb"?',
    "fracture.fault={law='of-mine',closure_length=1}": "a law from outside is known only to the script that registers it (and",
    "geometry={domain=[0,0,1000]}": "geometry.domain = [0, 0, 1000]: must be [xmin, ymin, xmax, ymax] or at least three points",
    "rock.granite={poissons_ratio=0.2}": "rock.granite.youngs_modulus: missing; a rock needs it unless rigid = true",
    "rock.granite={youngs_modulus=1,poissons_ratio=0.2}": "rock.granite.density: missing; dynamic stages need it",
    "well.node2.control=pumpin": 'well.node2.control = "pumpin": no [control] of that name; did you mean "pumping"?',
    "stage.slow.control=zzz": 'stage.slow.control = "zzz": no [control] of that name; allowed: pumping',
    "well.node2.pressure=initial": 'well.node2.pressure = "initial": contradicts flow_rate',
    "well.node2.flow_rate=initial": "well.node2.flow_rate",
    "well.node2.at={fracture='fault'}": 'well.node2.at = {fracture = "fault"}: must be [x, y], the name',
    "well.node2.at=[1]": "must be [x, y], the name of a point, or {fracture",
    "well.node2.at={fracture='fault',end='middle'}": 'end = "middle" is unknown; allowed: "start", "end"',
    "well=[{name='a',at='a',flow_rate=1,control='pumping'},{name='a',at='b',flow_rate=1}]": 'well.a.name = "a": stands twice',
    "load.0.pressure=1": 'load.0.traction = "initial-stress": contradicts pressure',
    "load.0.force=[1,0]": 'load.0.traction = "initial-stress": contradicts force; give one of them',
    "load.0={on='west',force=[1]}": "load.0.force = [1]: must be [x, y], each a number or a time table",
    "method={stepper='hht',newmark_beta=0.3}": 'method.newmark_beta = 0.3: is no key of stepper = "hht", but of newmark; remove it, or set stepper',
    "method={stepper='explicit',newmark_gamma=0.6}": 'method.newmark_gamma = 0.6: is no key of stepper = "explicit", but of newmark',
    "method.hht_alpha=-0.2": 'method.hht_alpha = -0.2: is no key of stepper = "newmark", but of hht; remove it, or set stepper',
    "method.rho_infinity=0.5": 'is no key of stepper = "newmark", but of generalised-alpha',
    "method.newton=newtn": 'method.newton = "newtn": unknown; allowed: "newton", "modified", "secant"; did you mean "newton"?',
    "method.overshoot=none": 'method.overshoot = "none": unknown; allowed: "hold", "one-change"',
    "load.0.traction=[1]": 'load.0.traction = [1]: must be [x, y]',
    "load.0.traction=[[0,1],2]": "must be a number in N/m^2",
    "load.0.control=pumping": "contradicts traction",
    "load=[{on='west'}]": "load.0.traction: missing; a load needs traction, pressure or force",
    "support.0.on=[]": "support.0.on = []: must not be empty",
    "support.0.components=['z']": 'allowed: "x", "y", "rotation"',
    "support.0={on='west',components=['x'],displacement={y=1}}": 'support.0.components = ["x"]: contradicts displacement',
    "well.node2.flow_rate=[[1,0],[0,1]]": "the times of a table must ascend, here 0 after 1",
    "well.node2.flow_rate=[[0,1],[2,1],[2,2],[2,3]]": "at most twice in a table (a jump), not 2; remove a row",
    "well.node2.flow_rate=[[0,1],[2]]": "row 2 is no pair [time, value]; must be a number in m^3/s",
    "well.node2.flow_rate=[0,1]": 'or a time table [[t, v], ...] such as [[0, 0], [10, "0.1 m^3/s"]], or {time = [...]',
    'well.node2.flow_rate=[[0,"x"]]': "row 1 of the table [[t, v], ...], its value: must be a number in m^3/s",
    "well.node2.flow_rate=[[0 1],[1 2]]": "is text, or a bracket or comma is missing; must be a number in m^3/s",
    "well.node2.flow_rate={time=[0,1],value=[1]}": "here 2 and 1; such as {time = [0, 10], value = [0, ",
    "load.0={on='west',force=[[0,1],[1,2]]}": "its x: row 1 is no pair [time, value]; must be a number in ",
    "load.0={on='west',force=[[0,1],2]}": "[x, y] with a time table is such as [[[0, 0], [10, 1]], 0]",
    "well.node2.flow_rate={time=[0,0],value=[1,2],interpolation='step'}": "the times of a step table must differ",
    "well.node2.flow_rate={time=[0],value=[1],interpolation='cubic'}": 'allowed: "linear", "step"',
    "well.node2.flow_rate={time=[0],value=[1,2]}": "lists time and value of the same length",
    "well.node2.flow_rate={times=[0],value=[1]}": 'unknown key "times" in a time table',
    "well.node2.flow_rate=[]": "at least one row",
    "stage.1.kind=statik": 'stage.1.kind = "statik": unknown; allowed: "equilibrate", "steady", "quasi-static", "dynamic"',
    "stage.1={kind='dynamic',end=1}": "stage.1.time_step: missing; a stage of kind dynamic needs it",
    "stage.1={kind='steady',time_step=1}": "stage.1.end: missing; a stage of kind steady needs end or steps",
    "stage.1={kind='auto',end=1}": "stage.1.time_step: missing; a stage of kind auto needs it",
    "stage.1.steps=3": "stage.1.steps = 3: contradicts end = 3; give one of them",
    "stage.1.end=-1": "stage.1.end = -1: must be later than the start of the stage, 0 (stage.1 is number 2 of 2 [[stage]])",
    "stage.1.until=incipient": "stage.1.control: missing; until needs the name of a [control]",
    "stage.1.then=hold": "stage.1.control: missing; then needs",
    "stage.slow.time_step=1": "stage.slow.time_step = 1: contradicts a steady stage until incipient",
    "probe.end.quantities=['sliip']": 'did you mean "slip"?',
    "well.node3.flow_rate=1": '--set well.node3.flow_rate=1: well.node3: no such entry; allowed: "node2"',
    "fluid.viscosity.x=1": "--set fluid.viscosity.x=1: fluid.viscosity is a value, not a table",
    "support.0.displacement={z=1}": "must be a table of x, y or rotation",
    "support.0.displacement={y='1 s'}": '"s" is not a unit of length',
    "title": "--set title: must be path.to.key=value",
}  # fmt: skip


@pytest.mark.parametrize("override", CASES)
def test_one_line_names_key_value_and_remedy(make, override):
    with pytest.raises(InputError) as caught:
        make(override)
    message = str(caught.value)
    assert CASES[override] in message
    assert "\n" not in message
    assert message.startswith(("scene.toml: ", "--set "))


def without(text, table):
    blocks = text.split("\n\n")
    return "\n\n".join(block for block in blocks if table not in block)


def test_missing_fluid(make):
    with pytest.raises(InputError, match=r"scene.toml: fluid: missing; a scene with wells needs \[fluid\]"):
        make(text=without(make.text, "[fluid]"))


def test_missing_mesh_rock_and_stress(make):
    with pytest.raises(InputError, match=r"geometry: missing; give \[geometry\] or \[mesh\]"):
        make(text=without(make.text, "[mesh]"))
    with pytest.raises(InputError, match=r"rock: missing"):
        make(text=without(make.text, "[rock"))
    with pytest.raises(InputError, match=r"load.0.traction = .* needs the table \[initial_stress\]"):
        make(text=without(make.text, "[initial_stress]"))


def test_control_without_follower(make):
    with pytest.raises(InputError, match="no well or load has this control"):
        make(text=without(make.text, "[[well]]"))


def test_several_errors_are_counted_and_spelling_comes_first(make):
    text = make.text.replace("normal_stiffness", "normal_stifness").replace("0.25", "0.75")
    with pytest.raises(InputError, match=r"fault.normal_stifness = .*did you mean.*\(and 2 more errors\)$"):
        make(text=text)


def test_geometry_names(make):
    text = without(make.text, "[mesh]")
    geometry = "geometry={domain=[0,0,1,1],size=1,fracture=[{name='fault',points=[[0,0],[1,1]]}]}"
    with pytest.raises(InputError, match=r"rock.slate: is one too many; .geometry. has one rock, here granite"):
        make(geometry, "rock.slate={rigid=true}", text=text)
    with pytest.raises(
        InputError, match=r"mesh.file: missing; .geometry. makes the mesh of this scene: write geometry.refine"
    ):
        make(geometry, "mesh.refine=1", text=text)
    assert make(geometry, text=text).geometry.domain == ((0, 0), (1, 0), (1, 1), (0, 1))
    with pytest.raises(InputError, match=r"fracture.fold: missing; the fracture .fold. needs a table"):
        make(geometry.replace("'fault'", "'fold'"), text=text)
    with pytest.raises(InputError, match=r"no fracture of that name in \[geometry\]; did you mean .vault."):
        make(geometry.replace("'fault'", "'vault'"), "fracture.default={normal_stiffness=1,shear_stiffness=1,"
             "aperture=1,friction_angle_deg=3}", text=text)  # fmt: skip
    with pytest.raises(InputError, match="two points in a row are the same"):
        make(geometry.replace("[1,1]]", "[0,0]]"), text=text)
    with pytest.raises(InputError, match="xmin < xmax"):
        make(geometry.replace("[0,0,1,1]", "[0,0,0,1]"), text=text)


def test_syntax_missing_file_and_encoding(make, tmp_path):
    with pytest.raises(InputError, match=r"line 2.*: a table in braces is whole where it ends; write its keys within"):
        make(text="geometry = {size = 1}\n[[geometry.fracture]]\n")
    with pytest.raises(InputError, match=r"^scene.toml: not valid TOML: .*line 2"):
        make(text="title = 1\nunits 2\n")
    for value, how in {
        "[[0 1], [1 2]]": "commas between",
        "[[0, 1], [1, 2]": "commas between",
        "3 kPa": "in quotes",
    }.items():
        with pytest.raises(InputError, match=rf"line .* in key = {re.escape(value)}: .*{how}.*such as"):
            make(text=f"title = 1\nkey = {value}\n\n[fluid]\n")
    with pytest.raises(InputError, match="no such file; give the path of a TOML file"):
        load(tmp_path / "other.toml")
    with pytest.raises(InputError, match="cannot be read"):
        load(tmp_path)
    (tmp_path / "latin.toml").write_bytes(b'title = "\xe9"')
    with pytest.raises(InputError, match="not UTF-8"):
        load(tmp_path / "latin.toml")


def test_mesh_names(make):
    names = {
        "rocks": ("granite",),
        "fractures": ("fault",),
        "sides": ("west", "south", "north"),
        "points": (),
    }
    scene = make()
    scene.check_mesh_names(**names)
    two = make(text=make.text + '[[support]]\non = "eats"\n')
    with pytest.raises(InputError, match=r'support.1.on = "eats": .* \(support.1 is number 2 of 2 \[\[support\]\]\);'):
        two.check_mesh_names(**names)
    with pytest.raises(InputError, match=r'scene.toml: load.0.on = "north": not in the mesh; did you mean "south"'):
        scene.check_mesh_names(**names | {"sides": ("west", "south")})
    with pytest.raises(InputError, match=r"fracture.joint: missing; the mesh has a fracture"):
        scene.check_mesh_names(**names | {"fractures": ("fault", "joint")})
