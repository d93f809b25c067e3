"""Loads, supports and waves at the ends of explicit steps ahead, in tables from which loops take steps in a row."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from fracflow.mesh.data import Floats
from fracflow.model.dirichlet import change_of_speed, mean_speed
from fracflow.scene.time_table import AT_ONCE, Around, TimeTable
from fracflow.solve.request import StepRequest, between, on_the_way

if TYPE_CHECKING:  # a run without explicit steps has no need of them
    from fracflow.solve.leapfrog.nodes import Nodes

MOST_KEPT = 2.5e5  # numbers of a table: 2 MB


@dataclass(frozen=True)
class StepsAhead:
    """Equal steps up to the end of a request, ``count`` in all, of which some are done.

    controls  load factors where the request begins; they change linearly over it
    then      length of the step that follows the request; 0 where the stage ends [time]
    """

    request: StepRequest
    controls: Mapping[str, float]
    count: int
    then: float
    done: int = 0

    @property
    def left(self) -> int:
        """How many are to be taken."""
        return self.count - self.done

    @property
    def dt(self) -> float:
        """Their length [time]."""
        return self.request.length / self.count

    def times(self, first: int, some: int) -> Floats:
        """Ends (k,) of some of those to be taken, from number ``first`` on."""
        return np.asarray(self._end(self._numbers(first, some)))

    def control(self, name: str, first: int, some: int) -> Floats:
        """Load factor (k,) at these ends."""
        share = self._numbers(first, some) / self.count
        return np.asarray(between(self.controls[name], self.request.controls[name], share))

    def _numbers(self, first: int, some: int) -> Floats:
        return self.done + first + 1.0 + np.arange(some)

    def _end(self, number: float | Floats) -> float | Floats:
        return self.request.time - self.request.length * (self.count - number) / self.count

    def _around(self, is_last: bool) -> Around:
        return self.dt, self.then if is_last else self.dt

    def around(self, first: int, some: int) -> list[tuple[slice, Around]]:
        """Lengths of steps around these ends: the last one of all has another one behind it."""
        is_end = first + some == self.left
        found = [(slice(0, some - is_end), self._around(is_last=False))]
        return [*found, (slice(some - 1, some), self._around(is_last=True))] if is_end else found

    @property
    def next_one(self) -> tuple[StepRequest, Around]:
        """The first of those to be taken, and lengths of the steps around its end."""
        number, around = self.done + 1, self._around(self.left == 1)
        controls = on_the_way(self.controls, self.request.controls, 0.0, number / self.count)
        time, (length, following) = float(self._end(number)), around
        return replace(self.request, time=time, length=length, controls=controls, next_length=following), around

    def after(self, taken: int) -> StepsAhead:
        """Those ahead once some are taken."""
        return replace(self, done=self.done + taken)


class SupportsAt(NamedTuple):
    """Supports (h,) at an instant, or (k, h) at some: displacement, and mean velocity and acceleration of the steps around."""

    at: Floats
    speed: Floats
    acceleration: Floats


def is_tabled(nodes: Nodes) -> bool:
    """Whether all supports of this rank are sums of tables over time."""
    known = [part for part in nodes.loads.supports if part.tables is not None]
    return sum(len(part.numbers) for part in known) == len(nodes.held)


def loads_at(nodes: Nodes, beside: Floats, ahead: StepsAhead, first: int, some: int) -> Floats:
    """Loads (k, m) at ``Nodes.changing`` at the ends of some steps, and what stays ``beside`` (m,) [force per thickness]."""
    if not nodes.changing.is_any:
        return np.zeros((some, 0))
    times, forces = ahead.times(first, some), nodes.changing.forces
    factors = np.ones((some, len(forces)))
    for column, pattern in enumerate(forces):
        for rows, around in ahead.around(first, some):
            if isinstance(pattern.value, TimeTable):
                factors[rows, column] = pattern.value.sampled(times[rows], *around)
            else:
                factors[rows, column] = [float(pattern.value(time)) for time in times[rows]]
        if pattern.control is not None:
            factors[:, column] *= ahead.control(pattern.control, first, some)
    return np.asarray(beside + factors @ nodes.changing.patterns)


def supports_at(nodes: Nodes, ahead: StepsAhead, first: int, some: int) -> SupportsAt:
    """Supports at the ends of some steps."""
    found = SupportsAt(*(np.zeros((some, len(nodes.held))) for _ in range(3)))
    if not len(nodes.held):
        return found
    times, sides, begin = ahead.times(first, some), ahead.around(first, some), 0
    for part in nodes.loads.supports:
        columns = slice(begin, begin := begin + len(part.numbers))
        for table, weight in part.tables or ():
            if not len(part.numbers) or not any(table.values):
                continue

            def at(time: float | Floats, table: TimeTable = table) -> Floats:
                return table.around(time, *AT_ONCE)

            for rows, around in sides:
                motion = at(times[rows]), mean_speed(at, times[rows], around), change_of_speed(at, times[rows], around)
                for values, each in zip(found, motion, strict=True):
                    values[rows, columns] += np.reshape(each, (-1, 1)) * weight
    return found


def waves_at(nodes: Nodes, ahead: StepsAhead, first: int, some: int) -> tuple[Floats, dict[str, Floats]]:
    """Forces (k, terms, o) of waves at ``Nodes.own`` at the ends of some steps, and powers (k,) by terms. Collective."""
    names, powers = list(nodes.dashpots), dict[str, Floats]()
    forces = np.zeros((some if nodes.waves else 0, len(names), len(nodes.own)))
    if not nodes.waves:
        return forces, powers
    times, force = ahead.times(first, some), nodes.operators.layout.solid_vector()
    for term in nodes.waves:
        brought, of_term = np.zeros(some), forces[:, names.index(term.name)]
        for rows, around in ahead.around(first, some):
            for k in range(rows.start, rows.stop):
                force.set(0.0)
                power = term.incoming(float(times[k]), around, force)
                assert power is not None
                of_term[k], brought[k] = force.getArray(readonly=True)[nodes.own], power
        powers[term.name] = brought
    force.destroy()
    return forces, powers
