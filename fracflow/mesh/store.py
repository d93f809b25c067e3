"""A split mesh on disk, so that a run can go on whatever becomes of the files it was made from."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fracflow.errors import InputError
from fracflow.mesh.cut_mesh import near_mesh
from fracflow.mesh.data import SplitMesh, is_unmeshed
from fracflow.mesh.near_cells import has_near_first
from fracflow.storage.files import steers
from fracflow.storage.sealed import AGAIN, SealedFile, read_sealed, write_sealed

_NO_MESH = "is no saved mesh"
MOST_CUTS = 12
_TEXTS = ("rocks", "fractures", "sides", "notes")
_LATER = {"cuts": 0, "near": -1}
_REALS = ("points", "joint_along")
_PARTS = tuple(field.name for field in fields(SplitMesh) if field.name != "coarse")


def save_mesh(mesh: SplitMesh, path: Path) -> str:
    """Write every part of a mesh, or of the coarse one it was made from, with its seal, and give the root of that."""
    parts = {name: getattr(mesh.coarse or mesh, name) for name in _PARTS}
    arrays = {name: value for name, value in parts.items() if isinstance(value, np.ndarray)}
    texts = {name: json.dumps(value, ensure_ascii=False) for name, value in parts.items() if name not in arrays}
    return write_sealed(path, arrays, texts)


def load_mesh(path: Path, root: str = "") -> SplitMesh:
    """Read a mesh that was saved, with the ``root`` of its seal where that is known; of one that is cut, the near cells.

    Raises InputError where there is none.
    """
    return near_mesh(_read(path, AGAIN, root))


def load_split(path: Path) -> SplitMesh:
    """Read a split mesh for another scene, as it is before its cells are cut: that of ``fracflow mesh``, or of a run.

    Raises InputError also where wells of its scene have made several ends of fractures one flow node.
    """
    remedy = "write one with: fracflow mesh SCENE -o NAME.h5"
    mesh = _read(path, remedy)
    if is_unmeshed(mesh.cells) or mesh.points.shape[1] != 2:
        raise InputError(f"{path}: is no mesh of plane rock; {remedy}")
    if len(mesh.flow_origin) < len(np.unique(mesh.origin[mesh.joint_bottom])):
        raise InputError(f"{path}: a well has joined ends of fractures in it; {remedy}")
    return replace(mesh, cuts=0, near=-1)


def _read(path: Path, remedy: str, root: str = "") -> SplitMesh:
    found = read_sealed(path, _NO_MESH, remedy=remedy, ours=root)
    try:
        mesh = SplitMesh(**{name: _part(found.arrays, found.notes, name) for name in _PARTS})
        _check(mesh)
    except (KeyError, ValueError) as error:
        raise InputError(f"{path}: {_NO_MESH} ({error}); {remedy}") from None
    return mesh


def mesh_root(path: Path) -> str:
    """The root of a mesh's seal, empty where it has none. Raises InputError as ``load_mesh`` does."""
    return read_sealed(path, _NO_MESH, names=()).root


def is_saved_mesh(path: Path) -> bool:
    """Whether a file is a saved mesh, of which no values are read."""
    try:
        return {"cells", "joint_bottom", "flow_origin"} <= SealedFile(path, _NO_MESH).layout.keys()
    except InputError:
        return False


def has_cells(path: Path) -> bool:
    """Whether a saved mesh has cells, and not walls of rock without a mesh alone; no values are read. Raises InputError."""
    _, shape = SealedFile(path, _NO_MESH).layout.get("cells", ("", ()))
    return shape[1:] != (2,)


def _part(arrays: Mapping[str, NDArray[Any]], texts: Mapping[str, Any], name: str) -> Any:
    if name in arrays:
        return arrays[name]
    if name in _LATER and name not in texts:  # of a mesh that an earlier version saved
        return _LATER[name]
    value = json.loads(str(texts[name]))
    return tuple(value) if isinstance(value, list) else value


def _check(mesh: SplitMesh) -> None:
    """Raise ValueError for parts that point to what there is not; others may have made the file."""
    if np.ndim(mesh.points) != 2 or mesh.points.shape[1] not in (2, 3):
        raise ValueError("points are no points")
    for name in _TEXTS:
        if not isinstance(value := getattr(mesh, name), tuple) or not all(isinstance(each, str) for each in value):
            raise ValueError(f"{name} are no names")
        if any(steers(each) for each in value):
            raise ValueError(f"{name}: control characters in a name")
    nodes, dim = mesh.points.shape
    tables = (mesh.cells, mesh.joint_bottom, mesh.flow_origin, mesh.side_facets)
    cells, joints, flows, facets = (len(np.atleast_1d(table)) for table in tables)
    width = 2 if dim == 2 or np.ndim(mesh.joint_bottom) != 2 else max(3, min(mesh.joint_bottom.shape[1], 4))
    columns = mesh.cells.shape[1] if np.ndim(mesh.cells) == 2 else 0
    shapes: dict[str, tuple[tuple[int, ...], int]] = {  # shape, and what each number is below
        "origin": ((nodes,), nodes),
        "cells": ((cells, columns), nodes),
        "cell_rock": ((cells,), len(mesh.rocks)),
        "joint_bottom": ((joints, width), nodes),
        "joint_top": ((joints, width), nodes),
        "joint_cells": ((joints, 2), cells),
        "joint_flow": ((joints, width), flows),
        "joint_fracture": ((joints,), len(mesh.fractures)),
        "joint_along": ((joints, width), 0),
        "flow_origin": ((flows,), nodes),
        "side_facets": ((facets, width), nodes),
        "side_cell": ((facets,), cells),
        "side_of": ((facets,), len(mesh.sides)),
    }
    for name, (shape, below) in shapes.items():
        values = getattr(mesh, name)
        if not isinstance(values, np.ndarray) or values.shape != shape:
            raise ValueError(f"{name} has the shape {np.shape(values)}, not {shape}")
        least = -1 if name == "cells" else 0  # which -1 pads
        fits = values.dtype.kind == "i" and (not values.size or least <= values.min() <= values.max() < below)
        if name not in _REALS and not fits:
            raise ValueError(f"{name} has numbers that are not from {least} to {below - 1}")
    for name in _REALS:
        if getattr(mesh, name).dtype.kind != "f" or not np.isfinite(getattr(mesh, name)).all():
            raise ValueError(f"{name} has values that are no numbers")
    if type(mesh.cuts) is not int or not 0 <= mesh.cuts <= MOST_CUTS:
        raise ValueError("cuts are no number of cuts")
    if type(mesh.near) is not int or not -1 <= mesh.near <= cells or not has_near_first(mesh):
        raise ValueError("near is no number of cells that come first")
    points = mesh.named_points
    if not isinstance(points, dict) or not all(type(at) is int and 0 <= at < nodes for at in points.values()):
        raise ValueError("named_points has numbers of no nodes")
