"""fields.vtkhdf: all fields of a run in one file of VTK's format with time, which ParaView opens without XDMF.

The file is small: its arrays are views of the data in ``fields`` (HDF5 virtual datasets), so the folder is moved as a whole.
It is replaced whole, and a kill leaves that of an earlier step. Points and cells of the rock come first, then those of the
fractures. Where a field is not defined, as slip inside the rock, it is nan, and -1 where it is a number of something.
Format: VTK's documentation, "VTKHDF file format", version 2, UnstructuredGrid with Steps.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from fracflow.mesh.data import Ints
from fracflow.output.fields import FieldWriter
from fracflow.storage import hdf5
from fracflow.storage.hdf5 import whole_file
from fracflow.storage.sealed import Slabs, write_slabs

NAME = "fields.vtkhdf"
GRID = "fields/grid.h5"
_TYPES = np.array([0, 0, 3, 5, 9], dtype=np.uint8)  # VTK's numbers of cells with 2, 3 and 4 nodes
_PLACES = {"point": "PointData", "cell": "CellData"}

Source = tuple[int, str, str, tuple[int, ...]]  # first row, file, dataset, its shape


class VtkHdf:
    """Writer of the file for families of fields, which write the data before."""

    def __init__(self, folder: Path, families: Sequence[FieldWriter]) -> None:
        """Write points and cells, and the file of the steps that are there. Raises OSError."""
        self.folder, self.families = folder, families
        sizes = [(size, count) for family in families for size, count in family.sizes.items()]
        cells = sum(count for _, count in sizes)
        points = sum(family.counts["point"] for family in families)
        kind = np.dtype(np.int64)
        grid = {
            "Points": Slabs(np.dtype(float), (points, 3), chain.from_iterable(each.points.parts for each in families)),
            "Connectivity": Slabs(kind, (sum(size * count for size, count in sizes),), _connectivity(families)),
            "Offsets": Slabs(kind, (cells + 1,), _offsets(families)),
            "Types": Slabs(_TYPES.dtype, (cells,), (_TYPES[each] for each in _sizes(families))),
        }
        self._grid = {name: (each.kind, each.shape) for name, each in grid.items()}
        write_slabs(folder / GRID, grid, {}, durable=False)
        self._again, self._is_behind = 0.0, True
        self.update(is_last=True)

    def update(self, is_last: bool = False) -> None:
        """Bring the file up to date, at a share of the time since it was if it is not the last time. Raises OSError."""
        began = time.monotonic()
        self._is_behind = True
        if is_last or began > self._again:
            self._write()
            self._is_behind = False
            self._again = time.monotonic() + hdf5.SHARE * (time.monotonic() - began)

    def close(self) -> None:
        """Bring the file up to date. Raises OSError."""
        if self._is_behind:
            self.update(is_last=True)

    def _write(self) -> None:
        steps = sorted({index for family in self.families for index in family.steps})
        times = {index: family.steps[index][0] for family in self.families for index in family.steps}
        with whole_file(self.folder / NAME) as file:
            root = file.create_group("VTKHDF")
            root.attrs["Version"] = np.array([2, 0], dtype=np.int64)
            root.attrs.create("Type", b"UnstructuredGrid", dtype=h5py.string_dtype("ascii", 16))
            for name, (kind, shape) in self._grid.items():
                _view(root, name, kind, shape, [(0, GRID, name, shape)])
            arrays = {"Points": "Points", "Cells": "Types", "ConnectivityIds": "Connectivity"}
            totals = {name: self._grid[array][1][0] for name, array in arrays.items()}
            for name, total in totals.items():
                root[f"NumberOf{name}"] = np.array([total], dtype=np.int64)
            about = root.create_group("Steps")
            about.attrs["NSteps"] = len(steps)
            about["Values"] = np.array([times[index] for index in steps])
            none: Ints = np.zeros(len(steps), dtype=np.int64)
            about["NumberOfParts"] = none + 1
            about["PartOffsets"] = about["PointOffsets"] = none
            about["CellOffsets"] = about["ConnectivityIdOffsets"] = none[:, None]
            for place, group in _PLACES.items():
                total = totals["Points" if place == "point" else "Cells"]
                offsets = np.arange(len(steps), dtype=np.int64) * total
                into, at = root.create_group(group), about.create_group(f"{group}Offsets")
                for name, (kind, width, sources) in self._sources(place, steps, total).items():
                    _view(into, name, kind, (len(steps) * total, *width), sources)
                    at[name] = offsets

    def _sources(
        self, place: str, steps: Sequence[int], total: int
    ) -> dict[str, tuple[Any, tuple[int, ...], list[Source]]]:
        """Type, shape of a row, and where its rows are, of each field on points or cells."""
        found: dict[str, tuple[Any, tuple[int, ...], list[Source]]] = {}
        first = 0
        for family in self.families:
            for number, index in enumerate(steps):
                for key, (kind, shape) in family.steps.get(index, (0.0, {}))[1].items():
                    if key.startswith(f"{place}/"):
                        name = key.partition("/")[2]
                        known = found.setdefault(name, (np.dtype(kind), shape[1:], []))
                        if known[:2] == (np.dtype(kind), shape[1:]):
                            known[2].append((number * total + first, f"fields/{family.file(index)}", key, shape))
            first += family.counts[place]
        return found


def _connectivity(families: Sequence[FieldWriter]) -> Iterator[Ints]:
    first = 0
    for family in families:
        for part in family.cells.parts:
            yield part[part >= 0] + first
        first += family.counts["point"]


def _sizes(families: Sequence[FieldWriter]) -> Iterator[Ints]:
    return ((part >= 0).sum(axis=1) for family in families for part in family.cells.parts)


def _offsets(families: Sequence[FieldWriter]) -> Iterator[Ints]:
    last: Ints = np.zeros(1, dtype=np.int64)
    yield last
    for sizes in _sizes(families):
        found = last[-1] + np.cumsum(sizes)
        yield found
        last = found if len(found) else last


def _view(group: h5py.Group, name: str, kind: Any, shape: tuple[int, ...], sources: Sequence[Source]) -> None:
    """An array whose rows are those of datasets in other files; h5py's own layouts take ten times as long."""
    made = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    made.set_fill_value(np.array(np.nan if np.dtype(kind).kind == "f" else -1).astype(kind))
    for first, file, key, size in sources:
        if size[0]:
            space = h5py.h5s.create_simple(shape)
            space.select_hyperslab((first, *(0 for _ in size[1:])), size)
            made.set_virtual(space, file.encode(), f"/{key}".encode(), h5py.h5s.create_simple(size))
    h5py.h5d.create(group.id, name.encode(), h5py.h5t.py_create(np.dtype(kind)), h5py.h5s.create_simple(shape), made)
