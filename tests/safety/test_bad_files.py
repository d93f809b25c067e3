"""Bad tables, meshes and commands: exit code 2, one line that names file, place and remedy, nothing written."""

from __future__ import annotations

import pytest
from malformed import (
    BROKEN,
    CELLS,
    FAULT,
    FLAT,
    GEOMETRY,
    MSH,
    NAMED,
    RUBBISH,
    TRACES,
    V1,
    VERSION,
    call,
    change,
    geo,
    mesh,
    msh,
    one_line_and_nothing_written,
    override,
    scene,
    traces,
)

from fracflow.mesh.files import gmsh

pytestmark = pytest.mark.serial

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
    "a key of the scene without --set": (
        call("run", "scene.toml", "mesh.refine=1"),
        "command line: mesh.refine=1: neither … a key of the scene stands behind --set: --set mesh.refine=1",
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
        "scene.toml: fluid.viscosity = … must be a number in N s/m^2 or",
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
        call("picture", "notes.txt", notes_txt="a"),
        "notes.txt: not valid TOML: … correct the line",
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
    for kind, cases in {"table": TABLES, "mesh": MESHES, "command": COMMANDS}.items()
    for name, case in cases.items()
}


@pytest.mark.parametrize("name", CASES)
def test_one_line_and_nothing_written(name, tmp_path, monkeypatch, capfd):
    one_line_and_nothing_written(CASES[name], tmp_path, monkeypatch, capfd)


def test_a_mesh_that_crashes_gmsh(tmp_path, monkeypatch, capfd):
    """Each kind of bad input is told by all ranks as one and the same error."""
    monkeypatch.setattr(gmsh, "_run", lambda folder, allowed: (-11, ""))
    expected = "square.msh: Gmsh crashed (signal 11); save it again from Gmsh"
    one_line_and_nothing_written((mesh(MSH), expected), tmp_path, monkeypatch, capfd)
