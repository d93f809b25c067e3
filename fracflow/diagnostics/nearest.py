"""The nearest of some points, looked for within a distance: SciPy's trees take 13 MB to import, on one rank of all."""

from __future__ import annotations

import numpy as np

from fracflow.mesh.data import Floats, Ints

PAIRS = 100_000  # distances that are computed at once, but for those of one place


def nearest_within(places: Floats, points: Floats, distance: float) -> Ints:
    """The nearest (n,) of points (m, dim) to each place (n, dim), -1 where none is within the distance [length].

    Points are sorted along the axis on which they lie farthest apart, and looked at in a strip on both sides of a place.
    """
    found = np.full(len(places), -1, dtype=np.int64)
    if not len(points):
        return found
    axis = int(np.argmax(np.ptp(points, axis=0)))
    order = np.argsort(points[:, axis], kind="stable")
    along = points[order, axis]
    first = np.searchsorted(along, places[:, axis] - distance, side="left")
    count = np.searchsorted(along, places[:, axis] + distance, side="right") - first
    here = np.flatnonzero(count)
    total = np.cumsum(count[here])
    for part in np.split(here, np.flatnonzero(np.diff(total // PAIRS)) + 1):
        starts = np.cumsum(count[part]) - count[part]
        pairs = np.repeat(first[part] - starts, count[part]) + np.arange(count[part].sum())
        place = np.repeat(np.arange(len(part)), count[part])
        away = np.linalg.norm(points[order[pairs]] - places[part[place]], axis=1)
        least = np.minimum.reduceat(away, starts) if len(part) else away
        nearest = np.flatnonzero(away == least[place])[::-1]  # of several the first one stays
        found[part[place[nearest]]] = np.where(away[nearest] <= distance, order[pairs[nearest]], -1)
    return found
