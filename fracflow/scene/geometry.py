"""Tables of traces: a CSV, or a map in GeoJSON, becomes entries of [[geometry.fracture]] and [fracture.NAME]."""

from __future__ import annotations

import csv
import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from fracflow.errors import InputError
from fracflow.scene.materials import Fracture
from fracflow.scene.messages import nearest, one_line
from fracflow.scene.method import ALTERNATIVES, with_default_fracture
from fracflow.scene.toml import LARGEST, write_value
from fracflow.scene.units import HUGE, UnitSystem
from fracflow.storage.files import PLAIN_TEXT, read_text

POINT, SEGMENT = ("x", "y"), ("x1", "y1", "x2", "y2")
PROPERTIES = tuple(Fracture.model_fields)
MOST_TRACES = 100_000


@dataclass(frozen=True)
class TraceRow:
    """A fracture of a table.

    name        its name
    points      [[x, y], ...] from its start to its end [length]
    properties  keys of [fracture.NAME] and their values, as the table has them
    line        where it begins in the file: its line, or of a map its feature
    part        the word for that
    """

    name: str
    points: list[list[float]]
    properties: dict[str, Any]
    line: int
    part: str = "line"


def read_traces(path: str | Path) -> list[TraceRow]:
    """Read traces from a table, or from a map where the name of the file ends in .geojson. Raises InputError."""
    return (read_traces_geojson if Path(path).suffix.lower() == ".geojson" else read_traces_csv)(path)


def read_traces_geojson(path: str | Path) -> list[TraceRow]:
    """Read traces from the features of a map, a LineString each, or a MultiLineString of which each part is one.

    The property ``name`` names a fracture; without it, it is "trace" and the number of the feature. Later parts have a number
    behind the name. Properties named as the keys of [fracture.NAME] are its values, and others are passed over. So are heights.
    Raises InputError naming file and feature.
    """
    path = Path(path)
    text = read_text(path, "geometry.fractures_csv names a map, from the scene's folder", LARGEST)
    try:
        found = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: {error}; give a map in GeoJSON") from None
    features = found.get("features") if isinstance(found, dict) else None
    if not isinstance(features, list) or not features:
        raise InputError(f"{path}: has no features; give a FeatureCollection with at least one trace")
    traces: dict[str, TraceRow] = {}
    for number, feature in enumerate(features, 1):
        for row in _of_feature(feature, number, f"{path}: feature {number}"):
            if row.name in traces:
                raise InputError(f'{path}: feature {number}: "{row.name}" was given before; choose another name')
            if len(traces) == MOST_TRACES:
                raise InputError(f"{path}: feature {number}: more than {MOST_TRACES} fractures; leave out the shortest")
            traces[row.name] = row
    return list(traces.values())


def _of_feature(feature: Any, number: int, where: str) -> Iterator[TraceRow]:
    """The traces of a feature."""
    shape = feature.get("geometry") if isinstance(feature, dict) else None
    kind, lines = (shape.get("type"), shape.get("coordinates")) if isinstance(shape, dict) else (None, None)
    if kind == "LineString":
        lines = [lines]
    elif kind != "MultiLineString":
        raise InputError(
            f"{where}: its geometry is {write_value(kind) if kind else 'empty'}; a trace must be a LineString"
        )
    given = feature.get("properties")
    given = given if isinstance(given, dict) else {}
    name = given.get("name")
    name = f"trace {number}" if name is None or name == "" else str(name)
    properties = {}
    for key in PROPERTIES:
        if (value := given.get(key)) is not None and value != "":
            if isinstance(value, bool) or not isinstance(value, int | float | str):
                raise InputError(f"{where}: {key}: must be a number, or a text with a unit")
            properties[key] = value if isinstance(value, str) else _number(str(value), key, where)
    for part, line in enumerate(lines if isinstance(lines, list) else [None], 1):
        if not isinstance(line, list) or len(line) < 2:
            raise InputError(f"{where}: has fewer than two points; a trace needs two or more")
        points: list[list[float]] = []
        for point in line:
            if not isinstance(point, list) or len(point) < 2:
                raise InputError(f"{where}: a point is no list of coordinates; give [x, y]")
            x, y = (_number(str(each), key, where) for each, key in zip(point[:2], POINT, strict=True))
            if not points:
                points.append([x, y])
            else:
                _extend(points, [x, y], f'{where}: "{name}"')
        yield TraceRow(name if part == 1 else f"{name} {part}", points, properties, number, "feature")


def read_traces_csv(path: str | Path) -> list[TraceRow]:
    """Read traces from a table with the columns name and x, y (a row a point) or x1, y1, x2, y2 (a row a segment).

    Columns may stand in any order. Further ones are named as the keys of [fracture.NAME], and hold numbers or text with
    a unit. An empty field gives nothing. The delimiter is a comma, a semicolon or a tab. Rows of one name follow each
    other along the trace, and segments of one name must join. A property of a fracture stands in its first row or is
    the same in all. Raises InputError naming file and line.
    """
    path = Path(path)
    rows = _rows(path)
    if not rows:
        raise InputError(f"{path}: is empty; its first line must name the columns, such as name,x,y")
    number, header = rows[0]
    columns = _columns(header, f"{path}: line {number}")
    layout = POINT if "x" in columns else SEGMENT
    traces: dict[str, TraceRow] = {}
    last = None
    for number, words in rows[1:]:
        where = f"{path}: line {number}"
        if len(words) != len(columns):
            named = f"the first line names {len(columns)} columns"
            raise InputError(f"{where}: has {len(words)} fields, {named}; give as many")
        row = dict(zip(columns, words, strict=True))
        name, values = row["name"], [_number(row[key], key, where) for key in layout]
        if not name:
            raise InputError(f"{where}: the name is empty; give each fracture one")
        given = {key: _value(row[key]) for key in columns if key in PROPERTIES and row[key]}
        if name not in traces:
            if len(traces) == MOST_TRACES:
                raise InputError(f"{where}: more than {MOST_TRACES} fractures; leave out the shortest")
            traces[name] = TraceRow(name, [values[:2]], given, number)
            values = values[2:]
        else:
            if name != last:
                raise InputError(f'{where}: "{name}" was given before; the rows of one fracture must follow each other')
            _go_on(traces[name], given, where)
        _extend(traces[name].points, values, f'{where}: "{name}"')
        last = name
    for name, trace in traces.items():
        if len(trace.points) < 2:
            raise InputError(f'{path}: line {trace.line}: fracture "{name}" has one point; a trace needs two or more')
    if not traces:
        raise InputError(f"{path}: has no rows below its first line; give at least one trace")
    return list(traces.values())


def with_traces(data: Mapping[str, Any], file: Path) -> dict[str, Any]:
    """Put the traces and properties of ``geometry.fractures_csv`` in its place in the data of a scene.

    A property goes over that of the fracture's own table, as that does over [fracture.default]. Raises InputError.
    """
    geometry = data.get("geometry")
    name = geometry.get("fractures_csv") if isinstance(geometry, Mapping) else None
    if not isinstance(geometry, Mapping) or not isinstance(name, str) or not re.fullmatch(PLAIN_TEXT, name):
        return dict(data)  # validation of the scene finds its faults
    path = Path(os.path.realpath(file.absolute().parent / name))  # of links in a circle too
    rows = read_traces(path)
    inside = {key: value for key, value in geometry.items() if key != "fractures_csv"}
    drawn = inside.get("fracture", [])
    tables = data.get("fracture", {})
    if not isinstance(drawn, Sequence) or not isinstance(tables, Mapping):
        return dict(data)  # which the scene then refuses
    known = {trace.get("name") for trace in drawn if isinstance(trace, Mapping)}
    more = {}
    for row in rows:
        if row.name in known or row.name == "default":
            why = "is drawn in [[geometry.fracture]] too" if row.name in known else "is kept for [fracture.default]"
            raise InputError(f'{path}: {row.part} {row.line}: name = "{row.name}": {why}; choose another name')
        if row.properties and isinstance(tables.get(row.name, {}), Mapping):  # the scene refuses what is no table
            more[row.name] = _table(row, tables, f"{path}: {row.part} {row.line}", data.get("units", "SI"))
    inside["fracture"] = [*drawn, *({"name": row.name, "points": row.points} for row in rows)]
    return {**data, "geometry": inside, **({"fracture": {**tables, **more}} if tables or more else {})}


def _table(row: TraceRow, tables: Mapping[str, Any], where: str, units: Any) -> dict[str, Any]:
    """The table of a fracture with the properties of its row; raises InputError if they do not fit it."""
    own: Mapping[str, Any] = tables.get(row.name, {})
    shut = {key for pair in ALTERNATIVES if set(pair) & set(row.properties) for key in pair}
    table = {key: value for key, value in own.items() if key not in shut} | row.properties
    given = {"fracture": {"default": tables.get("default"), row.name: table}}
    filled = with_default_fracture(given)["fracture"][row.name]
    try:
        Fracture.model_validate(filled, context={"units": UnitSystem.parse(units)})
    except ValidationError as error:
        raise InputError(f'{where}: "{row.name}": {one_line(error, filled, Fracture)}') from None
    except ValueError:
        pass  # units that are none: the scene says so
    return table


def _rows(path: Path) -> list[tuple[int, list[str]]]:
    """Line numbers and fields of the lines that are not empty."""
    text = read_text(path, "geometry.fractures_csv names a UTF-8 text file, from the scene's folder", LARGEST)
    head = next((line for line in text.splitlines() if line.strip()), "")
    reader = csv.reader(text.splitlines(), delimiter=max(",;\t", key=head.count), skipinitialspace=True, strict=True)
    rows = []
    try:
        for words in reader:
            if any(word.strip() for word in words):
                rows.append((reader.line_num, [word.strip() for word in words]))
    except csv.Error as error:
        raise InputError(f"{path}: line {reader.line_num}: {error}; give a plain table of text") from None
    return rows


def _columns(header: list[str], where: str) -> list[str]:
    columns = [word.lower() for word in header]
    for layout in (POINT, SEGMENT):
        allowed = ("name", *layout, *PROPERTIES)
        if not {"name", *layout} <= set(columns):
            continue
        for column in columns:
            if column not in allowed:
                raise InputError(f'{where}: unknown column "{column}"; {nearest(column, allowed)}')
            if columns.count(column) > 1:
                raise InputError(f'{where}: the column "{column}" stands twice; remove one')
        return columns
    raise InputError(f"{where}: the columns are {','.join(header)[:80]}; they must have name,x,y or name,x1,y1,x2,y2")


def _number(word: str, key: str, where: str) -> float:
    try:
        value = float(word)
    except ValueError:
        raise InputError(f'{where}: {key} = "{word}": is no number; decimals take a point') from None
    if not abs(value) <= HUGE:
        raise InputError(f"{where}: {key} = {word}: must be finite, and at most {HUGE:g}")
    return value


def _value(word: str) -> Any:
    """A number where the field is one, else its text."""
    try:
        return float(word)
    except ValueError:
        return word


def _go_on(trace: TraceRow, given: dict[str, Any], where: str) -> None:
    for key, value in given.items():
        if trace.properties.get(key) != value:
            first = write_value(trace.properties[key]) if key in trace.properties else "empty"
            why = f'it is {first} in the first row of "{trace.name}"; a fracture has one value'
            raise InputError(f"{where}: {key} = {write_value(value)}: {why}")


def _extend(points: list[list[float]], values: list[float], what: str) -> None:
    """Add a point to a trace, or a segment that must begin where the last one ended."""
    if len(values) == 4:
        if points[-1] != values[:2]:
            raise InputError(f"{what} goes on at {values[:2]}, but its last segment ended at {points[-1]}; join them")
        values = values[2:]
    if values:
        if points[-1] == values:
            raise InputError(f"{what}: the point {values} stands twice in a row; remove one")
        points.append(values)
