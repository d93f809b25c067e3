"""Areas and corner angles of cells."""

from __future__ import annotations

import numpy as np

from fracflow.mesh.data import Bools, Floats, Ints

MOST_ANGLE = 150.0  # of a corner [degree]
BLUNT = 0.1  # share of cells with a corner over 150 degrees from which on a mesh is spoilt: sound ones have up to 0.05


def cell_areas(points: Floats, cells: Ints) -> Floats:
    """Area (m,) of padded cells (m, k), positive if they turn counter-clockwise [length**2]."""
    nodes = np.where(cells < 0, cells[:, :1], cells)
    x, y = np.moveaxis(points[nodes][..., :2] - points[nodes[:, :1]][..., :2], 2, 0)
    return 0.5 * np.sum(x * np.roll(y, -1, axis=1) - np.roll(x, -1, axis=1) * y, axis=1)


def corner_angles(points: Floats, cells: Ints) -> Floats:
    """Angle inside each corner (m, k) of counter-clockwise cells of one shape [degree]; over 180 in a reflex corner."""
    corners = points[cells][..., :2]
    ahead, behind = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    turn = ahead[..., 0] * behind[..., 1] - ahead[..., 1] * behind[..., 0]
    return np.degrees(np.arctan2(turn, np.sum(ahead * behind, axis=2))) % 360


def is_blunt(points: Floats, cells: Ints) -> Bools:
    """Which of padded cells (m, k) have a corner over 150 degrees."""
    count, found = np.sum(cells >= 0, axis=1), np.zeros(len(cells), dtype=bool)
    for k in np.unique(count).tolist():
        found[count == k] = (corner_angles(points, cells[count == k][:, :k]) > MOST_ANGLE).any(axis=1)
    return found


def worst_cells(points: Floats, cells: Ints) -> dict[str, float]:
    """Smallest and largest corner angle of cells (m, k) [degree], and the shares with a corner under 20, over 150."""
    count = np.sum(cells >= 0, axis=1)
    angles = [corner_angles(points, cells[count == k][:, :k]) for k in np.unique(count).tolist()]
    least, most = (np.concatenate([getattr(a, which)(axis=1) for a in angles]) for which in ("min", "max"))
    return {
        "smallest angle": float(least.min()),
        "largest angle": float(most.max()),
        "cells under 20 degrees": float(np.mean(least < 20.0)),
        "cells over 150 degrees": float(np.mean(most > MOST_ANGLE)),
    }
