"""HDF5 files that a full disk cannot break: HDF5 writes through objects of ours, which never report an error to it.

HDF5 cannot let go of a file that it could not write: it keeps what is left of it, and crashes when the program ends.
"""

from __future__ import annotations

import os
import signal
import struct
import time
import zlib
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from fracflow.storage.files import CHUNK, open_fresh, open_own, part_of, replacing

SHARE = 100.0  # of the CPU time that it takes to bring a file up to date, and a tenth of the time, lie between two such times
LONGEST_REDO = 16 << 20  # bytes of changes beside it
Writes = list[tuple[int, bytes]]  # offset in the file, and bytes
_MAGIC, _ROW = b"FRACREDO", b"FRACROWS"  # of a change at places in the file, as earlier versions put down; of a row
_HEAD, _WRITE = struct.Struct("<8sIQ"), struct.Struct("<QQ")  # magic, checksum, length; offset or row, length
_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_SMALL = 1 << 16  # bytes: metadata, not arrays
_LARGEST, _GROWS = 1 << 28, 1 << 28  # bytes of a change, and by how many it may lengthen its file
_SUPERBLOCK, _VERSION, _FLAGS, _END = 48, 8, 11, 28  # bytes of the head of a file, and where in it things are
_WRITING, _SHARED = 1, 4  # flags of a file that is written, and may be read meanwhile


class Backing:
    """A file in the form that HDF5 needs. ``error`` is the first that there was; what comes after it is left out."""

    def __init__(self, path: Path) -> None:
        """Make the file, empty. Raises OSError."""
        self._begin(path, [])
        self.file = open_fresh(path)

    def _begin(self, path: Path, writes: Writes) -> None:
        self.path, self.size, self._at, self._writes = path, 0, 0, writes
        self.error: OSError | None = None

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Where the next bytes are read or written; from the start or the end."""
        self._at = offset + (self.size if whence == os.SEEK_END else 0)
        return self._at

    def tell(self) -> int:
        """Where that is."""
        return self._at

    def read(self, size: int = -1) -> bytes:
        """Bytes from there on; h5py asks for ``readinto``."""
        into = bytearray(max(0, self.size - self._at) if size < 0 else size)
        self.readinto(memoryview(into))
        return bytes(into)

    def readinto(self, into: memoryview) -> int:
        """Fill a buffer; zeros where nothing has been written."""
        view = memoryview(into).cast("B")
        view[:] = bytes(len(view))
        try:
            found = os.pread(self.file, len(view), self._at)
            view[: len(found)] = found
        except OSError as error:
            self._keep(error)
        lay_over(view, self._at, self._written(self._at, self._at + len(view)))
        return len(view)

    def _written(self, start: int, end: int) -> Writes:
        """Writes that are not in the file yet, and may have bytes of a stretch of it, in their order."""
        return self._writes

    def write(self, data: memoryview) -> int:
        """Put bytes there."""
        self._put(self._at, bytes(data))
        self.size = max(self.size, self._at + len(data))
        return len(data)

    def truncate(self, size: int | None = None) -> int:
        """Cut or lengthen the file."""
        self.size = self._at if size is None else size
        self._try(lambda: os.ftruncate(self.file, self.size))
        return self.size

    def flush(self) -> None:
        """All is written at once."""

    def sync(self) -> None:
        """Bring it to disk."""
        self._try(lambda: os.fsync(self.file))

    def close(self) -> None:
        """Close the file."""
        if self.file >= 0:
            file, self.file = self.file, -1
            self._try(lambda: os.close(file))

    def check(self) -> None:
        """Raise the first error that there was."""
        if self.error is not None:
            raise self.error

    def _put(self, offset: int, data: bytes) -> None:
        self._try(lambda: write_all(self.file, data, offset))
        if self.error is not None and len(data) <= _SMALL:  # HDF5 may read it again
            self._writes.append((offset, data))

    def _try(self, action: Callable[[], None]) -> None:
        if self.error is None:
            try:
                action()
            except OSError as error:
                self._keep(error)

    def _keep(self, error: OSError) -> None:
        if self.error is None:
            self.error = OSError(error.errno, error.strerror, str(self.path))


def write_all(file: int, data: bytes, offset: int) -> None:
    """Write all bytes at an offset of an open file. Raises OSError."""
    left = memoryview(data)
    while left:
        done = os.pwrite(file, left, offset)
        left, offset = left[done:], offset + done


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Keep Ctrl-C until HDF5 has returned: raised by an object of ours, it would leave HDF5 in the middle of a call."""
    came: list[int] = []
    try:
        before = signal.signal(signal.SIGINT, lambda number, _: came.append(number))
    except ValueError:  # not in the main thread, and interrupts come to no other
        yield
        return
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        if came:
            signal.raise_signal(signal.SIGINT)


@contextmanager
def whole_file(path: Path, is_synced: bool = False) -> Iterator[h5py.File]:
    """An HDF5 file that is written aside, and put in the place of the last one when it is whole. Raises OSError.

    is_synced   bring it to disk before
    """
    with replacing(path) as part, uninterrupted():
        backing = Backing(part)
        backing.path = path
        try:
            try:
                with h5py.File(backing, "w") as file:
                    yield file
            except (OSError, RuntimeError):
                backing.check()  # the message of HDF5 is less specific
                raise
            if is_synced:
                backing.sync()
        finally:
            backing.close()
        backing.check()


def add_dataset(
    file: h5py.File, name: str, kind: np.dtype[Any], shape: tuple[int, ...], chunk: tuple[int, ...] = ()
) -> h5py.h5d.DatasetID:
    """A new dataset, growing by rows where it has a chunk; HDF5's own calls take a fraction of the time of h5py's.

    name  with the groups that it is in, which are made
    """
    between, made = h5py.h5p.create(h5py.h5p.LINK_CREATE), h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    between.set_create_intermediate_group(True)
    made.set_obj_track_times(False)
    if chunk:
        made.set_chunk(chunk)
    space = h5py.h5s.create_simple(shape, (h5py.h5s.UNLIMITED, *shape[1:]) if chunk else shape)
    return h5py.h5d.create(file.id, name.encode(), h5py.h5t.py_create(kind, logical=True), space, made, between)


class Growing(Backing):
    """A file that grows by rows: what HDF5 has written of it where no name leads to it, and rows that are to follow.

    ``publish`` puts a copy in the place of PATH, whole and as HDF5 closes a file. Any reader may open PATH at any time, and
    keeps what it has opened. Rows that come after that are put down whole in PATH.redo, one after another. PATH with these
    behind it (``rows_in``) is the last state, after a kill too.
    """

    def __init__(self, path: Path) -> None:
        """Make the file, empty. Raises OSError."""
        super().__init__(part_of(path))
        self.path, self._rest, self._pause = path, 0.0, 0.0
        self._try(part_of(path).unlink)
        self._redo, self._put_down, self._published, self._used = -1, 0, 0.0, 0.0

    def is_due(self, size: int) -> bool:
        """Whether PATH may be brought up to date at a share of the time since it was, or a row makes PATH.redo too long."""
        is_long = self._put_down + size > LONGEST_REDO
        if self._redo < 0 or is_long:
            return True
        # by both clocks: on a busy machine time passes while this process waits. The second one takes 50 us to ask
        passed = time.monotonic() - self._published
        return passed > max(self._pause, self._rest) and time.process_time() - self._used > self._rest

    def put_down(self, number: int, row: bytes) -> None:
        """Let a row with a number count, once PATH has those before. Raises OSError; then it does not count."""
        body = _WRITE.pack(number, len(row)) + row
        change = _HEAD.pack(_ROW, zlib.crc32(body), len(body)) + body
        self.check()
        self._try(lambda: write_all(self._redo, change, self._put_down))
        self.check()
        self._put_down += len(change)

    def publish(self, bring_up_to_date: Callable[[], None]) -> None:
        """Put the file in the place of PATH once it was brought up to date, and begin PATH.redo anew. Raises OSError."""
        began, used = time.monotonic(), time.process_time()
        bring_up_to_date()
        self.check()
        self._try(self._copy)
        self.check()
        self._published, self._used = time.monotonic(), time.process_time()
        self._rest, self._pause = SHARE * (self._used - used), 0.1 * SHARE * (self._published - began)

    def close(self) -> None:
        """Close the file; without an error it needs PATH.redo no more."""
        redo, self._redo = self._redo, -1
        if redo >= 0:
            os.close(redo)
            if self.error is None:
                self._try(lambda: redo_of(self.path).unlink(missing_ok=True))
        super().close()

    def _copy(self) -> None:
        with replacing(self.path) as part:
            copy = open_fresh(part)
            try:
                os.ftruncate(copy, self.size)
                for at in range(0, self.size, CHUNK):
                    write_all(copy, os.pread(self.file, min(CHUNK, self.size - at), at), at)
                write_all(copy, _closed(os.pread(self.file, _SUPERBLOCK, 0), self.size, has_grown=True), 0)
            finally:
                os.close(copy)
        before, self._redo, self._put_down = self._redo, open_fresh(redo_of(self.path)), 0
        if before >= 0:
            os.close(before)


class Completed(Backing):
    """A file to read, whether it is still written or its writer was killed, as earlier versions left it.

    Changes at places in it, which they put down beside it, are laid over it. HDF5 takes it for one that was closed: a reader
    that it knows to be beside a writer would wait for ever for what is damaged.
    """

    def __init__(self, path: Path) -> None:
        """Open the file. Raises OSError."""
        while True:
            self.file = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
            self._begin(path, writes_of(path))
            if os.path.samestat(os.fstat(self.file), os.stat(path)):
                break
            os.close(self.file)  # its writer has put another in its place meanwhile
        self.size = max([os.fstat(self.file).st_size, *(offset + len(data) for offset, data in self._writes)])
        head = bytearray(os.pread(self.file, _SUPERBLOCK, 0).ljust(_SUPERBLOCK, b"\0"))
        lay_over(memoryview(head), 0, self._writes)
        last = (0, _closed(bytes(head), self.size, bool(self._writes))[: self.size])
        self._writes = without_overlap([*self._writes, last])
        self._ends = [offset + len(data) for offset, data in self._writes]

    def readinto(self, into: memoryview) -> int:
        """Fill a buffer; zeros where nothing has been written. Raises OSError."""
        found = super().readinto(into)
        self.check()
        return found

    def _written(self, start: int, end: int) -> Writes:
        first, last = bisect_right(self._ends, start), bisect_left(self._writes, (end,))
        return self._writes[first:last]


def lay_over(into: memoryview, start: int, writes: Writes) -> None:
    """Put what writes have of it into a buffer that begins at an offset of the file."""
    for offset, data in writes:
        first, last = max(start, offset), min(start + len(into), offset + len(data))
        if first < last:
            into[first - start : last - start] = data[first - offset : last - offset]


def without_overlap(writes: Writes) -> Writes:
    """The bytes that writes leave, each of them once, by their places; of two at a place the later one counts.

    Cut where any of them begins or ends, stretches are given away from the last write to the first: n log n, whatever
    a stranger writes.
    """
    cuts = sorted({cut for offset, data in writes for cut in (offset, offset + len(data))})
    number = {cut: k for k, cut in enumerate(cuts)}
    free = list(range(len(cuts)))  # where to look for the first stretch at or after the k-th that is not given away
    found = []
    for offset, data in reversed(writes):
        k, end = number[offset], number[offset + len(data)]
        while (k := _first_free(free, k)) < end:
            found.append((cuts[k], data[cuts[k] - offset : cuts[k + 1] - offset]))
            free[k] = k + 1
    return sorted(found)


def _first_free(free: list[int], k: int) -> int:
    while free[k] != k:
        free[k] = k = free[free[k]]  # halves the way for those who come after
    return k


def redo_of(path: Path) -> Path:
    """Where what changes in a file is put down first."""
    return path.with_name(path.name + ".redo")


def writes_of(path: Path) -> Writes:
    """The changes of a file that were put down whole as writes at its places; none where there is no such list."""
    try:
        end = os.stat(path).st_size + _GROWS
    except OSError:
        return []
    writes: Writes = []
    for change in _changes(beside(path), _MAGIC):
        if any(offset + len(data) > end for offset, data in change):
            break
        writes += change
    return writes


def rows_in(put_down: bytes, size: int) -> Writes:
    """Number and bytes of each row in what is ``beside`` a file, up to one that has not this size."""
    rows: Writes = []
    for change in _changes(put_down, _ROW):
        if any(len(row) != size for _, row in change):
            break
        rows += change
    return rows


def beside(path: Path) -> bytes:
    """All that was put down beside a file, of a bounded size; nothing where there is no such list."""
    try:
        with open(os.open(redo_of(path), os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC), "rb") as file:
            return file.read(_LARGEST)
    except OSError:
        return b""


def _changes(put_down: bytes, kind: bytes) -> Iterator[Writes]:
    """The changes of a kind, up to one that is not whole or none of ours."""
    left = memoryview(put_down)
    while len(left) >= _HEAD.size:
        magic, checksum, length = _HEAD.unpack_from(left)
        body, left = left[_HEAD.size : _HEAD.size + length], left[_HEAD.size + length :]
        if magic != kind or len(body) != length or zlib.crc32(body) != checksum:
            return
        writes, at = [], 0
        while at + _WRITE.size <= len(body):
            offset, size = _WRITE.unpack_from(body, at)
            at += _WRITE.size + size
            if not size or at > len(body):
                return
            writes.append((offset, bytes(body[at - size : at])))
        yield writes


def complete(path: Path) -> None:
    """Put changes that lie beside a file in their places. Raises OSError, and InputError for a file of another name too."""
    if writes := writes_of(path):
        file = open_own(path, os.O_RDWR)
        try:
            for offset, data in writes:
                write_all(file, data, offset)
        finally:
            os.close(file)
        redo_of(path).unlink(missing_ok=True)


def _closed(superblock: bytes, size: int, has_grown: bool = False) -> bytes:
    """The head of a file of ``size`` bytes as HDF5 closes it, where it has it open or the file ``has_grown`` since."""
    is_ours = len(superblock) == _SUPERBLOCK and superblock.startswith(_SIGNATURE) and superblock[_VERSION] >= 3
    if not is_ours or not (has_grown or superblock[_FLAGS] & _SHARED):
        return superblock
    head = bytearray(superblock[:-4])
    if struct.pack("<I", _lookup3(bytes(head))) != superblock[-4:]:  # damaged
        return superblock
    head[_FLAGS] &= ~(_WRITING | _SHARED)
    struct.pack_into("<Q", head, _END, size)
    return bytes(head) + struct.pack("<I", _lookup3(bytes(head)))


def _lookup3(data: bytes) -> int:
    """Checksum of HDF5's metadata, of whole words: B. Jenkins, lookup3.c (2006), hashlittle."""
    words = struct.unpack(f"<{len(data) // 4}I", data)
    sums = [(0xDEADBEEF + len(data)) & 0xFFFFFFFF] * 3
    while len(words) > 3:
        sums = [(s + w) & 0xFFFFFFFF for s, w in zip(sums, words, strict=False)]
        words = words[3:]
        a, b, c = 0, 1, 2
        for turn in (4, 6, 8, 16, 19, 4):
            sums[a] = ((sums[a] - sums[c]) & 0xFFFFFFFF) ^ _turned(sums[c], turn)
            sums[c] = (sums[c] + sums[b]) & 0xFFFFFFFF
            a, b, c = b, c, a
    sums = [(s + w) & 0xFFFFFFFF for s, w in zip(sums, (*words, 0, 0), strict=False)]
    c, b, a = 2, 1, 0
    for turn in (14, 11, 25, 16, 4, 14, 24):
        sums[c] = ((sums[c] ^ sums[b]) - _turned(sums[b], turn)) & 0xFFFFFFFF
        c, b, a = a, c, b
    return sums[2]


def _turned(word: int, by: int) -> int:
    return ((word << by) | (word >> (32 - by))) & 0xFFFFFFFF
