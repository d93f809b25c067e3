"""Grids with fractures, and what must hold for every split mesh."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np

from fracflow.elements.facet import frame
from fracflow.mesh.data import RawMesh
from fracflow.mesh.facets import half_facets

MESHES = Path(__file__).parents[2] / "meshes"


def grid(columns, rows, traces, triangles=False):
    """A unit grid of quads or triangles; each trace is a list of grid points one step apart."""
    x, y = np.meshgrid(np.arange(columns + 1.0), np.arange(rows + 1.0))
    width = columns + 1
    corner = (np.arange(rows)[:, None] * width + np.arange(columns)).ravel()
    cells = np.stack([corner, corner + 1, corner + width + 1, corner + width], axis=1)
    if triangles:
        cells = np.concatenate([cells[:, [0, 1, 2]], cells[:, [0, 2, 3]]])
    nodes = [[column + row * width for column, row in trace] for trace in traces]
    facets = [pair for trace in nodes for pair in pairwise(trace)]
    return RawMesh(
        points=np.stack([x.ravel(), y.ravel()], axis=1),
        cells=cells,
        cell_rock=np.zeros(len(cells), dtype=np.int64),
        rocks=("rock",),
        fracture_facets=np.array(facets, dtype=np.int64).reshape(-1, 2),
        fracture_of=np.repeat(np.arange(len(traces)), [len(trace) - 1 for trace in traces]),
        fractures=tuple(f"f{number}" for number in range(len(traces))),
        side_facets=np.stack([np.arange(columns), np.arange(columns) + 1], axis=1),
        side_of=np.zeros(columns, dtype=np.int64),
        sides=("south",),
        named_points={"origin": 0},
    )


def areas(mesh):
    """Area of each cell by the shoelace formula; padding repeats the first corner."""
    nodes = np.where(mesh.cells < 0, mesh.cells[:, :1], mesh.cells)
    x, y = np.moveaxis(mesh.points[nodes], 2, 0)
    return 0.5 * np.sum(x * np.roll(y, -1, 1) - np.roll(x, -1, 1) * y, axis=1)


def centres(mesh, rows):
    cells = mesh.cells[rows]
    return np.sum(mesh.points[cells] * (cells >= 0)[..., None], axis=1) / np.sum(cells >= 0, axis=1)[:, None]


def copies_at(mesh, point):
    return int(np.sum(np.linalg.norm(mesh.points - np.asarray(point), axis=1) < 1e-9))


def check(raw, mesh):
    """Conditions on every split mesh."""
    assert np.array_equal(mesh.points, raw.points[mesh.origin])
    assert np.array_equal(mesh.origin[: len(raw.points)], np.arange(len(raw.points)))
    back = np.where(mesh.cells < 0, -1, mesh.origin[mesh.cells])
    assert np.array_equal(back, raw.cells)
    assert np.array_equal(np.unique(mesh.cells[mesh.cells >= 0]), np.arange(len(mesh.points)))
    for face in (mesh.joint_bottom, mesh.joint_top):
        assert np.array_equal(mesh.origin[face], raw.fracture_facets)
    assert np.array_equal(mesh.flow_origin[mesh.joint_flow], raw.fracture_facets)
    corners = mesh.points[mesh.joint_bottom]
    normal = frame(corners)[0][:, -1]
    for column, sign, face in ((0, -1, mesh.joint_bottom), (1, 1, mesh.joint_top)):
        rows = mesh.joint_cells[:, column]
        middle = centres(mesh, rows) - corners.mean(axis=1)
        assert np.all(sign * np.sum(middle * normal, axis=1) > 0)
        assert np.all(np.any(mesh.cells[rows][:, :, None] == face[:, None, :], axis=1))
    half = half_facets(mesh.cells, mesh.points.shape[1])
    _, count = np.unique(np.sort(half.nodes, axis=1), axis=0, return_counts=True)
    assert count.max() <= 2
    assert np.all(np.any(mesh.cells[mesh.side_cell][:, :, None] == mesh.side_facets[:, None, :], axis=1))
