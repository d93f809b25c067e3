"""Values that change along a fracture, and pressures prescribed along it and in time."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationInfo

from fracflow.scene.units import LENGTH, TIME, Annotation, Quantity, fault, list_schema, number_schema, table_schema

Floats = NDArray[np.float64]

QUICK = 0.01  # of all that a pressure changes by: more in a step is quick


@dataclass(frozen=True)
class Profile:
    """A value tabled along a fracture, linear between its rows, constant beyond them.

    along   ascending distances from the start of the trace [length]
    values  one for each
    """

    along: tuple[float, ...]
    values: tuple[float, ...]

    def __call__(self, along: Floats) -> Floats:
        """Sample at distances (n,) from the start of the trace."""
        return np.asarray(np.interp(along, self.along, self.values), dtype=float)

    def plain(self) -> dict[str, Any]:
        """The profile as a scene file has it."""
        return {"along": list(self.along), "value": list(self.values)}


def sample(value: float | Profile | None, along: Floats) -> Floats:
    """A number, or a profile, at distances (n,) from the start of the trace; NaN for None."""
    if isinstance(value, Profile):
        return value(along)
    return np.full(np.shape(along), np.nan if value is None else value)


@dataclass(frozen=True)
class Pressures:
    """A pressure p(s, t) along a fracture; linear between rows and columns, constant beyond them.

    along   distances from the start of the trace [length]
    times   [time]
    values  a row for each time, in it one for each distance [stress]
    """

    along: tuple[float, ...]
    times: tuple[float, ...]
    values: tuple[tuple[float, ...], ...]

    def __call__(self, along: Floats, time: float) -> Floats:
        """Sample at distances (n,) at one time."""
        after = min(max(bisect_right(self.times, time), 1), len(self.times) - 1) if len(self.times) > 1 else 0
        late = np.interp(along, self.along, self.values[after])
        if after == 0:
            return np.asarray(late)
        span = self.times[after] - self.times[after - 1]
        share = min(max((time - self.times[after - 1]) / span, 0.0), 1.0)
        return np.asarray((1.0 - share) * np.interp(along, self.along, self.values[after - 1]) + share * late)

    def plain(self) -> dict[str, Any]:
        """The pressures as a scene file has them."""
        return {"along": list(self.along), "time": list(self.times), "value": [list(row) for row in self.values]}

    def fastest(self, along: Floats) -> Floats:
        """Largest rate of change, up or down, at distances (n,) [stress/time]."""
        rates = np.zeros(np.shape(along))
        for (begin, end), (before, after) in zip(pairwise(self.times), pairwise(self.values), strict=True):
            change = np.interp(along, self.along, after) - np.interp(along, self.along, before)
            rates = np.maximum(rates, np.abs(change) / (end - begin))
        return rates

    def is_quick(self, time_step: float) -> bool:
        """Whether a step may bring about more than a hundredth of its whole change, from lowest to highest."""
        spread = max(map(max, self.values)) - min(map(min, self.values))
        return bool(np.any(self.fastest(np.array(self.along)) * time_step > QUICK * spread))


@dataclass(frozen=True)
class Along(Annotation):
    """Annotation of a value that may change along a fracture; ``quantity`` is what each value must be."""

    quantity: Quantity

    def read(self, value: object, info: ValidationInfo) -> float | Profile | None:
        """Read a number, a string with unit, or {along = [...], value = [...]}."""
        if value is None:
            return None
        if not isinstance(value, dict):
            return self.quantity.read(value, info)
        along, values = _columns(value, ("along", "value"), info)
        return Profile(along, tuple(self.quantity.read(each, info) for each in values))

    def schema(self) -> dict[str, Any]:
        """Describe the value for ``fracflow schema``."""
        value = self.quantity.schema()
        return {"anyOf": [value, table_schema({"along": _many(number_schema(LENGTH)), "value": _many(value)})]}


@dataclass(frozen=True)
class AlongInTime(Annotation):
    """Annotation of a pressure along a fracture and in time."""

    dimension: str

    def read(self, value: object, info: ValidationInfo) -> Pressures | None:
        """Read a number, [[t, p], ...], {along, value} or {along, time, value = [row for each time]}."""
        quantity = Quantity(self.dimension)
        if value is None:
            return None
        if isinstance(value, list) and value and all(isinstance(row, list) and len(row) == 2 for row in value):
            times = _ascending([row[0] for row in value], Quantity(TIME), "times", info)
            return Pressures((0.0,), times, tuple((quantity.read(row[1], info),) for row in value))
        if not isinstance(value, dict):
            return Pressures((0.0,), (0.0,), ((quantity.read(value, info),),))
        if "time" not in value:
            along, values = _columns(value, ("along", "value"), info)
            return Pressures(along, (0.0,), (tuple(quantity.read(each, info) for each in values),))
        if set(value) != {"along", "time", "value"} or not all(isinstance(part, list) for part in value.values()):
            raise fault("must have lists along, time and value")
        along = _ascending(value["along"], Quantity(LENGTH), "distances", info)
        times = _ascending(value["time"], Quantity(TIME), "times", info)
        rows = value["value"]
        if len(rows) != len(times) or not all(isinstance(row, list) and len(row) == len(along) for row in rows):
            raise fault("value must have a row for each time, and in it a pressure for each distance")
        return Pressures(along, times, tuple(tuple(quantity.read(each, info) for each in row) for row in rows))

    def schema(self) -> dict[str, Any]:
        """Describe the value for ``fracflow schema``."""
        value, along, time = number_schema(self.dimension), _many(number_schema(LENGTH)), number_schema(TIME)
        tables = (
            table_schema({"along": along, "value": _many(value)}),
            table_schema({"along": along, "time": _many(time), "value": _many(_many(value))}),
        )
        return {"anyOf": [value, _many(list_schema(time, value)), *tables]}


def _many(each: dict[str, Any]) -> dict[str, Any]:
    """JSON schema of a list of one entry or more."""
    return {"type": "array", "minItems": 1, "items": each}


def _columns(table: dict[str, Any], keys: tuple[str, str], info: ValidationInfo) -> tuple[tuple[float, ...], list[Any]]:
    along, values = (table.get(key) for key in keys)
    if set(table) == set(keys) and isinstance(along, list) and isinstance(values, list) and len(along) == len(values):
        return _ascending(along, Quantity(LENGTH), "distances", info), values
    raise fault("must be a number, or {along = [...], value = [...]} with lists of the same length")


def _ascending(rows: list[Any], quantity: Quantity, what: str, info: ValidationInfo) -> tuple[float, ...]:
    values = tuple(quantity.read(row, info) for row in rows)
    if not values or any(later <= earlier for earlier, later in pairwise(values)):
        raise fault(f"the {what} of a table must ascend")
    return values
