"""Geometries and meshes read through Gmsh and meshio, domains cut by traces, tables of traces."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import kept_meshes
import numpy as np
import pytest
from meshing import MESHES, areas, check, copies_at

from fracflow.errors import InputError
from fracflow.mesh.files import gmsh
from fracflow.mesh.read import GeometrySpec, build_mesh, read_mesh, side_names
from fracflow.mesh.split import split, summary
from fracflow.storage import child

pytestmark = pytest.mark.serial

SQUARE = np.array([[0, 0], [4, 0], [4, 4], [0, 4]], dtype=float)

# A fault in pieces that run against each other; a curve in two groups, a clockwise surface, an unused point,
# a point and a curve of one name.
FAULT = """
Point(1) = {0, 0, 0}; Point(2) = {2, 0, 0}; Point(3) = {2, 3, 0}; Point(4) = {0, 3, 0};
Point(5) = {1, 0, 0}; Point(6) = {1, 3, 0}; Point(7) = {1, 1, 0}; Point(8) = {1, 2, 0}; Point(99) = {9, 9, 0};
Line(1) = {1, 5}; Line(2) = {5, 2}; Line(3) = {2, 3}; Line(4) = {3, 6}; Line(5) = {6, 4}; Line(6) = {4, 1};
Line(7) = {5, 7}; Line(8) = {8, 7}; Line(9) = {8, 6};
Curve Loop(1) = {1, 7, -8, 9, 5, 6}; Plane Surface(1) = {-1};
Curve Loop(2) = {2, 3, 4, -9, 8, -7}; Plane Surface(2) = {2};
Mesh.MeshSizeMax = 0.7;
Physical Surface("granit") = {1}; Physical Surface("Schiefer ü") = {2};
Physical Curve("fault") = {7, 8, 9};
Physical Curve("west") = {6}; Physical Curve("outside") = {6, 3};
Physical Point("brunnen") = {7}; Physical Point("west") = {4};
"""


def as_set(mesh):
    """The mesh without its numbering."""
    p = np.round(mesh.points, 9)
    cells = {(mesh.rocks[rock], frozenset(map(tuple, p[cell[cell >= 0]]))) for cell, rock in
             zip(mesh.cells, mesh.cell_rock, strict=True)}  # fmt: skip
    sides = {(mesh.sides[side], frozenset(map(tuple, p[facet]))) for facet, side in
             zip(mesh.side_facets, mesh.side_of, strict=True)}  # fmt: skip
    joints = {(mesh.fractures[f], frozenset(map(tuple, p[facet]))) for facet, f in
              zip(mesh.fracture_facets, mesh.fracture_of, strict=True)}  # fmt: skip
    return cells, sides, joints, {name: tuple(p[node]) for name, node in mesh.named_points.items()}


@pytest.fixture(scope="session")
def saved(tmp_path_factory):
    """Path of FAULT as .geo; beside it the meshes Gmsh made of it, named by version and whether binary."""
    geo = tmp_path_factory.mktemp("saved") / "fault.geo"
    geo.write_text(FAULT, encoding="utf-8")
    code = """
import gmsh, sys
gmsh.initialize()
gmsh.option.setNumber("General.Terminal", 0)
gmsh.open(sys.argv[1])
gmsh.model.mesh.generate(2)
for version in (2.2, 4.1):
    for binary in (0, 1):
        gmsh.option.setNumber("Mesh.MshFileVersion", version)
        gmsh.option.setNumber("Mesh.Binary", binary)
        gmsh.write(f"{sys.argv[1][:-4]}-{version}-{binary}.msh")
gmsh.model.mesh.partition(3)
for is_split, name in enumerate(("parts", "part")):
    gmsh.option.setNumber("Mesh.PartitionSplitMeshFiles", is_split)
    gmsh.write(f"{sys.argv[1][:-4]}-{name}.msh")
gmsh.finalize()
"""
    subprocess.run([sys.executable, "-c", code, str(geo)], check=True)
    return geo


@pytest.mark.parametrize("version", ["2.2-0", "2.2-1", "4.1-0", "4.1-1", "parts"])
def test_msh_gives_the_mesh_of_the_geo(saved, version):
    expected = read_mesh(saved, {"fault"})
    found = read_mesh(saved.with_name(f"fault-{version}.msh"), {"fault"})
    assert as_set(found) == as_set(expected)
    for mesh in (expected, found):
        both = split(mesh)
        check(mesh, both)
        assert areas(mesh).min() > 0 and areas(mesh).sum() == pytest.approx(6)
        assert summary(both)["blocks"] == 2 and set(mesh.rocks) == {"granit", "Schiefer ü"}
        assert mesh.points[mesh.named_points["brunnen"]].tolist() == [1, 1]
        assert mesh.points[mesh.named_points["west"]].tolist() == [0, 3]
        # One direction along the fault, whatever its curves: a chain has one start.
        starts = np.setdiff1d(mesh.fracture_facets[:, 0], mesh.fracture_facets[:, 1])
        assert len(starts) == 1 and mesh.points[starts[0]].tolist() == [1, 0]
        xs = both.points[both.cells[both.joint_cells[:, 0]]][..., 0]
        assert xs.min() >= 1  # the fault runs along +y: below is x > 1
        west = mesh.sides.index("west")
        assert np.sum(mesh.side_of == west) * 2 == np.sum(mesh.side_of == mesh.sides.index("outside"))


def test_default_takes_all_curves_inside(saved):
    mesh = read_mesh(saved, {"default"})
    assert mesh.fractures == ("fault",) and set(mesh.sides) == {"west", "outside"}


def test_one_part_of_a_partitioned_mesh_is_refused(saved):
    """Without its other parts the domain would end where a part does."""
    with pytest.raises(
        InputError, match=r"part_2\.msh: .*without the other parts.*PartitionSplitMeshFiles = 0; save it"
    ):
        read_mesh(saved.with_name("fault-part_2.msh"), {"fault"})


@pytest.mark.parametrize(
    ("file", "fractures", "cells", "joints", "sides"),
    [
        ("report_5_2/block.geo", {"lower", "upper"}, 3, 2, {"left"}),
        ("report_5_3/fault.geo", {"fault"}, 8, 4, {"west", "east", "south", "north"}),
        ("report_5_5/fault.geo", {"fault"}, 24, 6, {"west", "east", "south", "north"}),
    ],
)
def test_meshes_of_the_report(file, fractures, cells, joints, sides):
    raw = read_mesh(MESHES / file, fractures)
    mesh = split(raw)
    check(raw, mesh)
    assert (len(mesh.cells), len(mesh.joint_flow), set(mesh.sides)) == (cells, joints, sides)
    assert mesh.cells.min() >= 0 and mesh.cells.shape[1] == 4
    direction = raw.points[raw.fracture_facets[:, 1]] - raw.points[raw.fracture_facets[:, 0]]
    assert np.all(direction @ ([1, 0] if "lower" in fractures else [0, 1]) > 0)
    assert summary(mesh)["blocks"] == (3 if "lower" in fractures else 2)


@pytest.mark.parametrize(("kind", "width"), [("quads", 4), ("triangles", 3)])
def test_inclined_joint(kind, width):
    raw = read_mesh(MESHES / "r01_inclined_joint" / f"{kind}.geo", {"joint"})
    mesh = split(raw)
    check(raw, mesh)
    assert mesh.cells.shape[1] == width and mesh.cells.min() >= 0 and 40 <= len(mesh.cells) <= 200
    step = raw.points[raw.fracture_facets[:, 1]] - raw.points[raw.fracture_facets[:, 0]]
    assert np.allclose(np.degrees(np.arctan2(step[:, 1], step[:, 0])), 60)
    assert summary(mesh)["blocks"] == 2 and summary(mesh)["lengths"]["joint"] == pytest.approx(2)
    assert set(mesh.sides) == {"bottom", "top", "left", "right"}
    assert raw.points[raw.named_points["pin"]].tolist() == [0, 0] and areas(mesh).sum() == pytest.approx(2)
    if kind == "quads":
        corners = raw.points[raw.cells]
        skew = corners[:, 0] - corners[:, 1] + corners[:, 2] - corners[:, 3]
        assert np.max(np.abs(skew)) > 0.01  # distorted, no parallelograms


ARC = [[1 + np.cos(a), 2 + np.sin(a)] for a in np.linspace(np.pi / 2, -np.pi / 2, 7)]
NETWORKS: dict[str, tuple[list, dict, int, int]] = {
    "X": ([[[0, 2], [4, 2]], [[2, 0], [2, 4]]], {(2, 2): 4, (0, 2): 2}, 4, 0),
    "T": ([[[0, 2], [4, 2]], [[2, 2], [2, 4]]], {(2, 2): 3, (2, 4): 2}, 3, 0),
    "buried": ([[[1, 1], [3, 3]], [[1, 3], [3, 1]]], {(2, 2): 4, (1, 1): 1, (3, 1): 1}, 1, 4),
    "arc": ([ARC], {(1, 3): 1, (2, 2): 2, (1, 1): 1}, 1, 2),
    "loop": ([[[1, 1], [3, 1], [2, 3], [1, 1]]], {(1, 1): 2, (2, 3): 2}, 2, 0),
    "cut": ([[[0, 1], [2, 3], [4, 1.5]]], {(0, 1): 2, (2, 3): 2, (4, 1.5): 2}, 2, 0),
    "none": ([], {}, 1, 0),
}


@pytest.mark.parametrize("cells", ["triangles", "quads"])
@pytest.mark.parametrize("network", NETWORKS)
def test_built_networks(network, cells):
    lines, copies, blocks, tips = NETWORKS[network]
    traces = tuple((f"Trace {number}", np.array(line, float)) for number, line in enumerate(lines))
    raw = build_mesh(GeometrySpec(SQUARE, traces, 1.0, 0.4, cells))
    mesh = split(raw)
    check(raw, mesh)
    assert areas(mesh).min() > 0 and areas(mesh).sum() == pytest.approx(16)
    assert {place: copies_at(mesh, place) for place in copies} == copies
    found = summary(mesh)
    assert (found["blocks"], found["tips"]) == (blocks, tips)
    assert set(raw.sides) == {"south", "east", "north", "west"} and raw.rocks == ("rock",)
    assert raw.cells.shape[1] == (3 if cells == "triangles" else 4) and raw.cells.min() >= 0
    for name, points in traces:
        assert found["lengths"][name] == pytest.approx(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
        nodes = raw.fracture_facets[raw.fracture_of == raw.fractures.index(name)]
        starts = np.setdiff1d(nodes[:, 0], nodes[:, 1])
        assert np.allclose(raw.points[starts], points[:1] if network != "loop" else np.zeros((0, 2)))
    if network == "loop":  # given counter-clockwise: the triangle inside is on the left, the top
        inside = np.concatenate([mesh.points[mesh.cells[row]] for row in mesh.joint_cells[:, 1]])
        assert inside.min() >= 1 and inside.max() <= 3


def test_sides_of_other_domains():
    assert side_names(SQUARE[[2, 1, 0, 3]]) == ["east", "south", "west", "north"]
    polygon = np.array([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]], float) * 1e6 + 5e6
    raw = build_mesh(GeometrySpec(polygon, (("cut", polygon[[0, 3]]),), 0.5e6))
    assert set(raw.sides) == {f"side{number}" for number in range(1, 7)}
    first = raw.side_facets[raw.side_of == raw.sides.index("side1")]
    assert np.all(raw.points[first][..., 1] == 5e6)
    assert summary(split(raw))["blocks"] == 2 and areas(raw).sum() == pytest.approx(3e12)


@pytest.mark.parametrize(
    ("traces", "message"),
    [
        ([("a", [[5, 1], [6, 1]])], r'fracture "a": lies outside the domain; move or remove it'),
        ([("a", [[1, 1], [1, 1]])], r'fracture "a": two points in a row are \[1.0, 1.0\]'),
        ([("a", [[1, 1], [2, 1]]), ("b", [[2, 1], [1, 1]])], r'"b": runs along fracture "a" for 1, from \(2, 1\) to \(1, 1\)'),
        ([("south", [[1, 1], [2, 1]])], r'fracture "south": the name is taken'),
        ([("a", [[1, 1]])], "two or more pairs"),
        ([("a", [[1, 1], [3, 1]]), ("b", [[2, 1], [3.5, 1]])],
         r'"b": runs along fracture "a" for 1, .*remove one, or lower snap'),
        ([("a", [[1, 0], [3, 0]])], r'fracture "a": runs along side south for 2, .*move it inside'),
        ([("a", [[1, 1], [1.01, 1.03]])], r'fracture "a": is shorter than snap = 0.05'),
        ([("a", [[1, 1], [3, 1], [1, 1.01]])], r'fracture "a": folds back on itself'),
        ([("a", [[0.1, 2], [3.9, 2]]), ("b", [[0.1, 1.997], [3.9, 2.003]])], 'at 0.09 degrees; the least .* is 0.1'),
    ],
)  # fmt: skip
def test_traces_that_cannot_be_meshed(traces, message):
    snap = 1e-3 if "degrees" in message else 0.05
    spec = GeometrySpec(SQUARE, tuple((name, np.array(points, float)) for name, points in traces), 1.0, snap=snap)
    with pytest.raises(InputError, match=message) as caught:
        build_mesh(spec)
    assert "\n" not in str(caught.value)


CELL = "Point(1) = {0,0,0,1}; Point(2) = {1,0,0,1}; Point(3) = {0,1,0,1}; Line(1) = {1,2}; Line(2) = {2,3};" \
    "Line(3) = {3,1}; Curve Loop(1) = {1:3}; Plane Surface(1) = {1};"  # fmt: skip

ROCK = CELL + 'Physical Surface("a") = {1};'


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("syntax.geo", "Point(1) = {0, 0\nLine", "syntax.geo: Gmsh: .*syntax error"),
        ("line.geo", "x = 1;\ny = 2;", "Gmsh would ignore the last line"),
        ("empty.geo", "", "empty.geo: has no cells"),
        ("bare.geo", CELL + 'Physical Curve("a") = {1};', "belongs to no physical surface"),
        ("two.geo", ROCK + 'Physical Surface("b") = {1};', 'surfaces, "a" and "b"'),
        ("unnamed.geo", CELL + "Physical Surface(7) = {1};", "physical surface 7 has no name"),
        ("curved.geo", ROCK + 'Mesh.ElementOrder = 2;', "type Line 3; use linear"),
        ("gone.geo", ROCK + 'Physical Curve("b") = {1, 77};', "Skipping unknown curve 77 .*: tags change in Boolean"),
        ("missing.geo", ROCK + 'Physical Curve("b") = {1};', 'no physical curve "fault"'),
        ("point.geo", ROCK + 'Point(9) = {.2, .2, 0}; Physical Point("p") = {9};',
         'physical point "p" is no node'),
        ("loose.geo", ROCK + 'Point(8) = {.2, .2, 0}; Point(9) = {.4, .2, 0};'
         'Line(9) = {8, 9}; Physical Curve("fault") = {9};', 'physical curve "fault" is not made of edges'),
        ("tilted.geo", ROCK.replace("{1,0,0,1}", "{1,0,1,1}"), "not in a plane"),
        ("mesh.msh", "nonsense", "no Gmsh mesh of version 2 or 4"),
        ("cut.msh", "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n3\n", "cannot be read as a Gmsh mesh"),
        ("mesh.vtk", "", 'unknown kind of file ".vtk"'),
    ],
)  # fmt: skip
def test_files_that_make_no_sense(tmp_path, name, text, message):
    path = tmp_path / name
    path.write_text(text if name == "line.geo" else text + "\n")
    needs = {"fault"} if name in ("missing.geo", "loose.geo") else set()
    with pytest.raises(InputError, match=message) as caught:
        read_mesh(path, needs)
    assert "\n" not in str(caught.value) and str(caught.value).startswith(str(path))


def test_no_file(tmp_path):
    with pytest.raises(InputError, match=r"absent\.geo: no such file"):
        read_mesh(tmp_path / "absent.geo", set())


def test_a_crash_is_one_line(monkeypatch, tmp_path):
    shell = tmp_path / "python"
    shell.write_text("#!/bin/sh\nkill -SEGV $$\n")
    shell.chmod(0o755)
    monkeypatch.setattr(child.sys, "executable", str(shell))
    with pytest.raises(InputError, match=r"geometry: Gmsh crashed \(signal 11\)"):
        build_mesh(GeometrySpec(SQUARE, (), 1.0))


def test_three_fractures():
    lines = {"Anna": [[200, 120], [340, 320], [830, 530]], "Bruno": [[430, 680], [640, 200]],
             "Clara": [[600, 540], [1000, 330]]}  # fmt: skip
    traces = [(name, np.array(points, float)) for name, points in lines.items()]
    domain = np.array([[0, 0], [1000, 0], [1000, 800], [0, 800]], float)
    raw = build_mesh(GeometrySpec(domain, tuple(traces), 80, 25))
    mesh = split(raw)
    check(raw, mesh)
    found = summary(mesh)
    assert (found["junctions"], found["tips"], found["blocks"]) == (2, 5, 1)
    assert copies_at(mesh, traces[2][1][-1]) == 2  # Clara reaches the boundary


@pytest.mark.serial
def test_a_mesh_that_is_kept_for_other_tests_is_the_one_that_gmsh_makes(tmp_path, monkeypatch):
    """Equal to the last bit, and made anew where anything differs that it is made from."""
    saved, makes, made = MESHES / "report_5_2" / "block.geo", kept_meshes.make, []
    square = GeometrySpec(domain=np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]]), traces=(), size=0.5)
    coarse = [read_mesh(saved, set()), build_mesh(square)]
    monkeypatch.setenv(kept_meshes.FOLDER, str(tmp_path))
    monkeypatch.setattr(kept_meshes, "make", lambda *given: made.append(given) or makes(*given))
    monkeypatch.setattr(gmsh, "_work", kept_meshes.find)
    for _ in range(2):
        for mesh, expected in zip((read_mesh(saved, set()), build_mesh(square)), coarse, strict=True):
            assert np.array_equal(mesh.points, expected.points) and np.array_equal(mesh.cells, expected.cells)
    assert len(made) == 2
    assert len(build_mesh(replace(square, size=0.25)).points) > len(coarse[1].points)
    wrong = tmp_path / "wrong.geo"
    wrong.write_text("Point(1) = {0, 0, 0};\nLine(1) = {1, 2};\n")
    for _ in range(2):
        with pytest.raises(InputError):
            read_mesh(wrong, set())
    assert len(made) == 5  # no error is kept


@pytest.mark.serial
def test_a_worker_that_lacks_a_module_is_no_fault_of_the_file(tmp_path, monkeypatch):
    (tmp_path / "box.geo").write_text('SetFactory("OpenCASCADE");\nRectangle(1) = {0, 0, 0, 1, 1};\n')
    monkeypatch.setattr(gmsh, "_run", lambda *given: (1, "ModuleNotFoundError: No module named 'numpy'"))
    with pytest.raises(InputError, match=r"box.geo: Gmsh failed: .*'numpy'; install that module"):
        read_mesh(tmp_path / "box.geo", set())
