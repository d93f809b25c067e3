"""Small scenes and meshes that tests change in one place, the answer of a command, and the content of a folder."""

from __future__ import annotations

import os
import sys
import warnings
from pathlib import Path

import pytest

from fracflow.cli.app import main

ROOT = Path(__file__).parents[1]

SCENE = """title = "A square with a fault"
[geometry]
domain = [0, 0, 4, 4]
size = 2
[[geometry.fracture]]
name = "fault"
points = [[1, 2], [4, 2]]
[rock.rock]
youngs_modulus = "50 GPa"
poissons_ratio = 0.25
density = 2700
[initial_stress]
yy = "-5 MPa"
[fracture.fault]
normal_stiffness = "10 GPa/m"
shear_stiffness = "5 GPa/m"
aperture = "1 mm"
friction_angle_deg = 30
[fluid]
viscosity = "1e-3 Pa s"
[output]
pictures = false
[[support]]
on = ["west", "east", "south", "north"]
[[well]]
name = "well"
at = {fracture = "fault", end = "end"}
flow_rate = [[0, 0], [1, 1e-6]]
[[probe]]
name = "probe"
at = [3, 2]
[[stage]]
kind = "quasi-static"
time_step = 1
steps = 1
"""
TRACES = '[[geometry.fracture]]\nname = "fault"\npoints = [[1, 2], [4, 2]]\n'
GEOMETRY = SCENE[SCENE.index("[geometry]") : SCENE.index("[rock.rock]")]
FAULT = SCENE[SCENE.index("[fracture.fault]") : SCENE.index("[fluid]")]
STAGE = SCENE[SCENE.index("[[stage]]") :]
HELD = 'on = ["west", "east", "south", "north"]'
END = '{fracture = "fault", end = "end"}'

MSH = """$MeshFormat
2.2 0 8
$EndMeshFormat
$PhysicalNames
6
2 1 "rock"
1 2 "fault"
1 3 "south"
1 4 "east"
1 5 "north"
1 6 "west"
$EndPhysicalNames
$Nodes
9
1 0 0 0
2 2 0 0
3 4 0 0
4 0 2 0
5 2 2 0
6 4 2 0
7 0 4 0
8 2 4 0
9 4 4 0
$EndNodes
$Elements
14
1 3 2 1 1 1 2 5 4
2 3 2 1 1 2 3 6 5
3 3 2 1 1 4 5 8 7
4 3 2 1 1 5 6 9 8
5 1 2 2 2 4 5
6 1 2 2 2 5 6
7 1 2 3 3 1 2
8 1 2 3 3 2 3
9 1 2 4 4 3 6
10 1 2 4 4 6 9
11 1 2 5 5 7 8
12 1 2 5 5 8 9
13 1 2 6 6 1 4
14 1 2 6 6 4 7
$EndElements
"""
CELLS = MSH[MSH.index("1 3 2 1 1") : MSH.index("5 1 2 2 2")]
NAMED = ("$PhysicalNames\n6\n", '$PhysicalNames\n7\n{} 9 "empty"\n')  # a group without elements
V1 = "$NOD\n3\n1 0 0 0\n2 1 0 0\n3 0 1 0\n$ENDNOD\n$ELM\n1\n1 2 1 1 3 1 2 3\n$ENDELM\n"
RUBBISH = bytes(range(256)) * 8


def change(text, *pairs):
    """A text with parts of it replaced, each of which it must have."""
    for old, new in zip(pairs[::2], pairs[1::2], strict=True):
        assert old in text, old
        text = text.replace(old, new, 1)
    return text


def scene(*pairs):
    return {"scene.toml": change(SCENE, *pairs)}


def traces(table):
    """The scene with its fault from a table, None for a folder in its place."""
    return {"scene.toml": change(SCENE, TRACES, 'fractures_csv = "traces.csv"\n'), "traces.csv": table}


def mesh(content, *pairs, name="square.msh"):
    """The scene with a mesh of its own."""
    return {"scene.toml": change(SCENE, GEOMETRY, f'[mesh]\nfile = "{name}"\n', *pairs), name: content}


def msh(*pairs):
    return mesh(change(MSH, *pairs))


def placed(*pairs):
    """The scene with its mesh read, which is quicker than to make it."""
    return mesh(MSH, *pairs)


def geo(content):
    return mesh(content, name="square.geo")


def call(*words, **files):
    """The scene as it is, with other words on the command line; further files by name."""
    return {"scene.toml": SCENE, "words": words, **{name.replace("_", "."): text for name, text in files.items()}}


def override(*settings):
    return call("run", "scene.toml", "-o", "out", *(word for setting in settings for word in ("--set", setting)))


# what is given, and parts of the line that comes, in their order: file, key, value, remedy


BROKEN = "square.msh: cannot be read as a Gmsh mesh: … save it again from Gmsh"
FLAT = "square.msh: the cell at (1, 1) is flat, folded or not convex; mesh it better"
VERSION = "square.msh: is no Gmsh mesh of version 2 or 4; save it with Mesh.MshFileVersion = 4.1"


def lay(folder, files):
    """Write files, None for a folder, and return the words of the command."""
    for name, content in files.items():
        if content is None:
            (folder / name).mkdir()
        elif name != "words":
            (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    return list(files.get("words", ("run", "scene.toml", "-o", "out")))


def contents(folder):
    """All that lies in a folder: links as they are, files to the last byte, and times of writing."""
    found = {}
    for path in sorted(folder.rglob("*")):
        is_plain = path.is_file() and not path.is_symlink()
        found[path] = (path.lstat().st_mtime_ns, path.read_bytes() if is_plain else None)
    return found


def spoken(words, monkeypatch, capfd):
    """Exit code of a command in this process, and what it said on stderr, warnings that Python would show included."""
    monkeypatch.setattr(sys, "argv", ["fracflow", *words])
    with warnings.catch_warnings():
        warnings.resetwarnings()
        for hidden in (DeprecationWarning, PendingDeprecationWarning, ImportWarning, ResourceWarning):
            warnings.simplefilter("ignore", hidden)
        warnings.showwarning = lambda message, *_: print(f"warning: {message}", file=sys.stderr)
        with pytest.raises(SystemExit) as ended:
            main()
    return ended.value.code or 0, capfd.readouterr().err


def said(words, monkeypatch, capfd):
    """Exit code of a command in this process, and its one line."""
    code, line = spoken([str(word) for word in words], monkeypatch, capfd)
    check_one_line(line)
    return code, line


def check_one_line(said):
    assert said.startswith("fracflow: ") and said.endswith("\n") and said.count("\n") == 1, said
    assert said[:-1].isprintable() and "Traceback" not in said, said


def check_line(said, expected):
    check_one_line(said)
    rest = said
    for part in expected.split("…"):
        assert part.strip() in rest, f"{part.strip()!r} is not (or not there) in {said!r}"
        rest = rest.partition(part.strip())[2]


def environment():
    return {**os.environ, "PYTHONPATH": str(ROOT)}


def one_line_and_nothing_written(case, folder, monkeypatch, capfd):
    files, expected = case
    words = lay(folder, files)
    before = contents(folder)
    monkeypatch.chdir(folder)
    code, said = spoken(words, monkeypatch, capfd)
    assert code == 2, said
    check_line(said, expected)
    assert contents(folder) == before
