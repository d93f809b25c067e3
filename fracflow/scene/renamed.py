"""Scene keys that have a new name: the old one is still read, with a line of notice."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fracflow.errors import InputError

RENAMED = {("method", "film"): "flow_integrator"}
"""New names of keys by the table and the name that older scenes have for them."""


def with_new_keys(data: Mapping[str, Any], source: str) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Give the data of a scene with its keys as they are named now, and a line of notice for each old one.

    source  name of the scene file, for messages

    Raises InputError where a key stands under both names.
    """
    found, notes = dict(data), []
    for (table, old), new in RENAMED.items():
        keys = found.get(table)
        if not isinstance(keys, dict) or old not in keys:
            continue
        if new in keys:
            why = f"{table}.{new} is its new name and stands there too; keep that one"
            raise InputError(f"{source}: {table}.{old}: {why}")
        found[table] = {new if key == old else key: value for key, value in keys.items()}
        notes.append(_notice(table, old, new))
    return found, tuple(notes)


def with_new_path(setting: str) -> tuple[str, tuple[str, ...]]:
    """Give a ``path.to.key=value`` with the new name of its key, and a line of notice where it has the old one."""
    path, equals, value = setting.partition("=")
    for (table, old), new in RENAMED.items():
        if path.strip() == f"{table}.{old}":
            return f"{table}.{new}{equals}{value}", (_notice(table, old, new),)
    return setting, ()


def _notice(table: str, old: str, new: str) -> str:
    return f"{table}.{old}: this key is now called {table}.{new}; its old name is still read"
