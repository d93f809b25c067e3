"""Loads, supports and waves at the ends of explicit steps ahead, in tables from which loops take steps in a row."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from fracflow.mesh.data import Floats
from fracflow.scene.time_table import AT_ONCE, Around, TimeTable
from fracflow.solve.request import StepRequest

if TYPE_CHECKING:  # a run without explicit steps has no need of them
    from fracflow.solve.leapfrog.nodes import Nodes

MOST_KEPT = 2.5e5  # numbers of a table: 2 MB


@dataclass(frozen=True)
class StepsAhead:
    """Equal steps up to the end of a request, ``count`` in all, of which some are done.

    controls  load factors where the request begins
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
        number = self.done + first + 1 + np.arange(some)
        return self.request.time - self.request.length * (self.count - number) / self.count

    def control(self, name: str, first: int, some: int) -> Floats:
        """Load factor (k,) at these ends, as ``request.on_the_way`` has it."""
        number, before, after = (
            self.done + first + 1 + np.arange(some),
            self.controls[name],
            self.request.controls[name],
        )
        return np.where(number == self.count, after, before + number / self.count * (after - before))

    def around(self, first: int, some: int) -> list[tuple[slice, Around]]:
        """Lengths of steps around these ends: the last one of all has another one behind it."""
        is_end = first + some == self.left
        found = [(slice(0, some - is_end), (self.dt, self.dt))]
        return [*found, (slice(some - 1, some), (self.dt, self.then))] if is_end else found


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
    times, begin = ahead.times(first, some), 0
    for part in nodes.loads.supports:
        columns = slice(begin, begin := begin + len(part.numbers))
        for table, weight in part.tables or ():
            if len(part.numbers) and any(table.values):
                for values, column in zip(found, _moved(table, times, ahead.around(first, some)), strict=True):
                    values[:, columns] += column[:, None] * weight
    return found


def _moved(table: TimeTable, times: Floats, around: list[tuple[slice, Around]]) -> list[Floats]:
    """Value, mean velocity and acceleration (k,) at times (k,), as ``model.dirichlet.PrescribedValues`` has them."""
    value, speed, acceleration = found = [np.zeros(len(times)) for _ in range(3)]
    value[:] = table.around(times, *AT_ONCE)
    if len(table.times) == 1:
        return found

    def at(shift: float) -> Floats:
        return table.around(times[rows] + shift, *AT_ONCE)

    for rows, (before, after) in around:
        speed[rows] = (at(0.5 * after) - at(-0.5 * before)) / (0.5 * before + 0.5 * after)
        if after > 0.0:
            change = (at(after) - value[rows]) / after - (value[rows] - at(-before)) / before
            acceleration[rows] = 2.0 * change / (before + after)
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
