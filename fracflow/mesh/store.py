"""A split mesh on disk, so that a run can go on whatever becomes of the files it was made from."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fracflow.errors import InputError
from fracflow.mesh.cut_mesh import near_mesh
from fracflow.mesh.data import Ints, SplitMesh, is_unmeshed
from fracflow.mesh.near_cells import has_near_first
from fracflow.storage.files import steers
from fracflow.storage.sealed import AGAIN, SealedFile, Slabs, read_sealed, slabs_of, write_sealed

_NO_MESH = "is no saved mesh"
WRITE_ONE = "write one with: fracflow mesh SCENE -o NAME.h5"
Shape = tuple[int, ...]
MOST_CUTS = 12
NOT_BESIDE = "joints or sides are not on the cells that they name, or walls of a joint not at one place"
NOT_FIRST = "near is no number of cells that come first"
_TEXTS = ("rocks", "fractures", "sides", "notes")
_LATER = {"cuts": 0, "near": -1}
_REALS = ("points", "joint_along")
_PARTS = tuple(field.name for field in fields(SplitMesh) if field.name not in ("coarse", "sums"))
SLICED = ("points", "origin", "cells", "cell_rock")
"""Parts as long as the mesh has cells or nodes. All others are of joints and sides, or names."""
ARRAYS = (
    *SLICED, "joint_bottom", "joint_top", "joint_cells", "joint_flow", "joint_fracture", "joint_along", "flow_origin",
    "side_facets", "side_cell", "side_of",
)  # fmt: skip


def save_mesh(mesh: SplitMesh, path: Path, sliced: Mapping[str, Slabs] | None = None) -> str:
    """Write every part of a mesh, or of the coarse one it was made from, with its seal, and give the root of that.

    sliced  the parts SLICED, of a mesh that has the near cells alone
    """
    parts = {name: getattr(mesh.coarse or mesh, name) for name in _PARTS} | dict(sliced or {})
    arrays = {name: value for name, value in parts.items() if isinstance(value, (np.ndarray, Slabs))}
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
    mesh = _read(path, WRITE_ONE)
    if is_unmeshed(mesh.cells) or mesh.points.shape[1] != 2:
        raise no_plane_rock(path)
    first = mesh.origin[mesh.joint_bottom]
    refuse_joined_ends(len(mesh.flow_origin), len(np.unique(first)), path)
    refuse_flow_elsewhere(np.array_equal(mesh.flow_origin[mesh.joint_flow], first), path)
    return replace(mesh, cuts=0, near=-1)


def no_plane_rock(path: Path) -> InputError:
    """The error of a saved mesh that another scene cannot take."""
    return InputError(f"{path}: is no mesh of plane rock; {WRITE_ONE}")


def refuse_joined_ends(flow_nodes: int, ends: int, path: Path) -> None:
    """Raise InputError where wells have made several ends of fractures, so many that joints have, one flow node."""
    if flow_nodes < ends:
        raise InputError(f"{path}: a well has joined ends of fractures in it; {WRITE_ONE}")


def refuse_flow_elsewhere(is_there: bool, path: Path) -> None:
    """Raise InputError unless the flow nodes of joints are at the nodes of their walls, as they are where none are joined."""
    if not is_there:
        raise InputError(f"{path}: {_NO_MESH} (joint_flow has nodes that are not at the ends of joints); {WRITE_ONE}")


class SlicedFile:
    """A saved mesh whose arrays are read by rows; names and shapes are read at once, and checked.

    names   the mesh without a row of any array
    root    of its seal, empty where an earlier version left none
    layout  types and shapes of its arrays
    """

    def __init__(self, path: Path, root: str, remedy: str) -> None:
        """With the ``root`` of its seal where that is known. Raises InputError."""
        self.path, self._remedy = path, remedy
        self._file = SealedFile(path, _NO_MESH, remedy, root)
        self.root = self._file.place[1]
        with self._refusing():
            self.layout = {name: self._file.layout[name] for name in ARRAYS}
            parts: dict[str, Any] = {
                name: np.zeros((0, *shape[1:]), kind) for name, (kind, shape) in self.layout.items()
            }
            parts |= {name: _part({}, self._file.notes, name) for name in _PARTS if name not in ARRAYS}
            self.names = SplitMesh(**parts)
            shapes = {name: shape for name, (_, shape) in self.layout.items()}
            _check_names(self.names, shapes["points"], shapes["cells"])
            self._bounds = _bounds(self.names, shapes)
            for name, (shape, _) in self._bounds.items():
                _check_shape(name, shapes[name], shape)

    def rows(self, name: str, first: int, last: int) -> NDArray[Any]:
        """Rows (n, ...) of an array as they were sealed, in numbers of 8 bytes. Raises InputError."""
        kind, shape = self.layout[name]
        found = np.empty((last - first, *shape[1:]), dtype=dtype_of(name))
        for start, end in slabs_of(np.dtype(kind), shape, first, last):
            values, (_, below) = self._file.rows(name, start, end), self._bounds[name]
            with self._refusing():
                _check_values(name, values, (end - start, *shape[1:]), below)
            low, high = max(first, start), min(last, end)
            found[low - first : high - first] = values[low - start : high - start]
        return found

    @contextmanager
    def _refusing(self) -> Iterator[None]:
        try:
            yield
        except (KeyError, ValueError) as error:
            raise InputError(f"{self.path}: {_NO_MESH} ({error}); {self._remedy}") from None


def dtype_of(name: str) -> type[np.float64] | type[np.int64]:
    """Type of the numbers of an array in memory."""
    return np.float64 if name in _REALS else np.int64


def cells_of(path: Path, remedy: str) -> tuple[int, int]:
    """Numbers of cells of a saved mesh of plane rock, and of those that come first; 0 of another mesh, -1 where cells are cut.

    Raises InputError where it is no saved mesh.
    """
    file = SealedFile(path, _NO_MESH, remedy)
    (_, cells), (_, points) = (file.layout.get(name, ("", ())) for name in ("cells", "points"))
    is_plane = len(cells) == 2 and cells[1] > 2 and points[1:] == (2,)
    try:
        near, cuts = (json.loads(str(file.notes.get(name, later))) for name, later in (("near", -1), ("cuts", 0)))
    except ValueError:
        near, cuts = -1, 0
    return (cells[0] if is_plane else 0), near if cuts == 0 and type(near) is int else -1


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
    shapes = {name: np.shape(getattr(mesh, name)) for name in ARRAYS}
    _check_names(mesh, shapes["points"], shapes["cells"])
    for name, (shape, below) in _bounds(mesh, shapes).items():
        _check_values(name, getattr(mesh, name), shape, below)
    if not has_near_first(mesh):
        raise ValueError(NOT_FIRST)
    first = mesh.origin[walls_of(mesh)]
    if not are_beside(mesh, mesh.cells[mesh.joint_cells], mesh.cells[mesh.side_cell], first):
        raise ValueError(NOT_BESIDE)


def walls_of(facets: SplitMesh) -> Ints:
    """Nodes (f, 2, k) below and above each joint."""
    return np.stack([facets.joint_bottom, facets.joint_top], axis=1)


def are_beside(facets: SplitMesh, of_joints: Ints, of_sides: Ints, first: Ints) -> bool:
    """Whether joints and sides are on their cells, and the walls of each joint copies of the same nodes.

    facets     a mesh with some joints and sides
    of_joints  (f, 2, c) nodes of the cells below and above each
    of_sides   (s, c) of the cell of each side
    first      (f, 2, k) first copies of the nodes of ``walls_of``
    """
    has_walls = (walls_of(facets)[..., None] == of_joints[:, :, None, :]).any(axis=-1).all()
    has_sides = (facets.side_facets[..., None] == of_sides[:, None, :]).any(axis=-1).all()
    return bool(has_walls and has_sides and np.array_equal(first[:, 0], first[:, 1]))


def _check_names(mesh: SplitMesh, points: Shape, cells: Shape) -> None:
    """The same of names and counts, of a mesh with points and cells of these shapes."""
    if len(points) != 2 or points[1] not in (2, 3):
        raise ValueError("points are no points")
    for name in _TEXTS:
        if not isinstance(value := getattr(mesh, name), tuple) or not all(isinstance(each, str) for each in value):
            raise ValueError(f"{name} are no names")
        if any(steers(each) for each in value):
            raise ValueError(f"{name}: control characters in a name")
    if type(mesh.cuts) is not int or not 0 <= mesh.cuts <= MOST_CUTS:
        raise ValueError("cuts are no number of cuts")
    if type(mesh.near) is not int or not -1 <= mesh.near <= (cells[0] if cells else 0):
        raise ValueError(NOT_FIRST)
    named = mesh.named_points
    if not isinstance(named, dict) or not all(type(at) is int and 0 <= at < points[0] for at in named.values()):
        raise ValueError("named_points has numbers of no nodes")


def _bounds(mesh: SplitMesh, shapes: Mapping[str, Shape]) -> dict[str, tuple[Shape, int]]:
    """Shape that each array of a mesh with these ``shapes`` must have, and what each of its numbers is below."""
    (nodes, dim), cells, joint = shapes["points"], shapes["cells"], shapes["joint_bottom"]
    count, columns = cells[0] if cells else 0, cells[1] if len(cells) == 2 else 0
    joints, flows, facets = ((shapes[name] or (1,))[0] for name in ("joint_bottom", "flow_origin", "side_facets"))
    width = 2 if dim == 2 or len(joint) != 2 else max(3, min(joint[1], 4))
    return {
        "points": ((nodes, dim), 0),
        "origin": ((nodes,), nodes),
        "cells": ((count, columns), nodes),
        "cell_rock": ((count,), len(mesh.rocks)),
        "joint_bottom": ((joints, width), nodes),
        "joint_top": ((joints, width), nodes),
        "joint_cells": ((joints, 2), count),
        "joint_flow": ((joints, width), flows),
        "joint_fracture": ((joints,), len(mesh.fractures)),
        "joint_along": ((joints, width), 0),
        "flow_origin": ((flows,), nodes),
        "side_facets": ((facets, width), nodes),
        "side_cell": ((facets,), count),
        "side_of": ((facets,), len(mesh.sides)),
    }


def _check_shape(name: str, found: Shape, shape: Shape) -> None:
    if found != shape:
        raise ValueError(f"{name} has the shape {found}, not {shape}")


def _check_values(name: str, values: Any, shape: Shape, below: int) -> None:
    """Raise ValueError for an array (...) of another shape, or with values that a mesh does not have."""
    _check_shape(name, np.shape(values) if isinstance(values, np.ndarray) else (), shape)
    if name in _REALS:
        if values.dtype.kind != "f" or not np.isfinite(values).all():
            raise ValueError(f"{name} has values that are no numbers")
        return
    least = -1 if name == "cells" else 0  # which -1 pads
    if values.dtype.kind != "i" or (values.size and not least <= values.min() <= values.max() < below):
        raise ValueError(f"{name} has numbers that are not from {least} to {below - 1}")
