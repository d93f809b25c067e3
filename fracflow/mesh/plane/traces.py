"""Fracture traces as users have them become a network that can be meshed; what was changed is said."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fracflow.errors import InputError
from fracflow.mesh.data import Bools, Floats, Ints
from fracflow.mesh.places import extent_of, place_text
from fracflow.mesh.plane.planar_graph import PlanarGraph, cross, near_edges, planar_graph_of, settle
from fracflow.remarks import note

ROUNDS = 30  # of merging, moving and cutting
EXACT = 1e-9  # of the domain's extent: moves under this are round-off and go without saying
LEAST_ANGLE = 0.1  # degrees between edges that meet
SHALLOW = 10.0  # degrees: lines that cross at less may share a stretch
FRACTION = 0.004  # a pencil's line, 0.4 mm, on a map on which the median trace is 10 cm long
SPARE = 0.25  # of the shortest trace or side, which snapping must not swallow
STRETCH = 20.0  # snaps that two traces may share

Trace = tuple[str, Floats]
"""Name and points (m, 2) of a fracture, from its start to its end."""


@dataclass(frozen=True)
class TraceNetwork:
    """The sides of the domain and the fractures, cut where they meet.

    points  (n, 2)  coordinates [length]
    edges   (m, 2)  points from start to end, along the trace or round the domain
    owner   (m,)    the trace of each edge, or side k as -1 - k
    notes   what was changed, a line each
    """

    points: Floats
    edges: Ints
    owner: Ints
    notes: tuple[str, ...]

    @property
    def tips(self) -> Ints:
        """Points (n,) where a single edge ends: the tips of fractures inside the rock."""
        count = np.bincount(self.edges.ravel(), minlength=len(self.points))
        return np.flatnonzero(count == 1)

    @property
    def meeting(self) -> Ints:
        """Points (n,) of fractures where three edges or more meet."""
        count = np.bincount(self.edges[self.owner >= 0].ravel(), minlength=len(self.points))
        return np.flatnonzero(count > 2)

    def along(self, owner: int) -> list[list[int]]:
        """Edges of a trace or a side, those of a side head to tail."""
        edges = self.edges[self.owner == owner]
        if owner < 0:  # straight
            step = self.points[edges[:, 1]] - self.points[edges[:, 0]]
            edges = edges[np.argsort(np.sum(self.points[edges[:, 0]] * step.sum(axis=0), axis=1))]
        return edges.tolist()


def tidy(
    domain: Floats, sides: Sequence[str], traces: Sequence[Trace], snap: float, stretch: float, unit: str = ""
) -> TraceNetwork:
    """Make traces meet where they all but meet, and cut off what is outside the domain.

    domain   (k, 2) corners of a polygon [length]; ``sides`` are the names of its sides
    snap     points nearer than this to each other, or to a trace or side, become one with it [length]
    stretch  traces that cross at under 10 degrees, or share up to this length, keep it as the first one's [length]
    unit     what messages write behind a length

    Raises InputError, naming the traces, for those that are too short, outside, run along each other or a side, or
    meet at less than 0.1 degrees.
    """
    names = [name for name, _ in traces]
    _check_domain(domain, snap, unit)
    given = planar_graph_of(domain, [points for _, points in traces])
    lines = settle(given, snap, ROUNDS)
    if lines is None:
        raise InputError(f"geometry: snap = {snap:.3g}{unit} leaves no end of points to move; lower geometry.snap")
    extent = np.ptp(domain, axis=0).max()
    labels = _Labels(names, list(sides), unit)
    missing = np.setdiff1d(np.arange(len(names)), lines.owner)
    if len(missing):
        raise InputError(
            f'geometry: fracture "{names[missing[0]]}": is shorter than snap = {snap:.3g}{unit}; remove it'
        )
    lines, notes = _inside(lines, domain, labels)
    lines, more = _without_repeats(lines, labels, stretch, _shallow_pairs(given))
    notes = [*_moves(lines, given, labels, EXACT * extent), *notes, *more]
    used, compact = np.unique(lines.edges, return_inverse=True)
    network = TraceNetwork(lines.points[used], compact.reshape(-1, 2), lines.owner, tuple(notes))
    _check_angles(network, labels)
    return network


def cut_at(network: TraceNetwork, places: Floats, snap: float) -> TraceNetwork:
    """The network with a point where traces are nearest to each place (n, 2); one within ``snap`` of it stands for it."""
    points, edges, owner = network.points, network.edges, network.owner
    for place in places:
        own = np.flatnonzero(owner >= 0)
        if not len(own) or np.linalg.norm(points[edges[own]] - place, axis=2).min() <= snap:
            continue
        start, step = points[edges[own, 0]], np.diff(points[edges[own]], axis=1)[:, 0]
        along = np.clip(np.sum((place - start) * step, axis=1) / np.sum(step**2, axis=1), 0.0, 1.0)
        feet = start + along[:, None] * step
        near = int(np.argmin(np.linalg.norm(feet - place, axis=1)))
        edge, foot = int(own[near]), feet[near]
        if np.linalg.norm(points[edges[edge]] - foot, axis=1).min() > snap:
            here = len(points)
            points = np.append(points, foot[None], axis=0)
            halves = [[edges[edge, 0], here], [here, edges[edge, 1]]]
            edges = np.concatenate([edges[:edge], halves, edges[edge + 1 :]])
            owner = np.insert(owner, edge, owner[edge])
    return replace(network, points=points, edges=edges, owner=owner)


@dataclass(frozen=True)
class _Labels:
    """The names of owners in messages, and the unit behind lengths."""

    traces: list[str]
    sides: list[str]
    unit: str = ""

    def __call__(self, owner: int) -> str:
        return f'fracture "{self.traces[owner]}"' if owner >= 0 else f"side {self.sides[-1 - owner]}"

    def all_of(self, owners: Ints) -> str:
        return " and ".join(self(owner) for owner in np.unique(owners)[::-1].tolist())


class RowsOf:
    """The rows that have a value, among those chosen if they are, without a look at all of them for each."""

    def __init__(self, values: Ints, chosen: Bools | None = None) -> None:
        """Sort the rows by values (n,)."""
        self._rows = np.arange(len(values)) if chosen is None else np.flatnonzero(chosen)
        self._rows = self._rows[np.argsort(values[self._rows], kind="stable")]
        self._values = values[self._rows]

    def __call__(self, value: int) -> Ints:
        """Those (k,) of a value, in their order."""
        begin, end = np.searchsorted(self._values, [value, value + 1])
        return np.asarray(self._rows[begin:end])


def is_within(points: Floats, polygon: Floats) -> np.ndarray:
    """Whether each point (m, 2) is inside a polygon (k, 2)."""
    start, end = polygon, np.roll(polygon, -1, axis=0)
    y = points[:, 1, None]
    is_across = (start[:, 1] > y) != (end[:, 1] > y)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        crossing = start[:, 0] + (y - start[:, 1]) / (end[:, 1] - start[:, 1]) * (end[:, 0] - start[:, 0])
    return np.sum(is_across & (points[:, 0, None] < crossing), axis=1) % 2 == 1


def polygon_area(corners: Floats) -> float:
    """Area of a polygon (k, 2), whichever way round [length**2]."""
    x, y = (corners - corners.mean(axis=0)).T
    return float(abs(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)) / 2)


def natural_snap(domain: Floats, traces: Sequence[Trace]) -> tuple[float, str]:
    """The snap of traces that state none [length], and why: 0.4 % of their median length.

    The median stays where one trace more is drawn far away. It counts at most as the width of the domain, the root of
    its area. No trace or side may be shorter than four snaps.

    domain  (k, 2) corners of a polygon [length]
    """
    lengths = np.array([np.linalg.norm(np.diff(points, axis=0), axis=1).sum() for _, points in traces])
    sides = np.linalg.norm(np.roll(domain, -1, axis=0) - domain, axis=1)
    width, percent = float(np.sqrt(polygon_area(domain))), f"{100.0 * FRACTION:g} % of"
    found = [
        (FRACTION * width, f"{percent} the domain's width"),
        (SPARE * float(sides.min()), f"{SPARE:g} of the domain's shortest side"),
    ]
    if len(lengths):
        name = traces[int(np.argmin(lengths))][0]
        found += [
            (FRACTION * float(np.median(lengths)), f"{percent} the median length of traces"),
            (SPARE * float(lengths.min()), f'{SPARE:g} of the length of fracture "{name}", the shortest'),
        ]
    return min(each for each in found if each[0] > 0.0)  # a domain that is none is refused by name later


def _check_domain(domain: Floats, snap: float, unit: str) -> None:
    alone = planar_graph_of(domain, [])
    gaps = np.linalg.norm(domain - np.roll(domain, -1, axis=0), axis=1)
    if gaps.min() <= snap:
        where = place_text(domain[np.argmin(gaps)], extent_of(domain))
        raise InputError(f"geometry.domain: the side that starts at {where} is no longer than snap = {snap:.3g}{unit}")
    touching = near_edges(alone.points, alone.edges, np.arange(len(domain)), snap)[0]
    if len(touching):
        where = place_text(domain[touching[0]], extent_of(domain))
        raise InputError(f"geometry.domain: the corner {where} is within snap = {snap:.3g}{unit} of another side")
    if cross(alone, snap) is not alone or polygon_area(domain) <= snap * gaps.max():
        raise InputError(
            "geometry.domain: the sides cross each other; list the corners in their order round the domain"
        )


def _shallow_pairs(given: PlanarGraph) -> set[tuple[int, int]]:
    """Pairs of traces of which two segments lie at under SHALLOW degrees and cross."""
    cut = cross(given, 0.0)
    new = np.arange(len(given.points), len(cut.points))
    at, owner, heading = _ends_at(cut.points, cut.edges, cut.owner)
    is_new = np.isin(at, new)
    return {
        (min(a, b), max(a, b))
        for a, b, angle, _ in _neighbours(at[is_new], owner[is_new], heading[is_new])
        if angle < SHALLOW
    }


def _ends_at(points: Floats, edges: Ints, owner: Ints) -> tuple[Ints, Ints, Floats]:
    """Point, owner and heading [degree] of both ends of all edges, seen from the point."""
    step = points[edges[:, 1]] - points[edges[:, 0]]
    ahead = np.degrees(np.arctan2(step[:, 1], step[:, 0]))
    return edges.T.ravel(), np.tile(owner, 2), np.concatenate([ahead % 360, (ahead + 180) % 360])


def _neighbours(at: Ints, owner: Ints, heading: Floats) -> list[tuple[int, int, float, int]]:
    """Ends next to each other round a point: both owners, the angle between them [degree], the point."""
    order = np.lexsort([heading, at])
    at, owner, heading = at[order], owner[order], heading[order]
    begins = np.flatnonzero(np.append(True, at[1:] != at[:-1])) if len(at) else np.zeros(0, dtype=np.int64)
    following = np.arange(1, len(at) + 1)
    following[np.append(begins[1:], len(at)) - 1 if len(at) else begins] = begins
    angle = (heading[following] - heading) % 360
    rows = np.flatnonzero((angle < SHALLOW) & (following != np.arange(len(at))))
    columns = (owner[rows], owner[following[rows]], angle[rows], at[rows])
    return list(zip(*(column.tolist() for column in columns), strict=True))


def _inside(lines: PlanarGraph, domain: Floats, labels: _Labels) -> tuple[PlanarGraph, list[str]]:
    """Only the edges in or on the domain, and what was cut; raises InputError for a trace of which nothing is left."""
    middle = lines.points[lines.edges].mean(axis=1)
    is_out = ~is_within(middle, domain) & ~_is_repeat_of_side(lines)
    gone = np.setdiff1d(lines.owner, lines.owner[~is_out])
    if len(gone):
        others = ", ".join(f'"{labels.traces[trace]}"' for trace in gone[1:9]) + (", ..." if len(gone) > 9 else "")
        more = f" (and {len(gone) - 1} more: {others})" if others else ""
        raise InputError(f"geometry: {labels(gone[0])}: lies outside the domain{more}; move or remove it")
    notes = []
    on_side, of_trace = np.isin(np.arange(len(lines.points)), lines.edges[lines.owner < 0]), RowsOf(lines.owner, is_out)
    for trace in np.unique(lines.owner[is_out]).tolist():
        edges = lines.edges[of_trace(trace)]
        met = edges[on_side[edges]]
        met = met[np.sort(np.unique(met, return_index=True)[1])]  # in the order along the trace
        length = np.linalg.norm(np.diff(lines.points[edges], axis=1), axis=2).sum()
        where = ", ".join(place_text(place, extent_of(lines.points)) for place in lines.points[met])
        notes.append(
            note(f"{labels(trace)}: cut at {where}, where it leaves the domain; {length:.4g}{labels.unit} is left out")
        )
    return replace(lines, edges=lines.edges[~is_out], owner=lines.owner[~is_out]), notes


def _is_repeat_of_side(lines: PlanarGraph) -> np.ndarray:
    """Whether each edge joins the ends of an edge of a side: as all edges of sides do."""
    key = np.sort(lines.edges, axis=1) @ [len(lines.points), 1]
    return np.isin(key, key[lines.owner < 0])


def _without_repeats(
    lines: PlanarGraph, labels: _Labels, stretch: float, shallow: set[tuple[int, int]]
) -> tuple[PlanarGraph, list[str]]:
    """Each edge once, a side's or that of the first trace, and what was shared; raises InputError for long stretches."""
    ends = np.sort(lines.edges, axis=1)
    order = np.lexsort([np.where(lines.owner < 0, -1, lines.owner), ends[:, 1], ends[:, 0]])
    is_again = np.all(ends[order[1:]] == ends[order[:-1]], axis=1)
    first, again = order[:-1][is_again], order[1:][is_again]
    length = np.linalg.norm(np.diff(lines.points[lines.edges], axis=1)[:, 0], axis=1)
    notes, owners = [], RowsOf(lines.owner)
    for keeper, other in sorted(set(zip(lines.owner[first].tolist(), lines.owner[again].tolist(), strict=True))):
        rows = again[(lines.owner[first] == keeper) & (lines.owner[again] == other)]
        shared, place = length[rows].sum(), lines.points[lines.edges[rows]].reshape(-1, 2)
        where = " to ".join(place_text(place[row], extent_of(lines.points)) for row in (0, -1))
        whole = min(length[owners(owner)].sum() if owner >= 0 else np.inf for owner in (keeper, other))
        limit = np.inf if (min(keeper, other), max(keeper, other)) in shallow else stretch
        if shared > min(limit, 0.5 * whole):
            if keeper == other:
                raise InputError(f"geometry: {labels(other)}: folds back on itself from {where}; remove a point")
            raise InputError(
                f"geometry: {labels(other)}: runs along {labels(keeper)} for {shared:.4g}{labels.unit}, from {where}, nearer"
                f" than geometry.snap; {'remove one' if keeper >= 0 else 'move it inside'}, or lower snap"
            )
        if keeper != other:
            line = (
                f"{labels(other)}: shares {shared:.4g}{labels.unit} from {where} with {labels(keeper)}, which keeps it"
            )
            notes.append(note(line))
    kept = np.setdiff1d(np.arange(len(ends)), again)
    return replace(lines, edges=lines.edges[kept], owner=lines.owner[kept]), notes


def _moves(lines: PlanarGraph, given: PlanarGraph, labels: _Labels, least: float) -> list[str]:
    """Say which ends, bends and crossings moved, how far and onto what."""
    at, of, extent = lines.edges.ravel(), np.repeat(lines.owner, 2), extent_of(lines.points)
    moved = np.linalg.norm(lines.points[lines.became] - lines.first, axis=1)
    came_with = np.full(len(lines.points), -1)
    came_with[given.edges.ravel()] = np.repeat(given.owner, 2)
    is_end = np.bincount(given.edges.ravel(), minlength=len(lines.points)) == 1
    notes, ends_at = [], RowsOf(at)
    for point in np.flatnonzero((moved > least) & np.isin(lines.became, at)).tolist():
        here = lines.became[point]
        others = np.setdiff1d(of[ends_at(here)], [came_with[point]])
        if point < lines.given:
            what = f"{labels(came_with[point])}: {'end' if is_end[point] else 'point'}"
            onto = f" onto {labels.all_of(others)}" if len(others) else ""
        else:
            what, onto = f"{labels.all_of(others)}: crossing", ""
        before, after = (place_text(each, extent) for each in (lines.first[point], lines.points[here]))
        notes.append(note(f"{what} {before} moved by {moved[point]:.3g}{labels.unit} to {after}{onto}"))
    for point, trace, distance in zip(*(part.tolist() for part in lines.bends), strict=True):
        if distance > least and len(ends_at(point)):
            place = place_text(lines.points[point], extent)
            notes.append(note(f"{labels(trace)}: bent by {distance:.3g}{labels.unit} to {place}"))
    return notes


def _check_angles(network: TraceNetwork, labels: _Labels) -> None:
    """Raise InputError for edges that meet at less than a cell can have."""
    found = _neighbours(*_ends_at(network.points, network.edges, network.owner))
    for one, other, angle, point in found:
        if angle < LEAST_ANGLE:
            where = place_text(network.points[point], extent_of(network.points))
            raise InputError(
                f"geometry: {labels(one)} and {labels(other)} meet at {where} at {angle:.2g}"
                f" degrees; the least that can be meshed is {LEAST_ANGLE:g}: turn or join them"
            )
