"""Quads from triangles, and the measures of cells, by hand."""

from __future__ import annotations

import numpy as np
import pytest

from fracflow.mesh.files.gmsh import Elements
from fracflow.mesh.plane.quads import all_quads
from fracflow.mesh.plane.quality import cell_areas, corner_angles, worst_cells

pytestmark = pytest.mark.serial

SQUARE = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=float)


def elements(points, triangles, lines=(), line_members=()):
    none = np.zeros((0, 2), dtype=np.int64)
    return Elements(
        points=np.asarray(points, dtype=float),
        nodes={"point": none[:, :1], "line": np.array(lines, np.int64).reshape(-1, 2), "triangle": np.array(triangles),
               "quad": np.zeros((0, 4), np.int64)},
        members={"point": none, "line": np.array(line_members, np.int64).reshape(-1, 2),
                 "triangle": np.stack([np.arange(len(triangles)), np.zeros(len(triangles), np.int64)], axis=1), "quad": none},
        others=(), group_dims=np.array([2, 1]), group_tags=np.array([1, 2]), group_names=("rock", "fault"),
    )  # fmt: skip


def test_two_triangles_make_four_squares():
    found = all_quads(elements(SQUARE, [[0, 1, 2], [0, 2, 3]]))
    quads = found.nodes["quad"]
    assert len(found.points) == 9 and not len(found.nodes["triangle"])
    assert cell_areas(found.points, quads) == pytest.approx([0.25] * 4)
    assert np.all(corner_angles(found.points, quads) == pytest.approx(90)) and found.members["quad"].tolist() == [
        [0, 0], [1, 0], [2, 0], [3, 0]
    ]  # fmt: skip


def test_a_line_between_two_triangles_keeps_them_apart():
    found = all_quads(elements(SQUARE, [[0, 1, 2], [0, 2, 3]], [[2, 0]], [[0, 1]]))
    assert cell_areas(found.points, found.nodes["quad"]) == pytest.approx([1 / 6] * 6)
    halves = found.nodes["line"]
    assert halves[0, 0] == 2 and halves[1, 1] == 0 and found.points[halves[0, 1]].tolist() == [0.5, 0.5]
    assert found.members["line"].tolist() == [[0, 1], [1, 1]]


def test_slivers_become_convex_quads():
    thin = [[0, 0], [1, 0], [2, 0.01], [1, 0.02]]
    found = all_quads(elements(thin, [[0, 1, 3], [1, 2, 3]]))
    assert corner_angles(found.points, found.nodes["quad"]).max() < 180
    assert cell_areas(found.points, found.nodes["quad"]).sum() == pytest.approx(0.02)


def test_angles_of_mixed_cells():
    points = np.array([*SQUARE, [2, 0.5], [1.2, 0.5]])
    cells = np.array([[0, 1, 2, 3], [1, 4, 2, -1]])
    assert cell_areas(points, cells) == pytest.approx([1, 0.5])
    found = worst_cells(points, cells)
    assert found["smallest angle"] == pytest.approx(np.degrees(2 * np.arctan(0.5)))
    assert found["largest angle"] == pytest.approx(90) and found["cells under 20 degrees"] == 0
    reflex = corner_angles(points, np.array([[1, 4, 2, 5]]))
    assert reflex[0, 3] == pytest.approx(360 - 2 * np.degrees(np.arctan(2.5)))
