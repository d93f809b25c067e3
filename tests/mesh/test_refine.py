"""Cells cut in four: shapes, areas, names and directions stay, and traces keep their lengths."""

from dataclasses import fields, replace

import h5py
import numpy as np
import pytest

from fracflow.mesh.cut_mesh import cut_mesh
from fracflow.mesh.data import RawMesh
from fracflow.mesh.plane.quality import cell_areas
from fracflow.mesh.split import merged_faces, split
from fracflow.mesh.store import load_mesh, save_mesh

pytestmark = pytest.mark.serial

# a quad and two triangles beside it, a fracture from the bottom to the top between them
MIXED = RawMesh(
    points=np.array([[0.0, 0], [1, 0], [1, 1], [0, 1], [2, 0], [2, 1]]),
    cells=np.array([[0, 1, 2, 3], [1, 4, 5, -1], [1, 5, 2, -1]]),
    cell_rock=np.array([0, 1, 1]),
    rocks=("hard", "soft"),
    fracture_facets=np.array([[1, 2]]),
    fracture_of=np.array([0]),
    fractures=("seam",),
    side_facets=np.array([[0, 1], [1, 4], [3, 0]]),
    side_of=np.array([0, 0, 1]),
    sides=("south", "west"),
    named_points={"corner": 5},
)


def test_mixed_cells():
    fine = cut_mesh(replace(split(MIXED), cuts=2))
    assert np.array_equal(fine.points[:6], MIXED.points) and fine.named_points == {"corner": 5}
    assert len(np.unique(fine.points, axis=0)) == len(np.unique(fine.origin)) == 25 + 20
    assert len(fine.points) == 25 + 25  # the seam, which cuts the rock in two, has a copy of each of its nodes
    areas = cell_areas(fine.points, fine.cells)
    assert areas[fine.cell_rock == 0] == pytest.approx(np.full(16, 1 / 16))
    assert areas[fine.cell_rock == 1] == pytest.approx(np.full(32, 1 / 32))
    assert ((fine.cells >= 0).sum(axis=1) == np.where(fine.cell_rock == 0, 4, 3)).all()
    up = fine.points[fine.joint_bottom]
    assert up == pytest.approx(np.array([[[1, k / 4], [1, (k + 1) / 4]] for k in range(4)]))
    south = fine.points[fine.side_facets[fine.side_of == 0]]
    assert (south[..., 1] == 0).all() and (np.diff(south[..., 0]) == 0.25).all() and len(south) == 8
    assert fine.joint_along[:, 1] - fine.joint_along[:, 0] == pytest.approx(np.full(4, 0.25))
    assert (fine.cell_rock[fine.joint_cells] == [1, 0]).all()  # below is on the right


def test_walls_of_a_cut_mesh_are_merged():
    whole = replace(split(MIXED), cuts=2)
    fine, merged = cut_mesh(whole), cut_mesh(merged_faces(whole, np.array([True])))
    assert len(merged.points) == 45 and not len(merged.joint_flow) and not len(merged.flow_origin)
    assert np.array_equal(merged.origin, np.arange(45))
    assert merged.points[merged.named_points["corner"]] == pytest.approx([2, 1])
    assert cell_areas(merged.points, merged.cells) == pytest.approx(cell_areas(fine.points, fine.cells))


def test_a_mesh_is_saved_before_its_cells_are_cut(tmp_path):
    fine = cut_mesh(replace(split(MIXED), cuts=2))
    root = save_mesh(fine, tmp_path / "mesh.h5")
    with h5py.File(tmp_path / "mesh.h5") as file:
        assert file["points"].shape == split(MIXED).points.shape
    again = load_mesh(tmp_path / "mesh.h5", root)
    assert again.coarse is not None and again.coarse.cuts == 2
    for field in fields(fine):
        if field.name != "coarse":
            assert np.array_equal(getattr(again, field.name), getattr(fine, field.name)), field.name
