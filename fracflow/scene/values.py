"""Values that change in time, tractions made of them, and places on the mesh, as a scene writes them."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any, ClassVar, Literal

from pydantic import ValidationInfo
from pydantic_core import PydanticCustomError

from fracflow.scene.time_table import TimeTable
from fracflow.scene.units import (
    LENGTH,
    PLAIN,
    STRESS,
    TIME,
    Annotation,
    Quantity,
    example,
    fault,
    list_schema,
    number_schema,
    system_of,
    table_schema,
    what_fits,
)

POINT = list_schema(number_schema(LENGTH), number_schema(LENGTH))
"""JSON schema of [x, y]."""


@dataclass(frozen=True)
class FractureEnd:
    """The start or the end of a fracture trace."""

    fracture: str
    end: Literal["start", "end"]

    def plain(self) -> dict[str, str]:
        """The place as a scene file has it."""
        return asdict(self)


@dataclass(frozen=True)
class AlongFracture:
    """A point of a fracture trace, at a distance from its start [length], or at a fraction of its length."""

    fracture: str
    distance: float | None
    fraction: float | None = None

    def plain(self) -> dict[str, Any]:
        """The place as a scene file has it."""
        place = {"fraction": self.fraction} if self.distance is None else {"at": self.distance}
        return {"fracture": self.fracture, **place}


Position = tuple[float, float] | str | FractureEnd | AlongFracture


@dataclass(frozen=True)
class Tabled(Annotation):
    """Annotation of a value that may change in time; ``word`` is a name that may stand in its place."""

    dimension: str = PLAIN
    word: str | None = None

    def read(self, value: object, info: ValidationInfo) -> TimeTable | str:
        """Read a number, a string with unit, [[t, v], ...] or {time, value, interpolation}."""
        if self.word is not None and value == self.word:
            return self.word
        if isinstance(value, dict):
            return self._from_columns(value, info)
        if isinstance(value, list):
            wrong = [n for n, row in enumerate(value) if not (isinstance(row, list) and len(row) == 2)]
            if wrong:
                raise fault(f"row {wrong[0] + 1} is no pair [time, value]; {self._fits(info)}")
            return self._table([row[0] for row in value], [row[1] for row in value], "linear", info)
        if isinstance(value, bool) or not isinstance(value, int | float | str):
            raise fault(self._fits(info))
        try:
            return TimeTable.constant(Quantity(self.dimension).read(value, info))
        except PydanticCustomError as error:
            if isinstance(value, str) and value.lstrip().startswith(("[", "(", "{")):
                raise fault(f"is text, or a bracket or comma is missing; {self._fits(info)}") from None
            or_word = f', or "{self.word}"' if self.word and isinstance(value, str) else ""
            raise fault(f"{error}{or_word}") from None

    def _fits(self, info: ValidationInfo) -> str:
        word = f', or "{self.word}"' if self.word else ""
        table = f"[[t, v], ...] such as [[0, 0], [10, {self._one(info)}]], or {{time = [...], value = [...]}}"
        return f"must be {what_fits(self.dimension, system_of(info))}, or a time table {table}{word}"

    def _one(self, info: ValidationInfo) -> str:
        """A value as an example, in the units of the scene."""
        system = system_of(info)
        has_units = self.dimension != PLAIN and system is not None and system.name != "none"
        return f'"{example(self.dimension)}"' if has_units else "1"

    def _from_columns(self, value: dict[str, Any], info: ValidationInfo) -> TimeTable:
        unknown = sorted(set(value) - {"time", "value", "interpolation"})
        if unknown:
            raise fault(f'unknown key "{unknown[0]}" in a time table; allowed: time, value, interpolation')
        times, values = value.get("time"), value.get("value")
        if not isinstance(times, list) or not isinstance(values, list) or len(times) != len(values):
            counts = (f"{len(part) if isinstance(part, list) else 'no list'}" for part in (times, values))
            what = "a time table needs lists time and value of the same length, here {} and {}".format(*counts)
            raise fault(f"{what}; such as {{time = [0, 10], value = [0, {self._one(info)}]}}")
        interpolation = value.get("interpolation", "linear")
        if interpolation not in ("linear", "step"):
            raise fault(f'interpolation = "{interpolation}" is unknown; allowed: "linear", "step"')
        return self._table(times, values, interpolation, info)

    def _table(
        self, times: list[Any], values: list[Any], interpolation: Literal["linear", "step"], info: ValidationInfo
    ) -> TimeTable:
        if not times:
            raise fault(f"a time table needs at least one row; {self._fits(info)}")
        t = self._column("time", TIME, times, info)
        v = self._column("value", self.dimension, values, info)
        fallen = [f"{later:g} after {earlier:g}" for earlier, later in pairwise(t) if later < earlier]
        if fallen:
            raise fault(f"the times of a table must ascend, here {fallen[0]}")
        thrice = [f"{first:g}" for first, third in zip(t, t[2:], strict=False) if third == first]
        if thrice:
            raise fault(f"a time may stand at most twice in a table (a jump), not {thrice[0]}; remove a row")
        if interpolation == "step" and len(set(t)) < len(t):
            raise fault("the times of a step table must differ; a step needs no second row")
        return TimeTable(t, v, interpolation)

    def _column(self, name: str, dimension: str, column: list[Any], info: ValidationInfo) -> tuple[float, ...]:
        found = list[float]()
        for entry in column:
            try:
                found.append(Quantity(dimension).read(entry, info))
            except PydanticCustomError as error:
                raise fault(f"row {len(found) + 1} of the table [[t, v], ...], its {name}: {error}") from None
        return tuple(found)

    def schema(self) -> dict[str, Any]:
        """Describe the value for ``fracflow schema``."""
        time, value = number_schema(TIME), number_schema(self.dimension)
        rows = {"type": "array", "minItems": 1, "items": list_schema(time, value)}
        keys = {"time": {"type": "array", "items": time}, "value": {"type": "array", "items": value}}
        columns = table_schema({**keys, "interpolation": {"enum": ["linear", "step"]}}, "interpolation")
        words = [{"const": self.word}] if self.word else []
        return {"anyOf": [value, rows, columns, *words]}


@dataclass(frozen=True)
class TabledVector(Annotation):
    """Annotation of a vector [x, y] of values that may change in time, or one word, if not empty, in its place."""

    EXAMPLE: ClassVar[str] = "[[[0, 0], [10, 1]], 0]"
    dimension: str
    word: str = ""

    def read(self, value: object, info: ValidationInfo) -> tuple[TimeTable, TimeTable] | str:
        """Read ``[x, y]`` or the word."""
        if self.word and value == self.word:
            return self.word
        if not isinstance(value, list) or len(value) != 2:
            or_word = f', or "{self.word}"' if self.word else ""
            raise fault(f"must be [x, y], each a number or a time table, such as {self.EXAMPLE}{or_word}")
        found = []
        for name, part in zip("xy", value, strict=True):
            try:
                found.append(Tabled(self.dimension).read(part, info))
            except PydanticCustomError as error:
                raise fault(f"its {name}: {error}; [x, y] with a time table is such as {self.EXAMPLE}") from None
        x, y = found
        assert isinstance(x, TimeTable) and isinstance(y, TimeTable)
        return x, y

    def schema(self) -> dict[str, Any]:
        """Describe the value for ``fracflow schema``."""
        part = Tabled(self.dimension).schema()
        vector = list_schema(part, part) | {"dimension": self.dimension}
        return {"anyOf": [vector, {"const": self.word}]} if self.word else vector


@dataclass(frozen=True)
class Components(Annotation):
    """Annotation of values by their components, of so many names and dimensions: a table over time for each that is given."""

    parts: tuple[tuple[str, str], ...]

    def read(self, value: object, info: ValidationInfo) -> dict[str, TimeTable]:
        """Read ``{x = ..., y = ...}``."""
        known = dict(self.parts)
        if not isinstance(value, dict) or not value or not set(value) <= set(known):
            *some, last = known
            raise fault(f"must be a table of {', '.join(some)} or {last}, such as {{{some[-1]} = [[0, 0], [1, 2]]}}")
        tables: dict[str, TimeTable] = {}
        for part, given in value.items():
            table = Tabled(known[part]).read(given, info)
            assert isinstance(table, TimeTable)
            tables[part] = table
        return tables

    def schema(self) -> dict[str, Any]:
        """Describe the value for ``fracflow schema``."""
        keys = {part: Tabled(dimension).schema() for part, dimension in self.parts}
        return table_schema(keys, *keys) | {"minProperties": 1}


DISPLACED = Components((("x", LENGTH), ("y", LENGTH), ("rotation", PLAIN)))
STRESSED = Components((("xx", STRESS), ("yy", STRESS), ("xy", STRESS)))


@dataclass(frozen=True)
class At(Annotation):
    """Annotation of a place: coordinates, a point named in the mesh, an end of a fracture, or a point along it."""

    def read(self, value: object, info: ValidationInfo) -> Position:
        """Read ``[x, y]``, ``"name"`` or ``{fracture = "name", end = "start"}``, or with ``at`` or ``fraction`` for end."""
        if isinstance(value, str) and value:
            return value
        if isinstance(value, list) and len(value) == 2:
            return Quantity(LENGTH).read(value[0], info), Quantity(LENGTH).read(value[1], info)
        if isinstance(value, dict) and set(value) == {"fracture", "end"} and isinstance(value["fracture"], str):
            if value["end"] not in ("start", "end"):
                raise fault(f'end = "{value["end"]}" is unknown; allowed: "start", "end"')
            return FractureEnd(value["fracture"], value["end"])
        if isinstance(value, dict) and set(value) == {"fracture", "at"} and isinstance(value["fracture"], str):
            return AlongFracture(value["fracture"], Quantity(LENGTH, at_least=0.0).read(value["at"], info))
        if isinstance(value, dict) and set(value) == {"fracture", "fraction"} and isinstance(value["fracture"], str):
            share = Quantity(at_least=0.0, at_most=1.0).read(value["fraction"], info)
            return AlongFracture(value["fracture"], None, share)
        raise fault(
            'must be [x, y], the name of a point, or {fracture = "name", end = "start" or "end"}; for end may stand at = the'
            " distance from its start, or fraction = 0 to 1 of its length"
        )

    def schema(self) -> dict[str, Any]:
        """Describe the value for ``fracflow schema``."""
        fracture = {"fracture": {"type": "string"}}
        end, at = {"enum": ["start", "end"]}, Quantity(LENGTH, at_least=0.0).schema()
        fraction = Quantity(at_least=0.0, at_most=1.0).schema()
        along = [
            table_schema({**fracture, key: one}) for key, one in (("end", end), ("at", at), ("fraction", fraction))
        ]
        return {"anyOf": [POINT | {"dimension": LENGTH}, {"type": "string", "minLength": 1}, *along]}


@dataclass(frozen=True)
class Domain(Annotation):
    """Annotation of the outline of the rock: a rectangle or a polygon; or a word for rock that has none."""

    word: str

    def read(self, value: object, info: ValidationInfo) -> tuple[tuple[float, float], ...] | str:
        """Read ``[xmin, ymin, xmax, ymax]`` or ``[[x, y], ...]`` as the corners, or the word."""
        if value == self.word:
            return self.word
        if isinstance(value, list) and len(value) == 4 and not any(isinstance(part, list) for part in value):
            left, bottom, right, top = (Quantity(LENGTH).read(part, info) for part in value)
            if left >= right or bottom >= top:
                raise fault("must be [xmin, ymin, xmax, ymax] with xmin < xmax and ymin < ymax")
            return (left, bottom), (right, bottom), (right, top), (left, top)
        if isinstance(value, list) and len(value) >= 3 and any(isinstance(part, list) for part in value):
            return read_points(value, info)
        raise fault(f'must be [xmin, ymin, xmax, ymax] or at least three points [x, y], or "{self.word}"')

    def schema(self) -> dict[str, Any]:
        """Describe the value for ``fracflow schema``."""
        corners = {"type": "array", "minItems": 3, "items": POINT}
        polygon = {"type": "array", "anyOf": [list_schema(*[number_schema(LENGTH)] * 4), corners]}
        return {"dimension": LENGTH, "anyOf": [polygon, {"const": self.word}]}


@dataclass(frozen=True)
class Polyline(Annotation):
    """Annotation of the points of a trace."""

    def read(self, value: object, info: ValidationInfo) -> tuple[tuple[float, float], ...]:
        """Read ``[[x, y], ...]``, two points or more, no two in a row the same."""
        if not isinstance(value, list) or len(value) < 2:
            raise fault("must be at least two points [x, y]")
        points = read_points(value, info)
        if any(here == there for here, there in pairwise(points)):
            raise fault("two points in a row are the same; remove one")
        return points

    def schema(self) -> dict[str, Any]:
        """Describe the value for ``fracflow schema``."""
        return {"type": "array", "minItems": 2, "dimension": LENGTH, "items": POINT}


def read_points(value: list[Any], info: ValidationInfo) -> tuple[tuple[float, float], ...]:
    """Read ``[[x, y], ...]``."""
    if not all(isinstance(point, list) and len(point) == 2 for point in value):
        raise fault("must be a list of points [x, y]")
    return tuple((Quantity(LENGTH).read(x, info), Quantity(LENGTH).read(y, info)) for x, y in value)
