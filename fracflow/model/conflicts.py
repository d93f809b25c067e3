"""Where two entries of a scene prescribe one unknown in two ways: supports that meet at a corner, wells at one node."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import combinations

import numpy as np

from fracflow.errors import InputError
from fracflow.mesh.data import Ints, SplitMesh
from fracflow.model.dirichlet import AXES, motion
from fracflow.scene.boundary import Support, Well
from fracflow.scene.scene import Scene
from fracflow.scene.time_table import AT_ONCE, TimeTable

APART = 1e-12  # of the largest motion there: less is round-off of its tables


def meeting_supports(scene: Scene, mesh: SplitMesh, points: Mapping[str, Ints]) -> Iterator[str]:
    """A line for each two supports that move a node in two ways, of which the first holds. Rigid rocks are left out.

    points  split nodes (n,) of each named point
    """
    nodes = [np.unique(np.concatenate([_nodes(scene, mesh, points, name) for name in s.on])) for s in scene.support]
    for one, other in combinations(range(len(scene.support)), 2):
        both = np.intersect1d(nodes[one], nodes[other])
        apart = {part: both[_apart(mesh, scene.support[one], scene.support[other], part, both)] for part in AXES[:2]}
        found = [part for part, where in apart.items() if len(where)]
        if found:
            where = np.unique(np.concatenate(list(apart.values())))
            at = ", ".join(f"({x:.6g}, {y:.6g})" for x, y in mesh.points[where[:2]])
            more = f" and {len(where) - 2} more" if len(where) > 2 else ""
            yield (
                f"support.{other} ({', '.join(scene.support[other].on)}) prescribes another displacement in"
                f" {' and '.join(found)} than support.{one} ({', '.join(scene.support[one].on)}) at nodes of both,"
                f" {at}{more}: there the first entry holds; put the one that shall hold first"
            )


def refuse_two_pressures(scene: Scene, wells: Mapping[str, tuple[int, ...]]) -> None:
    """Raise InputError where two wells prescribe pressures at one flow node, unless these are the same."""
    given = [well for well in scene.well if well.pressure is not None and well.name in wells]
    for one, other in combinations(given, 2):
        if not {*wells[one.name]}.isdisjoint(wells[other.name]) and not _alike(one, other):
            raise InputError(
                f"well.{other.name}: at: sits on the node of well.{one.name}, which prescribes another pressure there:"
                " move one of them, or leave it out"
            )


def _alike(one: Well, other: Well) -> bool:
    return one.pressure == other.pressure


def _nodes(scene: Scene, mesh: SplitMesh, points: Mapping[str, Ints], name: str) -> Ints:
    if name in mesh.sides:
        return np.unique(mesh.side_facets[mesh.side_of == mesh.sides.index(name)])
    if name in mesh.rocks and not scene.rock[name].rigid:
        nodes = np.unique(mesh.cells[mesh.cell_rock == mesh.rocks.index(name)])
        return nodes[nodes >= 0]
    return np.asarray(points.get(name, ()), dtype=np.int64)


def _apart(mesh: SplitMesh, one: Support, other: Support, part: str, nodes: Ints) -> np.ndarray:
    """Which nodes (n,) two supports move in two ways at any time, along one axis."""
    is_apart = np.zeros(len(nodes), dtype=bool)
    if part not in one.components or part not in other.components:
        return is_apart
    place = mesh.points[nodes]
    for time in sorted({0.0, *_times(one), *_times(other)}):
        first, second = (
            np.broadcast_to(motion(support, part)(time, place, AT_ONCE), len(nodes)) for support in (one, other)
        )
        largest = max(np.abs(first).max(initial=0.0), np.abs(second).max(initial=0.0))
        is_apart |= np.abs(first - second) > APART * largest
    return is_apart


def _times(support: Support) -> Iterator[float]:
    tables: list[TimeTable] = list((support.displacement or {}).values())
    tables += [entry for row in support.displacement_gradient or () for entry in row]
    for table in tables:
        yield from table.times
