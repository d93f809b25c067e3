"""Unbounded rock in plane strain, as the dislocations that jumps along fractures are.

A jump D that varies along a trace is a density of dislocations b = dD/ds, which all add up to none. With E' = E/(1 - nu^2)
two of them at a distance r have the energy -(E'/(4 pi)) (b.c ln r - (b.r)(c.r)/r^2) (Hirth and Lothe 1982, chapter 5).
Where D is linear on segments b is constant, and the energy of the rock is a sum over pairs of them. It is symmetric, and no
integral is singular where segments bend, end on others, or cross at their ends. These are the equations of displacement
discontinuities (Crouch and Starfield 1983), tested by jumps that are linear too.

At a tip D is a root of the distance, and b in the last joint is far from constant. Without more a crack of equal joints is
0.114 of one too short at each tip, and its jumps err by order 1 (`at_tips`).

Where D is smooth, forces over the lengths of equal joints h are too small: by (k h)^2/6 for a wave number k. For the force at a
node is the mean of the stress over both its joints, and so is a jump that is linear between nodes.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fracflow.elements.shape import Floats, Ints, gauss

Bools = NDArray[np.bool_]

# distance over length, and Gauss points of a segment: errors are 1e-13 from there on
POINTS_BY_DISTANCE = ((40.0, 3), (10.0, 4), (3.0, 6))
NEAR = ((0.5, 16), (0.1, 72), (0.0, 400))  # the same of one segment, where the integral along the other is exact
TINY = float(np.finfo(float).tiny)
CHUNK = 1 << 16  # pairs of segments whose points fit a processor's cache
AT_TIP = 0.2437838  # in ln r: see at_tips


def at_tips(ends: Floats) -> Floats:
    """Additions (n,) to ln r in the mean of a segment with itself: AT_TIP for each of its ends that no other segment has.

    ends  (n, 2, 2)
    Nodes j = 1, 2, ... of equal joints from a tip at 0 then have jumps sqrt(j) far from it, without the term 1/sqrt(j) that
    a shift of the tip would make. Their equations are T D = AT_TIP D_1 e_1, with a Toeplitz matrix T of symbol
    G(t) |2 sin(t/2)|, and G = pi |2 sin(t/2)|^3 sum_n |t + 2 pi n|^-3. By Wiener and Hopf's factors
    AT_TIP = e^g (1/4 - S)/(5/4 - S), where g is the mean of ln G and S that of ln(pi/G)/(4 sin^2(t/2)). Such a correction is
    that of Ryder and Napier (1985), there for constant jumps. Linear jumps then have the volume of the root, for which the node
    beside the tip lies 14 % above it; the next are within 0.7 %. Without the addition the first is 2 % above, the next 3, 2 and
    1 % below. A jump that ends less steeply has little of it.

    The root is that of a tip alone. Thin rock between tips side by side has too little energy for it, and K_s would not be
    positive. So the addition falls to none as the nearest other segment is one to half a joint from the tip.
    """
    _, number, count = np.unique(ends.reshape(-1, 2), axis=0, return_inverse=True, return_counts=True)
    segment, end = np.nonzero(count[number.ravel()].reshape(-1, 2) == 1)
    share = np.clip(2.0 * _nearest(ends, segment, ends[segment, end]) - 1.0, 0.0, 1.0)
    return np.asarray(AT_TIP * np.bincount(segment, share, minlength=len(ends)))


def _nearest(ends: Floats, segment: Ints, place: Floats) -> Floats:
    """Distance (m,) of places (m, 2), of a segment each, from the nearest other one, over its own length; inf past that."""
    middle, length = ends.mean(axis=1), np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    axis = int(np.argmax(np.ptp(middle, axis=0)))
    order, reach = np.argsort(middle[:, axis]), 1.001 * (length[segment] + 0.5 * length.max())
    low, high = (np.searchsorted(middle[order, axis], place[:, axis] + side * reach) for side in (-1.0, 1.0))
    found = np.full(len(segment), np.inf)
    for k, own in enumerate(segment.tolist()):
        near = order[low[k] : high[k]]
        apart = _from_point(place[k], ends[near[near != own]])
        found[k] = apart.min(initial=np.inf) / length[own]
    return found


def energies(ends: Floats, rows: Ints, own: Floats | None = None) -> Floats:
    """Means (r, n, 3) of delta_ij ln r - r_i r_j/r^2 over pairs of segments, as xx, yy, xy; of some ``rows`` (r,) with all.

    ends  (n, 2, 2) of segments that have at most ends in common [length]
    own   (n,) added to ln r of each segment with itself
    Equal to the last bit where two segments change places.
    """
    result = np.empty((len(rows), len(ends), 3))
    place = np.full(len(ends), -1)
    place[rows] = np.arange(len(rows))
    step = max(CHUNK // len(ends), 1)
    for first in range(0, len(rows), step):
        chosen = rows[first : first + step]
        one, other = (part.ravel() for part in np.meshgrid(chosen, np.arange(len(ends)), indexing="ij"))
        asked = (one <= other) | (place[other] < 0)
        one, other = one[asked], other[asked]
        values = pair_means(ends, one, other, own)
        result[place[one], other] = values
        mirrored = place[other] >= 0
        result[place[other[mirrored]], one[mirrored]] = values[mirrored]
    return result


def pair_means(ends: Floats, one: Ints, other: Ints, own: Floats | None = None) -> Floats:
    """The same means (m, 3) of pairs of segments, by their numbers (m,)."""
    middle, length = ends.mean(axis=1), np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    low, high = np.minimum(one, other), np.maximum(one, other)
    half = 0.5 * (length[low] + length[high])
    apart = np.linalg.norm(middle[low] - middle[high], axis=1) - half
    apart /= np.maximum(length[low], length[high])
    values, left = np.empty((len(low), 3)), np.ones(len(low), dtype=bool)
    for least, count in POINTS_BY_DISTANCE:
        now = left & (apart > least)
        values[now] = _far(ends[low[now]], ends[high[now]], count)
        left &= ~now
    values[left] = _near(ends[low[left]], ends[high[left]])
    if own is not None:
        itself = low == high
        values[itself, :2] += own[low[itself], None]
    return values


def _far(one: Floats, other: Floats, count: int) -> Floats:
    """Means (m, 3) over pairs of segments (m, 2, 2) by Gauss points on both."""
    place, weight = gauss(count)
    here, there = (each[:, 0, None] + place[:, None] * (each[:, 1] - each[:, 0])[:, None] for each in (one, other))
    total = np.zeros((len(one), 3))
    for i in range(count):
        for j in range(count):
            arm = here[:, i] - there[:, j]
            total += weight[i] * weight[j] * _kernel(arm)
    return total


def _near(one: Floats, other: Floats) -> Floats:
    """Means (m, 3) over pairs of segments (m, 2, 2) that may touch or be the same."""
    values = np.empty((len(one), 3))
    longer = np.linalg.norm(one[:, 1] - one[:, 0], axis=1) > np.linalg.norm(other[:, 1] - other[:, 0], axis=1)
    short, long = np.where(longer[:, None, None], other, one), np.where(longer[:, None, None], one, other)
    same = np.all(short[:, :, None] == long[:, None], axis=3)  # (m, end of the short one, end of the long one)
    itself, touch = same.sum(axis=(1, 2)) == 2, same.sum(axis=(1, 2)) == 1
    values[itself] = _itself(short[itself])
    values[touch] = _touching(short[touch], long[touch], same[touch])
    left, length = ~(itself | touch), np.linalg.norm(short[:, 1] - short[:, 0], axis=1)
    apart = _distance(short, long) / length
    for least, count in NEAR:
        now = np.flatnonzero(left & (apart > least))
        left[now] = False
        place, weight = gauss(count)
        for each in now[:, None] if count > 100 else [now]:
            start, step = short[each, 0], short[each, 1] - short[each, 0]
            points = start[:, None] + place[:, None] * step[:, None]
            found = mean_along(points, long[each, None, 0], long[each, None, 1])
            values[each] = np.einsum("q,mqk->mk", weight, found)
    return values


def _itself(segment: Floats) -> Floats:
    """The mean (m, 3) over each segment and itself."""
    step = segment[:, 1] - segment[:, 0]
    length = np.linalg.norm(step, axis=1)
    return _kernel(step, np.log(length) - 1.5)


def _touching(one: Floats, other: Floats, same: Bools) -> Floats:
    """The mean (m, 3) over segments with one end in common, the Boolean ``same`` (m, 2, 2).

    From there on r_i r_j/r^2 is of degree 0 in both places, and ln r but for a constant. By Euler's theorem the double integral
    is one along the far edges.
    """
    of_one, of_other = same.any(axis=2).argmax(axis=1), same.any(axis=1).argmax(axis=1)
    row = np.arange(len(one))
    far = mean_along(one[row, 1 - of_one], other[:, 0], other[:, 1])
    far += mean_along(other[row, 1 - of_other], one[:, 0], one[:, 1])
    return np.asarray(0.5 * far - np.array([0.5, 0.5, 0.0]))


def mean_along(place: Floats, start: Floats, end: Floats) -> Floats:
    """Means (..., 3) of delta_ij ln r - r_i r_j/r^2 along segments, r from there to a ``place``; all arguments (..., 2)."""
    step = end - start
    length = np.linalg.norm(step, axis=-1)
    (tx, ty), (ax, ay) = np.moveaxis(step / length[..., None], -1, 0), np.moveaxis(place - start, -1, 0)
    along, across = ax * tx + ay * ty, ay * tx - ax * ty
    left = along - length
    log_start, log_end = (0.5 * np.log(np.maximum(each**2 + across**2, TINY)) for each in (along, left))
    angle = np.arctan2(along, np.abs(across)) - np.arctan2(left, np.abs(across))
    normal = np.abs(across) * angle / length  # mean of (r.n)^2/r^2
    mixed = across * (log_start - log_end) / length
    log = (along * log_start - left * log_end) / length - 1.0 + normal
    xx = tx * tx + (ty * ty - tx * tx) * normal - 2.0 * tx * ty * mixed
    xy = tx * ty * (1.0 - 2.0 * normal) + (tx * tx - ty * ty) * mixed
    return np.stack([log - xx, log - 1.0 + xx, -xy], axis=-1)


def _kernel(arm: Floats, log: Floats | None = None) -> Floats:
    """delta_ij ln r - r_i r_j/r^2 (m, 3) of r = ``arm`` (m, 2), or with another ``log`` (m,)."""
    x, y = arm.T
    square = x * x + y * y
    log = 0.5 * np.log(square) if log is None else log
    xx = x * x / square
    return np.stack([log - xx, log - 1.0 + xx, -x * y / square], axis=1)


def _distance(one: Floats, other: Floats) -> Floats:
    """Distance (m,) of segments (m, 2, 2) that do not cross."""
    found = np.full(len(one), np.inf)
    for segment, points in ((one, other), (other, one)):
        for point in (points[:, 0], points[:, 1]):
            found = np.minimum(found, _from_point(point, segment))
    return found


def _from_point(point: Floats, segment: Floats) -> Floats:
    """Distance (m,) of points (m, 2) from segments (m, 2, 2)."""
    start, step = segment[:, 0], segment[:, 1] - segment[:, 0]
    along = np.clip(np.sum((point - start) * step, axis=1) / np.sum(step**2, axis=1), 0.0, 1.0)
    return np.asarray(np.linalg.norm(point - start - along[:, None] * step, axis=1))


def displacements(places: Floats, ends: Floats, jumps: Floats, poissons_ratio: float) -> Floats:
    """Displacements (m, 2) at places (m, 2) of rock with linear ``jumps`` (n, 2, 2) at the ``ends`` (n, 2, 2) of segments.

    A jump is the displacement on the left of a segment less that on its right [length]. Where segments meet, jumps add up to
    none. Muskhelishvili's potentials: 2 mu u = kappa phi - z conj(phi') - conj(psi). Far away there is none.
    """
    return _summed(places, lambda here: _displacements(here, ends, jumps, poissons_ratio), len(ends))


def stresses(places: Floats, ends: Floats, jumps: Floats, modulus: float) -> Floats:
    """Stresses (m, 3) at places (m, 2) as xx, yy, xy, tension positive; ``modulus`` is E' [stress], others as above."""
    return _summed(places, lambda here: _stresses(here, ends, jumps, modulus), len(ends))


def _summed(places: Floats, kernel: Callable[[Floats], Floats], count: int) -> Floats:
    step = max(CHUNK // max(count, 1), 1)
    return np.concatenate([kernel(places[first : first + step]) for first in range(0, max(len(places), 1), step)])


def _complex(vectors: Floats) -> Any:
    return vectors[..., 0] + 1j * vectors[..., 1]


def _segments(places: Floats, ends: Floats) -> tuple[Any, ...]:
    """Directions (n,), lengths (n,), arms (m, n) from both ends, and the difference (m, n) of their logarithms."""
    z, (start, end) = _complex(places)[:, None], _complex(ends).T
    ahead, behind = z - start, z - end
    tiny = TINY**0.25  # at an end itself logarithms cancel
    ahead, behind = (np.where(arm == 0.0, tiny, arm) for arm in (ahead, behind))
    length = np.abs(end - start)
    # across the segment the difference of angles jumps by 2 pi, and nowhere else
    logs = np.log(np.abs(ahead)) - np.log(np.abs(behind)) + 1j * np.angle(ahead * np.conj(behind))
    return (end - start) / length, length, ahead, behind, logs


def _displacements(places: Floats, ends: Floats, jumps: Floats, nu: float) -> Floats:
    along, length, ahead, _, logs = _segments(places, ends)
    first, last = 1j / (8.0 * np.pi * (1.0 - nu)) * _complex(jumps).T
    slope, share = (last - first) / length, ahead / along
    phi = (first + slope * share) * logs - (last - first)
    chi = slope * (np.conj(ahead) * logs - np.conj(along) * (share * logs - length)) / along
    chi += (np.conj(first) + np.conj(slope) * share) * logs - np.conj(last - first)
    found = ((3.0 - 4.0 * nu) * phi - np.conj(chi)).sum(axis=1)
    return np.stack([found.real, found.imag], axis=1)


def _stresses(places: Floats, ends: Floats, jumps: Floats, modulus: float) -> Floats:
    along, length, ahead, behind, logs = _segments(places, ends)
    first, last = 1j * modulus / (8.0 * np.pi) * _complex(jumps).T
    slope = (last - first) / length
    inverse = (1.0 / behind - 1.0 / ahead) / along
    phi = slope * logs / along
    psi = np.conj(slope) * logs / along - slope * np.conj(ahead) * inverse
    psi += slope * np.conj(along) / along * (ahead * inverse - logs / along)
    mean, rest = 2.0 * phi.sum(axis=1).real, psi.sum(axis=1)
    return np.stack([mean - rest.real, mean + rest.real, rest.imag], axis=1)
