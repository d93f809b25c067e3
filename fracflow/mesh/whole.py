"""Areas and blocks of all the rock, as rank 0 knows them: of a mesh that has the near cells alone by what ranks have found."""

from __future__ import annotations

import numpy as np

from fracflow.mesh.data import Bools, Floats, Ints, SplitMesh
from fracflow.mesh.distribute import pieces_of_rock
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
    block = pieces_of_rock(uncut)[0][uncut.cells[:, 0]]
    return block[parent], _sums(block, _areas(uncut))


def blocks_with(mesh: SplitMesh, rock: int) -> Bools:
    """Which blocks of rock (b,) have cells of a rock by its number; of a mesh whose cells ranks have, those of all ranks."""
    if mesh.sums is not None:
        return mesh.sums.has_rock[rock]
    piece, rocks, _ = pieces_of_rock(mesh)
    found = np.zeros(len(rocks), dtype=bool)
    found[piece[mesh.cells[mesh.cell_rock == rock, 0]]] = True
    return found


def share_of_blunt(mesh: SplitMesh) -> float:
    """Share of the cells of ``uncut`` that have a corner over 150 degrees."""
    if mesh.sums is not None:
        return mesh.sums.blunt
    return worst_cells(mesh.uncut.points, mesh.uncut.cells)["cells over 150 degrees"]


def _areas(mesh: SplitMesh) -> Floats:
    return np.abs(cell_areas(mesh.points, mesh.cells))


def _sums(label: Ints, values: Floats, count: int = 0) -> Floats:
    return np.asarray(np.bincount(label, values, count), dtype=np.float64)
