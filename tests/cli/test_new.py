"""``fracflow new``: scenes of three fractures, of a table of traces and of a mesh, that can be run; nothing is written over."""

import os

import numpy as np
import pytest
from malformed import MSH, spoken

from fracflow.cli.check import set_up
from fracflow.cli.new import write_scene
from fracflow.errors import InputError
from fracflow.scene.scene import load

pytestmark = pytest.mark.serial
AWKWARD = 'name,x,y\n"a ""b"" [c] {d}",0,0\n"a ""b"" [c] {d}",30,10\nÖst 1,500010,4e6\nÖst 1,500050,4.00001e6\n'


def random_traces(path, count=24):
    """Traces of all directions in a square of 2 km."""
    random = np.random.default_rng(1)
    middles, angles = random.uniform(0.0, 2000.0, (count, 2)), random.uniform(0.0, np.pi, count)
    lengths = 100.0 * random.pareto(2.0, count) + 100.0
    ends = 0.5 * lengths[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    rows = [f"{n},{x},{y}" for n in range(count) for x, y in (middles[n] - ends[n], middles[n] + ends[n])]
    path.write_text("\n".join(["name,x,y", *rows]))


def test_of_your_own_traces(tmp_path):
    random_traces(tmp_path / "my.csv")
    path = write_scene(tmp_path / "deep" / "mine", traces=tmp_path / "my.csv")
    assert path == tmp_path / "deep" / "mine" / "scene.toml"
    scene = load(path)
    assert len(scene.geometry.fracture) == 24 and "../../my.csv" in path.read_text()
    assert "# fractures, the longest first: " in path.read_text() and "and 4 more" in path.read_text()
    longest = max(scene.geometry.fracture, key=lambda trace: np.hypot(*np.subtract(*trace.points)))
    assert scene.well[0].at.fracture == longest.name
    sizes, _, card, _, _ = set_up(scene)
    assert 500 < sizes["cells"] < 20_000 and sizes["joints"] > 100 and card


def test_of_your_own_mesh(tmp_path):
    (tmp_path / "square.msh").write_text(MSH)
    path = write_scene(tmp_path / "mine.toml", mesh=tmp_path / "square.msh")
    scene = load(path)
    assert path == tmp_path / "mine.toml" and scene.mesh.file == "square.msh"
    assert "fractures, the longest first: fault\n" in path.read_text()
    assert set(scene.absorbing[0].on) == {"west", "east", "south", "north"} and list(scene.rock) == ["rock"]
    assert set_up(scene)[0]["joints"] > 0


def test_outer_curves_without_a_name_are_told(tmp_path):
    """Those at x = 4 and at y = 4, of two edges each."""
    lines = [line for line in MSH.splitlines() if not line.startswith(("1 4", "1 5"))]
    named = [line for line in lines if len(line.split()) != 7 or line.split()[3] not in ("4", "5")]
    elements = named.index("$Elements") + 1
    named[elements] = str(len(named) - elements - 2)
    named[named.index("$PhysicalNames") + 1] = "4"
    (tmp_path / "square.msh").write_text("\n".join(named) + "\n")
    with pytest.warns(UserWarning, match=r"4 outer edges have no name, as at \("):
        path = write_scene(tmp_path / "mine.toml", mesh=tmp_path / "square.msh")
    with pytest.raises(InputError, match=r"out of balance at .*outer curves without a name, as at \("):
        set_up(load(path))


def test_names_and_places_of_any_kind(tmp_path, monkeypatch):
    (tmp_path / "odd.csv").write_text(AWKWARD)
    monkeypatch.chdir(tmp_path)
    scene = load(write_scene(tmp_path / "new", traces=tmp_path / "odd.csv"))
    assert {trace.name for trace in scene.geometry.fracture} == {'a "b" [c] {d}', "Öst 1"}
    (west, south), _, (east, north), _ = scene.geometry.domain
    assert west < 0 and south < 0 and east > 500050 and north > 4.00001e6


def test_a_file_that_is_there_stays(tmp_path):
    (tmp_path / "scene.toml").write_text("mine")
    os.symlink(tmp_path / "nowhere", tmp_path / "link.toml")
    for where in (tmp_path, tmp_path / "link.toml"):
        with pytest.raises(InputError, match="is there already"):
            write_scene(where)
    assert (tmp_path / "scene.toml").read_text() == "mine" and not (tmp_path / "nowhere").exists()
    with pytest.raises(InputError, match="a file has the name of its folder; name another"):
        write_scene(tmp_path / "scene.toml" / "below")


WRONG = {
    "--traces my.csv --mesh my.msh": "new: --traces and --mesh: give one of them",
    "--traces nowhere.csv": "nowhere.csv: no such file",
    "--traces bad.csv": "bad.csv: line 1: the columns are a,b; they must have name,x,y",
    "--traces west.csv": 'fracture "west": the name is taken by another fracture, a side or the rock; choose another',
    "--mesh plain.geo": "plain.geo: no named curve inside the mesh is a fracture; give each one a physical curve",
}


@pytest.mark.parametrize("words", WRONG)
def test_what_makes_no_scene_is_refused_and_nothing_written(words, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bad.csv").write_text("a,b\n1,2\n")
    (tmp_path / "west.csv").write_text("name,x,y\nwest,0,0\nwest,1,1\n")
    square = (
        "Point(1) = {0, 0, 0};\nPoint(2) = {1, 0, 0};\nPoint(3) = {0, 1, 0};\nLine(1) = {1, 2};\nLine(2) = {2, 3};\n"
    )
    rest = 'Line(3) = {3, 1};\nCurve Loop(1) = {1, 2, 3};\nPlane Surface(1) = {1};\nPhysical Surface("rock") = {1};\n'
    (tmp_path / "plain.geo").write_text(square + rest)
    code, line = spoken(["new", "made", *words.split()], monkeypatch, capfd)
    assert code == 2 and WRONG[words] in line and line.count("\n") == 1
    assert not (tmp_path / "made").exists()
