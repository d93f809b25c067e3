"""The errors of pydantic as one line: file, key, value, and a correct form."""

from __future__ import annotations

import types
from collections.abc import Iterable, Mapping, Sequence
from difflib import get_close_matches
from typing import Any, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from fracflow.scene.meanings import meanings
from fracflow.scene.toml import write_value

Path = tuple[int | str, ...]
OF_TRACES = frozenset({"trace", "traces", "points", "coordinates", "line"})  # that are written into [fracture.NAME]
MOST_LETTERS, MOST_NAMES = 100, 300  # that a misspelt name is compared by, and with


OTHER_WORDS = {
    "duration": "end", "dt": "time_step", "timestep": "time_step", "E": "youngs_modulus", "young": "youngs_modulus",
    "nu": "poissons_ratio", "rho": "density", "mu": "friction_coefficient", "kn": "normal_stiffness",
    "ks": "shear_stiffness", "k_n": "normal_stiffness", "k_s": "shear_stiffness", "rate": "flow_rate", "q": "flow_rate",
    "p0": "initial_pressure", "position": "at", "location": "at", "gap": "aperture",
}  # fmt: skip
"""Words of other programs and of papers -> the key that they stand for, where a table has it."""


def nearest(name: str, allowed: Iterable[str]) -> str:
    """Say which allowed name was probably meant, or list them all."""
    names = sorted(allowed)
    if (other := OTHER_WORDS.get(name)) in names:
        return f'did you mean "{other}"?'
    longer = [each for each in names[:MOST_NAMES] if name in each.split("_")]
    match = longer if len(longer) == 1 else get_close_matches(name[:MOST_LETTERS], names[:MOST_NAMES], n=1)
    if match:
        return f'did you mean "{match[0]}"?'
    more = f" and {len(names) - MOST_NAMES} more" if len(names) > MOST_NAMES else ""
    return f"allowed: {', '.join(names[:MOST_NAMES])}{more}" if names else "there is none"


def one_line(error: ValidationError, data: Mapping[str, Any], model: type[BaseModel]) -> str:
    """Turn the errors of a scene into ``key = value: what is wrong``: the first, and how many more.

    Unknown keys come first and missing ones last: a misspelt key is both, and its spelling is what helps. An unknown law comes
    before its keys.
    """
    order = {"extra_forbidden": 0, "missing": 2}
    errors = sorted(
        error.errors(include_url=False),
        key=lambda entry: -1 if entry["loc"][-1:] == ("law",) else order.get(entry["type"], 1),
    )
    first = errors[0]
    path: Path = first["loc"]
    context = first.get("ctx", {})
    if "path" in context:
        path = tuple(context["path"])
    elif "key" in context:
        path = (*path, context["key"])
    more = others(len(errors) - 1)
    whole = first["type"] == "fracflow" and path == first["loc"] and "text" in context
    return f"{written(path, data, whole)}: {_what(first, path, data, model)}{_counted(path, data)}{more}"


def others(count: int) -> str:
    """How many more errors a scene has, behind the first of them."""
    return f" (and {count} more error{'s' if count > 1 else ''})" if count else ""


def _counted(path: Path, data: Mapping[str, Any]) -> str:
    """Which of the tables [[stage]] the key stage.0 is, where it has no name and there are more."""
    tables = data.get(path[0]) if len(path) > 1 and isinstance(path[0], str) and isinstance(path[1], int) else None
    return numbered(path[0], path[1], len(tables)) if isinstance(tables, list) and not _name(tables, path[1]) else ""


def numbered(key: object, index: int | str, count: int) -> str:
    """Say which table a number means: keys count them from 0, as ``--set`` takes them."""
    return f" ({key}.{index} is number {int(index) + 1} of {count} [[{key}]])" if count > 1 else ""


def _name(here: Any, key: int | str) -> str:
    """The name of an entry of a list, empty for none."""
    entry = here[key] if isinstance(here, list) and isinstance(key, int) and key < len(here) else None
    name = entry.get("name") if isinstance(entry, Mapping) else None
    return name if isinstance(name, str) else ""


def written(path: Path, data: Mapping[str, Any], tables: bool = False) -> str:
    """Write ``well.node2.flow_rate = 3``: the key as ``--set`` takes it, and its value (a table if asked)."""
    here: Any = data
    words: list[str] = []
    for key in path:
        inside = isinstance(here, Mapping) and key in here
        inside = inside or (isinstance(here, list) and isinstance(key, int) and key < len(here))
        words.append((_name(here, key) or str(key))[:MOST_LETTERS])
        here = here[key] if inside else None
    if here is None or (isinstance(here, Mapping) and not tables):
        return ".".join(words)
    value = " ".join(write_value(here).split())
    return f"{'.'.join(words)} = {value if len(value) <= 60 else value[:57] + '...'}"


def _what(error: ErrorDetails, path: Path, data: Mapping[str, Any], model: type[BaseModel]) -> str:
    """Say what is wrong with a key and what would be right."""
    kind, context = error["type"], error.get("ctx", {})
    if kind == "fracflow":
        return str(context["text"])
    if kind == "extra_forbidden" and len(path) == 3 and path[0] == "fracture" and path[2] in OF_TRACES:
        return f"unknown key; a trace stands in geometry, as {_as_trace(str(path[1]), error['input'])} there"
    if kind == "extra_forbidden" and _is_table_of_traces(path, error["input"]):
        return (
            f"unknown key; a file of traces stands in geometry, as fractures_csv = {write_value(error['input'])} there"
        )
    if kind == "extra_forbidden":
        return f"unknown key; {nearest(str(path[-1]), _model_at(model, path[:-1]).model_fields)}"
    if kind == "missing":
        if not isinstance(path[-1], str):
            return f"missing; the list must be longer by entry {path[-1]}"
        if path == ("mesh", "file") and "geometry" in data:
            keys = ", ".join(
                f"geometry.{key}" for key in data["mesh"] if key in _model_at(model, ("geometry",)).model_fields
            )
            return "missing; [geometry] makes the mesh of this scene" + (
                f": write {keys}" if keys else "; remove [mesh]"
            )
        return f"missing; required: {meanings(_model_at(model, path[:-1])).get(path[-1], '')}".removesuffix(": ")
    if kind == "literal_error":
        allowed = str(context["expected"]).replace("'", '"').replace(" or ", ", ")
        close = get_close_matches(str(error["input"]), [word.strip('"') for word in allowed.split(", ")], 1, 0.5)
        return f"unknown; allowed: {allowed}" + (f'; did you mean "{close[0]}"?' if close else "")
    simple = {
        "string_type": "must be a string",
        "int_type": "must be a whole number",
        "bool_type": "must be true or false",
        "dict_type": "must be a table",
        "model_type": "must be a table",
        "model_attributes_type": "must be a table",
        "string_too_short": "must not be empty",
        "string_too_long": f"must have at most {context.get('max_length')} letters",
        "too_short": "must not be empty",
        "string_pattern_mismatch": "must be one line without control characters",
        "too_long": f"must have at most {context.get('max_length')} entries",
        "greater_than_equal": f"out of range; must be at least {context.get('ge')}",
        "less_than_equal": f"out of range; must be at most {context.get('le')}",
    }
    if kind == "tuple_type":
        tables = _model_at(model, path) is not BaseModel
        return f"must be an array of tables [[{'.'.join(map(str, path))}]]" if tables else "must be a list"
    return simple.get(kind, " ".join(error["msg"].split()).lower())


def _is_table_of_traces(path: Path, given: object) -> bool:
    """Whether a key that may mean traces, or one of geometry, names a file of them."""
    may_be = path[-1] in OF_TRACES or path[0] == "geometry"
    return (
        may_be
        and isinstance(given, str)
        and given.lower().endswith((".csv", ".geojson"))
        and len(given) <= MOST_LETTERS
    )


def _as_trace(name: str, points: object) -> str:
    """The key of geometry that states the trace of a fracture, with the points given if they fit in it."""
    shown = " ".join(write_value(points).split()) if isinstance(points, list) else ""
    shown = shown if shown.startswith("[[") and len(shown) <= 60 else "[[x1, y1], [x2, y2]]"
    return f"fracture = [{{name = {write_value(name[:MOST_LETTERS])}, points = {shown}}}]"


def _model_at(model: Any, path: Path) -> type[BaseModel]:
    """Find the model of the table at ``path``: through optional, dict and tuple types; else BaseModel."""
    for key in path:
        inner = _inner(model)
        if isinstance(inner, type) and issubclass(inner, BaseModel) and str(key) in inner.model_fields:
            model = inner.model_fields[str(key)].annotation
        elif get_origin(inner) in (dict, tuple):
            model = next(arg for arg in reversed(get_args(inner)) if arg is not ...)
        else:
            return BaseModel
    inner = _inner(model)
    if get_origin(inner) is tuple:
        inner = get_args(inner)[0]
    return inner if isinstance(inner, type) and issubclass(inner, BaseModel) else BaseModel


def _inner(annotation: Any) -> Any:
    """Strip ``| None`` from a type."""
    if get_origin(annotation) in (Union, types.UnionType):
        rest: Sequence[Any] = [arg for arg in get_args(annotation) if arg is not type(None)]
        return rest[0] if len(rest) == 1 else annotation
    return annotation
