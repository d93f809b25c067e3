"""Cells cut in four: shapes, areas, names and directions stay, and traces keep their lengths."""

import numpy as np
import pytest

from fracflow.mesh.data import RawMesh
from fracflow.mesh.plane.quality import cell_areas
from fracflow.mesh.plane.refine import refined
from fracflow.mesh.split import split

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
    fine = refined(refined(MIXED))
    assert np.array_equal(fine.points[:6], MIXED.points) and fine.named_points == {"corner": 5}
    assert len(np.unique(fine.points, axis=0)) == len(fine.points) == 25 + 20
    areas = cell_areas(fine.points, fine.cells)
    assert areas[fine.cell_rock == 0] == pytest.approx(np.full(16, 1 / 16))
    assert areas[fine.cell_rock == 1] == pytest.approx(np.full(32, 1 / 32))
    assert ((fine.cells >= 0).sum(axis=1) == np.where(fine.cell_rock == 0, 4, 3)).all()
    up = fine.points[fine.fracture_facets]
    assert up == pytest.approx(np.array([[[1, k / 4], [1, (k + 1) / 4]] for k in range(4)]))
    south = fine.points[fine.side_facets[fine.side_of == 0]]
    assert (south[..., 1] == 0).all() and (np.diff(south[..., 0]) == 0.25).all() and len(south) == 8
    mesh = split(fine)
    assert mesh.joint_along[:, 1] - mesh.joint_along[:, 0] == pytest.approx(np.full(4, 0.25))
    assert (mesh.cell_rock[mesh.joint_cells] == [1, 0]).all()  # below is on the right
