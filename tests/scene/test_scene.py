import json
import math
import pickle
import subprocess
import sys

import numpy as np
import pytest
import tomllib
from hypothesis import given
from hypothesis import strategies as st
from pages import SCENES

from fracflow.remarks import note
from fracflow.scene.advice import advice
from fracflow.scene.scene import Scene, load
from fracflow.scene.schema import note_on_meanings, rows
from fracflow.scene.toml import write_float, write_value
from fracflow.scene.units import UnitSystem
from fracflow.scene.unusual import unusual
from fracflow.scene.values import FractureEnd, TimeTable

pytestmark = pytest.mark.serial

WHOLE = [path for path in SCENES if path.match("meshes/*/scene.toml")]


def test_units_become_plain_numbers(make):
    scene = make("fracture.fault.shear_stiffness=100 MPa/m", "rock.granite.density=2.7 g/cm^3")
    fault = scene.fracture["fault"]
    assert scene.rock["granite"].youngs_modulus == 50e9
    assert scene.rock["granite"].density == pytest.approx(2700, rel=1e-14)
    assert (fault.normal_stiffness, fault.shear_stiffness, fault.aperture) == pytest.approx((1e10, 1e8, 1e-3))
    assert scene.fluid.viscosity == pytest.approx(1e-3)
    assert scene.well[0].flow_rate(0.0) == pytest.approx(3e-3)
    assert scene.stage[1].time_step == pytest.approx(0.01)
    assert make("fracture.fault.friction_angle_deg=0.5 rad").fracture["fault"].friction == pytest.approx(math.tan(0.5))


def test_foot_pound_second(make):
    scene = make("units=ft-lbf-s", "rock.granite.density=5.12 slug/ft^3", "fluid.specific_weight=62.4 lbf/ft^3")
    assert scene.rock["granite"].density == pytest.approx(5.12, rel=1e-6)
    assert scene.fluid.specific_weight == pytest.approx(62.4, rel=1e-12)
    assert scene.rock["granite"].youngs_modulus == pytest.approx(50e9 / 47.88025898, rel=1e-8)
    assert scene.fracture["fault"].aperture == pytest.approx(1e-3 / 0.3048, rel=1e-12)


def test_times_are_shown_in_the_unit_of_the_author(make, tmp_path):
    """That of the last end, or of the time steps; where none has a unit of its own, one that suits the time."""
    last = "stage.1.end"
    for setting, unit, hours in (("72 h", "h", "72 h"), ("3 d", "days", "3 days"), ("1 week", None, "3 days")):
        scene = make(f"{last}={setting}")
        assert (scene.output.time_unit, scene.time_text(259200.0)) == (unit, hours)
        (tmp_path / "scene.toml").write_text(scene.dump_toml())
        assert load(tmp_path / "scene.toml", [f"{last}=90"]).time_text(259200.0) == hours
    plain = (f"{last}=72", "stage.1.time_step=1")
    assert make(*plain).unit_names == {"length": "m", "force": "N", "time": "s"}
    assert make(f"{last}=72 h", "output.time_unit=min").unit_names["shown_time"] == "min"
    assert make(f"{last}=72 h", "units=m-N-h").output.time_unit is None


def test_table_interpolates_and_takes_the_mean_at_jumps():
    linear = TimeTable((0.0, 1.0, 1.0, 2.0), (0.0, 1.0, 3.0, 4.0))
    assert [linear(t) for t in (-1, 0, 0.5, 1, 1 + 5e-13, 1.5, 2, 9)] == [0, 0, 0.5, 2, 2, 3.5, 4, 4]
    step = TimeTable((0.0, 0.3, 1.0), (1.0, 5.0, -1.0), "step")
    assert [step(t) for t in (-1, 0, 0.1, 3 * 0.1, 0.31, 1, 2)] == [1, 1, 1, 3, 5, 2, -1]
    assert TimeTable.constant(7.0)(3) == 7
    assert TimeTable((0.0, 0.0), (0.0, 1.0))(0.0) == 0.5
    times = np.linspace(-0.4, 2.5, 25)
    for table in (linear, step, TimeTable.constant(7.0)):
        for around in ((0.12, 0.12), (0.12, 0.0), (0.0, 0.1)):
            one_by_one = [table(time, around) + table.bent(time, *around) for time in times]
            assert np.abs(table.sampled(times, *around) - one_by_one).max() < 1e-15


def test_tables_of_a_scene(make):
    rate = (
        make('well.node2.flow_rate={time=["0 s", "1 min"], value=["1 l/s", 2], interpolation="step"}').well[0].flow_rate
    )
    assert rate == TimeTable((0.0, 60.0), (pytest.approx(1e-3), 2.0), "step")
    traction = make("load.0.traction=[[[0, 0], [1, 2]], '1 MPa']").load[0].traction
    assert (traction[0](0.5), traction[1](0.5)) == (1.0, 1e6)
    assert (
        make(
            "well.node2={name='w',at='w',pressure='initial'}",
            "load.0={on='west',pressure=1,control='pumping'}",
        )
        .well[0]
        .pressure
        == "initial"
    )


def test_supports(make):
    assert make().support[0].on == ("west",)
    assert make().support[0].components == ("x", "y")
    moved = make("support.0.displacement={y = [[0, 0], [1, 2]]}").support[0]
    assert moved.components == ("y",) and moved.displacement["y"](0.5) == 1 and "x" not in moved.displacement


def test_overrides_by_name_index_and_new_tables(make):
    scene = make(
        "well.node2.flow_rate=5",
        "stage.slow.tolerance=1e-4",
        "stage.1.end=7",
        "petsc.ksp_rtol=1e-9",
        "title=two words",
        "load.0.on.1=east",
        'control."a.b".initial=2',
    )
    assert scene.well[0].flow_rate(0) == 5
    assert (scene.stage[0].tolerance, scene.stage[1].end) == (1e-4, 7)
    assert scene.petsc == {"ksp_rtol": 1e-9} and scene.control["a.b"].initial == 2
    assert scene.title == "two words" and scene.load[0].on == ("south", "east")


def test_an_option_that_reaches_no_solver_is_told(make):
    lines = advice(make("petsc.ksp_type=gmres", "petsc.whole-lu_mat_mumps_icntl_14=80", "petsc.solid_ksp_rtol=1e-9"))
    (line,) = (line for line in lines if line.startswith("petsc."))
    assert line.startswith("petsc.ksp_type reaches no solver: ") and "monolithic, whole-lu, solid, flow" in line


@pytest.mark.parametrize("step, told", [("3", ["lasts 2 s"]), ("2", []), ("1.5", [])])
def test_a_step_beyond_the_end_of_its_stage_is_told(make, step, told):
    """The stage before it moves its start."""
    stages = f'stage=[{{kind="quasi-static", time_step=1, end=5}}, {{kind="quasi-static", time_step={step}, end=7}}]'
    lines = [line for line in advice(make(stages)) if "is longer than the stage" in line]
    assert len(lines) == len(told) and all(word in line for word, line in zip(told, lines, strict=True))


def test_values_of_another_unit_are_told(make):
    lines = advice(make("fracture.fault.leak_off={permeability=1e-3, storage=1e-10}", "fracture.fault.aperture=2"))
    assert [line for line in lines if "unusually" in line] == [
        "fracture.fault.aperture = 2 m is unusually large: is its unit right?",
        "fracture.fault.leak_off.permeability = 0.001 m^2 is unusually large: is its unit right?",
    ]
    crack = "fracture.crack.friction_coefficient"
    told = f"{crack} = 30 is unusually large: give an angle as friction_angle_deg"
    assert told in advice(load("meshes/pressurised_crack/scene.toml", [f"{crack}=30"]))


JOINT = "fracture.fault={normal_stiffness=1e10, shear_stiffness=1e10, aperture=1e-3, friction_angle_deg=%s}"
RATES = (
    "fracture.fault={law='rate-and-state', normal_stiffness=1e10, shear_stiffness=1e10, aperture=1e-3, direct_effect=0.01,"
    " friction_coefficient=0.6, evolution_effect=0.014, characteristic_slip=1e-3, initial_slip_rate=1e-9,"
    " reference_slip_rate=%s}"
)
LATER = "stage=[{name='slow', kind='quasi-static', time_step=1, end=3}]"
PRESSED = "initial_stress={xx=-8e6, yy=-9e6}"
TRACE = 'geometry={domain=[0, 0, 100, 100], size=20, fracture=[{name="fault", points=[[30, 50], [70, 50]]}]}'


@pytest.mark.parametrize(("units", "metres"), [("SI", 1.0), ("ft-lbf-s", 0.3048), ("mm-N-s", 1e-3)])
def test_darcys_are_areas_in_all_units(units, metres):
    found = UnitSystem.parse(units).convert("2 mD", "length**2") * metres**2
    assert found == pytest.approx(2 * 9.869233e-16, rel=1e-12)


@pytest.mark.parametrize(
    "settings, told",
    [
        ([JOINT % 0.54], 'friction_angle_deg = 0.54 degree is unusually small: give "0.54 rad", if that is meant'),
        ([JOINT % 1.5], "friction_angle_deg = 1.5 degree is unusually small: is its unit right?"),
        ([JOINT % '"0.54 rad"'], None),
        ([JOINT % 5], None),
        ([JOINT % 60], None),
        (["fracture.fault.aperture=50 mm"], "fracture.fault.aperture = 0.05 m is unusually large: is its unit right?"),
        (["fracture.fault.aperture=50 mm", "fracture.fault.hydraulic_aperture=1 mm"], None),
        (["fracture.fault.aperture=30 mm"], None),
        ([TRACE, "fluid.flow_depth=50 mm"], "fluid.flow_depth = 0.05 m is unusually small beside fractures of 40 m"),
        ([TRACE, "fluid.flow_depth=1 m"], None),
        (["fluid.flow_depth=50 mm"], None),  # a sample of a laboratory
        (
            ["initial_stress={xx=-8e6, yy=-9e6}", "fluid.initial_pressure=4 kPa"],
            "4000 N/m^2 (0.004 MPa) is next to nothing",
        ),
        (["initial_stress={xx=-8e5, yy=-9e5}", "fluid.initial_pressure=4 kPa"], None),
        (
            ["fracture.fault.aperture=0.5 um"],
            "fracture.fault.aperture = 5e-07 m is unusually small: is its unit right?",
        ),
        (["fracture.fault.aperture=2 um"], None),
        (["fluid={viscosity=1e-3, density=1}"], "fluid.density = 1 N s^2/m^4 (0.001 g/cm^3) is that of a gas"),
        (["fluid={viscosity=1.8e-5, density=1.2}"], None),  # air
        (["fluid={viscosity=1e-3, density=800}"], None),
        (["initial_stress={xx=-8e6, yy=-9e6}", "fluid.initial_pressure=10 kPa"], None),
        (["fluid.viscosity=1 mPa s"], None),
        (
            ["fluid.compressibility=0.5 1/MPa"],
            "fluid.compressibility = 5e-07 m^2/N is that of a gas, of a liquid's viscosity",
        ),
        (["fluid.compressibility=0.5 1/GPa"], None),
        (["initial_stress={xx=5e6, yy=7.5e6, gradient={xx=2e4, yy=2.5e4}}"], None),  # 0 is above the rock
        (["fluid.compressibility=0.5 1/MPa", "fluid.viscosity=1.8e-5"], None),
        ([RATES % 31.5, LATER], "fracture.fault.reference_slip_rate = 31.5 m/s is unusually large: is its unit right?"),
        ([RATES % 1e-6, LATER], None),
        ([f"{JOINT[:-3]}30, leak_off={{permeability='0.01 mD', storage=1e-11}}}}"], None),
        (
            ["initial_stress={xx=8e6, yy=-9e6}"],
            "initial_stress.xx = 8e+06 N/m^2 is tension, as compression is negative: is",
        ),
        (
            ["fracture.fault.shear_stiffness=1e13"],
            "1e+13 N/m^3 is 1e+03 of normal_stiffness, 1e+10 N/m^3; joints have 0.01",
        ),
        (["fracture.fault.shear_stiffness=10 MPa/m"], "= 1e+07 N/m^3 is 0.001 of normal_stiffness"),
        (["fracture.fault.shear_stiffness=100 MPa/m"], None),
        (
            [PRESSED, "fracture.fault.normal_stiffness=10 MPa/m"],
            "closed the joint by 0.8 m, 8e+02 times the aperture: is its unit",
        ),
        ([PRESSED, "fracture.fault.normal_stiffness=1 GPa/m"], None),
        ([PRESSED, "fluid.initial_pressure=7.99e6", "fracture.fault.normal_stiffness=200 MPa/m"], None),
    ],
)
def test_values_that_rock_seldom_has_are_told(make, settings, told):
    text = make.text.replace('[mesh]\nfile = "fault.geo"', "") if TRACE in settings else make.text
    lines = list(unusual(make(*settings, text=text)))
    assert (len(lines) == 1 and told in lines[0]) if told else lines == []


def test_a_rate_of_another_unit_is_told_with_both(make):
    """The number of the message is in units of the scene: one that had a unit is not to be given anew in another one."""
    (line,) = unusual(make("well.node2.flow_rate=300 L/s"))
    assert line.startswith("well.node2.flow_rate = 0.3 m^3/s (300 L/s) is more than wells bring: is its unit right?")
    assert line.endswith(
        'where 0.3 stands alone and means L/s, give "0.3 L/s"; it enters fluid.flow_depth = 1 m of the fractures'
    )


@pytest.mark.parametrize("stress, told", [("-14", True), ("-14e6", False), ("0", False)])
def test_a_stress_of_pascals_is_told(make, stress, told):
    lines = advice(make(f"initial_stress={{xx={stress}, yy={stress}}}"))
    found = [line for line in lines if line.startswith("initial_stress.xx = -14 ")]
    assert bool(found) is told and all('give "-14 MPa"' in line for line in found)


@pytest.mark.parametrize(
    "key, small, large, unit",
    [
        ("fluid.initial_pressure", "5", "5e6", "N/m^2"),
        ("well.0.maximum_pressure", "7", "7e6", "N/m^2"),
        ("well.0.flow_rate", "1e-3", "0.5", "m^3/s"),
    ],
)
def test_pressures_of_pascals_and_rates_of_cubic_metres_are_told(make, key, small, large, unit):
    name = key.replace(".0.", f".{make().well[0].name}.")
    told = {
        value: [line for line in advice(make(f"{key}={value}")) if line.startswith(name)] for value in (small, large)
    }
    wrong, right = (large, small) if unit == "m^3/s" else (small, large)
    usual = "L/s" if unit == "m^3/s" else "MPa"
    assert len(told[wrong]) == 1 and told[right] == []
    assert told[wrong][0].startswith(f"{name} = {wrong} {unit} (") and f'give "{wrong} {usual}"' in told[wrong][0]


def test_a_rate_of_one_metre_of_fractures_is_told(make):
    """Nothing in the scene says how deep they are out of the plane."""
    told, stated = (
        [line for line in advice(make(*given)) if "out of the plane" in line] for given in ((), ("fluid.flow_depth=1",))
    )
    assert (
        len(told) == 1 and told[0].startswith(note("well.node2.flow_rate enters 1 m of the fractures")) and not stated
    )


def test_a_pressure_at_the_start_that_nothing_stores_is_told(make):
    """Springs leave c_f d k_n/(1 + c_f d k_n) of it; moved walls, or a pressure that is prescribed, keep it."""
    start, stiff = "initial={pressure=2e5}", "fracture.fault={%s}"
    joint = "normal_stiffness=1e8, shear_stiffness=1e8, aperture=1e-3, friction_coefficient=0.6"
    given = [start, stiff % joint]

    def told(*more):
        return [line for line in advice(make(*given, *more)) if line.startswith("initial.pressure")]

    (line,), (some,) = told(), told("fluid.compressibility=1e-6")
    assert "does not last" in line and "give fluid.initial_pressure instead" in line and "of the difference" not in line
    assert "but for about 0.09 of the difference" in some  # 0.1/1.1
    assert not told("fluid.compressibility=1e-4") and not told("fluid.initial_pressure=2e5")
    assert not told("initial.displacement=[0, 0.001]") and not told(f"fracture.fault={{{joint}, pressure=2e5}}")


def test_names_paths_and_flow(make, tmp_path):
    scene = make()
    assert scene.mesh_path == (tmp_path / "fault.geo").resolve() and scene.folder == tmp_path
    assert scene.fracture_named("fault").friction == pytest.approx(math.tan(math.pi / 6))
    assert scene.probe[0].at == FractureEnd("fault", "start") and scene.well[0].at == (0.0, 1.0)
    assert scene.has_flow and scene.has_dynamics
    dry = make("fluid.viscosity=0", "fluid.initial_pressure=1e5")
    assert not dry.has_flow and any("nothing carries fluid.initial_pressure" in line for line in advice(dry))
    assert not make("fluid.specific_weight=0").has_flow
    assert scene.stage[0].takes_no_time and scene.stage[1].step_count(0.0) == 300


@pytest.mark.parametrize(("end", "step", "count"), [(20, 0.1, 200), (0.3, 0.1, 3), (1, 0.3, 4), (3, 0.01, 300)])
def test_steps_cover_the_stage(make, end, step, count):
    assert make(f"stage.1.end={end}", f"stage.1.time_step={step}").stage[1].step_count(0.0) == count


def test_report_model_resolves_methods(make):
    default, report = make().method, make("model=report").method
    assert (default.storage, default.conductance, default.newton_test) == ("lumped", "front", "residual")
    assert (default.tangent, default.open_strength, default.quadrature) == ("consistent", "none", "nodal")
    assert (report.storage, report.conductance, report.newton_test) == ("report", "report", "out-of-balance")
    assert (report.tangent, report.open_strength, report.coupling) == ("decoupled", "cohesion", "auto")
    assert make("model=report", "method.tangent=consistent").method.tangent == "consistent"
    assert make("model=full").method == default.model_copy(update={"events": "located", "factors": "new"})
    assert None not in default.model_dump().values()


def test_dump_loads_again(make, tmp_path):
    scene = make("model=report", 'title=a "b" \\ c', "well.node2.flow_rate=[[0,1],[0,2],[3,1e-7]]", "units=ft-lbf-s")
    text = scene.dump_toml()
    assert make(text=text) == scene
    assert make(text=text).dump_toml() == text
    assert 'newton_test = "out-of-balance"' in text and text.startswith("version = ")


def test_scene_travels_between_ranks(make):
    scene = make()
    assert pickle.loads(pickle.dumps(scene)) == scene
    assert pickle.loads(pickle.dumps(scene)).mesh_path == scene.mesh_path


def test_dump_with_the_key_of_a_stepper_loads_again(make):
    """It has the defaults of all steppers."""
    scene = make("method.stepper=hht", "method.hht_alpha=-0.2")
    assert "newmark_beta" in scene.dump_toml() and make(text=scene.dump_toml()) == scene


def test_dump_for_another_folder(make, tmp_path):
    scene = make()
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "scene.toml").write_text(scene.dump_toml(tmp_path / "run"))
    assert load(tmp_path / "run" / "scene.toml").mesh_path == scene.mesh_path


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_floats_are_written_exactly(value):
    assert tomllib.loads(f"x = {write_float(value)}")["x"] == value
    assert isinstance(tomllib.loads(f"x = {write_float(value)}")["x"], float)


@given(st.text(st.characters(exclude_categories=["Cs"])))
def test_strings_are_written_exactly(value):
    assert tomllib.loads(f"x = {write_value(value)}")["x"] == value


def test_schema_documents_every_key():
    schema = Scene.json_schema()
    tables = {"Scene": schema} | schema["$defs"]
    bare = [
        f"{name}.{key}"
        for name, table in tables.items()
        for key, field in table.get("properties", {}).items()
        if not field.get("description")
    ]
    assert not bare
    assert '"dimension": "force/length**3"' in json.dumps(schema)


def test_there_are_scenes():
    names = {"report_5_2", "report_5_3", "report_5_5", "r01_inclined_joint", "three_fractures"}
    assert {file.parent.name for file in WHOLE} >= names


@pytest.mark.parametrize("file", WHOLE, ids=lambda file: file.parent.name)
def test_every_scene_loads_and_survives_its_dump(file, tmp_path):
    scene = load(file)
    (tmp_path / "scene.toml").write_text(scene.dump_toml())
    assert load(tmp_path / "scene.toml") == scene
    plain = load(file, ["model=report", "method={stepper='newmark'}"])  # explicit steps lump storage
    assert plain.method.storage == "report"


def test_report_scenes_hold_the_data_of_the_text():
    for name, ratio, shear, steps in (("report_5_3", 0.98, -1.4e5, 300), ("report_5_5", 0.94, -1.35e5, 300)):
        scene = load(WHOLE[0].parents[1] / name / "scene.toml")
        stress, fault, fluid, rock = (
            scene.initial_stress,
            scene.fracture["fault"],
            scene.fluid,
            scene.rock["rock"],
        )
        assert (stress.xx, stress.yy, stress.zz, stress.xy) == (-2e5, -6e5, -2e5, shear)
        assert (rock.youngs_modulus, rock.poissons_ratio, rock.density) == pytest.approx((5e8, 0.25, 5.12), rel=1e-6)
        assert (fault.normal_stiffness, fault.shear_stiffness, fault.aperture) == pytest.approx((1e8, 1e8, 0.01))
        assert (fault.friction_angle_deg, fault.cohesion, fault.stick_slip_ratio) == (40, 0, ratio)
        assert (fluid.viscosity, fluid.specific_weight) == pytest.approx((0.235e-4, 62.4))
        assert (fluid.initial_pressure, fluid.flow_depth) == pytest.approx((0.3e5, 100))
        assert scene.stage[1].steps == steps and scene.stage[1].time_step == 0.01


def test_schema_as_a_table_has_every_key_once():
    """Tables, arrays of tables and tables by name, each with dimension or choices, default and meaning."""
    found = {row[0]: row[1:] for row in rows(Scene.json_schema())}
    assert found["rock.NAME.youngs_modulus"][0] == "[force/length**2]"
    assert found["method.coupling"][:2] == ("auto | monolithic | fixed-point | whole-lu | condensed", "auto")
    assert found["stage[].kind"][1] == "required"
    assert found["initial_stress.gradient.yy"][0] == "[force/length**3]"
    assert found["initial.rock.NAME.velocity"][2]
    assert all(meaning for _, _, meaning in found.values())
    assert len(found) == len(list(rows(Scene.json_schema()))) > 120


def test_where_docstrings_are_lost_the_schema_says_so_in_one_line():
    """Under -OO, and of an installation without sources, where pydantic finds no meaning of a key."""
    words = [sys.executable, "-OO", "-m", "fracflow", "schema", "--json"]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    assert done.stderr.count("\n") == 1 and done.stderr.startswith("note: meanings of keys are missing")
    law = json.loads(done.stdout)["definitions"]["Fracture"]["properties"]["law"]["description"]
    assert "linear" in law.split("; ") and "(" not in law
    schema = Scene.json_schema()
    assert note_on_meanings(schema) == ""
    del schema["properties"]["title"]["description"]
    assert note_on_meanings(schema) == done.stderr.strip()


def test_a_control_that_is_raised_by_a_share_of_zero_is_told(make):
    """increment_per_step is over the value at the start of the stage: loads and wells of a control at 0 did nothing."""
    raised = "{kind='quasi-static', time_step=1, end=4, control='pumping', increment_per_step=0.2}"
    found = "{kind='steady', until='incipient', control='pumping'}"

    def told(stages, initial):
        lines = advice(make(f"stage=[{', '.join(stages)}]", f"control.pumping.initial={initial}"))
        return [line.split(": ")[0].split(" raises")[0] for line in lines if "stays at 0" in line]

    assert told([raised], 0) == ["well.node2", "stage.0.increment_per_step"]
    assert told([raised, found], 0) == ["stage.0.increment_per_step"]
    assert told([found, raised], 0) == told([raised], 1) == []
