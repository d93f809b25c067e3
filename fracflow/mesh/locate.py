"""Nodes of wells, probes, point supports and ties of a scene; runs on rank 0, which has the mesh whole."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NoReturn

import numpy as np

from fracflow.elements.shape import shape_at
from fracflow.errors import InputError
from fracflow.mesh.data import Bools, Floats, Ints, SplitMesh, is_unmeshed
from fracflow.mesh.graph import components
from fracflow.mesh.places import extent_of, place_text

PLACE_ROUND_OFF = 1e-6  # of the mesh's extent
BESIDE, BESIDE_OF_EXTENT = 0.1, 1e-3  # of a joint and of the mesh: nearer to it a place is as good as on it
At = Sequence[float] | Floats | str | tuple[str, str]
"""Coordinates, the name of a point, or (fracture, "start" | "end")."""


@dataclass(frozen=True)
class FracturePlace:
    """A flow node and the joint ends that meet there, or a point between the two ends of a joint.

    flow     number of the flow node; of a point, that of the nearer end
    point    (dim,) coordinates [length]
    nodes    split nodes (bottom, top) of the first joint end
    joints   (k,) joints that end there; of a point, its joint twice
    ends     (k,) which end of each, 0 or 1
    within   both ends of the joint of a point, each a place of its own; none at a node
    shares   (2.1) the shape functions of the joint at the point
    """

    flow: int
    point: Floats
    nodes: tuple[int, int]
    joints: Ints
    ends: Ints
    within: tuple[FracturePlace, ...] = ()
    shares: tuple[float, ...] = ()

    @property
    def stands_on(self) -> tuple[int, ...]:
        """Nodes of the split mesh that a probe there looks at."""
        return tuple(node for place in self.within or (self,) for node in place.nodes)


@dataclass(frozen=True)
class RockPlace:
    """A node of the rock and the cells around it, or a point inside a cell.

    node     its number in the split mesh; of a point, the nearest corner of its cell
    point    (dim,) coordinates [length]
    cells    (k,) cells that have the node, of the rock that is meant; of a point, those of all corners, its own the first
    corners  (k, w) their nodes, -1 pads
    within   corners of the cell of a point, each a place of its own; none at a node
    shares   (2.1) the shape functions of the cell at the point
    """

    node: int
    point: Floats
    cells: Ints
    corners: Ints
    within: tuple[RockPlace, ...] = ()
    shares: tuple[float, ...] = ()

    @property
    def stands_on(self) -> tuple[int, ...]:
        """Nodes of the split mesh that a probe there looks at."""
        return tuple(place.node for place in self.within) or (self.node,)


def coordinates(mesh: SplitMesh, at: At, what: str) -> Floats:
    """Coordinates (dim,) that ``at`` stands for. Raises InputError naming ``what``."""
    if isinstance(at, str):
        if at not in mesh.named_points:
            known = ", ".join(sorted(mesh.named_points)) or "none"
            raise InputError(f'{what}: at = "{at}": the mesh has no point of that name (it has: {known})')
        return mesh.points[mesh.named_points[at]]
    if isinstance(at, tuple) and isinstance(at[0], str):
        return mesh.points[fracture_end(mesh, at[0], str(at[1]), what)]
    return np.asarray(at, dtype=float)


def fracture_end(mesh: SplitMesh, fracture: str, end: str, what: str) -> int:
    """Raw node where a trace starts or ends. Raises InputError for a closed or branching trace."""
    if fracture not in mesh.fractures:
        raise InputError(f'{what}: fracture = "{fracture}": no such fracture (there are: {", ".join(mesh.fractures)})')
    nodes = mesh.origin[mesh.joint_bottom[mesh.joint_fracture == mesh.fractures.index(fracture)]]
    here, there = (0, 1) if end == "start" else (1, 0)
    ends = np.setdiff1d(nodes[:, here], nodes[:, there])
    if len(ends) != 1:
        places = ", ".join("[{:.6g}, {:.6g}]".format(*mesh.points[node, :2]) for node in ends[:5]) or "none"
        raise InputError(f'{what}: fracture "{fracture}" has {len(ends)} {end}s; give coordinates instead ({places})')
    return int(ends[0])


def on_fracture(mesh: SplitMesh, at: At, what: str, fracture: str | None = None, unit: str = "") -> FracturePlace:
    """The flow node nearest to ``at``. Raises InputError, with ``unit`` behind lengths, if it is farther than its joint's."""
    point, chosen = coordinates(mesh, at, what), _joints_of(mesh, what, fracture)
    raw = mesh.origin[mesh.joint_bottom]
    candidates = np.unique(raw[chosen])
    distance = np.linalg.norm(mesh.points[candidates] - point, axis=1)
    node = int(candidates[np.argmin(distance)])
    joints, ends = np.nonzero((raw == node) & chosen[:, None])
    longest = max(_length(mesh, joint) for joint in joints.tolist())
    if distance.min() > longest:
        _refuse_far(what, point, f"{distance.min():.3g}{unit}", fracture)
    nodes = (int(mesh.joint_bottom[joints[0], ends[0]]), int(mesh.joint_top[joints[0], ends[0]]))
    return FracturePlace(int(mesh.joint_flow[joints[0], ends[0]]), mesh.points[node], nodes, joints, ends)


def _joints_of(mesh: SplitMesh, what: str, fracture: str | None) -> Bools:
    """Which joints are of a fracture, or all. Raises InputError where there are none."""
    if not len(mesh.flow_origin):
        raise InputError(f"{what}: the mesh has no fractures")
    if fracture is None:
        return np.ones(len(mesh.joint_flow), dtype=bool)
    if fracture not in mesh.fractures:
        raise InputError(f'{what}: on = "{fracture}": no such fracture (there are: {", ".join(mesh.fractures)})')
    return np.asarray(mesh.joint_fracture == mesh.fractures.index(fracture))


def _length(mesh: SplitMesh, joint: int) -> float:
    return float(np.linalg.norm(np.subtract(*mesh.points[mesh.joint_bottom[joint, :2]])))


def _refuse_far(what: str, point: Floats, distance: str, fracture: str | None) -> NoReturn:
    found = "the nearest fracture" if fracture is None else f'fracture "{fracture}"'
    raise InputError(
        f"{what}: at = {point.tolist()}: {found} is {distance} away; move it onto {'one' if fracture is None else 'that'}"
    )


def refuse_cut_off(mesh: SplitMesh, trace: Floats, point: Floats, what: str, fracture: str, unit: str = "") -> None:
    """Raise InputError, naming ``what``, for a point (2,) on the part of a trace that a side of the domain cuts off.

    trace  (k, 2) corners of the fracture as it was drawn
    """
    joints = np.flatnonzero(_joints_of(mesh, what, fracture))
    away = np.linalg.norm(mesh.points[mesh.joint_bottom[joints]] - point, axis=2)
    row, end = np.unravel_index(np.argmin(away), away.shape)
    size = _length(mesh, int(joints[row]))
    if away.min() > size >= _to_trace(trace, point):
        here, there = (
            place_text(each, extent_of(mesh.points))
            for each in (point, mesh.points[mesh.joint_bottom[joints[row], end]])
        )
        raise InputError(
            f'{what}: at {here}{unit}: lies outside the domain, at whose side fracture "{fracture}" ends, at {there}{unit}:'
            " give a place before that, or a geometry.domain that has both"
        )


def _to_trace(trace: Floats, point: Floats) -> float:
    """Distance of a point (2,) from a trace with corners (k, 2)."""
    along, to = np.diff(trace, axis=0), point - trace[:-1]
    share = np.clip((to * along).sum(axis=1) / (along**2).sum(axis=1), 0.0, 1.0)
    return float(np.linalg.norm(to - share[:, None] * along, axis=1).min())


def along_fracture(mesh: SplitMesh, at: At, what: str, fracture: str | None = None, unit: str = "") -> FracturePlace:
    """The point of the traces nearest to ``at``, between two nodes or at one.

    Raises InputError, with ``unit`` behind lengths, if it is farther than the length of its joint.
    """
    point, chosen = coordinates(mesh, at, what), np.flatnonzero(_joints_of(mesh, what, fracture))
    along, distance = _feet(mesh, point, chosen)
    nearest = int(np.argmin(distance))
    joint, shares = int(chosen[nearest]), np.array([1.0 - along[nearest], along[nearest]])
    if distance[nearest] > _length(mesh, joint):
        _refuse_far(what, point, f"{distance[nearest]:.3g}{unit}", fracture)
    foot = shares @ mesh.points[mesh.joint_bottom[joint]]
    end = int(np.argmax(shares))
    corner = mesh.points[mesh.joint_bottom[joint, end]]
    if np.linalg.norm(foot - corner) <= PLACE_ROUND_OFF * np.ptp(mesh.points, axis=0).max():
        return on_fracture(mesh, corner, what, fracture, unit)
    within = tuple(_joint_end(mesh, joint, each) for each in (0, 1))
    joints, ends = np.array([joint, joint]), np.array([0, 1])
    return FracturePlace(within[end].flow, foot, within[end].nodes, joints, ends, within, tuple(shares.tolist()))


def beside(mesh: SplitMesh, joints: Ints, point: Floats) -> float:
    """Distance of a point (dim,) from the nearest of joints (n,) that it was moved onto; 0 where it is as good as on one."""
    off = float(_feet(mesh, point, joints)[1].min(initial=np.inf))
    longest = max((_length(mesh, joint) for joint in joints.tolist()), default=0.0)
    near = max(BESIDE * longest, BESIDE_OF_EXTENT * float(np.ptp(mesh.points, axis=0).max()))
    return off if near < off < np.inf else 0.0


def _joint_end(mesh: SplitMesh, joint: int, end: int) -> FracturePlace:
    nodes = int(mesh.joint_bottom[joint, end]), int(mesh.joint_top[joint, end])
    flow = int(mesh.joint_flow[joint, end])
    return FracturePlace(flow, mesh.points[nodes[0]], nodes, np.array([joint]), np.array([end]))


def point_along(mesh: SplitMesh, fracture: str, distance: float, what: str, unit: str = "") -> Floats:
    """The point (dim,) of a fracture at a ``distance`` from its start [length]. Raises InputError where it has none."""
    chosen = _joints_of(mesh, what, fracture)
    along, ends = mesh.joint_along[chosen], mesh.points[mesh.joint_bottom[chosen]]
    low, high = along.min(axis=1), along.max(axis=1)
    if distance > high.max() * (1.0 + PLACE_ROUND_OFF):
        raise InputError(
            f'{what}: at = {distance:.6g}{unit}: fracture "{fracture}" is {high.max():.6g}{unit} long; give less'
        )
    found = int(np.argmin(np.maximum(low - distance, distance - high)))
    share = np.clip((distance - along[found, 0]) / (along[found, 1] - along[found, 0]), 0.0, 1.0)
    result: Floats = ends[found, 0] + share * (ends[found, 1] - ends[found, 0])
    return result


def covering(points: Floats, cells: Ints, point: Floats) -> int | None:
    """The one of counter-clockwise cells (m, k) that a point (dim,) lies in, up to round-off; None where there is none."""
    found, depth = all_covering(points, cells, point, float(np.ptp(points, axis=0).max()))
    return int(found[np.argmax(depth)]) if len(found) else None


def all_covering(points: Floats, cells: Ints, point: Floats, extent: float) -> tuple[Ints, Floats]:
    """All such cells (n,) of a mesh of an ``extent``, and how deep (n,) the point lies in each [length**2]."""
    corners = points[np.where(cells < 0, cells[:, :1], cells)]
    sides = np.roll(corners, -1, axis=1) - corners
    away = point - corners
    turn = sides[..., 0] * away[..., 1] - sides[..., 1] * away[..., 0]
    inside = np.all(turn >= -PLACE_ROUND_OFF * extent * np.linalg.norm(sides, axis=2), axis=1)
    found = np.flatnonzero(inside)
    return found, turn[found].min(axis=1)


def in_rock(mesh: SplitMesh, at: At, what: str, rock: str | None = None) -> RockPlace:
    """The node or the point inside a cell at ``at``, of the named rock where one is given. Raises InputError outside it."""
    point = coordinates(mesh, at, what)
    if is_unmeshed(mesh.cells):
        return RockPlace(0, point, np.zeros(1, dtype=np.int64), mesh.cells[:1])
    chosen = np.ones(len(mesh.cells), dtype=bool) if rock is None else mesh.cell_rock == mesh.rocks.index(rock)
    cell = covering(mesh.points, mesh.cells[chosen], point)
    if cell is None:
        inside = "the mesh" if rock is None else f'rock "{rock}"'
        raise InputError(f"{what}: at = {point.tolist()}: is outside {inside}; move it in")
    nodes = np.unique(mesh.cells[chosen])
    nodes = nodes[nodes >= 0]
    away = np.linalg.norm(mesh.points[nodes] - point, axis=1)
    if away.min() <= PLACE_ROUND_OFF * np.ptp(mesh.points, axis=0).max():
        return _at_node(mesh, int(nodes[np.argmin(away)]), chosen)
    return _in_cell(mesh, int(np.flatnonzero(chosen)[cell]), point)


def _at_node(mesh: SplitMesh, node: int, chosen: Bools) -> RockPlace:
    around = np.flatnonzero((mesh.cells == node).any(axis=1) & chosen)
    return RockPlace(node, mesh.points[node], around, mesh.cells[around])


def _in_cell(mesh: SplitMesh, cell: int, point: Floats) -> RockPlace:
    """A point inside a cell; of cells around its corners count those of the same rock."""
    nodes = mesh.cells[cell][mesh.cells[cell] >= 0]
    within = tuple(_at_node(mesh, int(node), mesh.cell_rock == mesh.cell_rock[cell]) for node in nodes)
    others = np.setdiff1d(np.concatenate([corner.cells for corner in within]), cell)
    cells = np.append(cell, others)
    nearest = int(nodes[np.argmin(np.linalg.norm(mesh.points[nodes] - point, axis=1))])
    shares = shape_at(mesh.points[nodes], point)
    return RockPlace(nearest, point, cells, mesh.cells[cells], within, tuple(shares.tolist()))


def _feet(mesh: SplitMesh, point: Floats, joints: Ints | slice) -> tuple[Floats, Floats]:
    """Where joints (n,) are nearest to a point: the place on each, from 0 to 1, and its distance [length]."""
    start, end = mesh.points[mesh.joint_bottom[joints]].swapaxes(0, 1)
    step = end - start
    along = np.clip(np.sum((point - start) * step, axis=1) / np.sum(step**2, axis=1), 0.0, 1.0)
    return along, np.linalg.norm(start + along[:, None] * step - point, axis=1)


def probe_place(mesh: SplitMesh, at: At, what: str, on: str | None = None, unit: str = "") -> FracturePlace | RockPlace:
    """A probe sits on a fracture if ``on`` names one, or if it lies on one; else in the rock. Raises InputError."""
    if on is not None and on in mesh.fractures:
        return along_fracture(mesh, at, what, on, unit)
    if on is not None and on not in mesh.rocks:
        fractures, rocks = (", ".join(names) for names in (mesh.fractures, mesh.rocks))
        raise InputError(f'{what}: on = "{on}": neither a fracture ({fractures}) nor a rock ({rocks})')
    if on is None and len(mesh.flow_origin):
        extent = np.ptp(mesh.points, axis=0).max()
        if _feet(mesh, coordinates(mesh, at, what), slice(None))[1].min() <= 1e-9 * extent:
            return along_fracture(mesh, at, what, unit=unit)
    return in_rock(mesh, at, what, on)


NEAR = 1e-6  # of a side's extent: facets this near to each other, once shifted, face each other


def tied_nodes(mesh: SplitMesh, sides: Sequence[str]) -> Ints:
    """Pairs (m, 2) of split nodes that move alike on one side, or on two that face each other.

    Facets are matched by their middles, so that copies of a node at the end of a fracture find the copy on
    their own side of it. Raises InputError where two sides do not coincide by a translation.
    """
    chosen = [mesh.side_facets[mesh.side_of == mesh.sides.index(name)] for name in sides]
    if len(sides) == 1:
        nodes = np.unique(chosen[0])
        return np.stack([np.full(len(nodes) - 1, nodes[0]), nodes[1:]], axis=1)
    from scipy.spatial import cKDTree  # imports much

    ends = [mesh.points[facets] for facets in chosen]
    low, high = (np.array([part.min(axis=(0, 1)), part.max(axis=(0, 1))]) for part in ends)
    shift, extent = (high - low).mean(axis=0), float(np.ptp(low, axis=0).max())
    gap, partner = cKDTree(ends[1].mean(axis=1)).query(ends[0].mean(axis=1) + shift)
    meets = np.linalg.norm(ends[0][:, :, None] + shift - ends[1][partner][:, None], axis=-1)
    place = meets.argmin(axis=2)
    is_apart = (gap > NEAR * extent) | (meets.min(axis=2).max(axis=1) > NEAR * extent)
    if len(chosen[0]) != len(chosen[1]) or is_apart.any():
        raise InputError(
            f'tie: the sides "{sides[0]}" and "{sides[1]}" do not face each other: {len(chosen[0])} and {len(chosen[1])}'
            " facets, which no translation brings to coincide; mesh them alike"
        )
    pairs = np.stack([chosen[0], np.take_along_axis(chosen[1][partner], place, axis=1)], axis=-1)
    return np.unique(pairs.reshape(-1, 2), axis=0)


def representatives(pairs: Ints, count: int) -> Ints:
    """The lowest of all that are tied to each of ``count`` things, by pairs (m, 2); itself where it is not tied."""
    label = components(pairs[:, 0], pairs[:, 1], count)
    lowest = np.full(count, count, dtype=np.int64)
    np.minimum.at(lowest, label, np.arange(count))
    return lowest[label]
