"""Files of a run with seals: digests of all that they hold, by which damage is seen before anything goes on from it.

An array is hashed in pieces of whole rows, PIECE bytes or one row, in original order. On any number of ranks a piece has one
digest (BLAKE2b, 16 bytes; RFC 7693). The root is the digest of names, types, shapes, attributes and all pieces. An array that
grows by rows is a chain: the digest of a row is that of the one before it with the row's bytes (Haber and Stornetta 1991).
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from fracflow.errors import InputError
from fracflow.storage.hdf5 import add_dataset, whole_file
from fracflow.storage.reader import Arrays, Layout, read_h5

SEAL = "seal"  # dataset of digests, and attribute of the root
PIECE = 1 << 20  # bytes
WIDTH = 16  # bytes of a digest
AGAIN = "start the run again with fracflow run"
_BLOCK = 1 << 24  # bytes of rows that are put together at once

Bytes = NDArray[np.uint8]


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


def pieces(values: NDArray[Any]) -> Bytes:
    """Digests (k, WIDTH) of the pieces of an array."""
    rows, count = piece_rows(values.dtype.str, values.shape), len(np.atleast_1d(values))
    whole = np.ascontiguousarray(np.atleast_1d(values))
    found = [digest(whole[at : at + rows].reshape(-1).view(np.uint8).data) for at in range(0, count, rows)]
    return np.frombuffer(b"".join(found), dtype=np.uint8).reshape(-1, WIDTH)


def root_of(layout: Layout, notes: Mapping[str, Any], digests: Bytes) -> str:
    """The digest over names, types, shapes and notes of a file and its pieces, which are in the order of the names."""
    about = json.dumps([[[name, *layout[name]] for name in sorted(layout)], notes], sort_keys=True)
    return digest(about.encode(), digests.tobytes()).hex()


def layout_of(arrays: Mapping[str, NDArray[Any]]) -> Layout:
    """Types and shapes of arrays (...)."""
    return {name: (values.dtype.str, tuple(values.shape)) for name, values in arrays.items()}


def write_sealed(path: Path, arrays: Mapping[str, Any], notes: Mapping[str, Any], durable: bool = True) -> str:
    """Write arrays and notes with their seal aside, and put the file in the place of the last one; gives the root.

    notes    texts and numbers
    durable  whether it is on disk before it takes that place

    Raises OSError.
    """
    values = {name: np.asarray(each) for name, each in arrays.items()}
    digests = np.concatenate([np.zeros((0, WIDTH), np.uint8), *(pieces(values[name]) for name in sorted(values))])
    root = root_of(layout_of(values), notes, digests)
    with whole_file(path, is_synced=durable) as file:
        for name, each in (*values.items(), (SEAL, digests)):
            dataset = add_dataset(file, name, each.dtype, each.shape)
            if each.size:
                dataset.write(h5py.h5s.ALL, h5py.h5s.ALL, np.ascontiguousarray(each).reshape(each.shape))
        for name, note in {**notes, SEAL: root}.items():
            file.attrs[name] = note
    return root


def read_sealed(
    path: Path, what: str, names: Sequence[str] | None = None, remedy: str = AGAIN, ours: str = ""
) -> Sealed:
    """Read arrays of these names, all without any, and the notes, and hold them against the seal.

    what  how a message goes on that cannot read it: "is no checkpoint"
    ours  root that the file must have; any without one

    Raises InputError that names the file and the array.
    """
    found = read_h5(path, what, remedy, None if names is None else [*names, SEAL])
    layout, arrays, notes = dict(found.layout), dict(found.arrays), dict(found.attributes)
    root, digests = str(notes.pop(SEAL, "")), arrays.pop(SEAL, None)
    known = layout.pop(SEAL, None)
    if not root and known is None and not ours:
        return Sealed(arrays, notes, "")
    starts = _starts(layout)
    if digests is None or digests.dtype != np.uint8 or digests.shape[1:] != (WIDTH,):
        raise InputError(f"{path}: its seal is damaged; {remedy}")
    for name, values in arrays.items() if len(digests) == starts[""] else ():
        mine = pieces(values)
        wrong = np.flatnonzero((digests[starts[name] : starts[name] + len(mine)] != mine).any(axis=1))
        if len(wrong):
            rows = piece_rows(*layout[name])
            first, last = int(wrong[0]) * rows, min((int(wrong[0]) + 1) * rows, len(np.atleast_1d(values))) - 1
            raise InputError(f"{path}: {name}, rows {first} to {last}, is not as it was sealed; {remedy}")
    if root != root_of(layout, notes, digests):
        raise InputError(f"{path}: its notes, names or shapes are not as they were sealed; {remedy}")
    if ours and root != ours:
        raise InputError(f"{path}: is not of this run: its seal is another than checkpoint.h5 says; {remedy}")
    return Sealed(arrays, notes, root)


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
