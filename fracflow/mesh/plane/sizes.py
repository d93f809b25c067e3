"""How fine cells must be along a network of traces: as asked, and finer where parts of it come near each other."""

from __future__ import annotations

import numpy as np

from fracflow.errors import InputError
from fracflow.mesh.data import Floats, Ints
from fracflow.mesh.plane.planar_graph import boxes_that_meet
from fracflow.mesh.plane.traces import SHALLOW, RowsOf, TraceNetwork

STEP = 2**0.5  # ratio of sizes that follow each other
SLENDER = 0.26  # thickness over length of a wedge, of 15 degrees: thicker ones hardly turn
ERROR_OF_WEDGE = {1.0: 0.05, 4.0: 0.02, 8.0: 0.011, 16.0: 0.004}
"""Joints at a tip, in the thickness of a wedge of 6 degrees there: error of openings, over the largest. The volume of the
fracture that opens less errs by 59, 5, 8 and 2 % of its own (``scripts/bench wedge``)."""
PER_ROOT, ROOT = 16.0, 8.0  # of these: that meshes get, and below which a run has a line on it
MOST = 5_000_000  # points

Source = tuple[float, Floats]
"""A mesh size, and the points (k, 2) around which it is kept [length]."""


def sources(network: TraceNetwork, fine: float, at_tips: float, per_gap: float, least: float) -> list[Source]:
    """Mesh sizes and the points that have them: ``fine`` along all fractures, ``at_tips`` at their tips.

    Tips where a wedge of rock ends have a sixteenth of its thickness (``_wedges``). Cells are at most ``per_gap`` times as
    long as the gap between two edges, or an edge, but never under ``least``. Every point of a fracture is within half a size
    of a point of that size. All [length]. Raises InputError where that takes too many points.
    """
    own = np.flatnonzero(network.owner >= 0)
    if not len(own):
        return []
    length = np.linalg.norm(np.diff(network.points[network.edges], axis=1)[:, 0], axis=1)
    pairs = _near_pairs(network, fine / per_gap)

    def size_at(edge: Ints, along: Floats) -> Floats:
        gap = np.minimum(_gaps(network, edge, _places(network, edge, along), *pairs), length[edge])
        return np.clip(per_gap * gap, least, fine)

    edge, along = _samples(own, length, fine)
    size = size_at(edge, along)
    is_near = np.isin(edge, pairs[0])
    while True:
        # Sizes change by at most per_gap per length: none is missed between two points nearer than this.
        step = np.diff(along) * length[edge[:-1]]
        enough = np.maximum(np.minimum(size[1:], size[:-1]) / per_gap, least)
        wide = np.flatnonzero((edge[1:] == edge[:-1]) & is_near[:-1] & (step > enough))
        if not len(wide):
            break
        if len(edge) + len(wide) > MOST:
            raise InputError(
                f"geometry: cells down to {least:.3g} between near traces are too many; raise geometry.snap"
            )
        more = edge[wide], (along[wide] + along[wide + 1]) / 2
        size = np.insert(size, wide + 1, size_at(*more))
        edge, along = (np.insert(old, wide + 1, new) for old, new in zip((edge, along), more, strict=True))
        is_near = np.insert(is_near, wide + 1, True)
    place = _places(network, edge, along)
    found, tips = _by_size(size, place, fine, least), network.points[network.tips]
    if len(tips) and at_tips < fine:
        found.append((at_tips, tips))
    tip, thickness = _wedges(network, PER_ROOT * at_tips, fine)
    return found + _by_size(thickness / PER_ROOT, network.points[tip], at_tips, 0.0)


def _by_size(size: Floats, place: Floats, most: float, least: float) -> list[Source]:
    """Places (n, 2) by their sizes (n,), which are rounded down to steps below ``most``, and never under ``least``."""
    level = np.ceil(np.log(most / size) / np.log(STEP) - 1e-9).astype(np.int64)
    return [(max(most / STEP**k, least), place[level == k]) for k in np.unique(level).tolist()]


def _wedges(network: TraceNetwork, most: float, least: float) -> tuple[Ints, Floats]:
    """Tips (k,) where a slender wedge of rock ends, ``least`` long, and its thickness (k,) there, under ``most`` [length].

    It lies between two traces, from where they meet to the tip of one. Where both are open, only its root at the tip holds it.
    Errors of the strain there turn it, and part the opening wrongly between the two.
    """
    is_trace = network.owner >= 0
    ends = np.stack([network.edges[is_trace].ravel(), np.repeat(network.owner[is_trace], 2)], axis=1)
    at, whose = np.unique(ends, axis=0).T
    tip = network.tips
    own = whose[np.searchsorted(at, tip)]
    found: dict[int, float] = {}
    of_trace, of_point, edges_of = RowsOf(whose), RowsOf(at), RowsOf(network.owner)
    for each, trace in zip(tip.tolist(), own.tolist(), strict=True):
        here = np.concatenate([of_point(point) for point in at[of_trace(trace)].tolist()])
        here = here[whose[here] != trace]  # where others meet the trace
        for other in np.unique(whose[here]).tolist():
            apart = network.points[at[here[whose[here] == other]]] - network.points[each]
            length = np.linalg.norm(apart, axis=1).min()
            edges = network.points[network.edges[edges_of(other)]]
            gap = float(_distances(network.points[[each]], edges).min())
            if length >= least and gap < min(most, SLENDER * length, found.get(each, most)):
                found[each] = gap
    return np.array(list(found), dtype=np.int64), np.array(list(found.values()))


def _distances(place: Floats, ends: Floats) -> Floats:
    """Distance (n,) of places (n or 1, 2) from edges (n, 2, 2) [length]."""
    start, end = np.moveaxis(ends, 1, 0)
    step = end - start
    along = np.clip(np.sum((place - start) * step, axis=1) / np.sum(step * step, axis=1), 0, 1)
    return np.asarray(np.linalg.norm(place - start - along[:, None] * step, axis=1))


def _near_pairs(network: TraceNetwork, reach: float) -> tuple[Ints, Ints]:
    """Edges of fractures and others that may be within ``reach``: without common end, or parting at a small angle."""
    ends = network.points[network.edges]
    one, other = boxes_that_meet(ends, reach / 2)
    one, other = np.concatenate([one, other]), np.concatenate([other, one])
    is_own = network.owner[one] >= 0
    one, other = one[is_own], other[is_own]
    same = network.edges[one][:, :, None] == network.edges[other][:, None, :]
    sign = np.where(same, np.array([[1, -1], [-1, 1]]), 0).sum(axis=(1, 2))
    step = np.diff(ends, axis=1)[:, 0]
    step /= np.linalg.norm(step, axis=1)[:, None]
    is_sharp = sign * np.sum(step[one] * step[other], axis=1) > np.cos(np.radians(SHALLOW))
    keep = ~np.any(same, axis=(1, 2)) | is_sharp
    return one[keep], other[keep]


def _samples(edges: Ints, length: Floats, spacing: float) -> tuple[Ints, Floats]:
    """Edge and place (0 to 1) of points along the given edges, ends included, no farther apart than ``spacing``."""
    count = 1 + np.ceil(length[edges] / spacing).astype(np.int64)
    row = np.repeat(np.arange(len(edges)), count)
    along = (np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)) / (count[row] - 1)
    return edges[row], along


def _places(network: TraceNetwork, edge: Ints, along: Floats) -> Floats:
    start, end = np.moveaxis(network.points[network.edges[edge]], 1, 0)
    return start + along[:, None] * (end - start)


def _gaps(network: TraceNetwork, edge: Ints, place: Floats, one: Ints, other: Ints) -> Floats:
    """Distance of each sample from the nearest edge paired with its own; inf where there is none."""
    first = np.searchsorted(edge, one, side="left")  # samples come edge by edge, in ascending order
    count = np.searchsorted(edge, one, side="right") - first
    pair = np.repeat(np.arange(len(one)), count)
    sample = np.arange(len(pair)) - np.repeat(np.cumsum(count) - count, count) + first[pair]
    gaps = np.full(len(place), np.inf)
    np.minimum.at(gaps, sample, _distances(place[sample], network.points[network.edges[other[pair]]]))
    return gaps
