"""Fields for ParaView: one HDF5 file a step, the mesh once, and an XDMF index of them all."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fracflow.errors import InputError
from fracflow.output.folder import step_of, to_json, write_atomic
from fracflow.storage.reader import Layout
from fracflow.storage.sealed import Sealed, layout_of, read_sealed, write_sealed

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Data = dict[str, NDArray[Any]]

# XDMF: name and code of the topology of cells with 2, 3 and 4 nodes
_SHAPES = {2: ("Polyline", 2), 3: ("Triangle", 4), 4: ("Quadrilateral", 5)}
_NO_FIELDS, _REMEDY = "is no readable field file", "name a run with fields"
_CENTRES = {"point": "Node", "cell": "Cell"}


class FieldWriter:
    """Writer of one family of fields: ``<name>.xdmf`` in ``folder``, data in ``folder/fields``.

    points  (n, 2 or 3)  coordinates [length]
    cells   (m, k)       nodes, -1 pads; 2 nodes are a piece of a fracture, 3 a triangle, 4 a quadrilateral
    attrs   metadata stored with the mesh, e.g. names behind cell data; lists and mappings as JSON
    resume  keep the steps that are there; otherwise they are removed

    ``left_out`` are lines on files of steps that cannot be read, ``steps`` time and layout of those that are there.
    """

    def __init__(
        self,
        folder: str | Path,
        name: str,
        points: Floats,
        cells: Ints,
        attrs: Mapping[str, Any] | None = None,
        resume: bool = False,
    ) -> None:
        self.folder, self.name = Path(folder), name
        (self.folder / "fields").mkdir(parents=True, exist_ok=True)
        if not resume:
            for _, path in list_steps(self.folder, name):
                path.unlink()
        self.points, self.cells = _padded(points, 3), np.asarray(cells, np.int64)
        self.steps: dict[int, tuple[float, Layout]] = {}
        self._counts = (len(points), len(cells))
        topology, kind = _topology(np.asarray(cells))
        self._mesh = (kind, topology, self.points)
        arrays = {"points": self.points, "cells": self.cells, "topology": topology}
        _write(self.folder / "fields" / f"{name}_mesh.h5", arrays, attrs or {})
        self._grids, self.left_out = self._known()
        self._write_index()

    def _known(self) -> tuple[dict[int, str], list[str]]:
        """Entries of the index for the steps that are there, and why others are not: no run goes on from fields."""
        found, left_out = {}, []
        for index, path in list_steps(self.folder, self.name):
            try:
                found[index] = self._known_step(index, path, *_read_flat(path))
            except InputError as error:
                left_out.append(f"{str(error).partition(';')[0]}: left out of {self.name}.xdmf")
        return found, left_out

    def file(self, index: int) -> str:
        """Name of the file of a step, in the folder "fields"."""
        return f"{self.name}_{index:06d}.h5"

    def _known_step(self, index: int, path: Path, time: float, *data: Data) -> str:
        """Keep what a step has; its entry of the index."""
        arrays = {
            f"{place}/{key}": each for place, part in zip(_CENTRES, data, strict=True) for key, each in part.items()
        }
        self.steps[index] = (time, layout_of(arrays))
        return self._grid(path, time, *data)

    def write(
        self,
        index: int,
        time: float,
        point_data: Mapping[str, ArrayLike] | None = None,
        cell_data: Mapping[str, ArrayLike] | None = None,
    ) -> Path:
        """Write the fields of one step and return the path of its file; a step already there is replaced.

        Rows are points or cells; then nothing (scalar), 2 or 3 (vector, padded to 3) or (d, d) (tensor,
        padded to 3 x 3). Any other shape is written as it is. Raises ValueError if the rows do not match.
        """
        arrays: Data = {}
        for place, count, data in zip(_CENTRES, self._counts, (point_data, cell_data), strict=True):
            for key, value in (data or {}).items():
                arrays[f"{place}/{key}"] = _stored(np.asarray(value))
                if len(arrays[f"{place}/{key}"]) != count:
                    got = len(arrays[f"{place}/{key}"])
                    raise ValueError(f"field {key} of {self.name}: {got} rows, should be {count} {place}s")
        path = self.folder / "fields" / self.file(index)
        _write(path, arrays, {"time": float(time)})
        self._grids[index] = self._known_step(index, path, float(time), *_by_place(arrays))
        self._write_index()
        return path

    def drop(self, index: int) -> None:
        """Take the fields of one step away, where there are any."""
        if self._grids.pop(index, None) is not None:
            del self.steps[index]
            self._write_index()
            (self.folder / "fields" / self.file(index)).unlink(missing_ok=True)

    def _grid(self, path: Path, time: float, *data: Data) -> str:
        places = zip(_CENTRES, data, strict=True)
        fields = [(place, key, value) for place, values in places for key, value in values.items()]
        attributes = [
            f'<Attribute Name="{escape(key)}" AttributeType="{_attribute_type(value)}" '
            f'Center="{_CENTRES[place]}">{_item(value, path, f"{place}/{key}")}</Attribute>'
            for place, key, value in fields
        ]
        mesh = self.folder / "fields" / f"{self.name}_mesh.h5"
        kind, topology, points = self._mesh
        nodes = ' NodesPerElement="2"' if kind == "Polyline" else ""
        head = [
            f'<Grid Name="{escape(self.name)}" GridType="Uniform"><Time Value="{time!r}"/>',
            f'<Topology TopologyType="{kind}" NumberOfElements="{self._counts[1]}"{nodes}>'
            f"{_item(topology, mesh, 'topology')}</Topology>",
            f'<Geometry GeometryType="XYZ">{_item(points, mesh, "points")}</Geometry>',
        ]
        return "\n".join([*head, *attributes, "</Grid>"])

    def _write_index(self) -> None:
        head = f'<Grid Name="{escape(self.name)}" GridType="Collection" CollectionType="Temporal">'
        grids = [self._grids[index] for index in sorted(self._grids)]
        lines = ['<?xml version="1.0"?>', '<Xdmf Version="3.0"><Domain>', head, *grids, "</Grid>"]
        write_atomic(self.folder / f"{self.name}.xdmf", "\n".join([*lines, "</Domain></Xdmf>", ""]))


def list_steps(folder: str | Path, name: str) -> list[tuple[int, Path]]:
    """Step index and file of each written step, in order."""
    found = [(step_of(path, name), path) for path in (Path(folder) / "fields").glob("*.h5")]
    return sorted((number, path) for number, path in found if number is not None)


def read_mesh(folder: str | Path, name: str) -> tuple[Floats, Ints, dict[str, Any]]:
    """Points (n, 3), cells (m, k) with -1 padding, and the mesh's metadata (JSON is left as text). Raises InputError."""
    path = Path(folder) / "fields" / f"{name}_mesh.h5"
    found = read_sealed(path, _NO_FIELDS, remedy=_REMEDY)
    points, cells = (found.arrays.get(key, np.zeros(0)) for key in ("points", "cells"))
    if points.ndim != 2 or points.shape[1] != 3 or cells.ndim != 2 or cells.dtype.kind != "i":
        raise InputError(f"{path}: {_NO_FIELDS} (it has no points or no cells); {_REMEDY}")
    if cells.size and not -1 <= cells.min() <= cells.max() < len(points):
        raise InputError(f"{path}: {_NO_FIELDS} (cells have nodes that are not there); {_REMEDY}")
    return points, cells, dict(found.notes)


def read_step(path: str | Path) -> tuple[float, Data, Data]:
    """Time, point data and cell data of one step, as stored: vectors have 3 components, tensors 3 x 3. Raises InputError."""
    time, *data = _read_flat(Path(path))
    point, cell = ({key: _unflattened(value) for key, value in values.items()} for values in data)
    return time, point, cell


def read_time(path: str | Path) -> float:
    """Time of one step. Raises InputError."""
    return _time_of(Path(path), read_sealed(Path(path), _NO_FIELDS, names=(), remedy=_REMEDY))


def _read_flat(path: Path) -> tuple[float, Data, Data]:
    found = read_sealed(path, _NO_FIELDS, remedy=_REMEDY)
    return _time_of(path, found), *_by_place(found.arrays)


def _time_of(path: Path, found: Sealed) -> float:
    time = found.notes.get("time")
    if not isinstance(time, float):
        raise InputError(f"{path}: {_NO_FIELDS} (it has no time); {_REMEDY}")
    return time


def _by_place(arrays: Mapping[str, NDArray[Any]]) -> tuple[Data, Data]:
    """Point data and cell data by the names of the fields, in the order of these."""
    point, cell = (
        {key.partition("/")[2]: arrays[key] for key in sorted(arrays) if key.startswith(f"{place}/")}
        for place in _CENTRES
    )
    return point, cell


def _write(path: Path, arrays: Mapping[str, NDArray[Any]], attrs: Mapping[str, Any]) -> None:
    notes = {key: value if isinstance(value, str | int | float) else to_json(value) for key, value in attrs.items()}
    write_sealed(path, arrays, notes, durable=False)


def _topology(cells: Ints) -> tuple[Ints, str]:
    """Cells in the form of XDMF: one array if all have the same shape, else codes and nodes in a row."""
    sizes = (cells >= 0).sum(axis=1)
    if not np.isin(sizes, list(_SHAPES)).all():
        raise ValueError(f"cells have {sorted(set(sizes.tolist()))} nodes, should be 2, 3 or 4")
    if len(set(sizes.tolist())) <= 1:
        size = int(sizes[0]) if len(sizes) else max(_SHAPES)
        return cells[:, :size].astype(np.int64), _SHAPES[size][0]
    codes = np.array([0, 0, *(code for _, code in _SHAPES.values())])[sizes]
    # A polyline's code is followed by its number of nodes; other shapes know theirs.
    counts = np.where(sizes == 2, 2, -1)
    rows = np.column_stack([codes, counts, cells])
    return rows[rows >= 0].astype(np.int64), "Mixed"


def _padded(array: ArrayLike, width: int) -> NDArray[Any]:
    values = np.asarray(array, dtype=float)
    return np.pad(values, [(0, 0)] + [(0, width - size) for size in values.shape[1:]])


def _stored(values: NDArray[Any]) -> NDArray[Any]:
    if values.dtype == bool:
        values = values.astype(np.int32)
    if values.ndim == 2 and values.shape[1] == 1:
        values = values[:, 0]
    if values.ndim == 2 and values.shape[1] in (2, 3):
        return _padded(values, 3)
    if values.ndim == 3 and values.shape[1:] in ((2, 2), (3, 3)):
        # XDMF readers need a tensor as nine numbers in a row.
        return _padded(values, 3).reshape(len(values), 9)
    return values


def _unflattened(values: NDArray[Any]) -> NDArray[Any]:
    return values.reshape(-1, 3, 3) if values.shape[1:] == (9,) else values


def _attribute_type(values: NDArray[Any]) -> str:
    width = 1 if values.ndim == 1 else int(np.prod(values.shape[1:]))
    return {1: "Scalar", 3: "Vector", 9: "Tensor"}.get(width, "Matrix")


def _item(values: NDArray[Any], path: Path, key: str) -> str:
    kind = "Float" if values.dtype.kind == "f" else "Int"
    size = " ".join(str(n) for n in values.shape)
    form = f'NumberType="{kind}" Precision="{values.dtype.itemsize}" Format="HDF"'
    return f'<DataItem Dimensions="{size}" {form}>{escape(f"fields/{path.name}:/{key}")}</DataItem>'
