"""The regions that traces on whole numbers cut out of a square, in exact fractions: the reference for meshes."""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import dataclass
from fractions import Fraction
from itertools import combinations, pairwise
from math import atan2, degrees


@dataclass(frozen=True)
class Arrangement:
    """The graph of the sides (owner None) and the traces: edges as {(point, point): owner}, points in fractions."""

    edges: dict
    repeated: set  # pairs of owners that share an edge
    empty: set  # traces of which nothing is inside
    blocks: int
    areas: list | None  # of the blocks, ascending; None where the graph is not connected
    tips: set
    junctions: int  # points where more than two trace edges meet
    networks: list  # for each part that hangs together, its traces

    @property
    def points(self):
        return {point for edge in self.edges for point in edge}


def cross(o, a, b):
    return (a[0] - o[0]) * (b[1] - o[1]) - (a[1] - o[1]) * (b[0] - o[0])


def lies_on(point, a, b):
    inside = min(a[0], b[0]) <= point[0] <= max(a[0], b[0]) and min(a[1], b[1]) <= point[1] <= max(a[1], b[1])
    return inside and cross(a, b, point) == 0


def common_points(one, other):
    """Points in both segments: ends that lie on the other, and the crossing."""
    (a, b), (c, d) = one, other
    found = {p for p in one if lies_on(p, c, d)} | {p for p in other if lies_on(p, a, b)}
    span = (b[0] - a[0]) * (d[1] - c[1]) - (b[1] - a[1]) * (d[0] - c[0])
    if span:
        t = Fraction((c[0] - a[0]) * (d[1] - c[1]) - (c[1] - a[1]) * (d[0] - c[0]), span)
        point = (a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1]))
        if lies_on(point, a, b) and lies_on(point, c, d):
            found.add(point)
    return found


def groups(pairs, members):
    """Union by relabelling: sets that hang together."""
    label = {member: member for member in members}
    for one, other in pairs:
        old, new = label[one], label[other]
        label = {member: new if value == old else value for member, value in label.items()}
    return {frozenset(m for m in members if label[m] == value) for value in set(label.values())}


def arrange(width, traces):
    """The arrangement of a square of ``width`` from 0 and traces, lists of points of whole numbers."""
    corners = [(0, 0), (width, 0), (width, width), (0, width)]
    lines = [(None, pair) for pair in zip(corners, corners[1:] + corners[:1], strict=True)]
    lines += [(number, pair) for number, trace in enumerate(traces) for pair in pairwise(trace)]
    on = [set(pair) for _, pair in lines]
    for (i, (_, one)), (j, (_, other)) in combinations(enumerate(lines), 2):
        both = common_points(one, other)
        on[i] |= both
        on[j] |= both
    edges, repeated = {}, set()
    for (owner, _), points in zip(lines, on, strict=True):
        for a, b in pairwise(sorted(points)):
            middle = ((Fraction(a[0]) + b[0]) / 2, (Fraction(a[1]) + b[1]) / 2)
            if all(0 <= part <= width for part in middle):
                if (a, b) in edges:
                    repeated.add((edges[a, b], owner))
                edges[a, b] = owner
    points = {point for edge in edges for point in edge}
    own = {edge: owner for edge, owner in edges.items() if owner is not None}
    at, all_at = Counter(p for edge in own for p in edge), Counter(p for edge in edges for p in edge)
    tips = {p for p in points if all_at[p] == 1}
    alone = groups(edges, points)
    return Arrangement(
        edges=edges,
        repeated=repeated,
        empty=set(range(len(traces))) - set(edges.values()),
        blocks=len(edges) - len(points) + len(alone),  # Euler, without the outside
        areas=faces(edges) if len(alone) == 1 else None,
        tips=tips,
        junctions=sum(count > 2 for count in at.values()),
        networks=sorted(sorted({owner for (a, _), owner in own.items() if a in part})
                        for part in groups(own, {point for edge in own for point in edge})),
    )  # fmt: skip


def faces(edges):
    """Areas of the faces of a connected graph, by walking round each with it on the left."""
    around = defaultdict(list)
    for a, b in edges:
        around[a].append(b)
        around[b].append(a)
    following = {}
    for here, ends in around.items():
        ends.sort(key=lambda end: atan2(float(end[1] - here[1]), float(end[0] - here[0])))
        for end, before in zip(ends, ends[-1:] + ends[:-1], strict=True):
            following[end, here] = (here, before)
    areas = []
    while following:
        step, first = following.popitem()
        following[step] = first
        area = Fraction(0)
        while step in following:
            area += Fraction(step[0][0] * step[1][1] - step[1][0] * step[0][1]) / 2
            step = following.pop(step)
        areas.append(float(area))
    return sorted(area for area in areas if area > 0)


def least_gap(arrangement):
    """Smallest distance between two points, or a point and an edge that does not end there."""
    least = float("inf")
    points = [(float(x), float(y)) for x, y in arrangement.points]
    edges = [tuple((float(x), float(y)) for x, y in edge) for edge in arrangement.edges]
    for p in points:
        for a, b in edges:
            if p in (a, b):
                continue
            step = (b[0] - a[0], b[1] - a[1])
            t = ((p[0] - a[0]) * step[0] + (p[1] - a[1]) * step[1]) / (step[0] ** 2 + step[1] ** 2)
            t = min(1.0, max(0.0, t))
            least = min(least, ((p[0] - a[0] - t * step[0]) ** 2 + (p[1] - a[1] - t * step[1]) ** 2) ** 0.5)
    return least


def least_angle(arrangement):
    """Smallest angle between edges that meet [degree]."""
    headings = defaultdict(list)
    for a, b in arrangement.edges:
        for here, there in ((a, b), (b, a)):
            headings[here].append(degrees(atan2(float(there[1] - here[1]), float(there[0] - here[0]))))
    turns = [(b - a) % 360 for h in headings.values() for a, b in pairwise([*sorted(h), min(h) + 360]) if len(h) > 1]
    return min(turns)
