"""A split mesh on disk, so that a run can go on whatever becomes of the files it was made from."""

from __future__ import annotations

import json
from dataclasses import fields
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from fracflow.errors import InputError
from fracflow.files_hdf import whole_file
from fracflow.mesh.data import SplitMesh


def save_mesh(mesh: SplitMesh, path: Path) -> None:
    """Write every part of a mesh, aside and then renamed. Raises OSError."""
    with whole_file(path) as file:
        for field in fields(mesh):
            value = getattr(mesh, field.name)
            if isinstance(value, np.ndarray):
                file[field.name] = value
            else:
                file.attrs[field.name] = json.dumps(value, ensure_ascii=False)


def load_mesh(path: Path) -> SplitMesh:
    """Read a mesh that was saved. Raises InputError where there is none."""
    try:
        with h5py.File(path, "r") as file:
            return SplitMesh(**{field.name: _part(file, field.name) for field in fields(SplitMesh)})
    except (OSError, KeyError) as error:
        raise InputError(f"{path}: is no saved mesh ({error}); start the run again with fracflow run") from error


def _part(file: h5py.File, name: str) -> Any:
    if name in file:
        return file[name][()]
    value = json.loads(file.attrs[name])
    return tuple(value) if isinstance(value, list) else value
