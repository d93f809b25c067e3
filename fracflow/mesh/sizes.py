"""How fine cells must be along a network of traces: as asked, and finer where parts of it come near each other."""

from __future__ import annotations

import numpy as np

from fracflow.mesh.arrange import boxes_that_meet
from fracflow.mesh.data import Floats, Ints
from fracflow.mesh.traces import SHALLOW, Network

STEP = 2**0.5  # ratio of sizes that follow each other

Source = tuple[float, Floats]
"""A mesh size, and the points (k, 2) around which it is kept [length]."""


def sources(network: Network, fine: float, at_tips: float, per_gap: float, least: float) -> list[Source]:
    """Mesh sizes and the points that have them: ``fine`` along all fractures, ``at_tips`` at their tips.

    Cells are at most ``per_gap`` times as long as the gap between two edges, or an edge, but never under ``least``.
    Every point of a fracture is within half a size of a point of that size. All [length].
    """
    own = np.flatnonzero(network.owner >= 0)
    if not len(own):
        return []
    length = np.linalg.norm(np.diff(network.points[network.edges], axis=1)[:, 0], axis=1)
    one, other = _near_pairs(network, fine / per_gap)
    is_near = np.zeros(len(length), dtype=bool)
    is_near[one] = True
    is_near |= per_gap * length < fine
    edge, place = _samples(network, own, length, np.where(is_near, least, fine))
    size = np.clip(per_gap * length[edge], least, fine)
    size = np.minimum(size, np.maximum(per_gap * _gaps(network, edge, place, one, other), least))
    level = np.ceil(np.log(fine / size) / np.log(STEP) - 1e-9).astype(np.int64)
    found = [(max(fine / STEP**k, least), place[level == k]) for k in np.unique(level).tolist()]
    tips = network.points[network.tips]
    return [*found, *([(at_tips, tips)] if len(tips) and at_tips < fine else [])]


def _near_pairs(network: Network, reach: float) -> tuple[Ints, Ints]:
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


def _samples(network: Network, edges: Ints, length: Floats, spacing: Floats) -> tuple[Ints, Floats]:
    """Edge and place (k, 2) of points along the given edges, ends included, no farther apart than ``spacing``."""
    count = 1 + np.ceil(length[edges] / spacing[edges]).astype(np.int64)
    row = np.repeat(np.arange(len(edges)), count)
    along = (np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)) / (count[row] - 1)
    start, end = np.moveaxis(network.points[network.edges[edges[row]]], 1, 0)
    return edges[row], start + along[:, None] * (end - start)


def _gaps(network: Network, edge: Ints, place: Floats, one: Ints, other: Ints) -> Floats:
    """Distance of each sample from the nearest edge paired with its own; inf where there is none."""
    first = np.searchsorted(edge, one, side="left")  # samples come edge by edge, in ascending order
    count = np.searchsorted(edge, one, side="right") - first
    pair = np.repeat(np.arange(len(one)), count)
    sample = np.arange(len(pair)) - np.repeat(np.cumsum(count) - count, count) + first[pair]
    start, end = np.moveaxis(network.points[network.edges[other[pair]]], 1, 0)
    step = end - start
    along = np.clip(np.sum((place[sample] - start) * step, axis=1) / np.sum(step * step, axis=1), 0, 1)
    distance = np.linalg.norm(place[sample] - start - along[:, None] * step, axis=1)
    gaps = np.full(len(place), np.inf)
    np.minimum.at(gaps, sample, distance)
    return gaps
