"""A split mesh on disk, so that a run can go on whatever becomes of the files it was made from."""

from __future__ import annotations

import json
import os
from dataclasses import fields
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from fracflow.errors import InputError
from fracflow.files import fresh, steers
from fracflow.files_hdf5 import check_contained
from fracflow.mesh.data import SplitMesh


def save_mesh(mesh: SplitMesh, path: Path) -> None:
    """Write every part of a mesh, aside and then renamed."""
    part = fresh(path.with_name(path.name + ".part"))
    with h5py.File(part, "w") as file:
        for field in fields(mesh):
            value = getattr(mesh, field.name)
            if isinstance(value, np.ndarray):
                file[field.name] = value
            else:
                file.attrs[field.name] = json.dumps(value, ensure_ascii=False)
    os.replace(part, path)


def load_mesh(path: Path) -> SplitMesh:
    """Read a mesh that was saved. Raises InputError where there is none."""
    try:
        with h5py.File(path, "r") as file:
            check_contained(file, path)
            return SplitMesh(**{field.name: _part(file, field.name) for field in fields(SplitMesh)})
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: is no saved mesh ({error}); start the run again with fracflow run") from error


def _part(file: h5py.File, name: str) -> Any:
    if name in file:
        return file[name][()]
    value = json.loads(file.attrs[name])
    if any(steers(str(each)) for each in value):
        raise KeyError(f"{name}: control characters in a name")
    return tuple(value) if isinstance(value, list) else value
