"""Prescribed displacements of supports and pressures, each unknown by the first that names it; and where two differ."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import chain, combinations
from typing import Any

import numpy as np

from fracflow._petsc import MPI
from fracflow.errors import InputError
from fracflow.mesh.blocks import Blocks, SolidBlock, owner_of
from fracflow.mesh.data import Bools, Floats, Ints
from fracflow.mesh.places import place_text
from fracflow.mesh.slices.directory import Route
from fracflow.model.solid import summed_at_nodes
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

    def speed_over(self, begin: float, dt: float, now: float | Floats) -> float | Floats:
        """Mean velocity (n,) over a step that begins where they are ``now``; over one that ends there, of a ``dt`` below 0."""
        return (self.value(begin + dt) - now) / dt

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
    nodes = nodes_on(block, name, points)
    if nodes is None:
        known = ", ".join([*block.sides, *block.rocks, *points])
        raise InputError(f'support: on = "{name}": no such side, rock or point (the mesh has: {known})')
    turning = block.body[nodes] >= 0
    if blocks.comm.allreduce(int(turning.any())):
        raise InputError(f'support: on = "{name}": lies on a rigid rock; support the rock itself, by its name')
    given = [part for part in support.components if part != "rotation"]
    if "rotation" in support.components and support.displacement and "rotation" in support.displacement:
        raise InputError(f'support: on = "{name}": only a rigid rock has a rotation')
    return {part: (block.unknown[nodes, AXES.index(part)], block.points[nodes]) for part in given}


def nodes_on(block: SolidBlock, name: str, points: Mapping[str, Ints]) -> Ints | None:
    """Local nodes (n,) of this rank's facets of a side, cells of a rock, or a point; None where the mesh has no such name.

    points  split nodes (n,) of each named point
    """
    if name in block.sides:
        return np.unique(block.side_facets[block.side_of == block.sides.index(name)])
    if name in block.rocks:
        nodes = np.unique(block.cells[block.cell_rock == block.rocks.index(name)])
        return nodes[nodes >= 0]
    return np.flatnonzero(np.isin(block.node_ids, points[name])) if name in points else None


def own(starts: Ints, rank: int, everywhere: Ints) -> Ints:
    """Local numbers (m,) of the numbers (n,) that a rank owns, each once."""
    mine = np.unique(everywhere)
    return mine[owner_of(starts, mine) == rank] - starts[rank]


def prescribe(
    starts: Ints, comm: MPI.Comm, found: tuple[Ints, Floats], taken: Ints, value: Callable[..., Any]
) -> tuple[PrescribedValues, Ints]:
    """Unknowns of this rank among numbers (n,) found anywhere, but for those ``taken`` before; and those taken now. Collective.

    taken  of those of this rank, at least
    value  of time, of what was found with each number (n, k), and of what is ``around`` that time
    """
    to_owners = Route(comm, owner_of(starts, found[0]))
    numbers, data = (to_owners.send(each) for each in found)
    mine, first = np.unique(numbers, return_index=True)
    is_new = np.isin(mine, taken, invert=True)  # where two supports meet, the first one holds
    held = PrescribedValues(mine[is_new] - starts[comm.rank], _AtPlaces(value, data[first[is_new]]))
    return held, np.union1d(taken, mine)


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


def meeting_supports(scene: Scene, blocks: Blocks, points: Mapping[str, Ints]) -> list[str]:
    """A line for each two supports that move a node in two ways, of which the first holds. Rigid rocks are left out.

    points  split nodes (n,) of each named point
    Collective; every rank has the lines.
    """
    supports, comm, lines = scene.support, blocks.comm, []
    pairs = [(i, k) for i, k in combinations(range(len(supports)), 2) if _may_differ(supports[i], supports[k])]
    held = {each: _own_nodes_on(scene, blocks, points, supports[each].on) for each in sorted({*chain(*pairs)})}
    for one, other in pairs:
        places = blocks.solid.points[np.intersect1d(held[one], held[other])]
        apart = np.array([_apart(comm, places, supports[one], supports[other], part) for part in AXES[:2]])
        where = places[apart.any(axis=0)]
        first = where[np.lexsort(where.T[::-1])[:2]]  # by place: numbers depend on how a mesh is read
        are_apart, counts, firsts = zip(*comm.allgather((apart.any(axis=1), len(where), first)), strict=True)
        count, named = sum(counts), sorted(tuple(place) for each in firsts for place in each)[:2]
        if count:
            found = [part for part, is_so in zip(AXES, np.any(are_apart, axis=0), strict=False) if is_so]
            extent = _extent(blocks)
            at = ", ".join(place_text(place, extent) for place in named)
            more = f" and {count - 2} more" if count > 2 else ""
            lines.append(
                f"support.{other} ({', '.join(supports[other].on)}) prescribes another displacement in"
                f" {' and '.join(found)} than support.{one} ({', '.join(supports[one].on)}) at nodes of both,"
                f" {at}{more}: there the first entry holds; put the one that shall hold first"
            )
    return lines


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


def _may_differ(one: Support, other: Support) -> bool:
    """Whether two supports prescribe motions along one axis that are not the same."""
    shared = (part for part in AXES[:2] if part in one.components and part in other.components)
    return any(motion(one, part) != motion(other, part) for part in shared)


def _own_nodes_on(scene: Scene, blocks: Blocks, points: Mapping[str, Ints], names: Iterable[str]) -> Ints:
    """Nodes (n,) that this rank owns on sides, points, and rocks that are not rigid, ascending. Collective.

    Another rank may have the facet or the cell that a node is on.
    """
    asked = [name for name in names if name not in scene.rock or not scene.rock[name].rigid]
    found = [nodes for name in asked if (nodes := nodes_on(blocks.solid, name, points)) is not None]
    nodes = np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *found]))
    flags = summed_at_nodes(blocks, nodes, np.ones((len(nodes), 1)))
    return np.flatnonzero(flags[: blocks.solid.owned, 0] > 0.0)


def _apart(comm: MPI.Comm, places: Floats, one: Support, other: Support, part: str) -> Bools:
    """Which nodes (n,) at places (n, dim) two supports move in two ways at any time, along one axis. Collective."""
    is_apart = np.zeros(len(places), dtype=bool)
    if part not in one.components or part not in other.components:
        return is_apart
    times = sorted({0.0, *_times(one), *_times(other)})

    def moved(time: float) -> Floats:
        return np.stack(
            [np.broadcast_to(motion(each, part)(time, places, AT_ONCE), len(places)) for each in (one, other)]
        )

    largest = np.array([np.abs(moved(time)).max(initial=0.0) for time in times])
    comm.Allreduce(MPI.IN_PLACE, largest, MPI.MAX)
    for time, size in zip(times, largest, strict=True):
        is_apart |= np.abs(np.subtract(*moved(time))) > APART * size
    return is_apart


def _extent(blocks: Blocks) -> float:
    """``extent_of`` all nodes. Collective."""
    signed = np.concatenate([blocks.solid.points, -blocks.solid.points], axis=1).max(axis=0, initial=-np.inf)
    blocks.comm.Allreduce(MPI.IN_PLACE, signed, MPI.MAX)
    return float(np.add(*np.split(signed, 2)).max())


def _times(support: Support) -> Iterator[float]:
    tables: list[TimeTable] = list((support.displacement or {}).values())
    tables += [entry for row in support.displacement_gradient or () for entry in row]
    for table in tables:
        yield from table.times
