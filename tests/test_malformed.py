"""Bad input through the command line: exit code 2, one line that names file, key, value and remedy, nothing written."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from resealed import changed_notes, resealed

from fracflow.cli.app import main

pytestmark = pytest.mark.serial
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
SCENES = {
    "missing": ({}, "scene.toml: no such file; give the path of a TOML file"),
    "a folder": ({"scene.toml": None}, "scene.toml: cannot be read: Is a directory; give the path of a TOML file"),
    "empty": ({"scene.toml": ""}, "scene.toml: stage: missing; a run needs at least one [[stage]] (and 2 more)"),
    "truncated": ({"scene.toml": SCENE[: SCENE.index(' GPa"')]}, "scene.toml: not valid TOML: … (at"),
    "cut between tables": (
        {"scene.toml": SCENE[: SCENE.index("[[support]]")]},
        "scene.toml: stage: missing; a run needs",
    ),
    "rubbish": ({"scene.toml": RUBBISH}, "scene.toml: not UTF-8 text: … at byte 128; save it as UTF-8"),
    "UTF-16": ({"scene.toml": SCENE.encode("utf-16")}, "scene.toml: not UTF-8 text: … at byte 0; save it as UTF-8"),
    "Latin-1": (
        {"scene.toml": SCENE.replace("square", "Würfel").encode("latin-1")},
        "not UTF-8 text: … save it as UTF-8",
    ),
    "a NUL": (scene("2700", "2700\0"), "scene.toml: not valid TOML: … (at line 11, column 15)"),
    "nested too deep": (scene('"A square with a fault"', "[" * 5000), "scene.toml: not valid TOML: brackets too deep"),
    "a table twice": (
        scene("[fluid]", "[rock.rock]\n[fluid]"),
        "scene.toml: not valid TOML: Cannot declare … (at line 19",
    ),
    "a title of two lines": (scene("A square", r"A\nsquare"), 'title = "A\\nsquare … must be one line'),
    "NaN": (scene("0.25", "nan"), "scene.toml: rock.rock.poissons_ratio = nan: must be finite"),
    "infinite": (scene("2700", "inf"), "scene.toml: rock.rock.density = inf: must be finite, and at most 1e+100"),
    "a huge whole number": (
        scene("2700", "9" * 400),
        "scene.toml: rock.rock.density = 999… must be finite, and at most",
    ),
    "a huge number": (
        scene('"50 GPa"', "1e308"),
        "scene.toml: rock.rock.youngs_modulus = 1e308: must be finite, and at most",
    ),
    "a huge number in a unit": (
        scene('"50 GPa"', '"1e999 Pa"'),
        'rock.rock.youngs_modulus = "1e999 Pa": must be finite',
    ),
    "a number that is almost zero": (
        scene('"1e-3 Pa s"', "1e-320"),
        "fluid.viscosity = 1e-320: … at least 1e-100 or 0",
    ),
    "a length in Pa": (
        scene('"1 mm"', '"1 Pa"'),
        'fracture.fault.aperture = "1 Pa": "Pa" is not a unit of length; … "1 mm"',
    ),
    "unit unknown": (
        scene("50 GPa", "50 GPu"),
        'youngs_modulus = "50 GPu": unknown unit "GPu"; must be a number in N/m**2 or',
    ),
    "negative aperture": (
        scene('"1 mm"', '"-1 mm"'),
        'fracture.fault.aperture = "-1 mm": out of range; must be above 0',
    ),
    "a profile below zero": (
        scene('"1 mm"', "{along = [0, 3], value = [1, -1]}"),
        "fault.aperture = {along … must be above 0",
    ),
    "a profile that descends": (
        scene('"1 mm"', "{along = [3, 0], value = [1, 2]}"),
        "fracture.fault.aperture = {along = [3, 0], value = [1, 2]}: the distances of a table must ascend",
    ),
    "times that descend": (
        scene("[0, 0], [1,", "[2, 0], [1,"),
        "well.well.flow_rate = [[2, 0], … the times of a table must ascend",
    ),
    "unit system unknown": (
        scene("title", 'units = "kg"\ntitle'),
        'scene.toml: units = "kg": not a unit system; use "SI"',
    ),
    "key unknown": (
        scene("viscosity", "viscositty"),
        'fluid.viscositty = "1e-3 Pa s": unknown key; did you mean "viscosity"?',
    ),
    "fractures of no geometry": (
        scene(TRACES, "fracture = []\n"),
        "fracture.fault: no fracture of that name in [geometry]",
    ),
    "a default for no fractures": (
        scene(TRACES, "fracture = []\n", "fracture.fault", "fracture.default"),
        'scene.toml: well.well.at.fracture = "fault": not in the mesh; none is allowed here',
    ),
    "a name twice": (
        scene(TRACES, TRACES * 2),
        'geometry.fracture.fault.name = "fault": stands twice; names must differ',
    ),
    "a fracture called like a side": (
        {"scene.toml": SCENE.replace("fault", "west")},
        'scene.toml: geometry: fracture "west": the name is taken by another fracture, a side or the rock; choose another',
    ),
    "a probe called dot": (scene('"probe"', '"."'), 'probe...name = ".": is no name for the history'),
    "a name with a NUL": (
        scene('"probe"', '"a\\u0000"'),
        'name = "a\\u0000": must be one line without control characters',
    ),
    "mesh and geometry": (
        scene("[fluid]", '[mesh]\nfile = "a.msh"\n[fluid]'),
        "geometry: contradicts [mesh]; give one of them",
    ),
    "domain crosses itself": (
        scene("[0, 0, 4, 4]", "[[0, 0], [4, 4], [4, 0], [0, 4]]"),
        "scene.toml: geometry.domain: the sides cross each other; list the corners in their order",
    ),
    "domain without area": (
        scene("[0, 0, 4, 4]", "[[0, 2], [2, 2], [4, 2]]"),
        "geometry.domain: the corner (2, 2) is within",
    ),
    "domain inside out": (
        scene("[0, 0, 4, 4]", "[4, 4, 0, 0]"),
        "geometry.domain = [4, 4, 0, 0]: must be … xmin < xmax",
    ),
    "domain closed twice": (
        scene("[0, 0, 4, 4]", "[[0, 0], [4, 0], [4, 4], [0, 0]]"),
        "geometry.domain: the side that starts at (0, 0) is no longer than snap = 0.0113",
    ),
    "cells too many": (
        scene("size = 2", "size = 1e-6"),
        "geometry.size = 1e-06: would take some 2e+13 cells; raise it",
    ),
    "a trace of one point": (
        scene("[[1, 2], [4, 2]]", "[[1, 2]]"),
        "fault.points = [[1, 2]]: must be at least two points",
    ),
    "a trace of no length": (
        scene("[4, 2]]", "[1, 2]]"),
        "fault.points = [[1, 2], [1, 2]]: two points in a row are the same",
    ),
    "a trace of hardly any length": (
        scene("[4, 2]]", "[1, 2.01]]", "size = 2", "size = 2\nsnap = 0.1"),
        'fracture "fault": is shorter than snap = 0.1; remove it',
    ),
    "a trace outside": (
        scene("[[1, 2], [4,", "[[10, 2], [14,"),
        'fracture "fault": lies outside the domain; move or remove it',
    ),
    "a trace along a side": (
        scene("[[1, 2], [4, 2]]", "[[0, 0], [4, 0]]"),
        'fracture "fault": runs along side south for 4',
    ),
    "a well off the fracture": (
        placed(END, "[1, 3.9]"),
        "well.well: at = [1.0, 3.9]: the nearest fracture is 2.15 away; move it",
    ),
    "a well on no fracture": (
        placed('"fault", end', '"fold", end'),
        'well.well.at.fracture = "fold": not in the mesh; allowed: fault',
    ),
    "a probe outside": (
        placed("[3, 2]\n", "[3, 5]\n"),
        "scene.toml: probe.probe: at = [3.0, 5.0]: is outside the mesh; move it in",
    ),
    "a quantity of no place": (
        placed("[3, 2]\n", '[3, 2]\nquantities = ["strain"]\n'),
        "scene.toml: probe.probe.quantities: strain: belongs to the rock … fracture fault there has displacement",
    ),
    "a support of no side": (
        placed('"east", ', '"eest", '),
        'support.0.on = "eest": not in the mesh; did you mean "west"?',
    ),
    "a load on a fracture": (
        placed("[[well]]", '[[load]]\non = "fault"\npressure = 1\n[[well]]'),
        'scene.toml: load.0.on = "fault": not in the mesh; allowed: east, north, south, west',
    ),
    "a rotation of a deformable rock": (
        scene(HELD, 'on = "rock"\ncomponents = ["x", "y", "rotation"]'),
        'scene.toml: support.0.components = ["x", "y", "rotation"]: only a rigid rock has a rotation; leave it out',
    ),
    "ties that do not face": (
        placed(HELD, 'on = "north"\n[[tie]]\non = ["west", "south"]'),
        'scene.toml: tie: the sides "west" and "south" do not face each other: 2 and 2 facets … mesh them alike',
    ),
    "a tie to itself": (
        scene(HELD, f'{HELD}\n[[tie]]\non = ["west", "west"]'),
        'tie.0.on = ["west", "west"]: names one side twice',
    ),
    "end and steps": (
        scene("steps = 1", "steps = 1\nend = 3"),
        "stage.0.steps = 1: contradicts end = 3; give one of them",
    ),
    "steps without end": (
        scene("steps = 1", "end = 1e20"),
        "stage.0.time_step = 1: would take 1e+20 steps; raise it, or end",
    ),
    "a table of stages": (scene("[[stage]]", "[stage]"), "scene.toml: stage: must be an array of tables [[stage]]"),
    "equilibrate at the end": (
        {"scene.toml": SCENE + '[[stage]]\nkind = "equilibrate"\nsteps = 3\n'},
        'stage.1.kind = "equilibrate": only the first stage can equilibrate',
    ),
    "pumped without a drain": (
        placed("quasi-static", "steady"),
        "scene.toml: well.well: a steady stage pumps into fault … give one",
    ),
    "past the strength": (
        placed("yy =", 'xy = "4 MPa"\nyy ='),
        "scene.toml: initial state: initial shear traction reaches the strength of fault: lower the shear stress",
    ),
    "out of balance": (
        placed(HELD, 'on = "west"'),
        "scene.toml: initial state: out of balance at 4 unknowns, at east, north",
    ),
    "no name of an option": (
        {"scene.toml": SCENE + '[petsc]\n"" = 3\n'},
        "is no name of a PETSc option; give it without dash",
    ),
    "a type PETSc does not know": (
        {"scene.toml": SCENE + '[petsc]\nmonolithic_ksp_type = "gmress"\n'},
        'scene.toml: petsc.monolithic_ksp_type = "gmress": must be one of preonly, … command line: -- -monolithic_ksp_type',
    ),
}
TABLES = {
    "missing": (
        scene(TRACES, 'fractures_csv = "traces.csv"\n'),
        "traces.csv: no such file; geometry.fractures_csv",
    ),
    "a folder": (traces(None), "traces.csv: cannot be read: Is a directory; geometry.fractures_csv names a UTF-8"),
    "empty": (traces(""), "traces.csv: is empty; its first line must name the columns, such as name,x,y"),
    "a head alone": (traces("name,x,y\n"), "traces.csv: has no rows below its first line; give at least one trace"),
    "rubbish": (traces(RUBBISH), "traces.csv: not UTF-8 text: … at byte 128; save it as UTF-8"),
    "UTF-16": (
        traces("name,x,y\nfault,1,2\n".encode("utf-16")),
        "traces.csv: not UTF-8 text: … save it as UTF-8",
    ),
    "truncated": (
        traces("name,x,y\nfault,1,2\nfault,4\n"),
        "traces.csv: line 3: has 2 fields, the first line names 3 columns",
    ),
    "an open quote": (
        traces('name,x,y\n"fault,1,2\n'),
        "traces.csv: line 2: unexpected end of data; give a plain table",
    ),
    "NaN": (traces("name,x,y\nfault,1,nan\nfault,4,2\n"), "traces.csv: line 2: y = nan: must be finite"),
    "huge": (
        traces("name,x,y\nfault,1,2\nfault,1e300,2\n"),
        "traces.csv: line 3: x = 1e300: must be finite, and at most 1e+100",
    ),
    "decimal commas": (
        traces("name;x;y\nfault;1,5;2\n"),
        'traces.csv: line 2: x = "1,5": is no number; decimals take a point',
    ),
    "one point": (
        traces("name,x,y\nfault,1,2\n"),
        'traces.csv: line 2: fracture "fault" has one point; a trace needs two',
    ),
    "no length": (
        traces("name,x,y\nfault,1,2\nfault,1,2\n"),
        'traces.csv: line 3: "fault": the point [1.0, 2.0] stands twice',
    ),
    "no x": (
        traces("name,east,y\nfault,1,2\n"),
        "traces.csv: line 1: the columns are name,east,y; they must have name,x,y",
    ),
    "aperture below zero": (
        traces("name,x,y,aperture\nfault,1,2,-1\nfault,4,2,\n"),
        'traces.csv: line 2: "fault": aperture = -1.0: out of range; must be above 0',
    ),
    "a name apart": (
        traces("name,x,y\nfault,1,2\nb,1,1\nfault,4,2\n"),
        'line 4: "fault" was given before; the rows of one',
    ),
    "a name unknown": (
        traces("name,x,y\nfold,1,2\nfold,4,2\n"),
        'scene.toml: fracture.fold: missing; the fracture "fold" needs',
    ),
    "a path with a NUL": (
        scene(TRACES, 'fractures_csv = "a\\u0000.csv"\n'),
        'scene.toml: geometry.fractures_csv = "a\\u0000.csv": must be one line without control characters',
    ),
}
BROKEN = "square.msh: cannot be read as a Gmsh mesh: … save it again from Gmsh"
FLAT = "square.msh: the cell at (1, 1) is flat, folded or not convex; mesh it better"
VERSION = "square.msh: is no Gmsh mesh of version 2 or 4; save it with Mesh.MshFileVersion = 4.1"
MESHES = {
    "missing": (
        scene(GEOMETRY, '[mesh]\nfile = "a.msh"\n'),
        "a.msh: no such file; mesh.file names it from the scene's folder",
    ),
    "a folder": (mesh(None), "square.msh: is no regular file (a folder, pipe or device); mesh.file names it"),
    "name too long": (
        scene(GEOMETRY, f'[mesh]\nfile = "{"a" * 300}.msh"\n'),
        "a.msh: cannot be read: File name too long; mesh.file names it",
    ),
    "another kind": (mesh("x", name="square.vtk"), 'square.vtk: unknown kind of file ".vtk"; give a Gmsh .geo or .msh'),
    "empty": (mesh(""), VERSION),
    "rubbish": (mesh(RUBBISH), VERSION),
    "version 1": (mesh(V1), VERSION),
    "version 9": (msh("2.2 0 8", "9.9 0 8"), VERSION),
    "cut in the nodes": (mesh(MSH[: MSH.index("6 4 2 0")]), BROKEN),
    "cut in the elements": (mesh(MSH[: MSH.index("7 1 2 3 3")]), BROKEN),
    "a node missing": (msh("9 4 4 0\n", "", "$Nodes\n9", "$Nodes\n8"), BROKEN),
    "a word for a number": (msh("5 2 2 0", "5 two 2 0"), BROKEN),
    "a node beyond all": (msh("1 2 5 4\n", f"1 2 5 {'9' * 20}\n"), BROKEN),
    "more elements than it has": (msh("$Elements\n14", "$Elements\n1400000000000"), BROKEN),
    "names in Latin-1": (mesh(change(MSH, '"rock"', '"Würfel"').encode("latin-1")), BROKEN),
    "NaN": (
        msh("5 2 2 0", "5 nan 2 0"),
        "square.msh: a node has the coordinates [nan, 2.0, 0.0], which are not finite",
    ),
    "infinite": (
        msh("9 4 4 0", "9 inf 4 0"),
        "square.msh: a node has the coordinates [inf, 4.0, 0.0], which are not finite",
    ),
    "an inverted cell": (msh("1 1 2 5 4\n", "1 1 5 2 4\n"), FLAT),
    "a flat cell": (msh("5 2 2 0", "5 0 2 0"), "square.msh: the cell at (0.5, 1) is flat, folded or not convex"),
    "not in a plane": (
        msh("9 4 4 0", "9 4 4 1"),
        "square.msh: the mesh is not in a plane z = constant (z varies by 1)",
    ),
    "tetrahedra": (msh("14 1 2 6 6 4 7", "14 4 2 1 1 1 2 4 5"), "square.msh: has elements of type tetra; use linear"),
    "second order": (msh("14 1 2 6 6 4 7", "14 8 2 6 6 1 7 4"), "square.msh: has elements of type line3; use linear"),
    "no cells": (msh("$Elements\n14", "$Elements\n10", CELLS, ""), "square.msh: has no cells; it needs a surface"),
    "overlapping cells": (
        msh("$Elements\n14", "$Elements\n15", "$EndElements", "15 2 2 1 1 1 2 5\n$EndElements"),
        "scene.toml: mesh: more than two cells share the edge at (2, 1); cells must not overlap",
    ),
    "a rock without a name": (msh('6\n2 1 "rock"\n', "5\n"), "square.msh: physical surface 1 has no name; give it one"),
    "a cell of no rock": (
        msh("1 3 2 1 1", "1 3 2 0 0"),
        "square.msh: the cell at (1, 1) belongs to no physical surface; give",
    ),
    "a fracture through cells": (
        msh("2 2 4 5", "2 2 1 5"),
        'fracture "fault": the facet (0, 0) to (2, 2) is no edge of the mesh',
    ),
    "a side on the fracture": (
        msh("3 3 1 2", "3 3 4 5"),
        'side "south": the facet at (1, 2) is inside the mesh; name it as',
    ),
    "a fracture of another name": (
        msh('"fault"', '"fold"'),
        'square.msh: no physical curve "fault" for the fracture of that name',
    ),
    "a group without cells as a rock": (
        mesh(
            change(MSH, NAMED[0], NAMED[1].format(2)),
            "[rock.rock]",
            "[rock.empty]\nyoungs_modulus = 1e9\npoissons_ratio = 0.2\n[rock.rock]",
        ),
        'scene.toml: rock = "empty": not in the mesh; allowed: rock',
    ),
    "a group without cells as a fracture": (
        mesh(change(MSH, NAMED[0], NAMED[1].format(1)), "[fluid]", FAULT.replace("fault", "empty") + "[fluid]"),
        'square.msh: no physical curve "empty" for the fracture of that name (there are: east, fault, north, south, west)',
    ),
    "a group without cells as a side": (
        mesh(change(MSH, NAMED[0], NAMED[1].format(1)), '"west", "east"', '"empty", "east"'),
        'scene.toml: support.0.on = "empty": not in the mesh; allowed: east, north, rock, south, west',
    ),
    "a geometry that is empty": (geo("\n"), "square.geo: has no cells; it needs a surface, meshed or to be meshed"),
    "a geometry of bad syntax": (
        geo("Point(1) = {0, 0, 0;\n"),
        "square.geo: Gmsh: … line 1: syntax error (;); correct the file",
    ),
    "a geometry of rubbish": (
        geo(RUBBISH + b"\n"),
        "square.geo: line 2: a line end that is neither Unix's nor … --trust",
    ),
    "a geometry without its last line end": (
        geo("Point(1) = {0, 0, 0};"),
        "square.geo: Gmsh would ignore the last line",
    ),
    "a geometry that includes nothing": (
        geo('Include "a.geo";\n'),
        'square.geo: line 1: Include "a.geo";: no such file; correct the name',
    ),
    "a geometry that ends Gmsh": (geo("Exit;\n"), "square.geo: line 1: Exit;: … --trust"),
    "a solid body": (
        geo('SetFactory("OpenCASCADE");\nBox(1) = {0, 0, 0, 1, 1, 1};\nPhysical Surface("rock") = {1:6};\n'),
        "square.geo: the mesh is not in a plane z = constant (z varies by 1)",
    ),
}
COMMANDS = {
    "none": (call(), "command line: no command; see fracflow --help"),
    "unknown": (call("rum"), "command line: No such command 'rum'. … see fracflow --help"),
    "no scene": (call("run"), "command line: Missing argument 'scene'; see fracflow --help"),
    "a word too many": (call("check", "scene.toml", "b"), "command line: … (b); see fracflow --help"),
    "an option unknown": (
        call("check", "scene.toml", "--jason"),
        "command line: No such option: --jason … see fracflow --help",
    ),
    "an option misspelt": (
        call("run", "scene.toml", "--outptu", "x"),
        "command line: --outptu: neither an option of fracflow (see",
    ),
    "an option without value": (
        call("run", "scene.toml", "-o"),
        "command line: Option '-o' requires an argument; see fracflow",
    ),
    "a stray word for PETSc": (
        call("run", "scene.toml", "-o", "out", "--", "ksp_type"),
        "command line: ksp_type: neither",
    ),
    "--set without value": (
        override("stage.0.steps"),
        "--set stage.0.steps: must be path.to.key=value, such as stage.0",
    ),
    "--set without key": (override("=3"), "--set =3: must be path.to.key=value, such as"),
    "--set of no entry": (override("stage.7.steps=3"), "--set stage.7.steps=3: stage.7: no such entry; allowed: 0"),
    "--set of no key": (override("fluid.viscositty=3"), "scene.toml: fluid.viscositty = 3: unknown key; did you mean"),
    "--set inside a value": (
        override("fluid.viscosity.x=3"),
        "--set fluid.viscosity.x=3: fluid.viscosity is a value, not a",
    ),
    "--set of bytes": (
        override("fluid.viscosity=\udcff"),
        "scene.toml: fluid.viscosity = … must be a number in N*s/m**2 or",
    ),
    "to a file": (call("run", "scene.toml", "-o", "out", out="mine"), "out: is a file; name a folder for the run"),
    "below a file": (
        call("run", "scene.toml", "-o", "f.txt/out", f_txt="mine"),
        "f.txt/out: cannot be made in … name a folder",
    ),
    "to a foreign folder": (
        call("run", "scene.toml", "-o", "."),
        ".: holds files that are no run's; name a new or empty folder",
    ),
    "to a name too long": (call("run", "scene.toml", "-o", "x" * 300), "File name too long; name a folder to write to"),
    "resume of nothing": (
        call("resume", "nothing"),
        "nothing: holds no run of fracflow; name the folder of an earlier run",
    ),
    "resume of a file": (call("resume", "scene.toml"), "scene.toml: is a file; name a folder"),
    "resume of a scene's folder": (
        call("resume", "."),
        ".: holds no run of fracflow; name the folder of an earlier run",
    ),
    "picture of nothing": (call("picture", "nothing"), "nothing/history.h5: no such file; name the folder of a run"),
    "picture of a file": (
        call("picture", "scene.toml"),
        "scene.toml/history.h5: no such file; name the folder of a run",
    ),
    "picture of rubbish": (
        call("picture", ".", history_h5=RUBBISH),
        "history.h5: is no readable history … put back a copy of the file, or start the run again with fracflow run",
    ),
    "export of nothing": (
        call("export", "nothing", "--csv"),
        "nothing/history.h5: no such file; name the folder of a run",
    ),
    "export as nothing": (call("export", "."), "export: no format is named; give --csv"),
    "check of a bad scene": (
        {**scene("size = 2", "size = -2"), "words": ("check", "scene.toml", "--json")},
        "scene.toml: geometry.size = -2: out of range; must be above 0",
    ),
    "mesh of a bad scene": (
        {**scene("size = 2", "size = -2"), "words": ("mesh", "scene.toml")},
        "scene.toml: geometry.size = -2: out of range; must be above 0",
    ),
}
CASES = {
    f"{kind}: {name}": case
    for kind, cases in {"scene": SCENES, "table": TABLES, "mesh": MESHES, "command": COMMANDS}.items()
    for name, case in cases.items()
}


def lay(folder, files):
    """Write files, None for a folder, and return the words of the command."""
    for name, content in files.items():
        if content is None:
            (folder / name).mkdir()
        elif name != "words":
            (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    return list(files.get("words", ("run", "scene.toml", "-o", "out")))


def contents(folder):
    """The content of a folder, to the last byte and to its time of writing."""
    return {path: path.is_file() and (path.read_bytes(), path.stat().st_mtime_ns) for path in folder.rglob("*")}


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


def check_line(said, expected):
    assert said.startswith("fracflow: ") and said.endswith("\n") and said.count("\n") == 1, said
    assert said[:-1].isprintable() and "Traceback" not in said, said
    rest = said
    for part in expected.split("…"):
        assert part.strip() in rest, f"{part.strip()!r} is not (or not there) in {said!r}"
        rest = rest.partition(part.strip())[2]


@pytest.mark.parametrize("name", CASES)
def test_one_line_and_nothing_written(name, tmp_path, monkeypatch, capfd):
    files, expected = CASES[name]
    words = lay(tmp_path, files)
    before = contents(tmp_path)
    monkeypatch.chdir(tmp_path)
    code, said = spoken(words, monkeypatch, capfd)
    assert code == 2, said
    check_line(said, expected)
    assert contents(tmp_path) == before


@pytest.mark.parametrize(
    "files",
    [
        {"scene.toml": SCENE.encode("utf-8-sig")},
        {"scene.toml": SCENE.replace("\n", "\r\n")},
        scene("[0, 0, 4, 4]", "[[0, 0], [0, 4], [4, 4], [4, 0]]"),
        traces("name,x,y\nfault,1,2\nfault,4,2\n".encode("utf-8-sig")),
        mesh(MSH.replace("\n", "\r\n")),
        msh("1 1 2 5 4\n", "1 4 5 2 1\n"),
    ],
    ids=[
        "a byte order mark",
        "line ends of Windows",
        "clockwise",
        "a table with a mark",
        "a mesh of Windows",
        "a clockwise cell",
    ],
)
def test_what_is_odd_but_right(files, tmp_path, monkeypatch, capfd):
    """The cases above fail for what was changed in them: the scene itself runs, and so do these."""
    words = lay(tmp_path, files)
    monkeypatch.chdir(tmp_path)
    assert spoken(words, monkeypatch, capfd) == (0, "")
    assert (tmp_path / "out" / "history.h5").is_file()


@pytest.fixture(scope="module")
def stopped(tmp_path_factory):
    """A run that its checkpoint says is not at its end."""
    home = tmp_path_factory.mktemp("stopped")
    lay(home, placed("steps = 1", "steps = 2"))
    words = [sys.executable, "-m", "fracflow", "run", "scene.toml", "-o", "out"]
    subprocess.run(words, cwd=home, env=environment(), check=True, capture_output=True)
    with changed_notes(home / "out" / "checkpoint.h5") as notes:
        notes["finished"] = False
    return home / "out"


def environment():
    return {**os.environ, "PYTHONPATH": str(ROOT)}


def cut(path):
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def without(name):
    def drop(path):
        with resealed(path) as (arrays, _):
            del arrays[name]

    return drop


def without_note(name):
    def drop(path):
        with changed_notes(path) as notes:
            del notes[name]

    return drop


def of_three(path):
    with resealed(path) as (arrays, _):
        arrays["displacement"] = np.array([1.0, 2.0, 3.0])


AGAIN = "start the run again with fracflow run"
DAMAGES = {
    "rubbish as checkpoint": (
        "checkpoint.h5",
        lambda path: path.write_bytes(RUBBISH),
        f"checkpoint.h5: is no checkpoint … {AGAIN}",
    ),
    "an empty checkpoint": (
        "checkpoint.h5",
        lambda path: path.write_bytes(b""),
        f"checkpoint.h5: is no checkpoint … {AGAIN}",
    ),
    "half a checkpoint": ("checkpoint.h5", cut, f"checkpoint.h5: is no checkpoint … {AGAIN}"),
    "a checkpoint without its stage": (
        "checkpoint.h5",
        without_note("stage"),
        f"checkpoint.h5: is no checkpoint … {AGAIN}",
    ),
    "a checkpoint without pressure": ("checkpoint.h5", without("pressure"), f"(pressure has 0 rows, not 3); {AGAIN}"),
    "a checkpoint of another mesh": ("checkpoint.h5", of_three, f"(displacement has 3 rows, not … {AGAIN}"),
    "no mesh": ("mesh.h5", Path.unlink, f"mesh.h5: is no saved mesh … {AGAIN}"),
    "rubbish as mesh": ("mesh.h5", lambda path: path.write_bytes(RUBBISH), f"mesh.h5: is no saved mesh … {AGAIN}"),
    "a mesh without cells": ("mesh.h5", without("cells"), f"mesh.h5: is not of this run … {AGAIN}"),
    "no history": ("history.h5", Path.unlink, "history.h5: no such file"),
    "rubbish as history": (
        "history.h5",
        lambda path: path.write_bytes(RUBBISH),
        f"is no readable history … or {AGAIN}",
    ),
    "half a history": (
        "history.h5",
        cut,
        f"history.h5: is no readable history … put back a copy of the file, or {AGAIN}",
    ),
    "rubbish as scene": (
        "scene.toml",
        lambda path: path.write_bytes(RUBBISH),
        "scene.toml: not UTF-8 text: … save it as UTF-8",
    ),
    "no scene": ("scene.toml", Path.unlink, "holds no run of fracflow that could go on; name the folder of one"),
}


@pytest.mark.parametrize("name", DAMAGES)
def test_a_damaged_run_stays_as_it_is(name, stopped, tmp_path, monkeypatch, capfd):
    file, damage, expected = DAMAGES[name]
    folder = tmp_path / "out"
    shutil.copytree(stopped, folder)
    damage(folder / file)
    before = contents(folder)
    code, said = spoken(["resume", str(folder)], monkeypatch, capfd)
    assert code == 2, said
    check_line(said, expected)
    assert contents(folder) == before


def test_a_bad_scene_leaves_an_earlier_run(stopped, tmp_path, monkeypatch, capfd):
    shutil.copytree(stopped, tmp_path / "out")
    words = lay(tmp_path, msh("1 1 2 5 4\n", "1 1 5 2 4\n"))
    before = contents(tmp_path)
    monkeypatch.chdir(tmp_path)
    code, said = spoken(words, monkeypatch, capfd)
    assert code == 2
    check_line(said, FLAT)
    assert contents(tmp_path) == before


PROCESSES = {
    "command: unknown": CASES["command: unknown"],
    "mesh: an inverted cell": CASES["mesh: an inverted cell"],
    "mesh: a geometry of bad syntax": CASES["mesh: a geometry of bad syntax"],
    "options that a bad scene leaves unused": (
        {**placed("2700", "nan"), "words": ("run", "scene.toml", "-o", "out", "--", "-flow_ksp_rtol", "1e-9")},
        "scene.toml: rock.rock.density = nan: must be finite",
    ),
    "a type that PETSc does not know": (
        {**placed(), "words": ("run", "scene.toml", "-o", "out", "--", "-monolithic_pc_type", "luu")},
        "PETSc option of -monolithic_, in [petsc] or on the command line: … luu; see PETSc's manual",
    ),
}


@pytest.mark.starts_ranks
def test_in_processes_of_their_own(tmp_path):
    """As above, for whatever C libraries say at their end; and two ranks, of which one speaks."""

    def run(name):
        files, _ = PROCESSES[name]
        ranks = 2 if name == "mesh: an inverted cell" else 1
        folder = tmp_path / str(list(PROCESSES).index(name))
        folder.mkdir()
        words = [
            *(["mpirun", "-n", str(ranks)] if ranks > 1 else []),
            sys.executable,
            "-m",
            "fracflow",
            *lay(folder, files),
        ]
        before = contents(folder)
        done = subprocess.run(words, cwd=folder, env=environment(), capture_output=True, text=True, timeout=120)
        assert contents(folder) == before
        return ranks, done

    with ThreadPoolExecutor(2) as pool:
        for (ranks, done), (_, expected) in zip(pool.map(run, PROCESSES), PROCESSES.values(), strict=True):
            assert done.returncode == 2, done.stderr
            lines = done.stderr.splitlines(keepends=True)
            ours = [line for line in lines if line.startswith("fracflow: ")]
            assert len(ours) == 1 and (ranks > 1 or ours == lines), done.stderr  # mpirun adds lines of its own
            assert "Traceback" not in done.stderr and "arning" not in done.stderr, done.stderr
            check_line(ours[0], expected)
