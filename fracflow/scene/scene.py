"""The scene: what a run is about, validated, with units; errors name key, value and what would be right."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError, model_validator

from fracflow._version import __version__
from fracflow.errors import InputError
from fracflow.remarks import note
from fracflow.scene.checks import check_mesh_names, contradictions
from fracflow.scene.geometry import with_traces
from fracflow.scene.messages import one_line, others
from fracflow.scene.tables import Tables
from fracflow.scene.toml import override, read_toml, write_toml, write_value
from fracflow.scene.units import UnitSystem, fault

BEFORE_TRACES = ("geometry.fractures_csv", "units")  # settings that say how the table of traces is read
RENAMED = {("method", "film"): "flow_integrator"}
"""New names of keys by the table and the name that older scenes have for them."""


class Scene(Tables):
    """A scene: geometry, materials, what is held, loaded and pumped, and the stages of the run."""

    @model_validator(mode="after")
    def _agree(self) -> Scene:
        faults = list(contradictions(self))
        if faults:
            path, text = faults[0]
            raise fault(text + others(len(faults) - 1), path=path)
        return self

    def __eq__(self, other: object) -> bool:
        """Scenes are equal when their tables are, wherever they were read from."""
        return isinstance(other, Scene) and self.model_dump() == other.model_dump()

    __hash__ = None  # type: ignore[assignment]

    @staticmethod
    def from_data(data: Mapping[str, Any], file: Path = Path("scene.toml")) -> Scene:
        """Make a scene of what its TOML holds, with the traces of its CSV; raises InputError of one line."""
        data, notes = _with_new_keys(with_traces(data, file), file.name)
        try:
            units = UnitSystem.parse(data.get("units", "SI"))
        except ValueError as error:
            raise InputError(f"{file.name}: units = {write_value(data['units'])}: {error}") from None
        try:
            scene = Scene.model_validate(dict(data), context={"units": units})
        except ValidationError as error:
            raise InputError(f"{file.name}: {one_line(error, data, Scene)}") from None
        scene._file, scene._notes = file.absolute(), notes
        return scene

    check_mesh_names = check_mesh_names

    def dump_toml(self, to: Path | None = None) -> str:
        """Write the scene with all defaults; file names relative to the folder ``to`` where that is given."""
        data = self.model_dump(exclude_none=True) | {"version": __version__}
        if to is not None and self.mesh_path is not None:
            data["mesh"]["file"] = os.path.relpath(self.mesh_path, to)
        return write_toml({key: value for key, value in data.items() if value not in ((), {})})

    @classmethod
    def json_schema(cls) -> dict[str, Any]:
        """Document every key: a JSON schema with descriptions and dimensions."""
        return cls.model_json_schema()


def load(path: str | Path, overrides: Sequence[str] = (), trust: bool = False) -> Scene:
    """Read a scene file and apply ``path.to.key=value`` overrides; raises InputError of one line.

    trust  whether Gmsh may run the scene's .geo as it is, whatever that does
    """
    file = Path(path)
    data, notes = _with_new_keys(read_toml(file), file.name)
    settings = [_with_new_path(text) for text in overrides]
    for setting in [text for text, _ in settings if text.startswith(BEFORE_TRACES)]:
        override(data, setting)
    data = with_traces(data, file)
    for setting in [text for text, _ in settings if not text.startswith(BEFORE_TRACES)]:
        override(data, setting)
    scene = Scene.from_data(data, file)
    noticed = dict.fromkeys((*notes, *(line for _, lines in settings for line in lines), *scene._notes))
    scene._notes = tuple(noticed)  # a line once, however often the old name stands
    return scene.with_trust() if trust else scene


def _with_new_keys(data: Mapping[str, Any], source: str) -> tuple[dict[str, Any], tuple[str, ...]]:
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


def _with_new_path(setting: str) -> tuple[str, tuple[str, ...]]:
    """Give a ``path.to.key=value`` with the new name of its key, and a line of notice where it has the old one."""
    path, equals, value = setting.partition("=")
    for (table, old), new in RENAMED.items():
        if path.strip() == f"{table}.{old}":
            return f"{table}.{new}{equals}{value}", (_notice(table, old, new),)
    return setting, ()


def _notice(table: str, old: str, new: str) -> str:
    return note(f"{table}.{old}: this key is now called {table}.{new}; its old name is still read")
