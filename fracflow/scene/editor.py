"""The schema of a scene for editors: JSON Schema, draft 7, of what a TOML file may hold.

It says what a file alone can show: keys, kinds of values, names, ranges of plain numbers, units by their form. Whether a unit
fits its key, and whether tables agree, ``fracflow check`` says.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fracflow.scene.scene import RENAMED
from fracflow.scene.units import PLAIN, UnitSystem, unit_text

DRAFT = "http://json-schema.org/draft-07/schema#"
WITH_UNIT = r"^\s*[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?\s*(1\s*/\s*)?[A-Za-zµμΩÅ°%(].*$"
"""Form of a number with its unit."""
LIMITS = ("minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum")
FILLED = "Fracture"  # a table whose required keys [fracture.default] may give
SPARE, AS_THEY_ARE = ("prefixItems", "one_is_enough", "quantities", "properties"), ("default", "examples")
Schema = dict[str, Any]


def editor_schema(schema: Mapping[str, Any]) -> Schema:
    """The schema of a scene, as pydantic makes it with our dimensions, in words that editors of TOML know."""
    root = dict(schema)
    definitions = {name: _renamed(name, table) for name, table in root.pop("$defs").items()}
    definitions[FILLED] = {key: value for key, value in definitions[FILLED].items() if key != "required"}
    head = {"$schema": DRAFT, "title": "Scene of fracflow", "description": "Keys of a scene; see also fracflow schema."}
    tables = {name: _plain(table) for name, table in definitions.items()}
    return {**_plain(root), **head, "definitions": tables}


def _renamed(name: str, table: Mapping[str, Any]) -> Schema:
    """A table with the old names of its keys, which are still read."""
    keys = dict(table["properties"])
    for (place, old), new in RENAMED.items():
        if place == name.lower():
            meaning = f"deprecated: the old name of {new}, still read. {keys[new].get('description', '')}"
            keys[old] = {**keys[new], "description": meaning, "deprecated": True}
            keys[old].pop("default", None)
    return {**table, "properties": keys}


def _plain(node: Any) -> Any:
    """A part of the schema without null, which TOML has not, and with our own words said in those of draft 7."""
    if isinstance(node, list):
        return [_plain(each) for each in node]
    if not isinstance(node, Mapping):
        return node
    if node.get("type") in ("number", ["number", "string"]) and "dimension" in node:
        return _number(node)
    found = {key: _plain(value) for key, value in node.items() if key not in (*SPARE, *AS_THEY_ARE)}
    found |= {key: node[key] for key in AS_THEY_ARE if node.get(key) is not None}
    if "properties" in node:
        found["properties"] = {key: _plain(value) for key, value in node["properties"].items()}
    if "$ref" in found:
        there = {"$ref": found.pop("$ref").replace("$defs", "definitions")}
        found = {**found, "allOf": [there]} if found else there  # beside a $ref draft 7 reads nothing
    if "prefixItems" in node:
        found |= {"items": _plain(node["prefixItems"]), "additionalItems": False}
    if "quantities" in node:
        meanings = [f"{meaning} [{dimension}]" for dimension, meaning in node["quantities"].values()]
        found["x-taplo"] = {"docs": {"enumValues": meanings}}
    if "anyOf" in found:
        found = _chosen(found)
    if node.get("one_is_enough"):
        found = _or_one(found)
    return found


def _chosen(found: Schema) -> Schema:
    """A choice without null, and without being a choice where one is left."""
    choices = [each for each in found["anyOf"] if each.get("type") != "null"]
    rest = {key: value for key, value in found.items() if key != "anyOf"}
    return {**choices[0], **rest} if len(choices) == 1 else {**rest, "anyOf": choices}


def _or_one(found: Schema) -> Schema:
    """A list of names, or one name in its place."""
    about = {key: value for key, value in found.items() if key in ("title", "description", "default")}
    names = {key: value for key, value in found.items() if key not in about}
    return {**about, "anyOf": [names["items"], names]}


def _number(node: Mapping[str, Any]) -> Schema:
    """A number, or a text with a number and its unit."""
    dimension = node["dimension"]
    about = {key: node[key] for key in ("title", "description", "default", "deprecated") if node.get(key) is not None}
    number: Schema = {"type": "number", **{key: node[key] for key in LIMITS if key in node}}
    if dimension == PLAIN:
        return {**about, **number}
    system = UnitSystem.parse("SI")
    unit = unit_text(dimension, {"length": system.length, "force": system.force, "time": system.time}) or "degree"
    fits = f'a number in the units of the scene (SI: {unit}), or a text with a unit, such as "{node["examples"][0]}"'
    number["description"] = fits
    text = {"type": "string", "maxLength": 100, "pattern": WITH_UNIT, "examples": node["examples"], "description": fits}
    return {**about, "dimension": dimension, "examples": node["examples"], "anyOf": [number, text]}
