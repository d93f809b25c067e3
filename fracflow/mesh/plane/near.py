"""Near misses: ends, bends and crossings of traces that stay apart from another trace or side by a few snaps."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from fracflow.mesh.data import Floats, Ints
from fracflow.mesh.places import extent_of, place_without_round_off
from fracflow.mesh.plane.planar_graph import near_edges
from fracflow.mesh.plane.traces import TraceNetwork

WITHIN = 5.0  # snaps
AROUND = 12.0  # distances along the network: what meets by a shorter way has met, at over 10 degrees
MOST = 20  # listed one by one
HEAD = "near misses: "  # of the line that counts them
LINE = "near miss: "  # of the line of each
NEAREST = 3  # reported before a run


@dataclass(frozen=True)
class NearMiss:
    """A point of a trace that stays apart from another trace or a side.

    kind      "end", "bend" or "crossing"; "end beyond" of one that goes beyond what it crosses
    owners    names of the fractures that the point is of
    point     where it is [length]
    other     the fracture or side that it misses
    place     the nearest point of that [length]
    distance  between both [length]
    snap      the ``geometry.snap`` that makes them one [length]
    unit      what messages write behind a length
    """

    kind: str
    owners: tuple[str, ...]
    point: tuple[float, float]
    other: str
    place: tuple[float, float]
    distance: float
    snap: float
    unit: str = ""

    @property
    def subject(self) -> str:
        """The fractures that the point is of, and what they miss."""
        return " and ".join([f'fracture "{name}"' for name in self.owners] + [self.other])

    def __str__(self) -> str:
        names = " and ".join(f'fracture "{name}"' for name in self.owners)
        kind, how = ("end", "beyond") if self.kind == "end beyond" else (self.kind, "short of")
        how = how if kind == "end" else "from"
        join = "takes it back" if how == "beyond" else "joins them"
        return (
            f"near miss: {names}: {kind} {_spot(self.point)} is {self.distance:.3g}{self.unit} {how} {self.other} at"
            f" {_spot(self.place)}; geometry.snap = {self.snap:g} {join}"
        )

    def as_record(self) -> dict[str, object]:
        """For JSON."""
        return {key: value for key, value in asdict(self).items() if key != "unit"}


def near_misses(
    network: TraceNetwork, traces: Sequence[str], sides: Sequence[str], snap: float, unit: str = ""
) -> list[NearMiss]:
    """Each point of a trace that stays within five ``snap`` of another trace or a side, the nearest first.

    Two parts of a network count where the path between them along the network is over twelve times their distance. Of a pair
    of traces only the nearest points of a place count. Ends that go beyond what they cross come last: they cost small cells.

    traces, sides  names, by the network's owners
    unit           what messages write behind a length
    """
    reach = WITHIN * snap
    points = _Points(network)
    found: list[NearMiss] = []
    taken: dict[tuple[int, int], list[Floats]] = {}
    extent = extent_of(network.points)
    label = [f'fracture "{name}"' for name in traces] + [f"side {name}" for name in reversed(sides)]
    for distance, point, owner, place in sorted(_apart(network, points, reach), key=lambda each: each[:3]):
        own, here = points.owners[point], network.points[point]
        pairs = [(min(each, owner), max(each, owner)) for each in own]
        if any(np.linalg.norm(here - other) <= 2.0 * reach for pair in pairs for other in taken.get(pair, [])):
            continue
        way = points.way(point, place, owner, AROUND * distance)
        kind = points.kind(point)
        if way <= AROUND * distance:
            if kind != "end" or owner in own or owner < 0:
                continue
            kind = "end beyond"
        for pair in pairs:
            taken.setdefault(pair, []).append(here)
        names = tuple(traces[each] for each in own)
        (x, y), (a, b) = (place_without_round_off(each, extent) for each in (here, place.point))
        found.append(NearMiss(kind, names, (x, y), label[owner], (a, b), distance, _up(distance), unit))
    return sorted(found, key=lambda miss: miss.kind == "end beyond")


def near_miss_lines(misses: Sequence[NearMiss]) -> list[str]:
    """How many near misses there are, a line for each, and one for how many more."""
    if not misses:
        return []
    more, beyond = len(misses) - MOST, sum(miss.kind == "end beyond" for miss in misses)
    counts = ((len(misses) - beyond, "do not meet"), (beyond, "go beyond what they cross"))
    what = " and ".join(f"{count} {how}" for count, how in counts if count)
    lines = [f"{HEAD}{what}, by no more than {WITHIN:g} times geometry.snap", *(str(miss) for miss in misses[:MOST])]
    farthest = max((miss.distance for miss in misses[MOST:]), default=0.0)
    return lines + ([f"near miss: {more} more, up to {farthest:.3g}{misses[0].unit} apart"] if more > 0 else [])


def near_ones(notes: Sequence[str]) -> list[str]:
    """Of the notes of a mesh how many near misses there are, and the nearest ones."""
    counted = [line for line in notes if line.startswith(HEAD)]
    return counted + [line for line in notes if line.startswith(LINE)][:NEAREST]


@dataclass(frozen=True)
class _Place:
    """A point on an edge, from its ends by ``to_ends`` [length]."""

    point: Floats
    ends: tuple[int, int]
    to_ends: tuple[float, float]


class _Points:
    """The points of a network with the traces that they are of, and the ways between them."""

    def __init__(self, network: TraceNetwork) -> None:
        from scipy import sparse  # imports much

        count = len(network.points)
        is_trace = network.owner >= 0
        self.owners: list[list[int]] = [[] for _ in range(count)]
        pairs = np.stack([network.edges[is_trace].ravel(), np.repeat(network.owner[is_trace], 2)], axis=1)
        for point, owner in np.unique(pairs, axis=0).tolist():
            self.owners[point].append(owner)
        self.degree = np.bincount(network.edges[is_trace].ravel(), minlength=count)
        self.is_on_side = np.isin(np.arange(count), network.edges[~is_trace])
        length = np.linalg.norm(np.diff(network.points[network.edges], axis=1)[:, 0], axis=1)

        def graph(rows: np.ndarray) -> sparse.csr_matrix:
            edges = network.edges[rows]
            return sparse.coo_matrix((length[rows], (edges[:, 0], edges[:, 1])), shape=(count, count)).tocsr()

        self._along_traces, self._along_all = graph(is_trace), graph(np.ones(len(length), dtype=bool))

    def kind(self, point: int) -> str:
        """Of a point of a trace."""
        if self.degree[point] == 1:
            return "end"
        return "bend" if self.degree[point] == 2 and len(self.owners[point]) == 1 else "crossing"

    def way(self, point: int, place: _Place, owner: int, limit: float) -> float:
        """Length of the way along the traces, to a side along sides too; inf where it is over ``limit``."""
        from scipy.sparse.csgraph import dijkstra

        graph = self._along_traces if owner >= 0 else self._along_all
        away = dijkstra(graph, directed=False, indices=point, limit=limit)
        return float(min(away[end] + rest for end, rest in zip(place.ends, place.to_ends, strict=True)))


def _apart(network: TraceNetwork, points: _Points, reach: float) -> Iterator[tuple[float, int, int, _Place]]:
    """Distance, point, owner and place of all that is within ``reach`` of a point of a trace, but for what ends in it."""
    from scipy.spatial import cKDTree

    chosen = np.flatnonzero(points.degree > 0)
    if not len(chosen):
        return
    found = near_edges(network.points, network.edges, chosen, reach)
    for point, edge, along, foot, distance in zip(*found, strict=True):
        owner = int(network.owner[edge])
        if owner >= 0 or not points.is_on_side[point]:
            ends = network.points[network.edges[edge]]
            whole = float(np.linalg.norm(ends[1] - ends[0]))
            one, other = network.edges[edge].tolist()
            place = _Place(foot, (one, other), (float(along) * whole, (1.0 - float(along)) * whole))
            yield float(distance), int(point), owner, place
    pairs: Ints = chosen[cKDTree(network.points[chosen]).query_pairs(reach, output_type="ndarray")].reshape(-1, 2)
    for pair in pairs.tolist():
        # An end is listed with the trace that it misses, not the other way round.
        one, other = sorted(pair, key=lambda each: (points.degree[each], each))
        distance = float(np.linalg.norm(network.points[one] - network.points[other]))
        place = _Place(network.points[other], (other, other), (0.0, 0.0))
        own = points.owners[one]
        for owner in [each for each in points.owners[other] if each not in own] or points.owners[other]:
            yield distance, one, owner, place


def _up(length: float) -> float:
    """A length of three digits, no shorter."""
    unit = 10.0 ** (np.floor(np.log10(length)) - 2.0)
    return float(f"{np.ceil(length / unit) * unit:.3g}")


def _spot(point: tuple[float, float]) -> str:
    return f"({point[0]:.6g}, {point[1]:.6g})"
