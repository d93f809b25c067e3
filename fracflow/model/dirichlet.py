"""Prescribed displacements of supports and pressures, each unknown by the first that names it; and where two differ."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from fracflow._petsc import MPI
from fracflow.errors import InputError
from fracflow.mesh.blocks import Blocks, owner_of
from fracflow.mesh.data import Floats, Ints, SplitMesh
from fracflow.mesh.places import extent_of, place_text
from fracflow.scene.boundary import Support
from fracflow.scene.scene import Scene
from fracflow.scene.time_table import AT_ONCE, Around, TimeTable

Values = Callable[..., "float | Floats"]
"""(time, around = AT_ONCE) -> one value or one for each; ``around`` selects the side of a jump that counts."""
Tables = tuple[tuple[TimeTable, float | Floats], ...]
AXES = ("x", "y", "z")
APART = 1e-12  # of the largest motion there: less is round-off of its tables


@dataclass(frozen=True)
class PrescribedValues:
    """Unknowns of this rank (local numbers) that follow a function of time, one value for all or one for each.

    well  whose pressure it is, if that is a well's
    """

    numbers: Ints
    value: Values
    well: str = ""

    @property
    def tables(self) -> Tables | None:
        """Tables over time and their weights, one or (n,), of which it is the sum; None where it is another function."""
        if isinstance(self.value, TimeTable):
            return ((self.value, 1.0),)
        return self.value.tables if isinstance(self.value, _AtPlaces) else None

    def speed(self, time: float, around: Around) -> float | Floats:
        """Mean velocity (n,) over the halves of the steps ``around`` a time; does not ring at jumps, as Newmark's would."""
        return mean_speed(self.value, time, around)

    def first_speed(self, time: float, dt: float, now: Floats) -> Floats:
        """That (n,) over the first half of a stage's first step, from where they are ``now``: a jump there is part of it."""
        return (self.value(time + 0.5 * dt) - now) / (0.5 * dt)

    def acceleration(self, time: float, around: Around) -> float | Floats:
        """Change (n,) of the mean velocity from the step before a time to that after; none where a stage begins or ends."""
        return change_of_speed(self.value, time, around)


def mean_speed(value: Values, time: float | Floats, around: Around) -> float | Floats:
    """``PrescribedValues.speed`` of a function of time, or of many times (k,) at once."""
    before, after = 0.5 * around[0], 0.5 * around[1]
    return (value(time + after) - value(time - before)) / (before + after)


def change_of_speed(value: Values, time: float | Floats, around: Around) -> float | Floats:
    """``PrescribedValues.acceleration`` of a function of time, or of many times (k,) at once."""
    before, after = around
    if before == 0.0 or after == 0.0:
        return 0.0
    here = value(time)
    change = (value(time + after) - here) / after - (here - value(time - before)) / before
    return 2.0 * change / (before + after)


def supported(
    blocks: Blocks, support: Support, name: str, points: Mapping[str, Ints]
) -> dict[str, tuple[Ints, Floats]]:
    """Unknowns (n,) of each supported component on a side, a rock or a point, of this rank's part, and their places (n, dim).

    Raises InputError, on every rank.
    """
    block, dim = blocks.solid, blocks.sizes.dim
    if name in block.rocks and len(block.body_rock) and np.any(block.body_rock == block.rocks.index(name)):
        bodies = np.flatnonzero(block.body_rock == block.rocks.index(name))
        column, centres = (*AXES[:dim], "rotation"), block.body_center[bodies]
        return {part: (block.body_unknown[bodies, column.index(part)], centres) for part in support.components}
    if name in block.sides:
        nodes = np.unique(block.side_facets[block.side_of == block.sides.index(name)])
    elif name in block.rocks:
        nodes = np.unique(block.cells[block.cell_rock == block.rocks.index(name)])
        nodes = nodes[nodes >= 0]
    elif name in points:
        nodes = np.flatnonzero(np.isin(block.node_ids, points[name]))
    else:
        known = ", ".join([*block.sides, *block.rocks, *points])
        raise InputError(f'support: on = "{name}": no such side, rock or point (the mesh has: {known})')
    turning = block.body[nodes] >= 0
    if blocks.comm.allreduce(int(turning.any())):
        raise InputError(f'support: on = "{name}": lies on a rigid rock; support the rock itself, by its name')
    given = [part for part in support.components if part != "rotation"]
    if "rotation" in support.components and support.displacement and "rotation" in support.displacement:
        raise InputError(f'support: on = "{name}": only a rigid rock has a rotation')
    return {part: (block.unknown[nodes, AXES.index(part)], block.points[nodes]) for part in given}


def own(starts: Ints, rank: int, everywhere: Ints) -> Ints:
    """Local numbers (m,) of the numbers (n,) that a rank owns, each once."""
    mine = np.unique(everywhere)
    return mine[owner_of(starts, mine) == rank] - starts[rank]


def prescribe(
    starts: Ints, comm: MPI.Comm, found: tuple[Ints, Floats], taken: Ints, value: Callable[..., Any]
) -> tuple[PrescribedValues, Ints]:
    """Unknowns of this rank among numbers (n,) found anywhere, but for those taken before; and all taken now. Collective.

    value  of time, of what was found with each number (n, k), and of what is ``around`` that time
    """
    numbers, data = (np.concatenate(parts) for parts in zip(*comm.allgather(found), strict=True))
    everywhere, first = np.unique(numbers, return_index=True)
    is_new = np.isin(everywhere, taken, invert=True)  # where two supports meet, the first one holds
    here = is_new & (owner_of(starts, everywhere) == comm.rank)
    with_it = data[first[here]]
    numbers, taken = everywhere[here] - starts[comm.rank], np.union1d(taken, everywhere)
    return PrescribedValues(numbers, _AtPlaces(value, with_it)), taken


@dataclass(frozen=True)
class SupportMotion:
    """Displacement of a supported component over time, and its gradient along each axis, if any."""

    base: TimeTable
    gradient: tuple[TimeTable, ...] = ()

    def __call__(self, time: float, place: Floats, around: Around) -> float | Floats:
        """At places (n, dim), jumps as ``TimeTable.around`` has them."""
        if not self.gradient:
            return self.base(time, around)
        slope = np.array([entry(time, around) for entry in self.gradient])
        found: Floats = self.base(time, around) + place @ slope
        return found


@dataclass(frozen=True, eq=False)
class _AtPlaces:
    """A function of time, of data that stay, places (n, dim) for one, and of what is ``around`` the time."""

    function: Callable[..., Any]
    data: Any

    def __call__(self, time: float, around: Around = AT_ONCE) -> float | Floats:
        found: float | Floats = self.function(time, self.data, around)
        return found

    @property
    def tables(self) -> Tables | None:
        """See ``PrescribedValues``."""
        if not isinstance(self.function, SupportMotion):
            return None
        slopes = zip(self.function.gradient, np.transpose(self.data), strict=False)
        return ((self.function.base, 1.0), *slopes)


def motion(support: Support, part: str) -> SupportMotion:
    """Displacement of a supported component."""
    base = (support.displacement or {}).get(part, TimeTable.constant(0.0))
    if support.displacement_gradient is None or part not in AXES:
        return SupportMotion(base)
    return SupportMotion(base, tuple(support.displacement_gradient[AXES.index(part)]))


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
            at = ", ".join(place_text(place, extent_of(mesh.points)) for place in mesh.points[where[:2]])
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
        if not {*wells[one.name]}.isdisjoint(wells[other.name]) and one.pressure != other.pressure:
            raise InputError(
                f"well.{other.name}: at: sits on the node of well.{one.name}, which prescribes another pressure there:"
                " move one of them, or leave it out"
            )


def overruled_rates(scene: Scene, wells: Mapping[str, tuple[int, ...]]) -> Iterator[str]:
    """A line for each well whose flow_rate goes into a node at which another well keeps the pressure."""
    for rate in scene.well:
        for kept in scene.well:
            is_so = rate.flow_rate is not None and kept.pressure is not None and {rate.name, kept.name} <= wells.keys()
            if is_so and not {*wells[rate.name]}.isdisjoint(wells[kept.name]):
                yield (
                    f"well.{rate.name}: its flow_rate has no effect: it sits on a node of well.{kept.name}, which keeps"
                    " the pressure there and takes it all; move one of them, or leave it out"
                )


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
        moved = (motion(support, part)(time, place, AT_ONCE) for support in (one, other))
        first, second = (np.broadcast_to(each, len(nodes)) for each in moved)
        largest = max(np.abs(first).max(initial=0.0), np.abs(second).max(initial=0.0))
        is_apart |= np.abs(first - second) > APART * largest
    return is_apart


def _times(support: Support) -> Iterator[float]:
    tables: list[TimeTable] = list((support.displacement or {}).values())
    tables += [entry for row in support.displacement_gradient or () for entry in row]
    for table in tables:
        yield from table.times
