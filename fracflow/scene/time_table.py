"""A value tabled over time, and how steps sample it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Around = tuple[float, float]
"""Lengths of the step that ends at a time and of the one that follows; 0 where a stage begins or ends, or time has no part."""
AT_ONCE: Around = (0.0, 0.0)
JUST_BEFORE: Around = (1e-200, 0.0)
"""Around a time at which only what comes before a jump counts; and only what comes after it."""
JUST_AFTER: Around = (0.0, 1e-200)

MOST_KEPT = 16  # numbers that a table has found last


@dataclass(frozen=True)
class TimeTable:
    """A value tabled over time; constant outside the table.

    times          ascending [time]; in a linear table two equal times are a jump
    values         one for each time
    interpolation  "linear", or "step": each value holds until the next time
    """

    times: tuple[float, ...]
    values: tuple[float, ...]
    interpolation: Literal["linear", "step"] = "linear"

    @staticmethod
    def constant(value: float) -> TimeTable:
        """Make a table that has one value for ever."""
        return TimeTable((0.0,), (value,))

    def plain(self) -> Any:
        """The table as a scene file has it: one that is constant as a number."""
        if self == TimeTable.constant(self.values[0]):
            return self.values[0]
        return {"time": list(self.times), "value": list(self.values), "interpolation": self.interpolation}

    def __call__(self, time: float, around: Around = AT_ONCE) -> float:
        """Sample the table; at a jump, within 1e-12 of its time, by default the mean of both sides."""
        if len(self.times) == 1:  # most supports, whose unknowns ask for it many times a step
            return float(self.values[0])
        return self._once(("at", time, *around), lambda: float(self.around(time, *around)[0]))

    def _once(self, asked: tuple[Any, ...], find: Callable[[], float]) -> float:
        """A number found by ``find``, which a step asks for several times."""
        if asked not in self._found:
            if len(self._found) == MOST_KEPT:
                self._found.clear()
            self._found[asked] = find()
        return self._found[asked]

    @cached_property
    def _found(self) -> dict[tuple[Any, ...], float]:
        return {}

    @cached_property
    def _arrays(self) -> tuple[Floats, Floats]:
        return np.array(self.times), np.array(self.values)

    @cached_property
    def jumps(self) -> tuple[Floats, Floats]:
        """Times (k,) and sizes (k,) of its jumps."""
        times, values = self._arrays
        found = np.diff(values)
        at = found != 0.0 if self.interpolation == "step" else (np.diff(times) == 0.0) & (found != 0.0)
        return times[1:][at], found[at]

    @cached_property
    def kinks(self) -> tuple[Floats, Floats]:
        """Times (k,) and sizes (k,) of the changes of its slope, jumps left out; two at one time add up."""
        times, values = np.array(self.times), np.array(self.values)
        length = np.diff(times)
        moves = length > 0.0
        if self.interpolation == "step" or not moves.any():
            return np.zeros(0), np.zeros(0)
        slopes = np.diff(values)[moves] / length[moves]
        return np.concatenate([times[:-1][moves], times[1:][moves]]), np.concatenate([slopes, -slopes])

    @property
    def steepest(self) -> float:
        """The largest rate at which it changes, up or down, jumps left out."""
        steps, sizes = np.diff(self.times), np.abs(np.diff(self.values))
        if self.interpolation == "step" or not np.any(steps > 0.0):
            return 0.0
        return float((sizes[steps > 0.0] / steps[steps > 0.0]).max())

    @property
    def spread(self) -> float:
        """Largest value less the smallest one."""
        return max(self.values) - min(self.values)

    def bends(self, share: float) -> dict[float, float]:
        """Times at which it leaves the straight line from one neighbour to the other, or jumps, by over a share of its spread.

        With how much of it that is. Beyond its ends it goes on as far as between the last two.
        """
        if self.spread == 0.0:
            return {}
        if self.interpolation == "step":
            at, off = self.jumps
        else:
            at, v = np.array(self.times, dtype=float), np.array(self.values, dtype=float)
            t = np.concatenate([[2 * at[0] - at[1]], at, [2 * at[-1] - at[-2]]])
            v = np.concatenate([v[:1], v, v[-1:]])
            length = t[2:] - t[:-2]
            along = np.divide(np.diff(t)[:-1], length, out=np.zeros_like(length), where=length > 0.0)
            off = v[1:-1] - v[:-2] - along * (v[2:] - v[:-2])
        sizes = np.abs(off) / self.spread
        return {float(time): float(size) for time, size in zip(at, sizes, strict=True) if size > share}

    def ramps(self, longest: float, share: float) -> list[tuple[float, float]]:
        """Begin and end of each rise or fall that takes no longer, and is over a share of its spread; jumps left out."""
        if self.interpolation == "step":
            return []
        steps, sizes = np.diff(self.times), np.abs(np.diff(self.values))
        found = np.flatnonzero((steps > 0.0) & (steps <= longest) & (sizes > share * self.spread))
        return [(float(self.times[k]), float(self.times[k + 1])) for k in found]

    def departs(self, begin: float, end: float) -> float:
        """How far the table leaves the straight line between its values at two times, over its spread, between them."""
        times = np.array(self.times)
        times = times[(times > begin) & (times < end)]
        if not len(times):
            return 0.0
        first, last = self.around([begin, end], *AT_ONCE)
        share = (times - begin) / (end - begin)
        return float(np.abs(self.around(times, *AT_ONCE) - first - share * (last - first)).max()) / (self.spread or 1.0)

    def around(self, time: Floats | Sequence[float] | float, before: float, after: float) -> Floats:
        """Sample the table at times (n,) of steps: ``before`` is the length of the step that ends there, ``after`` of the next.

        A jump enters with the share of [time - before/2, time + after/2] that comes after it. At the jump itself this
        is the mean of both sides in the midst of equal steps. It is the right side where a stage begins (before = 0),
        the left one where it ends, and the mean where both are 0. A sum over the steps, halves at both ends, is that of
        the table but for second order.
        """
        at_times: Floats = np.atleast_1d(np.asarray(time, dtype=float))
        times, values = self._arrays
        tolerance = 1e-12 * np.maximum(np.abs(at_times), max(abs(times[0]), abs(times[-1])))
        past = np.searchsorted(times, at_times - tolerance)  # the limit from the left
        result: Floats = values[np.maximum(past - 1, 0)]
        if self.interpolation == "linear" and len(times) > 1:
            inside = (past > 0) & (past < len(times))
            first, last = np.clip(past - 1, 0, None), np.clip(past, None, len(times) - 1)
            length = np.where(inside, times[last] - times[first], 1.0)
            share = np.where(inside, np.minimum((at_times - times[first]) / length, 1.0), 0.0)
            result = np.where(share < 1.0, result + share * (values[last] - values[first]), values[last])
        at, sizes = self.jumps
        width, slack = 0.5 * (before + after), float(tolerance.max(initial=0.0))
        first, last = at_times.min(initial=np.inf) - 0.5 * before, at_times.max(initial=-np.inf) + 0.5 * after
        near = (at >= first - slack) & (at <= last + slack)  # others come wholly before or after
        for jump, size in zip(at[near], sizes[near], strict=True):
            is_past = jump < at_times - tolerance
            is_here = ~is_past & (jump <= at_times + tolerance)
            share = np.clip((at_times + 0.5 * after - jump) / width, 0.0, 1.0) if width > 0.0 else 1.0 * is_past
            share = np.where(is_here, after / (before + after) if width > 0.0 else 0.5, share)
            result = result + size * (share - is_past)
        return result

    def sampled(self, times: Floats, before: float, after: float) -> Floats:
        """``around`` and ``bent`` at times (n,)."""
        found = self.around(times, before, after)
        if before > 0.0 and len(self.times) > 1:
            at = np.sort(self.kinks[0])
            for k in np.flatnonzero(np.searchsorted(at, times) > np.searchsorted(at, times - before)):
                found[k] += self._bent(float(times[k]), before, after)
        return found

    def mean(self, begin: float, end: float) -> float:
        """Its integral between two times over the time between them, to round-off; ``begin`` < ``end``."""
        return self._once(("mean", begin, end), lambda: self._mean(begin, end))

    def _mean(self, begin: float, end: float) -> float:
        times = np.array(self.times)
        knots = np.concatenate([[begin], np.unique(times[(times > begin) & (times < end)]), [end]])
        first, last = self.around(knots[:-1], *JUST_AFTER), self.around(knots[1:], *JUST_BEFORE)
        return float(np.diff(knots) @ (0.5 * (first + last))) / (end - begin)

    def bent(self, time: float, before: float, after: float) -> float:
        """The correction to ``around``, so that a sum over the steps, halves at both ends, is the integral to round-off.

        A change m of slope at s in a step from a to b leaves -m (s - a)(b - s)/2 beside the trapezoid's sum. Its end makes up
        for that, which counts (before + after)/2: nothing acts before its time.
        """
        if before <= 0.0 or len(self.times) == 1:
            return 0.0
        return self._once(("bent", time, before, after), lambda: self._bent(time, before, after))

    def _bent(self, time: float, before: float, after: float) -> float:
        at, sizes = self.kinks
        inside = np.clip(at - (time - before), 0.0, None) * np.clip(time - at, 0.0, None)
        return -float(sizes @ inside) / (before + after)


@dataclass(frozen=True)
class Rates:
    """How a step samples flow rates, and with inertia forces, so that what it takes up is what they bring.

    A factor ``now`` times the mean over the step, less ``last`` times that over the one before. A ``share`` of the
    value at the end, as ``around`` says, is added.
    begin      of the step [time]
    before     of the one before it [time]
    controls   load factors in the one before it
    through    mean rates in the one before it, by their names, of wells that a limit may have kept from their table
    of_forces  forces are sampled so too, and supports at once
    """

    now: float = 0.0
    last: float = 0.0
    share: float = 1.0
    around: Around = JUST_BEFORE
    begin: float = 0.0
    before: float = 0.0
    controls: Mapping[str, float] = field(default_factory=dict)
    through: Mapping[str, float] = field(default_factory=dict)
    of_forces: bool = False

    def of(
        self,
        value: Callable[[float], Any],
        time: float,
        control: str | None,
        controls: Mapping[str, float],
        well: str | None = None,
    ) -> float:
        """The rate of a table, times the load factor that is named, in a step to ``time``; a constant if it is no table."""
        factor = 1.0 if control is None else controls[control]
        if not isinstance(value, TimeTable):
            return factor * float(value(time))
        rate = 0.0
        if self.share:
            rate += self.share * factor * (value(time, self.around) + value.bent(time, *self.around))
        if self.now:
            rate += self.now * factor * value.mean(self.begin, time)
        if self.last:
            if well is not None and well in self.through:
                return rate - self.last * self.through[well]
            old = 1.0 if control is None else self.controls.get(control, factor)
            rate -= self.last * old * value.mean(self.before, self.begin)
        return rate
