"""history.h5: one row a step in every dataset, readable by any program while the run goes on, and after a kill."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import ArrayLike, NDArray

from fracflow.errors import InputError
from fracflow.output.folder import to_json
from fracflow.storage.hdf5 import Committed, complete, uninterrupted
from fracflow.storage.reader import Found, read_h5
from fracflow.storage.sealed import AGAIN, SEAL, WIDTH, chain, chain_start, layout_of

_ROWS_A_CHUNK = 256
AT_LIMIT, SHUT = 1, 2  # values of well/NAME/limit
MOST_SPANS = 3  # of times in which a well was shut, in a line
_NO_HISTORY, _REMEDY = "is no readable history", f"put back a copy of the file, or {AGAIN}"


class HistoryFile:
    """Writer of a history: a chunked dataset for each key, all made by the first record (HDF5 SWMR).

    path   file to write; replaced if it exists
    attrs  metadata of the run (units, versions, ...); all but strings and numbers are stored as JSON

    lag    whether the file may be behind by as many records as keep that at 1 % of the time; else it has them all

    The file is there from the first record on. It is replaced by another one, never changed: whoever opens it finds whole
    records, those up to the last time that it was replaced. Each record is committed as a whole: those since then are in
    PATH.redo, until the file is closed; ``read_history`` has them all. Records are sealed one by one, in a chain. Raises
    OSError where a record cannot be written.
    """

    @uninterrupted()
    def __init__(self, path: str | Path, attrs: Mapping[str, Any] | None = None, lag: bool = True) -> None:
        self.path, self._lag = Path(path), lag
        if self.path.exists():
            complete(self.path)
        self._disk = Committed(self.path)
        self._file = h5py.File(self._disk, "w", libver="latest")
        self._sets: dict[str, h5py.Dataset] = {}
        self._shapes: dict[str, tuple[int, ...]] = {}  # of a record; h5py asks the file for them
        self._rows, self._last, self._goes_on = 0, b"", False
        self._notes = {k: v if isinstance(v, str | int | float) else to_json(v) for k, v in (attrs or {}).items()}
        for name, value in self._notes.items():
            self._file.attrs[name] = value
        self._file.flush()

    @classmethod
    def resume(cls, path: str | Path, rows: int, seal: str = "") -> HistoryFile:
        """Go on after the first ``rows`` records of the history at ``path``, as ``read_rows``; later ones are dropped."""
        return cls.after(path, *read_rows(path, rows, seal))

    @classmethod
    @uninterrupted()
    def after(cls, path: str | Path, old: Mapping[str, NDArray[Any]], attrs: Mapping[str, Any]) -> HistoryFile:
        """Go on after records (steps, ...), with these attributes."""
        history = cls(path, attrs)
        if old:
            history._create(old)
            history._extend(old)
            history._show()
            history._goes_on = True
        return history

    @property
    def seal(self) -> str:
        """Digest of the last record, in hexadecimal digits; empty before the first."""
        return self._last.hex()

    def append(self, record: Mapping[str, ArrayLike]) -> None:
        """Add one step.

        record  key -> number or array; keys are paths in the file ("time", "energy/kinetic", ...), the same
                in every record; arrays keep their shape. Raises ValueError naming a key that differs.
        """
        self.append_all([record])

    @uninterrupted()
    def append_all(self, records: Sequence[Mapping[str, ArrayLike]]) -> None:
        """Add some steps, at least one, with the same keys; as ``append``.

        Raises ValueError naming a key that differs, and InputError where the file to go on with has other keys.
        """
        values = {key: [_stored(record[key]) for record in records] for key in records[0]}
        row = {_path(key): each[0][None] if len(each) == 1 else np.stack(each) for key, each in values.items()}
        if not self._sets:
            self._create(row)
        elif row.keys() != self._sets.keys():
            odd = sorted(row.keys() ^ self._sets.keys())
            if self._goes_on:
                raise InputError(
                    f"{self.path}: {odd[0]} is not both there and in the steps that follow: probes or controls of the scene"
                    f" were changed; put them back, or {AGAIN}"
                )
            raise ValueError(f"history record: keys {odd} are not in every record; all must be in the first")
        self._extend(row)
        self._show()

    @uninterrupted()
    def close(self) -> None:
        """Close the file, if it is open, with all records in it. Raises OSError."""
        if self._disk.file < 0:
            return
        try:
            self._file.close()
            self._show(is_last=True)
        finally:
            self._disk.close()
        self._disk.check()

    def __enter__(self) -> HistoryFile:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _show(self, is_last: bool = False) -> None:
        self._disk.commit()
        if is_last or not self._lag or not self._disk.is_published or self._disk.is_due:
            self._disk.publish()

    def _create(self, columns: Mapping[str, NDArray[Any]]) -> None:
        if "time" not in columns or SEAL in columns:
            raise ValueError(f'history record: the key "time" is missing, or "{SEAL}" is a key')
        for key, values in columns.items():
            shape = values.shape[1:]
            chunk = (max(1, _ROWS_A_CHUNK // max(1, int(np.prod(shape)))), *(max(1, n) for n in shape))
            self._shapes[key] = shape
            self._sets[key] = self._file.create_dataset(
                key, shape=(0, *shape), maxshape=(None, *shape), dtype=values.dtype, chunks=chunk
            )
        rows = (_ROWS_A_CHUNK, WIDTH)
        self._seals = self._file.create_dataset(SEAL, shape=(0, WIDTH), maxshape=(None, WIDTH), dtype="u1", chunks=rows)
        self._last = chain_start(layout_of(columns), self._notes)
        self._file.attrs[SEAL] = self._last.hex()
        self._file.flush()
        self._file.swmr_mode = True

    def _extend(self, columns: Mapping[str, NDArray[Any]]) -> None:
        count = len(columns["time"])
        for key in columns:
            wrong, right = columns[key].shape[1:], self._shapes[key]
            if wrong != right:
                raise ValueError(f"history record: key {key} has shape {wrong}, the first record had {right}")
        seals = chain(self._last, columns)
        place = lru_cache(partial(_place, self._rows))
        for key in [*(name for name in columns if name != "time"), "time"]:
            if key == "time":
                _append(self._seals.id, seals, *place(seals.shape))
                self._file.flush()
            values = np.ascontiguousarray(columns[key])
            _append(self._sets[key].id, values, *place(values.shape))
        self._sets["time"].flush()
        self._rows += count
        self._last = seals[-1].tobytes() if count else self._last


@lru_cache(maxsize=4096)
def _path(key: str) -> str:
    """A key as HDF5 takes it: without empty parts, and without those that say "here"."""
    return "/".join(part for part in key.split("/") if part not in ("", "."))


def _place(row: int, shape: tuple[int, ...]) -> tuple[h5py.h5s.SpaceID, h5py.h5s.SpaceID]:
    """Rows of a shape in memory, and behind so many rows of a dataset."""
    space = h5py.h5s.create_simple((row + shape[0], *shape[1:]), (h5py.h5s.UNLIMITED, *shape[1:]))
    space.select_hyperslab((row, *(0 for _ in shape[1:])), shape)
    return h5py.h5s.create_simple(shape), space


def _append(
    dataset: h5py.h5d.DatasetID, values: NDArray[Any], memory: h5py.h5s.SpaceID, space: h5py.h5s.SpaceID
) -> None:
    """Write rows at the end; HDF5's own calls are four times as fast as h5py's slices, which matters with many keys."""
    dataset.set_extent(space.shape)
    dataset.write(memory, space, values)


def read_history(path: str | Path) -> dict[str, NDArray[Any]]:
    """Read all complete steps: key -> (steps, ...); works beside a live writer and after a kill.

    Raises InputError if ``path`` is no history, or a step in it is not as it was written.
    """
    return _read(path)[0]


def read_rows(path: str | Path, rows: int, seal: str = "") -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """The first ``rows`` records (rows, ...) and attributes; the last must have the digest ``seal`` where there is one.

    Raises InputError where there are fewer, or one of them is not as it was written; later ones may be anything.
    """
    old, attrs, last = _read(path, rows, must=bool(seal))
    found = len(old.get("time", ()))
    if rows > found:
        raise InputError(f"{path}: has {found} steps, not {rows} as checkpoint.h5 says; {AGAIN}")
    if seal and last != seal:
        raise InputError(f"{path}: step {rows - 1} is not that of checkpoint.h5; {AGAIN}")
    return old, attrs


def read_attributes(path: str | Path) -> dict[str, Any]:
    """Metadata that the history was made with; JSON is left as text. Raises InputError like read_history."""
    found = _found(path, ())
    _check_start(path, found)
    return {name: value for name, value in found.attributes.items() if name != SEAL}


def read_table(path: str | Path, key: str, attrs: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """A mapping that the attributes keep as JSON: units, probes, wells; empty without it. Raises InputError for any other."""
    try:
        found = json.loads((read_attributes(path) if attrs is None else attrs).get(key, "{}"))
        if isinstance(found, dict):
            return found
    except (ValueError, TypeError, RecursionError):
        pass
    raise InputError(f"{path}: its attribute {key} is no table; {_REMEDY}")


def shut_times(history: Mapping[str, NDArray[Any]], well: str) -> list[tuple[float, float]]:
    """When a well was shut by a limit of its pressure, from histories (n,): begin and end of each such time [time]."""
    shut = history.get(f"well/{well}/limit", np.zeros(0)) == SHUT
    times, changes = history["time"], np.flatnonzero(np.diff(np.concatenate([[False], shut, [False]]).astype(int)))
    return [(float(times[max(first - 1, 0)]), float(times[end - 1])) for first, end in changes.reshape(-1, 2)]


def shut_line(history: Mapping[str, NDArray[Any]], well: str, as_text: Callable[[float], str]) -> str:
    """A line on when a well was shut, from histories (n,), with times as ``as_text`` writes them; empty if it never was."""
    spans = [f"from {as_text(begin)} to {as_text(end)}" for begin, end in shut_times(history, well)]
    more = f" and {len(spans) - MOST_SPANS} times more" if len(spans) > MOST_SPANS else ""
    return f"well.{well} was shut by a limit of its pressure {', '.join(spans[:MOST_SPANS])}{more}" if spans else ""


def read_units(path: str | Path, attrs: Mapping[str, Any] | None = None) -> dict[str, str]:
    """Names of the units of length, force and time, as a history has them; empty without. Raises InputError."""
    return {name: str(unit) for name, unit in read_table(path, "units", attrs).items()}


def _read(
    path: str | Path, rows: int | None = None, must: bool = False
) -> tuple[dict[str, NDArray[Any]], dict[str, Any], str]:
    """Records, all or the first ``rows``, attributes, and the digest of the last record, empty where there are no seals."""
    found = _found(path)
    columns = {name: values[:rows] for name, values in found.arrays.items()}
    start, seals = _check_start(path, found), columns.pop(SEAL, None)
    attrs = {name: value for name, value in found.attributes.items() if name != SEAL}
    if columns and ("time" not in columns or columns["time"].dtype.kind != "f"):
        raise InputError(f"{path}: {_NO_HISTORY} (it has no time); {_REMEDY}")
    for name, values in columns.items():
        if values.ndim != 1 and (name == "time" or name.startswith(("step/", "energy/", "well/", "volume/"))):
            raise InputError(f"{path}: {_NO_HISTORY} ({name} has {values.ndim} dimensions); {_REMEDY}")
        if 0 in values.shape[1:]:
            raise InputError(f"{path}: {_NO_HISTORY} ({name} has steps without a number); {_REMEDY}")
    if seals is None or not start:
        if must:
            raise InputError(f"{path}: its seal is missing; {AGAIN}")
        return columns, attrs, ""
    if seals.dtype != np.uint8 or seals.shape[1:] != (WIDTH,):
        raise InputError(f"{path}: its seal is damaged; {_REMEDY}")
    mine = chain(start, columns)
    wrong = np.flatnonzero((mine != seals).any(axis=1))
    if len(wrong):
        raise InputError(
            f"{path}: step {wrong[0]} is not as it was written, those before it are; put back a copy of the file, or {AGAIN}"
        )
    return columns, attrs, (mine[-1].tobytes() if len(mine) else start).hex()


def _check_start(path: str | Path, found: Found) -> bytes:
    """The start of the chain, empty where there are no seals. Raises InputError where attributes or names were changed."""
    layout = {name: about for name, about in found.layout.items() if name != SEAL}
    notes = {name: value for name, value in found.attributes.items() if name != SEAL}
    if SEAL not in found.attributes and SEAL not in found.layout:
        return b""
    start = chain_start(layout, notes)
    if SEAL not in found.layout or found.attributes.get(SEAL) != start.hex():
        raise InputError(f"{path}: its attributes or names are not as they were written; {AGAIN}")
    return start


def _found(path: str | Path, names: tuple[str, ...] | None = None) -> Found:
    if not Path(path).is_file():
        raise InputError(f"{path}: no such file; name the folder of a run")
    found = read_h5(path, _NO_HISTORY, _REMEDY, names, live=True)
    if any(not shape for _, shape in found.layout.values()):
        raise InputError(f"{path}: {_NO_HISTORY} (not all it holds has rows); {_REMEDY}")
    return found


def _stored(value: ArrayLike) -> NDArray[Any]:
    array = np.asarray(value)
    if array.dtype == bool:
        return array.astype(np.int8)
    return array.astype(np.int64 if np.issubdtype(array.dtype, np.integer) else np.float64)
