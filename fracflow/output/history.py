"""history.h5: one row a step in every dataset, readable while the run goes on and after a kill."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import ArrayLike, NDArray

from fracflow.errors import InputError
from fracflow.files_hdf import Committed, Completed, complete
from fracflow.output.folder import to_json

_ROWS_A_CHUNK = 256


class HistoryFile:
    """Writer of a history: a chunked dataset for each key, all made by the first record (HDF5 SWMR).

    path   file to write; replaced if it exists
    attrs  metadata of the run (units, versions, ...); all but strings and numbers are stored as JSON

    ``time`` is the last dataset that a record is written to: a step that has its time is complete. Until the first
    record the file is PATH.part, for HDF5 could not read it after a kill. Each record is committed as a whole: beside the
    file is PATH.redo until it is closed, which ``read_history`` looks at. Raises OSError where a record cannot be written.
    """

    def __init__(self, path: str | Path, attrs: Mapping[str, Any] | None = None) -> None:
        self.path = Path(path)
        self._part = self.path.with_name(self.path.name + ".part")
        if self.path.exists():
            complete(self.path)
        self._disk, self._is_shown = Committed(self._part), False
        self._disk.path = self.path
        self._file = h5py.File(self._disk, "w", libver="latest")
        self._sets: dict[str, h5py.Dataset] = {}
        self._rows = 0
        for name, value in (attrs or {}).items():
            self._file.attrs[name] = value if isinstance(value, str | int | float) else to_json(value)
        self._file.flush()

    @classmethod
    def resume(cls, path: str | Path, rows: int) -> HistoryFile:
        """Go on after the first ``rows`` records of the history at ``path``; what follows them is dropped."""
        old = read_history(path)
        found = len(old.get("time", ()))
        if rows > found:
            raise InputError(f"{path}: has {found} steps, not {rows}; resume from an earlier one")
        history = cls(path, read_attributes(path))
        if old:
            history._create(old)
            history._extend({key: values[:rows] for key, values in old.items()})
            history._show()
        return history

    def append(self, record: Mapping[str, ArrayLike]) -> None:
        """Add one step.

        record  key -> number or array; keys are paths in the file ("time", "energy/kinetic", ...), the same
                in every record; arrays keep their shape. Raises ValueError naming a key that differs.
        """
        row = {key: _stored(value)[None] for key, value in record.items()}
        if not self._sets:
            self._create(row)
        elif row.keys() != self._sets.keys():
            odd = sorted(row.keys() ^ self._sets.keys())
            raise ValueError(f"history record: keys {odd} are not in every record; all must be in the first")
        self._extend(row)
        self._show()

    def close(self) -> None:
        """Close the file, if it is open; a closed history needs no SWMR reader. Raises OSError."""
        if self._disk.file < 0:
            return
        try:
            self._file.close()
            self._show()
        finally:
            self._disk.close()
        self._disk.check()

    def __enter__(self) -> HistoryFile:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _show(self) -> None:
        self._disk.commit()
        if not self._is_shown:  # whole from its first record on
            os.replace(self._part, self.path)
            self._disk.protect(self.path)
            self._is_shown = True

    def _create(self, columns: Mapping[str, NDArray[Any]]) -> None:
        if "time" not in columns:
            raise ValueError('history record: the key "time" is missing')
        for key, values in columns.items():
            shape = values.shape[1:]
            chunk = (max(1, _ROWS_A_CHUNK // max(1, int(np.prod(shape)))), *(max(1, n) for n in shape))
            self._sets[key] = self._file.create_dataset(
                key, shape=(0, *shape), maxshape=(None, *shape), dtype=values.dtype, chunks=chunk
            )
        self._file.flush()
        self._file.swmr_mode = True

    def _extend(self, columns: Mapping[str, NDArray[Any]]) -> None:
        count = len(columns["time"])
        for key in columns:
            if columns[key].shape[1:] != self._sets[key].shape[1:]:
                wrong, right = columns[key].shape[1:], self._sets[key].shape[1:]
                raise ValueError(f"history record: key {key} has shape {wrong}, the first record had {right}")
        for key in [*(name for name in columns if name != "time"), "time"]:
            if key == "time":
                self._file.flush()
            _append(self._sets[key].id, self._rows, np.ascontiguousarray(columns[key]))
        self._sets["time"].flush()
        self._rows += count


def _append(dataset: h5py.h5d.DatasetID, row: int, values: NDArray[Any]) -> None:
    """Write rows at the end; HDF5's own calls, four times as fast as h5py's slices, which a history of many keys feels."""
    dataset.set_extent((row + len(values), *values.shape[1:]))
    space = dataset.get_space()
    space.select_hyperslab((row, *(0 for _ in values.shape[1:])), values.shape)
    dataset.write(h5py.h5s.create_simple(values.shape), space, values)


def read_history(path: str | Path) -> dict[str, NDArray[Any]]:
    """Read all complete steps: key -> (steps, ...); works beside a live writer and after a kill.

    Raises InputError if ``path`` is no history.
    """
    with _opened(path) as file:
        found = dict(_datasets(file))
        rows = min((dataset.shape[0] for dataset in found.values()), default=0)
        return {key: dataset[:rows] for key, dataset in found.items()}


def read_attributes(path: str | Path) -> dict[str, Any]:
    """Metadata that the history was made with; JSON is left as text. Raises InputError like read_history."""
    with _opened(path) as file:
        return dict(file.attrs)


def _opened(path: str | Path) -> h5py.File:
    if not Path(path).is_file():
        raise InputError(f"{path}: no such file; name the folder of a run")
    try:
        return h5py.File(Completed(Path(path)), "r")
    except OSError as error:
        raise InputError(f"{path}: is no readable history ({error}); name a run's history.h5") from error


def _datasets(group: h5py.Group, prefix: str = "") -> Iterator[tuple[str, h5py.Dataset]]:
    for name, item in group.items():
        if isinstance(item, h5py.Group):
            yield from _datasets(item, f"{prefix}{name}/")
        else:
            yield prefix + name, item


def _stored(value: ArrayLike) -> NDArray[Any]:
    array = np.asarray(value)
    if array.dtype == bool:
        return array.astype(np.int8)
    return array.astype(np.int64 if np.issubdtype(array.dtype, np.integer) else np.float64)
