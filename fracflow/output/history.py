"""history.h5: one row a step in every dataset, readable by any program while the run goes on, and after a kill."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from math import prod
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import ArrayLike, NDArray

from fracflow.errors import InputError
from fracflow.output.folder import to_json
from fracflow.storage.hdf5 import Growing, add_dataset, beside, complete, rows_in, uninterrupted
from fracflow.storage.reader import Found, Layout, read_h5
from fracflow.storage.sealed import AGAIN, SEAL, WIDTH, chain, chain_start, digest, layout_of

_ROWS_A_CHUNK = 256
AT_LIMIT, SHUT = 1, 2  # values of well/NAME/limit
ROUND_OFF = 1e-9  # of the largest value of a history
MOST_SPANS = 3  # of times in which a well was shut, in a line
_NO_HISTORY, _REMEDY = "is no readable history", f"put back a copy of the file, or {AGAIN}"


class HistoryFile:
    """Writer of a history: a chunked dataset for each key, all made by the first record.

    path   file to write; replaced if it exists
    attrs  metadata of the run (units, versions, ...); all but strings and numbers are stored as JSON

    lag    whether the file may be behind by as many records as keep that at 1 % of the time; else it has them all

    The file is there from the first record on. It is replaced by another one, never changed: whoever opens it finds whole
    records, those up to the last time that it was replaced. Those since then are in PATH.redo, until the file is closed.
    Each is there, whole, when ``append`` returns. ``read_history`` has them all. Records are sealed one by one, in a chain.
    Raises OSError where a record cannot be written.
    """

    @uninterrupted()
    def __init__(self, path: str | Path, attrs: Mapping[str, Any] | None = None, lag: bool = True) -> None:
        self.path, self._lag = Path(path), lag
        if self.path.exists():
            complete(self.path)
        self._disk = Growing(self.path)
        self._file = h5py.File(self._disk, "w", libver="latest")
        self._sets: dict[str, h5py.h5d.DatasetID] = {}
        self._paths: dict[str, str] = {}  # of the keys of a record
        self._kept: list[bytes] = []  # records, with their digests, that are not in the file
        self._rows, self._last, self._goes_on = 0, b"", False
        self._notes = {k: v if isinstance(v, str | int | float) else to_json(v) for k, v in (attrs or {}).items()}
        for name, value in self._notes.items():
            self._file.attrs[name] = value

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
            seals = chain(history._last, old)
            history._disk.publish(lambda: history._extend({**old, SEAL: seals}))
            history._last, history._goes_on = seals[-1].tobytes() if len(seals) else history._last, True
        return history

    @property
    def seal(self) -> str:
        """Digest of the last record, in hexadecimal digits; empty before the first."""
        return self._last.hex()

    @uninterrupted()
    def append(self, record: Mapping[str, ArrayLike]) -> None:
        """Add one step.

        record  key -> number or array; keys are paths in the file ("time", "energy/kinetic", ...), the same
                in every record; arrays keep their shape

        Whole numbers stay whole. Raises ValueError naming a key that differs, and InputError where the file to go on with has
        other keys.
        """
        if self._paths.keys() != record.keys():
            self._paths = self._paths_of(record)
        row = self._row.packed({self._paths[key]: value for key, value in record.items()})
        self._last = digest(self._last, row)
        self._kept.append(row + self._last)
        if not self._lag or self._disk.is_due(len(self._kept[-1])):
            self._disk.publish(self._unload)
        else:
            self._disk.put_down(self._rows + len(self._kept) - 1, self._kept[-1])

    @uninterrupted()
    def close(self) -> None:
        """Close the file, if it is open, with all records in it. Raises OSError."""
        if self._disk.file < 0:
            return
        try:
            self._unload()
            self._file.close()
            self._disk.publish(lambda: None)
        finally:
            self._disk.close()
        self._disk.check()

    def __enter__(self) -> HistoryFile:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _paths_of(self, record: Mapping[str, ArrayLike]) -> dict[str, str]:
        """Where the values of a record go. The first one makes the datasets."""
        paths = {key: _path(key) for key in record}
        if not self._sets:
            self._create({paths[key]: _stored(value)[None] for key, value in record.items()})
        elif odd := sorted(set(paths.values()) ^ self._sets.keys() - {SEAL}):
            if self._goes_on:
                raise InputError(
                    f"{self.path}: {odd[0]} is not both there and in the steps that follow: probes or controls of the scene"
                    f" were changed; put them back, or {AGAIN}"
                )
            raise ValueError(f"history record: keys {odd} are not in every record; all must be in the first")
        return paths

    def _create(self, columns: Mapping[str, NDArray[Any]]) -> None:
        if "time" not in columns or SEAL in columns:
            raise ValueError(f'history record: the key "time" is missing, or "{SEAL}" is a key')
        layout = layout_of(columns)
        self._row = Row(layout)
        for key, (kind, (_, *shape)) in {**layout, SEAL: ("u1", (0, WIDTH))}.items():
            rows = _ROWS_A_CHUNK if key == SEAL else max(1, _ROWS_A_CHUNK // max(1, prod(shape)))
            chunk = (rows, *(max(1, n) for n in shape))
            self._sets[key] = add_dataset(self._file, key, np.dtype(kind), (0, *shape), chunk)
        self._last = chain_start(layout, self._notes)
        self._file.attrs[SEAL] = self._last.hex()

    def _unload(self) -> None:
        """Bring the records that are kept into the file."""
        kept, self._kept = self._kept, []
        if kept:
            self._extend(self._row.unpacked(kept))

    def _extend(self, columns: Mapping[str, NDArray[Any]]) -> None:
        """Write rows at the end; HDF5's own calls are four times as fast as h5py's slices, which matters with many keys."""
        rows = len(columns["time"])
        for key, values in columns.items():
            shape = values.shape[1:]
            space = h5py.h5s.create_simple((self._rows + rows, *shape), (h5py.h5s.UNLIMITED, *shape))
            space.select_hyperslab((self._rows, *(0 for _ in shape)), values.shape)
            self._sets[key].set_extent(space.shape)
            self._sets[key].write(h5py.h5s.create_simple(values.shape), space, np.ascontiguousarray(values))
        self._rows += rows
        self._file.flush()


class Row:
    """The bytes of a record: those of its values in the order of their names, as a chain has them."""

    def __init__(self, layout: Layout) -> None:
        """That of datasets (steps, ...)."""
        self.names = sorted(layout)
        self._kind = np.dtype([(name, layout[name][0], layout[name][1][1:]) for name in self.names])
        self._with_seal = np.dtype([("row", self._kind), (SEAL, "u1", (WIDTH,))])
        self.size = self._with_seal.itemsize
        self._shapes = [(name, layout[name][1][1:], layout[name][0][1] == "i") for name in self.names]

    def packed(self, record: Mapping[str, ArrayLike]) -> bytes:
        """Those of a record. Raises ValueError naming a key with another shape, or a fraction for a whole number."""
        for name, right, is_whole in self._shapes:
            value = record[name]
            if type(value) is not float or right or is_whole:
                wrong = np.shape(value)
                if wrong != right:
                    raise ValueError(f"history record: key {name} has shape {wrong}, the first record had {right}")
                if is_whole and np.asarray(value).dtype.kind == "f":
                    raise ValueError(f"history record: key {name} is no whole number, that of the first record was")
        row = np.empty((), self._kind)
        row[()] = tuple([record[name] for name in self.names])
        return row.tobytes()

    def unpacked(self, rows: Sequence[bytes]) -> dict[str, NDArray[Any]]:
        """Columns (rows, ...) of records with their digests, which are the column SEAL."""
        table = np.frombuffer(b"".join(rows), self._with_seal)
        return {**{name: table["row"][name] for name in self.names}, SEAL: table[SEAL]}


def _path(key: str) -> str:
    """A key as HDF5 takes it: without empty parts, and without those that say "here"."""
    return "/".join(part for part in key.split("/") if part not in ("", "."))


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


def last_of(values: NDArray[Any]) -> float:
    """The last of values (n,) in time; 0 where it is round-off of the largest, as the rate of a well that is shut."""
    largest = np.abs(values[np.isfinite(values)]).max(initial=0.0)
    return 0.0 if abs(values[-1]) < ROUND_OFF * largest else float(values[-1])


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
    put_down = beside(Path(path))  # before the file, which then has all records before these
    found = _found(path)
    columns = {name: values[:rows] for name, values in _with_rows(found, put_down).items()}
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


def _with_rows(found: Found, put_down: bytes) -> dict[str, NDArray[Any]]:
    """The columns of a file, with the records that follow beside it."""
    if "time" not in found.arrays or SEAL not in found.layout or not put_down:
        return found.arrays
    row = Row({name: about for name, about in found.layout.items() if name != SEAL})
    here = len(found.arrays["time"])
    more = row.unpacked([each for number, each in rows_in(put_down, row.size) if number >= here])
    return {name: np.concatenate([values, more[name]]) for name, values in found.arrays.items()}


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
