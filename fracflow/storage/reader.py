"""HDF5 files read by a process of their own, which a damaged or forged file may crash or hold up: h5_worker."""

from __future__ import annotations

import atexit
import json
import os
import select
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fracflow.errors import InputError
from fracflow.storage import worker as h5_worker
from fracflow.storage.child import environment
from fracflow.storage.files import check_regular

Arrays = dict[str, NDArray[Any]]
Layout = dict[str, tuple[str, tuple[int, ...]]]
"""Name of a dataset -> type, shape."""

PATIENCE = 10.0  # seconds for a small file
START = 120.0  # seconds until the process is ready: a cluster may fetch its libraries through a busy network
SLOWEST = 5e6  # bytes a second of a large one


@dataclass(frozen=True)
class Found:
    """The content of a file: attributes, types and shapes of all datasets, and the requested datasets."""

    attributes: Mapping[str, Any]
    layout: Layout
    arrays: Arrays


class _Refused(ValueError):
    """The answer was a reason."""


class _Broken(Exception):
    """The process that reads ended or hung."""


class _NotStarted(Exception):
    """There is no process that reads, which is no fault of the file."""


class Reader:
    """A process that reads HDF5 files; it starts with the first, and again after one that broke it."""

    def __init__(self) -> None:
        """Before the first file."""
        self._process: subprocess.Popen[bytes] | None = None
        self._owner = 0
        self._lock = threading.Lock()
        self._left = b""
        self._end = 0.0
        self.trusted: Path | None = None

    def read(self, path: Path, names: Sequence[str] | None, live: bool, rows: tuple[int, int] | None = None) -> Found:
        """Datasets of these names, all without any, or ``rows`` of them. Raises ValueError with the reason if it cannot."""
        size = os.stat(path).st_size
        if self.trusted in path.parents:
            try:
                return _found(*h5_worker.read(path, names, live, rows))
            except (RuntimeError, h5_worker.Refused) as error:
                raise ValueError(str(error)) from None
        with self._lock:
            whole = {"path": os.path.abspath(path), "names": None if names is None else list(names), "live": live}
            asked = whole | {"rows": rows}
            try:
                process = self._started()
                self._end = time.monotonic() + PATIENCE + size / SLOWEST
                return self._answer(process, asked, h5_worker.bound(size))
            except _Refused:
                raise
            except _Broken as error:
                self.close()
                raise ValueError(str(error)) from None
            except BaseException:
                self.close()  # it may be in the middle of an answer
                raise

    def close(self) -> None:
        """End the process."""
        process, self._process, self._left = self._process, None, b""
        if process is not None and self._owner == os.getpid():
            process.kill()
            for pipe in (process.stdin, process.stdout):
                if pipe is not None:
                    pipe.close()
            process.wait()

    def _answer(self, process: subprocess.Popen[bytes], asked: Mapping[str, Any], most: int) -> Found:
        assert process.stdin is not None
        try:
            process.stdin.write(json.dumps(asked).encode() + b"\n")
            process.stdin.flush()
        except OSError:
            raise _Broken("the process that reads it has ended") from None
        head, arrays = self._line(), {}
        if "error" in head:
            raise _Refused(head["error"])
        while "end" not in (line := self._line()):
            if "error" in line:
                raise _Refused(line["error"])
            kind = np.dtype(line["dtype"])
            if kind.kind not in "iufb" or not 0 <= kind.itemsize * prod(line["shape"]) <= most:
                raise _Broken("more came of it than it holds")
            values = np.empty(line["shape"], kind)
            most -= values.nbytes
            self._fill(values.reshape(-1).view(np.uint8).data)
            arrays[line["name"]] = values
        return _found(head, arrays)

    def _started(self) -> subprocess.Popen[bytes]:
        if self._process is not None and self._owner == os.getpid() and self._process.poll() is None:
            return self._process
        self.close()
        try:
            self._process = subprocess.Popen(
                [sys.executable, h5_worker.__file__],
                env=environment() | {"OMP_NUM_THREADS": "1"},
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                start_new_session=True,  # Ctrl-C is for those who wait
                bufsize=0,
            )
        except OSError as error:
            raise _NotStarted(f"could not be started: {error.strerror}") from None
        self._owner, self._left, self._end = os.getpid(), b"", time.monotonic() + START
        try:
            self._line()  # which says that it is ready
        except _Broken:
            raise _NotStarted(f"was not ready within {START:g} s, or ended before") from None
        return self._process

    def _more(self, into: memoryview | None = None) -> Any:
        """Bytes that have come, or how many of them were put ``into`` a buffer."""
        assert self._process is not None and self._process.stdout is not None
        pipe: Any = self._process.stdout
        waits = select.poll()
        waits.register(pipe, select.POLLIN)
        if not waits.poll(1e3 * max(0.0, self._end - time.monotonic())):
            raise _Broken("it takes longer to read than any whole file of its size")
        got = os.read(pipe.fileno(), 1 << 16) if into is None else pipe.readinto(into)
        if not got:
            code = self._process.wait()
            raise _Broken(f"the process that read it {f'was ended by signal {-code}' if code < 0 else 'has ended'}")
        return got

    def _line(self) -> dict[str, Any]:
        parts = [self._left]
        while b"\n" not in parts[-1]:
            parts.append(self._more())
        line, _, self._left = b"".join(parts).partition(b"\n")
        found: dict[str, Any] = json.loads(line)
        return found

    def _fill(self, view: memoryview) -> None:
        have = min(len(view), len(self._left))
        view[:have], self._left = self._left[:have], self._left[have:]
        while have < len(view):
            have += self._more(view[have:])


def _found(head: Mapping[str, Any], arrays: Arrays) -> Found:
    layout = {name: (kind, tuple(shape)) for name, kind, shape in head["layout"]}
    return Found(head["attributes"], layout, arrays)


_reader = Reader()
atexit.register(_reader.close)


def read_h5(
    path: str | Path,
    what: str,
    remedy: str,
    names: Sequence[str] | None = None,
    live: bool = False,
    rows: tuple[int, int] | None = None,
) -> Found:
    """Read an HDF5 file that may be damaged or forged, in bounded time and memory.

    what    how a message goes on that cannot call it so: "is no checkpoint"
    names   of the datasets to read, all of them without any
    live    whether a run may be writing to it, row by row: all datasets then have the rows that the shortest has
    rows    first of the rows to read, and the one after the last; all of them without any

    Raises InputError, with ``what``, the reason and the ``remedy``; or says that the machine reads no such file now.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(f"{path}: {what} (no such file); {remedy}")
    check_regular(path, remedy, 1 << 62)
    try:
        return _reader.read(path, names, live, rows)
    except _NotStarted as error:
        why = f"the process that reads HDF5 files {error}; try again later"
        raise InputError(f"{path}: cannot be read: {why}") from None
    except (ValueError, KeyError, TypeError, OSError, MemoryError) as error:
        raise InputError(f"{path}: {what} ({error}); {remedy}") from None


def end_reading() -> None:
    """End the process that reads, which takes memory of its own; the next file starts another."""
    _reader.close()


@contextmanager
def trusting(folder: Path) -> Iterator[None]:
    """Read the files of a folder in this process, which has just written all of them: another takes .13 s to start."""
    _reader.trusted = folder
    try:
        yield
    finally:
        _reader.trusted = None
