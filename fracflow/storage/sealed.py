"""Files of a run with seals: digests of all that they hold, by which damage is seen before anything goes on from it.

An array is hashed in pieces of whole rows, PIECE bytes or one row, in original order. On any number of ranks a piece has one
digest (BLAKE2b, 16 bytes; RFC 7693). The root is the digest of names, types, shapes, attributes and all pieces. An array that
grows by rows is a chain: the digest of a row is that of the one before it with the row's bytes (Haber and Stornetta 1991).
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from fracflow.errors import InputError
from fracflow.storage.hdf5 import add_dataset, whole_file
from fracflow.storage.reader import Arrays, Found, Layout, read_h5

SEAL = "seal"  # dataset of digests, and attribute of the root
PIECE = 1 << 20  # bytes
WIDTH = 16  # bytes of a digest
AGAIN = "start the run again with fracflow run"
SLAB = 1 << 21  # bytes of rows of an array that one rank holds for others
_BLOCK = 1 << 24  # bytes of rows that are put together at once

Bytes = NDArray[np.uint8]


@dataclass(frozen=True)
class Slabs:
    """An array that comes in slabs of rows.

    kind   type of its numbers
    shape  that of the whole
    parts  (rows, ...) from the first row to the last
    """

    kind: np.dtype[Any]
    shape: tuple[int, ...]
    parts: Iterable[NDArray[Any]]


@dataclass(frozen=True)
class Sealed:
    """The content of a sealed file.

    arrays  those that were asked for, by name
    notes   attributes
    root    digest over all, in hexadecimal digits; empty where an earlier version left no seal
    """

    arrays: Arrays
    notes: Mapping[str, Any]
    root: str


def digest(*parts: bytes | memoryview) -> bytes:
    """BLAKE2b of parts in a row, WIDTH bytes."""
    found = hashlib.blake2b(digest_size=WIDTH)
    for part in parts:
        found.update(part)
    return found.digest()


def piece_rows(kind: str, shape: Sequence[int]) -> int:
    """Rows of a piece of an array of type ``kind``."""
    return max(1, PIECE // max(1, np.dtype(kind).itemsize * int(np.prod(shape[1:], dtype=np.int64))))


def slabs_of(
    kind: np.dtype[Any], shape: Sequence[int], first: int = 0, last: int | None = None
) -> Iterator[tuple[int, int]]:
    """First row of each slab of an array, and the row after its last: whole pieces, SLAB bytes where a piece is not more.

    first, last  rows that the slabs have to hold, from the first to the one before the last; all without any
    """
    piece, last = piece_rows(kind.str, shape), shape[0] if last is None else last
    if first >= last:
        return
    rows, end = piece * (SLAB // PIECE), min(-(-last // piece) * piece, shape[0])
    for start in range(first // piece * piece, end, rows):
        yield start, min(start + rows, end)


class _Pieces:
    """Digests of the pieces of an array whose rows come in slabs."""

    def __init__(self, kind: str, shape: Sequence[int]) -> None:
        self._rows, self._have, self._ended = piece_rows(kind, shape), 0, b""
        self._open = hashlib.blake2b(digest_size=WIDTH)

    def add(self, slab: NDArray[Any]) -> None:
        """Take the rows (n, ...) that follow."""
        at = 0
        while at < len(slab):
            upto = min(len(slab), at + self._rows - self._have)
            self._open.update(slab[at:upto].reshape(-1).view(np.uint8).data)
            self._have, at = self._have + upto - at, upto
            if self._have == self._rows:
                self._end()

    def _end(self) -> None:
        self._ended += self._open.digest()
        self._have, self._open = 0, hashlib.blake2b(digest_size=WIDTH)

    def digests(self) -> Bytes:
        """(k, WIDTH), once all rows have come."""
        if self._have:
            self._end()
        return np.frombuffer(self._ended, dtype=np.uint8).reshape(-1, WIDTH)


def pieces(values: NDArray[Any]) -> Bytes:
    """Digests (k, WIDTH) of the pieces of an array."""
    found = _Pieces(values.dtype.str, values.shape)
    found.add(np.ascontiguousarray(np.atleast_1d(values)))
    return found.digests()


def root_of(layout: Layout, notes: Mapping[str, Any], digests: Bytes) -> str:
    """The digest over names, types, shapes and notes of a file and its pieces, which are in the order of the names."""
    about = json.dumps([[[name, *layout[name]] for name in sorted(layout)], notes], sort_keys=True)
    return digest(about.encode(), digests.tobytes()).hex()


def layout_of(arrays: Mapping[str, NDArray[Any]]) -> Layout:
    """Types and shapes of arrays (...)."""
    return {name: (values.dtype.str, tuple(values.shape)) for name, values in arrays.items()}


def write_sealed(path: Path, arrays: Mapping[str, Any], notes: Mapping[str, Any], durable: bool = True) -> str:
    """Write arrays and notes with their seal as ``write_slabs`` does; gives the root. Raises OSError."""
    return write_slabs(path, {name: whole(each) for name, each in arrays.items()}, notes, durable)


def whole(values: Any) -> Slabs:
    """An array of which all is there, as one slab; slabs stay as they are."""
    if isinstance(values, Slabs):
        return values
    found = np.asarray(values)
    return Slabs(found.dtype, found.shape, [found])


def write_slabs(path: Path, arrays: Mapping[str, Slabs], notes: Mapping[str, Any], durable: bool = True) -> str:
    """Write arrays and notes with their seal aside, and put the file in the place of the last one; gives the root.

    notes    texts and numbers
    durable  whether it is on disk before it takes that place

    Raises OSError.
    """
    with whole_file(path, is_synced=durable) as file:
        found = {name: _write_slabs(file, name, array) for name, array in arrays.items()}
        digests = np.concatenate([np.zeros((0, WIDTH), np.uint8), *(found[name] for name in sorted(found))])
        root = root_of({name: (array.kind.str, array.shape) for name, array in arrays.items()}, notes, digests)
        _write_slabs(file, SEAL, whole(digests))
        for name, note in {**notes, SEAL: root}.items():
            file.attrs[name] = note
    return root


def _write_slabs(file: h5py.File, name: str, array: Slabs) -> Bytes:
    """Write an array, slab by slab; the digests (k, WIDTH) of its pieces."""
    dataset, found, at = add_dataset(file, name, array.kind, array.shape), _Pieces(array.kind.str, array.shape), 0
    for part in array.parts:
        slab = np.ascontiguousarray(part).reshape(part.shape)
        found.add(np.atleast_1d(slab))
        if slab.shape == array.shape and slab.size:
            dataset.write(h5py.h5s.ALL, h5py.h5s.ALL, slab)
        elif slab.size:
            there = dataset.get_space()
            there.select_hyperslab((at, *(0 for _ in slab.shape[1:])), slab.shape)
            dataset.write(h5py.h5s.create_simple(slab.shape), there, slab)
            at += len(slab)
    return found.digests()


def read_sealed(
    path: Path, what: str, names: Sequence[str] | None = None, remedy: str = AGAIN, ours: str = ""
) -> Sealed:
    """Read arrays of these names, all without any, and the notes, and hold them against the seal.

    what  how a message goes on that cannot read it: "is no checkpoint"
    ours  root that the file must have; any without one

    Raises InputError that names the file and the array.
    """
    found = read_h5(path, what, remedy, None if names is None else [*names, SEAL])
    seal, arrays = _Seal(path, found, remedy), {name: each for name, each in found.arrays.items() if name != SEAL}
    for name, values in arrays.items():
        seal.check_rows(name, values)
    seal.check_root(ours)
    return Sealed(arrays, seal.notes, seal.root)


class SealedFile:
    """A sealed file of which slabs of rows are read; names, shapes and notes are held against the seal at once."""

    def __init__(self, path: Path, what: str, remedy: str = AGAIN, ours: str = "") -> None:
        """Arguments as of ``read_sealed``. Raises InputError."""
        self._path, self._what, self._remedy = path, what, remedy
        self._seal = _Seal(path, read_h5(path, what, remedy, [SEAL]), remedy)
        self._seal.check_root(ours)

    @property
    def place(self) -> tuple[Path, str]:
        """Where it lies, and the root of its seal."""
        return self._path, self._seal.root

    @property
    def layout(self) -> Layout:
        """Types and shapes of its arrays."""
        return self._seal.layout

    @property
    def notes(self) -> Mapping[str, Any]:
        """Its attributes."""
        return self._seal.notes

    def rows(self, name: str, first: int, last: int) -> NDArray[Any]:
        """Rows (n, ...) of an array, of whole pieces, as they were sealed. Raises InputError."""
        found = read_h5(self._path, self._what, self._remedy, [name], rows=(first, last)).arrays.get(name)
        if found is None or len(found) != last - first:
            raise InputError(f"{self._path}: {self._what} ({name} has not all of its rows); {self._remedy}")
        self._seal.check_rows(name, found, first)
        return found

    def array(self, name: str) -> NDArray[Any]:
        """An array (rows, ...), whole. Raises InputError."""
        kind, shape = self.layout.get(name, ("", (0,)))
        if not kind:
            raise InputError(f"{self._path}: {self._what} (it has no {name}); {self._remedy}")
        none = np.zeros((0, *shape[1:]), np.dtype(kind))
        return np.concatenate([none, *(self.rows(name, *each) for each in slabs_of(none.dtype, shape))])

    def each(self, name: str, step: int) -> NDArray[Any]:
        """Every so manieth row (k, ...) of an array, from the first on. Raises InputError."""
        kind, shape = self.layout.get(name, ("<i8", (0,)))
        parts = [self.rows(name, *each)[-each[0] % step :: step] for each in slabs_of(np.dtype(kind), shape)]
        return np.concatenate([np.zeros(0, np.dtype(kind)), *parts])


class _Seal:
    """The seal of a file, with its layout and notes. Where an earlier version left none, all passes."""

    def __init__(self, path: Path, found: Found, remedy: str) -> None:
        self._path, self._remedy = path, remedy
        self.layout, self.notes = dict(found.layout), dict(found.attributes)
        self.root, self._digests = str(self.notes.pop(SEAL, "")), found.arrays.get(SEAL)
        self._is_there = self.layout.pop(SEAL, None) is not None or bool(self.root)
        self._starts = _starts(self.layout)

    def check_rows(self, name: str, values: NDArray[Any], first: int = 0) -> None:
        """Hold rows, from the ``first`` of a piece on, against their digests. Raises InputError."""
        if not self._is_there:
            return
        digests = self._sound()
        if len(digests) != self._starts[""]:
            return  # nor is the root that of these
        mine, rows = pieces(values), piece_rows(*self.layout[name])
        at = self._starts[name] + first // rows
        wrong = np.flatnonzero((digests[at : at + len(mine)] != mine).any(axis=1))
        if len(wrong):
            start = first + int(wrong[0]) * rows
            last = min(start + rows, first + len(np.atleast_1d(values))) - 1
            raise InputError(f"{self._path}: {name}, rows {start} to {last}, is not as it was sealed; {self._remedy}")

    def check_root(self, ours: str) -> None:
        """Hold names, shapes and notes against the root, and that against ``ours`` if it is known. Raises InputError."""
        if not self._is_there and not ours:
            return
        if self.root != root_of(self.layout, self.notes, self._sound()):
            raise InputError(f"{self._path}: its notes, names or shapes are not as they were sealed; {self._remedy}")
        if ours and self.root != ours:
            why = "is not of this run: its seal is another than checkpoint.h5 says"
            raise InputError(f"{self._path}: {why}; {self._remedy}")

    def _sound(self) -> Bytes:
        digests = self._digests
        if digests is None or digests.dtype != np.uint8 or digests.shape[1:] != (WIDTH,):
            raise InputError(f"{self._path}: its seal is damaged; {self._remedy}")
        return digests


def _starts(layout: Layout) -> dict[str, int]:
    """First piece of each array, and under "" how many there are."""
    found, total = {}, 0
    for name in sorted(layout):
        kind, shape = layout[name]
        found[name] = total
        total += -(-(shape[0] if shape else 1) // piece_rows(kind, shape))
    return {**found, "": total}


def chain_start(layout: Layout, notes: Mapping[str, Any]) -> bytes:
    """The start of a chain of rows: the digest of names, types, shapes of a row, and notes."""
    rows = [[name, layout[name][0], list(layout[name][1][1:])] for name in sorted(layout)]
    return digest(json.dumps([rows, notes], sort_keys=True).encode())


def chain(last: bytes, columns: Mapping[str, NDArray[Any]]) -> Bytes:
    """Digests (rows, WIDTH) of rows that follow the one with the digest ``last``.

    columns  name -> (rows, ...); the bytes of a row are those of its columns in the order of their names
    """
    found = []
    for row in _rows(columns):
        last = digest(last, row)
        found.append(last)
    return np.frombuffer(b"".join(found), dtype=np.uint8).reshape(-1, WIDTH)


def _rows(columns: Mapping[str, NDArray[Any]]) -> Iterator[bytes]:
    names = sorted(columns)
    count = min((len(columns[name]) for name in names), default=0)
    if count == 1:  # of a step
        yield b"".join([columns[name].tobytes() for name in names])
        return
    width = sum(columns[name].nbytes // max(1, len(columns[name])) for name in names)
    step = max(1, _BLOCK // max(1, width))
    for at in range(0, count, step):
        upto = min(at + step, count)
        parts = [np.ascontiguousarray(columns[name][at:upto]).reshape(upto - at, -1) for name in names]
        block = np.concatenate([part.view(np.uint8).reshape(upto - at, -1) for part in parts], axis=1)
        for row in block:
            yield row.tobytes()
