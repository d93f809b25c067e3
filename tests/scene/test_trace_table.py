"""Traces and their properties from a table."""

from __future__ import annotations

import json
import math

import pytest
from pages import ROOT

from fracflow.errors import InputError
from fracflow.scene.advice import degrees
from fracflow.scene.geometry import read_traces, read_traces_csv
from fracflow.scene.scene import load

pytestmark = pytest.mark.serial

SCENE = """
[geometry]
domain = [0, 0, 10, 10]
size = 2
fractures_csv = "traces.csv"
[rock.rock]
youngs_modulus = "50 GPa"
poissons_ratio = 0.25
[[stage]]
kind = "steady"
time_step = 1
steps = 1
[fracture.default]
normal_stiffness = "10 GPa/m"
shear_stiffness = 1e9
aperture = "1 mm"
friction_angle_deg = 30
[fracture.Berta]
normal_stiffness = 5e9
shear_stiffness = 2e9
aperture = 0.002
friction_coefficient = 0.4
"""

TABLE = """cohesion;Aperture;X;Y;Name;friction_angle_deg;law
"2 MPa";0.1 mm;1;1;Änne;;
;;2;2;Änne;;
;;3;2;Änne;;
1e5;;5;5;Berta;45;
1e5;;6;6;Berta;45;
;;7;1;断层;;linear
;;7;2;断层;;
"""


@pytest.fixture
def write(tmp_path):
    def write(table, scene=SCENE, *overrides):
        (tmp_path / "traces.csv").write_bytes(table.encode() if isinstance(table, str) else table)
        (tmp_path / "scene.toml").write_text(scene, encoding="utf-8")
        return load(tmp_path / "scene.toml", overrides)

    return write


@pytest.mark.parametrize(
    "text",
    [
        "name,x,y\nÄtna,0,1\nÄtna,2,3\nÄtna,4,5\n断层,1,1\n断层,2,2\n",
        "\ufeffName ; X; Y\n Ätna ;0;1\nÄtna; 2 ; 3\n\nÄtna;4;5\n断层;1;1\n断层;2;2",
        "\n\ny\tname\tx\n1\tÄtna\t0\n3\tÄtna\t2\n5\tÄtna\t4\n1\t断层\t1\n2\t断层\t2\n",
        "name, x1, y1, x2, y2\r\nÄtna, 0, 1, 2, 3\r\nÄtna, 2, 3, 4, 5\r\n断层, 1, 1, 2, 2\r\n",
        "y2,x2,y1,x1,name\n3,2,1,0,Ätna\n5,4,3,2,Ätna\n2,2,1,1,断层\n",
    ],
    ids=["comma", "semicolon", "tab", "segments", "any order"],
)
def test_layouts(tmp_path, text):
    path = tmp_path / "traces.csv"
    path.write_bytes(text.encode())
    first, second = read_traces_csv(path)
    assert (first.name, second.name) == ("Ätna", "断层")
    assert first.points == [[0, 1], [2, 3], [4, 5]] and second.points == [[1, 1], [2, 2]]
    assert first.properties == second.properties == {}


def test_properties_of_a_trace_go_over_its_table_and_that_over_the_default(write):
    scene = write(TABLE)
    assert [trace.name for trace in scene.geometry.fracture] == ["Änne", "Berta", "断层"]
    assert scene.geometry.fracture[0].points == ((1, 1), (2, 2), (3, 2))
    anne, berta, last = (scene.fracture_named(name) for name in ("Änne", "Berta", "断层"))
    assert (anne.cohesion, anne.aperture, anne.normal_stiffness) == (2e6, pytest.approx(1e-4), 1e10)
    assert anne.friction == pytest.approx(math.tan(math.radians(30)))
    assert (berta.cohesion, berta.aperture, berta.shear_stiffness) == (1e5, 0.002, 2e9)
    assert berta.friction == pytest.approx(1)  # the angle of the table of traces over the coefficient of the scene
    assert (last.law, last.aperture, anne.law) == ("linear", 0.001, "hyperbolic-coulomb")


def test_a_resolved_scene_needs_no_table(write, tmp_path):
    scene = write(TABLE)
    (tmp_path / "traces.csv").unlink()
    (tmp_path / "again.toml").write_text(scene.dump_toml(tmp_path), encoding="utf-8")
    assert load(tmp_path / "again.toml") == scene


def test_settings_go_over_the_table(write, tmp_path):
    scene = write(TABLE, SCENE, "fracture.Änne.cohesion=7", "geometry.fracture.Berta.points=[[1, 5], [3, 5]]")
    assert scene.fracture["Änne"].cohesion == 7 and scene.geometry.fracture[1].points == ((1, 5), (3, 5))
    (tmp_path / "other.csv").write_text("name,x1,y1,x2,y2\nBerta,0,0,3,3\n")
    assert len(write(TABLE, SCENE, "geometry.fractures_csv=other.csv").geometry.fracture) == 1


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a,0,1\na,2,3\n", "line 1: the columns are a,0,1; they must have name,x,y or name,x1"),
        ("", "is empty; its first line must name the columns"),
        ("name,x,y\n", "has no rows"),
        ("name,x,y\na,0\n", "line 2: has 2 fields, the first line names 3 columns"),
        ("name;x;y\na;0;1,5\n", 'line 2: y = "1,5": is no number; decimals take a point'),
        ("name,x,y\na,0,nan\n", "line 2: y = nan: must be finite"),
        ("name,x,y\na,0,1\n", 'line 2: fracture "a" has one point'),
        ("name,x,y\na,0,1\na,0,1\n", r'line 3: "a": the point \[0.0, 1.0\] stands twice in a row'),
        ("name,x,y\na,0,1\nb,1,1\na,2,2\n", 'line 4: "a" was given before'),
        ("name,x,y\n,0,1\n", "line 2: the name is empty"),
        ("name,x1,y1,x2,y2\na,0,1,2,3\na,4,4,5,5\n", 'line 3: "a" goes on at'),
        ("name,x,y,apperture\na,0,1,2\n", 'line 1: unknown column "apperture"; did you mean "aperture"'),
        ("name,x,y,x\na,0,1,2\n", 'line 1: the column "x" stands twice'),
        (
            "name,x,y,aperture\na,0,1,1 mm\na,2,3,2 mm\n",
            'line 3: aperture = "2 mm": it is "1 mm" in the first row of "a"',
        ),
        ("name,x,y,aperture\na,0,1,\na,2,3,2 mm\n", 'line 3: aperture = "2 mm": it is empty in the first row'),
        ("name,x,y,aperture\na,0,1,2 Pa\na,2,3,\n", 'line 2: "a": aperture = "2 Pa": "Pa" is not a unit of length'),
        ("name,x,y,aperture\na,0,1,-1\na,2,3,\n", 'line 2: "a": aperture = -1.0: out of range; must be above 0'),
        ("name,x,y,law\na,0,1,linnear\na,2,3,\n", 'line 2: "a": law = "linnear": unknown; .*did you mean "linear"'),
        (b"name,x,y\n\xc4tna,0,1\n", "not UTF-8 text: .*save it as UTF-8"),
        (b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR", "not UTF-8 text: .*save it as UTF-8"),
        (b"name,x,y\na,\x000,1\n", "line 2"),
        ('name,x,y\n"a,0,1\na,1,1\n', "line 3: .*give a plain table"),
        ("name,x,y\ndefault,0,1\ndefault,1,1\n", r'line 2: name = "default": is kept for \[fracture.default\]'),
    ],
)
def test_tables_that_make_no_sense(write, text, message):
    with pytest.raises(InputError, match=message) as caught:
        write(text)
    assert "\n" not in str(caught.value) and "traces.csv: " in str(caught.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ('fractures_csv = "absent.csv"', "absent.csv: no such file"),
        ('fractures_csv = ""', "geometry.fractures_csv = .*must not be empty"),
        ("fractures_csv = 3", "geometry.fractures_csv = 3: must be a string"),
        ('fractures_csv = "traces.csv"\nsize_at_fractures = 3', "geometry.size_at_fractures = 3: must be at most size = 2"),
        ('fractures_csv = "traces.csv"\nsize_at_tips = 3', "geometry.size_at_tips = 3: must be at most the size at fractures"),
        ('fractures_csv = "traces.csv"\nsnap = "1 Pa"', 'geometry.snap = "1 Pa": "Pa" is not a unit of length'),
        ('fractures_csv = "traces.csv"\ngrowth = 0', "geometry.growth = 0: out of range; must be above 0"),
        ('fractures_csv = "traces.csv"\n[[geometry.fracture]]\nname = "Berta"\npoints = [[0, 0], [1, 1]]',
         r'traces.csv: line 5: name = "Berta": is drawn in \[\[geometry.fracture\]\] too'),
        ('fractures_csv = "traces.csv"\n[fracture.Clara]\nnormal_stiffness = 1\nshear_stiffness = 1\nlaw = "linear"',
         "fracture.Clara.*: no fracture of that name in .geometry."),
        ('fractures_csv = "traces.csv"\nfracture = 3', "geometry.fracture = 3: must be"),
        ('fractures_csv = "traces.csv"\n[fracture]\n"Änne" = 7', "fracture.Änne = 7: must be a table"),
        ('fractures_csv = "traces.csv"\n[fracture]\n"Änne" = []', r"fracture.Änne = \[\]: must be a table"),
    ],
)  # fmt: skip
def test_scenes_that_make_no_sense(write, change, message):
    with pytest.raises(InputError, match=message) as caught:
        write(TABLE, SCENE.replace('fractures_csv = "traces.csv"', change))
    assert "\n" not in str(caught.value)


def test_a_stated_snap_may_be_longer_than_cells(write):
    """The network of a coarse mesh must be had on a fine one too, and a scene that is written back be read again."""
    scene = write(TABLE, SCENE.replace('fractures_csv = "traces.csv"', 'fractures_csv = "traces.csv"\nsnap = 1.5'))
    assert scene.geometry.snap == 1.5 > 0.5 * scene.geometry.size


def test_a_property_that_every_trace_has_need_not_be_in_the_default(write):
    """The default then only fills; one trace without it is named."""
    table = "name,x1,y1,x2,y2,aperture\nA,1,1,2,2,1 mm\nB,3,1,4,4,{}\n"
    scene = SCENE.partition("[fracture.Berta]")[0].replace('aperture = "1 mm"\n', "")
    found = write(table.format("2 mm"), scene)
    assert {name: found.fracture_named(name).aperture for name in "AB"} == {"A": 1e-3, "B": 2e-3}
    with pytest.raises(
        InputError, match=r"fracture.(B|default).aperture: missing; the law hyperbolic-coulomb needs it"
    ):
        write(table.format(""), scene)


def line_of(coordinates, kind="LineString", **properties):
    return {"type": "Feature", "properties": properties, "geometry": {"type": kind, "coordinates": coordinates}}


def test_a_map_is_read_as_its_table(write, tmp_path):
    """The map of the tutorial; parts of a feature are fractures, which lie apart; heights and other properties are left."""
    first, *_ = rows = read_traces(ROOT / "meshes/own_traces/map.geojson")
    assert len(rows) == 7 and first.properties == {"aperture": "0.3 mm"} and first.points[1] == [180.0, 225.0]
    parts = line_of([[[1, 1, 9], [2, 2, 9]], [[3, 3], [4, 3]]], "MultiLineString", name="Berta", fid=7, aperture=2e-3)
    (tmp_path / "m.geojson").write_text(json.dumps({"features": [parts, line_of([[1, 5], [3, 5]])]}))
    scene = write(TABLE, SCENE, "geometry.fractures_csv=m.geojson")
    assert [(trace.name, trace.points[0]) for trace in scene.geometry.fracture] == [
        ("Berta", (1, 1)), ("Berta 2", (3, 3)), ("trace 2", (1, 5)),
    ]  # fmt: skip
    assert scene.fracture["Berta 2"].aperture == 2e-3


@pytest.mark.parametrize(
    ("features", "message"),
    [
        ([], "has no features"),
        ([line_of([[0, 1], [2, 3]], "Polygon")], 'feature 1: its geometry is "Polygon"; a trace must be a LineString'),
        ([{"geometry": None}], "feature 1: its geometry is empty"),
        ([line_of([[0, 1]])], "feature 1: has fewer than two points"),
        ([line_of([[0, 1], "x"])], "feature 1: a point is no list"),
        ([line_of([[0, 1], [2, None]])], 'feature 1: y = "None": is no number'),
        ([line_of([[0, 1], [2, 3]], name="a"), line_of([[0, 5], [2, 5]], name="a")], 'feature 2: "a" was given before'),
        ([line_of([[0, 1], [2, 3]], name="a", aperture=-1)], 'feature 1: "a": aperture = -1.0: out of range'),
        ([line_of([[0, 1], [2, 3]], name="a", aperture=[1])], "feature 1: aperture: must be a number"),
        ("{", "give a map in GeoJSON"),
    ],
)
def test_maps_that_make_no_sense(write, tmp_path, features, message):
    text = features if isinstance(features, str) else json.dumps({"features": features})
    (tmp_path / "m.geojson").write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        write(TABLE, SCENE, "geometry.fractures_csv=m.geojson")
    assert "m.geojson: " in str(caught.value)


@pytest.mark.parametrize(
    ("shift", "extent", "digits", "is_map"),
    [
        ((6.12, 46.51), 0.01, 5, True),  # a quarry in degrees
        ((-117.6, 35.7), 0.3, 5, True),  # a fault zone in degrees
        ((0.0, 0.0), 0.01, 5, False),  # a sample in metres, from its corner
        ((-0.5, -0.5), 1.0, 5, False),  # one about its middle
        ((12.0, 30.0), 10.0, 5, False),  # a drift in metres
        ((334120.0, 5151890.0), 100.0, 5, False),  # UTM
        ((6.0, 46.0), 0.5, 2, False),  # a block in a frame of its own, in centimetres
    ],
)
def test_degrees_are_not_taken_as_metres_without_a_word(write, shift, extent, digits, is_map):
    ends = {"A": ((0.1234567, 0.0213243), (0.7654321, 0.9876123)), "B": ((0.0314159, 0.9182736), (0.9898, 0.1928374))}
    rows = [
        ",".join([name, *(f"{at + extent * share:.{digits}f}" for at, share in zip(shift, end, strict=True))])
        for name, pair in ends.items() for end in pair
    ]  # fmt: skip
    found = [*degrees(write("\n".join(["name,x,y", *rows]), SCENE.partition("[fracture.Berta]")[0]))]
    assert len(found) == is_map and all("project the map" in line for line in found)
