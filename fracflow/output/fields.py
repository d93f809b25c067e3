"""Fields for ParaView: one HDF5 file a step, the mesh once, and an XDMF index of them all."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fracflow.errors import InputError
from fracflow.output.folder import step_of, to_json, write_atomic
from fracflow.storage.reader import Layout
from fracflow.storage.sealed import SealedFile, Slabs, read_sealed, slabs_of, whole, write_slabs

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

    Points, with three coordinates, and cells may come by slabs. ``counts`` are those of points and cells, ``sizes`` those of
    cells with so many nodes.
    ``left_out`` are lines on files of steps that cannot be read, ``steps`` time and layout of those that are there.
    """

    def __init__(
        self,
        folder: str | Path,
        name: str,
        points: Floats | Slabs,
        cells: Ints | Slabs,
        attrs: Mapping[str, Any] | None = None,
        resume: bool = False,
    ) -> None:
        self.folder, self.name = Path(folder), name
        (self.folder / "fields").mkdir(parents=True, exist_ok=True)
        if not resume:
            for _, path in list_steps(self.folder, name):
                path.unlink()
        self.points = points if isinstance(points, Slabs) else whole(_padded(points, 3))
        self.cells = cells if isinstance(cells, Slabs) else whole(np.asarray(cells, np.int64))
        self.steps: dict[int, tuple[float, Layout]] = {}
        self.counts = {"point": self.points.shape[0], "cell": self.cells.shape[0]}
        self.sizes = _sizes(self.cells)
        topology, kind = _topology(self.cells, self.sizes)
        self._mesh = kind, (topology.kind.str, topology.shape), (self.points.kind.str, self.points.shape)
        arrays = {"points": self.points, "cells": self.cells, "topology": topology}
        _write(self.folder / "fields" / f"{name}_mesh.h5", arrays, attrs or {})
        self._grids, self.left_out = self._known()
        self._write_index()

    def forget_mesh(self) -> None:
        """Let go of ``points`` and ``cells``, once no other file is made of them; their numbers stay."""
        del self.points, self.cells

    def _known(self) -> tuple[dict[int, str], list[str]]:
        """Entries of the index for the steps that are there, and why others are not: no run goes on from fields."""
        found, left_out = {}, []
        for index, path in list_steps(self.folder, self.name):
            try:
                found[index] = self._known_step(index, path, *_checked(path))
            except InputError as error:
                left_out.append(f"{str(error).partition(';')[0]}: left out of {self.name}.xdmf")
        return found, left_out

    def file(self, index: int) -> str:
        """Name of the file of a step, in the folder "fields"."""
        return f"{self.name}_{index:06d}.h5"

    def _known_step(self, index: int, path: Path, time: float, layout: Layout) -> str:
        """Keep what a step has; its entry of the index."""
        names = [name for place in _CENTRES for name in sorted(layout) if name.startswith(f"{place}/")]
        self.steps[index] = (time, {name: layout[name] for name in names})
        return self._grid(path, *self.steps[index])

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
        return self.write_stored(index, time, {k: whole(v) for k, v in stored(point_data, cell_data).items()})

    def write_stored(self, index: int, time: float, arrays: Mapping[str, Slabs]) -> Path:
        """Likewise, of arrays (rows, ...) in the form of ``stored``, by slabs. Raises ValueError if the rows do not match."""
        for name, array in arrays.items():
            place, _, key = name.partition("/")
            if array.shape[0] != (count := self.counts[place]):
                raise ValueError(f"field {key} of {self.name}: {array.shape[0]} rows, should be {count} {place}s")
        path = self.folder / "fields" / self.file(index)
        _write(path, arrays, {"time": float(time)})
        layout = {name: (array.kind.str, array.shape) for name, array in arrays.items()}
        self._grids[index] = self._known_step(index, path, float(time), layout)
        self._write_index()
        return path

    def drop(self, index: int) -> None:
        """Take the fields of one step away, where there are any."""
        if self._grids.pop(index, None) is not None:
            del self.steps[index]
            self._write_index()
            (self.folder / "fields" / self.file(index)).unlink(missing_ok=True)

    def _grid(self, path: Path, time: float, layout: Layout) -> str:
        attributes = [
            f'<Attribute Name="{escape(key)}" AttributeType="{_attribute_type(shape)}" '
            f'Center="{_CENTRES[place]}">{_item(kind, shape, path, name)}</Attribute>'
            for name, (kind, shape) in layout.items()
            for place, _, key in [name.partition("/")]
        ]
        mesh = self.folder / "fields" / f"{self.name}_mesh.h5"
        kind, topology, points = self._mesh
        nodes = ' NodesPerElement="2"' if kind == "Polyline" else ""
        head = [
            f'<Grid Name="{escape(self.name)}" GridType="Uniform"><Time Value="{time!r}"/>',
            f'<Topology TopologyType="{kind}" NumberOfElements="{self.counts["cell"]}"{nodes}>'
            f"{_item(*topology, mesh, 'topology')}</Topology>",
            f'<Geometry GeometryType="XYZ">{_item(*points, mesh, "points")}</Geometry>',
        ]
        return "\n".join([*head, *attributes, "</Grid>"])

    def _write_index(self) -> None:
        head = f'<Grid Name="{escape(self.name)}" GridType="Collection" CollectionType="Temporal">'
        grids = [self._grids[index] for index in sorted(self._grids)]
        lines = ['<?xml version="1.0"?>', '<Xdmf Version="3.0"><Domain>', head, *grids, "</Grid>"]
        write_atomic(self.folder / f"{self.name}.xdmf", "\n".join([*lines, "</Domain></Xdmf>", ""]))


def stored(point_data: Mapping[str, ArrayLike] | None, cell_data: Mapping[str, ArrayLike] | None) -> Data:
    """The arrays (n, ...) that a file has of data at points and cells."""
    places = zip(_CENTRES, (point_data, cell_data), strict=True)
    return {
        f"{place}/{key}": _stored(np.asarray(value)) for place, data in places for key, value in (data or {}).items()
    }


def list_steps(folder: str | Path, name: str) -> list[tuple[int, Path]]:
    """Step index and file of each written step, in order."""
    found = [(step_of(path, name), path) for path in (Path(folder) / "fields").glob("*.h5")]
    return sorted((number, path) for number, path in found if number is not None)


def exchange(folder: Path, name: str, aside: str, back: str) -> None:
    """Let a family with another mesh take a ``name``. That which has it goes on as ``aside``; one called ``back`` returns.

    Raises OSError.
    """
    _set_aside(folder, name, aside)
    _bring_back(folder, name, back)


def undo_exchange(folder: Path, name: str, aside: str, back: str) -> None:
    """Undo ``exchange``, also a part of it, before a writer of the family makes its index anew. Raises OSError."""
    if (folder / "fields" / f"{aside}_mesh.h5").exists():
        if (folder / "fields" / f"{name}_mesh.h5").exists():
            _set_aside(folder, name, back)
        _bring_back(folder, name, aside)


def _set_aside(folder: Path, name: str, other: str) -> None:
    fields, index = folder / "fields", folder / f"{name}.xdmf"
    for path in (fields / f"{name}_mesh.h5", *(path for _, path in list_steps(folder, name))):
        path.replace(fields / path.name.replace(name, other, 1))
    write_atomic(
        folder / f"{other}.xdmf", index.read_text(encoding="utf-8").replace(f"fields/{name}_", f"fields/{other}_")
    )


def _bring_back(folder: Path, name: str, other: str) -> None:
    """Undo ``_set_aside``, also half of it; the index of the other is no more."""
    fields = folder / "fields"
    for path in (fields / f"{other}_mesh.h5", *(path for _, path in list_steps(folder, other))):
        if path.exists():
            path.replace(fields / path.name.replace(other, name, 1))
    (folder / f"{other}.xdmf").unlink(missing_ok=True)


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
    found = read_sealed(Path(path), _NO_FIELDS, remedy=_REMEDY)
    time = _time_of(Path(path), found.notes)
    point, cell = ({key: _unflattened(value) for key, value in data.items()} for data in _by_place(found.arrays))
    return time, point, cell


def read_time(path: str | Path) -> float:
    """Time of one step. Raises InputError."""
    return _time_of(Path(path), read_sealed(Path(path), _NO_FIELDS, names=(), remedy=_REMEDY).notes)


def _checked(path: Path) -> tuple[float, Layout]:
    """Time, and types and shapes, of one step whose rows are as they were sealed. Raises InputError."""
    file = SealedFile(path, _NO_FIELDS, _REMEDY)
    for name, (kind, shape) in file.layout.items():
        for first, last in slabs_of(np.dtype(kind), shape or (1,)):
            file.rows(name, first, last)
    return _time_of(path, file.notes), file.layout


def _time_of(path: Path, notes: Mapping[str, Any]) -> float:
    time = notes.get("time")
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


def _write(path: Path, arrays: Mapping[str, Slabs], attrs: Mapping[str, Any]) -> None:
    notes = {key: value if isinstance(value, str | int | float) else to_json(value) for key, value in attrs.items()}
    write_slabs(path, arrays, notes, durable=False)


@dataclass(frozen=True)
class _Each:
    """Slabs made of those of another array."""

    parts: Iterable[NDArray[Any]]
    make: Callable[[NDArray[Any]], NDArray[Any]]

    def __iter__(self) -> Iterator[NDArray[Any]]:
        return map(self.make, self.parts)


def _sizes(cells: Slabs) -> dict[int, int]:
    """Number of nodes -> how many cells have so many. Raises ValueError."""
    total = sum((np.bincount((p >= 0).sum(axis=1), minlength=99) for p in cells.parts), np.zeros(99, dtype=np.int64))
    found = {int(size): int(total[size]) for size in np.flatnonzero(total)}
    if not found.keys() <= _SHAPES.keys():
        raise ValueError(f"cells have {sorted(found)} nodes, should be 2, 3 or 4")
    return found


def _topology(cells: Slabs, sizes: Mapping[int, int]) -> tuple[Slabs, str]:
    """Cells in the form of XDMF: one array if all have the same shape, else codes and nodes in a row."""
    if len(sizes) <= 1:
        size = next(iter(sizes), max(_SHAPES))
        shape = cells.shape[0], min(size, cells.shape[1])
        return Slabs(np.dtype(np.int64), shape, _Each(cells.parts, lambda part: part[:, :size])), _SHAPES[size][0]
    # A polyline's code is followed by its number of nodes; other shapes know theirs.
    total = sum(count * (1 + (size == 2) + size) for size, count in sizes.items())
    return Slabs(np.dtype(np.int64), (total,), _Each(cells.parts, _mixed)), "Mixed"


def _mixed(cells: Ints) -> Ints:
    sizes = (cells >= 0).sum(axis=1)
    codes = np.array([0, 0, *(code for _, code in _SHAPES.values())])[sizes]
    rows = np.column_stack([codes, np.where(sizes == 2, 2, -1), cells])
    return rows[rows >= 0].astype(np.int64)


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


def _attribute_type(shape: tuple[int, ...]) -> str:
    return {1: "Scalar", 3: "Vector", 9: "Tensor"}.get(int(np.prod(shape[1:])), "Matrix")


def _item(kind: str, shape: tuple[int, ...], path: Path, key: str) -> str:
    name, size = "Float" if np.dtype(kind).kind == "f" else "Int", " ".join(str(n) for n in shape)
    form = f'NumberType="{name}" Precision="{np.dtype(kind).itemsize}" Format="HDF"'
    return f'<DataItem Dimensions="{size}" {form}>{escape(f"fields/{path.name}:/{key}")}</DataItem>'
