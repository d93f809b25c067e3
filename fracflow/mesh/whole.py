"""Areas and blocks of all the rock, as rank 0 knows them: of a mesh that has the near cells alone by what ranks have found."""

from __future__ import annotations

import numpy as np

from fracflow.mesh.data import Floats, Ints, SplitMesh
from fracflow.mesh.graph import components
from fracflow.mesh.plane.quality import cell_areas, worst_cells


def rock_areas(mesh: SplitMesh) -> Floats:
    """Area (r,) of the cells of each rock [length**2]."""
    if mesh.sums is not None:
        return mesh.sums.rock_area
    uncut = mesh.uncut  # cuts do not change areas
    return _sums(uncut.cell_rock, _areas(uncut), len(mesh.rocks))


def block_areas(mesh: SplitMesh) -> tuple[Ints, Floats]:
    """Block of rock (m,) of each cell of a mesh, what no joint cuts, and area (b,) of each block [length**2]."""
    if mesh.sums is not None:
        return mesh.sums.piece[mesh.cells[:, 0]], mesh.sums.piece_area
    uncut, parent = mesh.uncut, np.arange(len(mesh.cells)) // mesh.children
    first = uncut.cells[:, 0]
    cell, corner = np.nonzero(uncut.cells[:, 1:] >= 0)
    block = components(first[cell], uncut.cells[cell, 1 + corner], len(uncut.points))[first]
    return block[parent], _sums(block, _areas(uncut))


def share_of_blunt(mesh: SplitMesh) -> float:
    """Share of the cells of ``uncut`` that have a corner over 150 degrees."""
    if mesh.sums is not None:
        return mesh.sums.blunt
    return worst_cells(mesh.uncut.points, mesh.uncut.cells)["cells over 150 degrees"]


def _areas(mesh: SplitMesh) -> Floats:
    return np.abs(cell_areas(mesh.points, mesh.cells))


def _sums(label: Ints, values: Floats, count: int = 0) -> Floats:
    return np.asarray(np.bincount(label, values, count), dtype=np.float64)
