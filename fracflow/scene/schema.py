"""Every key of a scene as rows of a table: what it may be, what it is if it is not given, what it means."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

Row = tuple[str, str, str, str]


def rows(schema: Mapping[str, Any]) -> Iterator[Row]:
    """(key, values, default, meaning) of every key of a JSON schema, tables after their own keys."""
    definitions = schema.get("$defs", {})

    def walk(table: Mapping[str, Any], path: str) -> Iterator[Row]:
        required, inner = set(table.get("required", ())), []
        for name, field in table.get("properties", {}).items():
            key, below = f"{path}{name}", _table_below(field, definitions)
            if below is None:
                default = "required" if name in required else _default(field)
                yield key, _values(field), default, field.get("description", "")
                yield from _quantities(key, field)
            else:
                inner.append((key + below[0], below[1], field.get("description", "")))
        for key, found, meaning in inner:
            yield f"[{key}]", "", "", meaning
            yield from walk(found, f"{key}.")

    yield from walk(schema, "")


def note_on_meanings(schema: Mapping[str, Any]) -> str:
    """A line where an installation has lost the docstrings that meanings are taken from; empty elsewhere."""
    if __doc__ and "description" in schema["properties"]["title"]:
        return ""
    return (
        "note: meanings of keys are missing, for they are docstrings in the sources: run Python without -OO, on an"
        " installation with .py files, or read meshes/SCENE.md in the repository"
    )


HEAD = """# Keys of a scene

Written by `fracflow schema --markdown`. A dimension in brackets asks for a number in the scene's units, or a string with a
unit such as `"30 GPa"`. `[]` marks an array of tables, `NAME` a name that the scene gives. [The tutorials](README.md) show
keys in use.
"""


def markdown(schema: Mapping[str, Any]) -> str:
    """The page in Markdown of every key of a JSON schema, a section for each table."""
    lines = [HEAD, "## Top of the file", ""]
    is_open = False
    for key, values, default, meaning in rows(schema):
        if key.startswith("["):
            lines += ["", f"## `{key}`", "", f"{meaning[:1].upper()}{meaning[1:]}." if meaning else ""]
            is_open = False
            continue
        if not is_open:
            lines += ["", "| key | values | default | meaning |", "|---|---|---|---|"]
            is_open = True
        default = default if default in ("", "required") else f"`{default}`"
        lines.append(f"| `{key}` | {_cell(values)} | {_cell(default)} | {_cell(meaning)} |")
    return re.sub(r"\n{3,}", "\n\n", "\n".join(lines)) + "\n"


def _cell(text: str) -> str:
    """A text inside a table of Markdown."""
    return text.replace("|", "\\|").replace("<", "&lt;")


def _table_below(field: Mapping[str, Any], definitions: Mapping[str, Any]) -> tuple[str, Mapping[str, Any]] | None:
    """The table that a key holds, with ``[]`` for an array of tables and ``.NAME`` for tables by name."""
    for choice in (field, *field.get("anyOf", ()), *field.get("allOf", ())):
        if "$ref" in choice:
            return "", definitions[choice["$ref"].rpartition("/")[2]]
        for word, key in (("items", "[]"), ("additionalProperties", ".NAME")):
            inside = choice.get(word)
            if isinstance(inside, Mapping) and "$ref" in inside:
                return key, definitions[inside["$ref"].rpartition("/")[2]]
    return None


def _quantities(key: str, field: Mapping[str, Any]) -> Iterator[Row]:
    """A row for each quantity that the entries of a list may name."""
    for choice in (field, *field.get("anyOf", ())):
        for name, (dimension, meaning) in choice.get("items", {}).get("quantities", {}).items():
            yield f'{key}: "{name}"', f"[{dimension}]", "", meaning


def _default(field: Mapping[str, Any]) -> str:
    value = field.get("default")
    return "" if value in (None, [], {}, "") else str(value)


def _values(field: Mapping[str, Any]) -> str:
    choices = [field, *field.get("anyOf", ())]
    words = [word for choice in choices for word in choice.get("enum", ())]
    words += [choice["const"] for choice in choices if "const" in choice]
    dimensions = [f"[{choice['dimension']}]" for choice in choices if "dimension" in choice][:1]
    if words or dimensions:
        return " | ".join(map(str, [*words, *dimensions]))
    kinds = [choice["type"] for choice in choices if isinstance(choice.get("type"), str) and choice["type"] != "null"]
    return " or ".join(dict.fromkeys(kinds))
