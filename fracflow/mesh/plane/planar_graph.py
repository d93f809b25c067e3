"""Lines in a plane become a planar graph: near points merge, points move onto near lines, crossings are cut."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from fracflow.mesh.data import Floats, Ints

CORNER, ON_SIDE, FREE = 0, 1, 2  # how freely a point moves: not at all, along its side, anywhere
CHUNK = 2_000_000  # pairs looked at together
TINY = 1e-300
ALMOST_ON = 2e-3  # slope, 0.11 degrees, at which a point and the ends of an edge make one line


@dataclass(frozen=True)
class PlanarGraph:
    """Points and the edges between them.

    points  (n, 2)  where they are now [length]; merged ones stay in the table, unused
    first   (n, 2)  where they were when they came in
    became  (n,)    the point each has been merged into, itself if none
    rank    (n,)    CORNER, ON_SIDE or FREE
    edges   (m, 2)  points from start to end, along the line they came from
    owner   (m,)    the line of each: a trace, or side k of the domain as -1 - k
    bends   points (k,) that edges of owner (k,) were led through, at a distance (k,) [length]
    given   points that were there before any crossing
    """

    points: Floats
    first: Floats
    became: Ints
    rank: Ints
    edges: Ints
    owner: Ints
    bends: tuple[Ints, Ints, Floats]
    given: int


def planar_graph_of(domain: Floats, traces: list[Floats]) -> PlanarGraph:
    """The sides of a polygon (k, 2) and the segments of the traces, each (m, 2), as they are given."""
    count = len(domain)
    around = np.arange(count)
    starts = count + np.cumsum([0, *map(len, traces)])
    points = np.concatenate([domain, *traces])
    inner = np.setdiff1d(np.arange(count, len(points)), starts[1:] - 1)
    edges = np.concatenate([np.stack([around, (around + 1) % count], axis=1), np.stack([inner, inner + 1], axis=1)])
    owner = np.concatenate([-1 - around, np.repeat(np.arange(len(traces)), [len(t) - 1 for t in traces])])
    rank = np.repeat([CORNER, FREE], [count, len(points) - count])
    nothing = np.zeros(0, dtype=np.int64)
    bends = (nothing, nothing, np.zeros(0))
    return PlanarGraph(points, points.copy(), np.arange(len(points)), rank, edges, owner, bends, len(points))


def settle(lines: PlanarGraph, snap: float, rounds: int) -> PlanarGraph | None:
    """Merge, move and cut until nothing is left to do; None if that takes more than ``rounds``.

    Afterwards edges meet at common points only. No two points are within ``snap`` of each other, and no end or bend
    of a line is within ``snap`` of another edge. A crossing may be: were it moved, the next one along two lines that
    part slowly would come near too, and so on to their ends.
    """
    for _ in range(rounds):
        before = lines
        for change in (merge, attach, cross):
            lines = change(lines, snap)
        if lines is before:
            return lines
    return None


def merge(lines: PlanarGraph, snap: float) -> PlanarGraph:
    """Merge points within ``snap``: into corners first, then points of a side, then those where most edges meet.

    Of others alike into those of longer lines, whichever line comes first.
    """
    from scipy.spatial import cKDTree  # imports much

    used = np.unique(lines.edges)
    tree = cKDTree(lines.points[used])
    next_one = tree.query(lines.points[used], k=[2], distance_upper_bound=np.nextafter(snap, np.inf))[0][:, 0]
    close = used[next_one <= snap]
    degree = np.bincount(lines.edges.ravel(), minlength=len(lines.points))
    order = np.lexsort([close, -_lengths_at(lines)[close], -degree[close], lines.rank[close]])
    target, is_kept = np.arange(len(lines.points)), lines.rank == CORNER
    for keeper in close[order].tolist():
        if target[keeper] == keeper:  # a fine line has far more pairs than points that stay
            near = used[tree.query_ball_point(lines.points[keeper], snap)]
            target[near[(target[near] == near) & ~is_kept[near]]] = keeper
            is_kept[keeper] = True
    if np.all(target[close] == close):
        return lines
    edges = target[lines.edges]
    is_left = edges[:, 0] != edges[:, 1]
    return replace(lines, became=target[lines.became], edges=edges[is_left], owner=lines.owner[is_left])


def _lengths_at(lines: PlanarGraph) -> Floats:
    """Of each point (n,) the length of the lines that it is of together, nine digits: equal ones stay equal."""
    line = np.unique(lines.owner, return_inverse=True)[1]
    whole = np.bincount(line, np.linalg.norm(np.diff(lines.points[lines.edges], axis=1)[:, 0], axis=1))
    found = np.bincount(lines.edges.ravel(), np.repeat(whole[line], 2), len(lines.points))
    return np.asarray(np.round(found / whole.max(), 9))


def attach(lines: PlanarGraph, snap: float) -> PlanarGraph:
    """Move points within ``snap`` of an edge onto it; a point of a side stays, and the edge bends to it."""
    point, edge, along, foot, distance = near_edges(lines.points, lines.edges, np.unique(lines.edges), snap)
    ends = lines.points[lines.edges[edge]]
    nearest_end = np.linalg.norm(ends - lines.points[point][:, None], axis=2).min(axis=1)
    is_meant = (point < lines.given) | (distance < ALMOST_ON * nearest_end)
    is_meant &= (lines.rank[point] == FREE) | (lines.owner[edge] >= 0)
    point, edge, along, foot, distance = (part[is_meant] for part in (point, edge, along, foot, distance))
    if not len(point):
        return lines
    order = np.lexsort([distance, point])
    order = order[np.append(True, point[order][1:] != point[order][:-1])]
    point, edge, along, foot, distance = (part[order] for part in (point, edge, along, foot, distance))
    is_free = lines.rank[point] == FREE
    points, rank = lines.points.copy(), lines.rank.copy()
    points[point[is_free]] = foot[is_free]
    rank[point[is_free & (lines.owner[edge] < 0)]] = ON_SIDE
    held = (point[~is_free], lines.owner[edge[~is_free]], distance[~is_free])
    bends = tuple(np.concatenate(both) for both in zip(lines.bends, held, strict=True))
    return _cut(replace(lines, points=points, rank=rank, bends=bends), edge, along, point)


def cross(lines: PlanarGraph, snap: float) -> PlanarGraph:
    """Cut edges where they cross."""
    one, other = boxes_that_meet(lines.points[lines.edges], 0.0)
    apart = np.all(lines.edges[one][:, :, None] != lines.edges[other][:, None, :], axis=(1, 2))
    one, other = one[apart], other[apart]
    start, step = lines.points[lines.edges[:, 0]], np.diff(lines.points[lines.edges], axis=1)[:, 0]
    reach = start[other] - start[one]
    span = _turn(step[one], step[other])
    with np.errstate(divide="ignore", invalid="ignore"):
        along_one, along_other = _turn(reach, step[other]) / span, _turn(reach, step[one]) / span
    inside = (span != 0) & (along_one > 0) & (along_one < 1) & (along_other > 0) & (along_other < 1)
    if not np.any(inside):
        return lines
    one, other, along_one, along_other = (part[inside] for part in (one, other, along_one, along_other))
    # On the straighter of the two, a side: its points must stay on it.
    on_one = (lines.owner[one] < 0)[:, None]
    at_one, at_other = start[one] + along_one[:, None] * step[one], start[other] + along_other[:, None] * step[other]
    new = np.where(on_one, at_one, at_other)
    number = len(lines.points) + np.arange(len(new))
    rank = np.where((lines.owner[one] < 0) | (lines.owner[other] < 0), ON_SIDE, FREE)
    more = replace(
        lines,
        points=np.concatenate([lines.points, new]),
        first=np.concatenate([lines.first, new]),
        became=np.concatenate([lines.became, number]),
        rank=np.concatenate([lines.rank, rank]),
    )
    twice = np.concatenate([number, number])
    return _cut(more, np.concatenate([one, other]), np.concatenate([along_one, along_other]), twice)


def near_edges(points: Floats, edges: Ints, chosen: Ints, reach: float) -> tuple[Ints, Ints, Floats, Floats, Floats]:
    """Chosen of points (n, 2) within ``reach`` of one of edges (m, 2) that does not end there, opposite to its inside.

    Gives point (n,), edge (n,), place along the edge (n,) from 0 to 1, foot (n, 2) and distance (n,) [length].
    """
    low, high = points[edges].min(axis=1) - reach, points[edges].max(axis=1) + reach
    point, edge = _meeting(points[chosen], points[chosen], low, high)
    point = chosen[point]
    apart = np.all(edges[edge] != point[:, None], axis=1)
    point, edge = point[apart], edge[apart]
    start, end = np.moveaxis(points[edges[edge]], 1, 0)
    along = np.sum((points[point] - start) * (end - start), axis=1) / np.sum((end - start) ** 2, axis=1)
    foot = start + along[:, None] * (end - start)
    distance = np.linalg.norm(points[point] - foot, axis=1)
    hit = (along > 0) & (along < 1) & (distance <= reach)
    return point[hit], edge[hit], along[hit], foot[hit], distance[hit]


def _cut(lines: PlanarGraph, edge: Ints, along: Floats, point: Ints) -> PlanarGraph:
    """Lead ``edge`` (k,) through ``point`` (k,), in the order of ``along`` (k,)."""
    whole = np.arange(len(lines.edges))
    on = np.concatenate([whole, edge, whole])
    node = np.concatenate([lines.edges[:, 0], point, lines.edges[:, 1]])
    order = np.lexsort([np.concatenate([np.full(len(whole), -1.0), along, np.full(len(whole), 2.0)]), on])
    on, node = on[order], node[order]
    is_piece = (on[1:] == on[:-1]) & (node[1:] != node[:-1])
    pieces = np.stack([node[:-1], node[1:]], axis=1)[is_piece]
    return replace(lines, edges=pieces, owner=lines.owner[on[:-1][is_piece]])


def boxes_that_meet(ends: Floats, reach: float) -> tuple[Ints, Ints]:
    """Pairs i < j of edges (m, 2, 2) whose boxes, wider by ``reach``, meet."""
    low, high = ends.min(axis=1) - reach, ends.max(axis=1) + reach
    one, other = _meeting(low, high, low, high)
    return one[one < other], other[one < other]


def _meeting(low: Floats, high: Floats, lows: Floats, highs: Floats) -> tuple[Ints, Ints]:
    """Pairs of boxes from ``low`` to ``high`` (n, 2) and from ``lows`` to ``highs`` (m, 2) that meet, in their order.

    In strips of y about as high as the boxes, the left end of one of two that meet lies within the other. A pair is found in
    the first strip that both are in.
    """
    if not len(low) or not len(lows):
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    ends = np.concatenate([low[:, 0], lows[:, 0], high[:, 0], highs[:, 0]])
    rank = np.unique(ends, return_inverse=True)[1].reshape(2, -1)
    bottom, top = np.concatenate([low[:, 1], lows[:, 1]]), np.concatenate([high[:, 1], highs[:, 1]])
    begin, count = float(bottom.min()), len(bottom)
    strips = 1.0 + min(float(top.max() - begin) / max(float((top - bottom).mean()), TINY), count)
    per_height = strips / max(float(top.max()) - begin, TINY)
    first, last = (np.floor((each - begin) * per_height).astype(np.int64) for each in (bottom, top))
    many = last - first + 1
    box = np.repeat(np.arange(count), many)
    strip = first[box] + np.arange(len(box)) - np.repeat(np.cumsum(many) - many, many)
    width = len(ends) + 1
    left, right = strip * width + rank[0][box], strip * width + rank[1][box]
    is_one = box < len(low)
    found = [np.zeros((0, 2), dtype=np.int64)]
    for these in (is_one, ~is_one):
        mine, theirs = np.flatnonzero(these), np.flatnonzero(~these)
        theirs = theirs[np.argsort(left[theirs], kind="stable")]
        start = np.searchsorted(left[theirs], left[mine] + (these is not is_one))  # left ends alike count once
        stop = np.searchsorted(left[theirs], right[mine], "right")
        for rows in _chunks(np.maximum(stop - start, 0)):
            size = np.maximum(stop[rows] - start[rows], 0)
            at = np.repeat(start[rows] - np.cumsum(size) + size, size) + np.arange(size.sum())
            pair = np.stack([np.repeat(mine[rows], size), theirs[at]], axis=1)
            a, b = box[pair].T
            meets = (
                (bottom[a] <= top[b]) & (bottom[b] <= top[a]) & (strip[pair[:, 0]] == np.maximum(first[a], first[b]))
            )
            found.append(np.sort(np.stack([a[meets], b[meets]], axis=1), axis=1))
    one, other = np.concatenate(found).T
    order = np.lexsort([other, one])
    return one[order], other[order] - len(low)


def _chunks(sizes: Ints) -> Iterator[slice]:
    """Slices of rows that have about CHUNK of ``sizes`` (n,) in all, at least one row each."""
    total, begin = np.cumsum(sizes), 0
    while begin < len(sizes):
        before = int(total[begin - 1]) if begin else 0
        end = max(begin + 1, int(np.searchsorted(total, before + CHUNK, "right")))
        yield slice(begin, end)
        begin = end


def _turn(one: Floats, other: Floats) -> Floats:
    """Cross product of vectors (., 2)."""
    return one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0]
