"""Facets in the plane and in space that the element tests share."""

from __future__ import annotations

import numpy as np

TURNS = np.radians([0.0, 30.0, 90.0, 135.0, 200.0, -70.0])
FLAT = {
    2: np.array([[0.0, 0.0], [2.5, 0.0]]),
    3: np.array([[0.0, 0.0, 0.0], [2.0, 0.3, 0.0], [0.4, 1.5, 0.0]]),
    4: np.array([[0.0, 0.0, 0.0], [2.0, -0.2, 0.0], [2.3, 1.4, 0.0], [0.2, 1.0, 0.0]]),
}
SIZE = {2: 2.5, 3: 1.44, 4: 2.64}  # by hand


def turned(points, dim):
    """Copies (6, k, dim) of one facet (k, dim), turned and moved."""
    turns = []
    for angle in TURNS:
        c, s = np.cos(angle), np.sin(angle)
        if dim == 2:
            turns.append([[c, -s], [s, c]])
        else:
            about_z = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
            c, s = np.cos(2.0 * angle + 0.3), np.sin(2.0 * angle + 0.3)
            turns.append(about_z @ [[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    return points @ np.array(turns).swapaxes(1, 2) + np.arange(1.0, dim + 1.0)


def facets(nodes):
    """Six facets (6, k, dim) of 2, 3 or 4 nodes."""
    return turned(FLAT[nodes], FLAT[nodes].shape[1])
