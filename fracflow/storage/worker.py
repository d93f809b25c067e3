"""The process that reads HDF5 files: the library may crash, hang or ask for any memory over a damaged or forged one.

It reports that it is ready, then serves requests, a line of JSON each on standard input. Its keys are ``path``, ``names`` of
the datasets to read (null for all), and ``live`` for a file that may have a writer. ``rows`` has the first row to read and the
one after the last (null for all). A reply begins with a line of JSON with attributes and layout. Each dataset follows with a
line of its name, type and shape, and its bytes. A line with ``end`` closes it. A line with ``error`` ends a reply too.

It reads numbers in datasets of the file itself. Links other than hard ones, external storage, filters and sizes beyond the
file are refused.
"""

import os
import sys

if __name__ == "__main__":  # the folder of this file has modules with common names; that of the package has not
    sys.path[0] = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))

import json
import resource
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from math import prod
from pathlib import Path
from typing import Any, BinaryIO

import h5py
import numpy as np

from fracflow.storage import hdf5 as files_hdf
from fracflow.storage.files import shown_plain

LEAST = 16  # bytes that a name takes in a file; where more are met, groups are in each other many times over
DEEPEST = 16  # groups in each other
MOST_NAMES = 100_000  # in a file of another program
ATTEMPTS = 5  # at a file whose writer is under way, which may change it in between
PAUSE = 0.05  # seconds between them
_SIZE = "/proc/self/statm"
_PLAIN = {"truncated file": "the file is cut short", "file signature not found": "no HDF5 file"}
SPARE = 256 << 20  # bytes of memory beside those of the file


class Refused(Exception):
    """The file holds something that no run writes."""


def bound(size: int) -> int:
    """Most bytes that datasets of a file of ``size`` bytes may have in all."""
    return 2 * size + (1 << 20)


def answer(request: dict[str, Any], out: BinaryIO) -> None:
    """Read one file and send what is asked for."""
    path, live = Path(request["path"]), bool(request["live"])
    _limit_memory(4 * path.stat().st_size + SPARE)
    for left in reversed(range(ATTEMPTS if live else 1)):
        try:
            head, arrays = read(path, request["names"], live, request["rows"])
            break
        except (OSError, RuntimeError, KeyError):  # its writer may have changed it meanwhile
            if not left or not files_hdf.redo_of(path).exists():
                raise
            time.sleep(PAUSE)
    _send(out, head)
    for name, values in arrays.items():
        _send(out, {"name": name, "dtype": values.dtype.str, "shape": list(values.shape)})
        out.write(values.data if values.size else b"")
    _send(out, {"end": True})


def read(
    path: Path, names: Sequence[str] | None, live: bool, asked: Sequence[int] | None = None
) -> tuple[dict[str, Any], dict[str, np.ndarray[Any, Any]]]:
    """Attributes and layout of a file, and its datasets (n, ...) of these names, all without any, or their rows asked for."""
    size = path.stat().st_size
    with _opened(path, live) as file:
        # no dataset stays open: one takes memory for tables of chunks, and there may be thousands
        layout = [
            (name, _type(name, dataset).str, [int(n) for n in dataset.shape])
            for name, dataset in _datasets(file, "", 0, iter(range(size // LEAST)))
        ]
        if sum(np.dtype(kind).itemsize * prod(shape) for _, kind, shape in layout) > bound(size):
            raise Refused(f"its datasets claim more than the {size} bytes of the file hold")
        shortest = min((shape[0] for _, _, shape in layout if shape), default=0) if live else None
        rows = slice(*asked) if asked else slice(shortest)
        known = {name: shape for name, _, shape in layout}
        wanted = known if names is None else [name for name in names if name in known]
        arrays = {name: np.ascontiguousarray(file[name][rows] if known[name] else file[name][()]) for name in wanted}
        return {"attributes": _attributes(file), "layout": layout}, arrays


def _send(out: BinaryIO, line: dict[str, Any]) -> None:
    out.write(json.dumps(line).encode() + b"\n")


@contextmanager
def _opened(path: Path, live: bool) -> Iterator[h5py.File]:
    # a file that may have a writer is read as one that was closed, with its last change laid over it
    backing = files_hdf.Completed(path) if live else None
    try:
        with h5py.File(path if backing is None else backing, "r") as file:
            yield file
    finally:
        if backing is not None:
            backing.close()  # HDF5 leaves it open


def _datasets(group: h5py.Group, prefix: str, depth: int, left: Iterator[int]) -> Iterator[tuple[str, h5py.Dataset]]:
    for name in group:
        if next(left, None) is None or depth > DEEPEST:
            raise Refused("it has more names, or groups in groups, than any run writes into so many bytes")
        key = f"{prefix}{name}"
        if group.id.links.get_info(os.fsencode(name)).type != h5py.h5l.TYPE_HARD:
            raise Refused(f"{key} is a link to elsewhere")
        item = group[name]
        if isinstance(item, h5py.Group):
            yield from _datasets(item, f"{key}/", depth + 1, left)
        elif isinstance(item, h5py.Dataset):
            yield key, _plain(key, item)
        else:
            raise Refused(f"{key} is no dataset")


def check_leads_nowhere(path: Path) -> None:
    """Raise ValueError for an HDF5 file of another program that leads to other files, or is none."""
    left = iter(range(MOST_NAMES))

    def look(group: h5py.Group, depth: int) -> None:
        for name in group:
            link = group.id.links.get_info(os.fsencode(name)).type
            if link != h5py.h5l.TYPE_HARD or depth > DEEPEST or next(left, None) is None:
                raise ValueError(shown_plain(f"{path.name}: {name[:200]} is a link, or one of too many names"))
            item = group[name]
            if isinstance(item, h5py.Group):
                look(item, depth + 1)
            elif isinstance(item, h5py.Dataset) and (item.external or item.is_virtual):
                raise ValueError(shown_plain(f"{path.name}: {name[:200]} is stored in other files"))

    try:
        with h5py.File(path, "r") as file:
            look(file, 0)
    except (OSError, RuntimeError, KeyError):
        raise ValueError(f"{path.name}: is no readable HDF5 file") from None


def _plain(key: str, dataset: h5py.Dataset) -> h5py.Dataset:
    made = dataset.id.get_create_plist()
    if made.get_layout() not in (h5py.h5d.COMPACT, h5py.h5d.CONTIGUOUS, h5py.h5d.CHUNKED) or made.get_external_count():
        raise Refused(f"{key} is stored in other files")
    if made.get_nfilters():
        raise Refused(f"{key} is compressed or filtered")
    if dataset.shape is None:
        raise Refused(f"{key} has no shape")
    return dataset


def _type(key: str, dataset: h5py.Dataset) -> np.dtype[Any]:
    kind = dataset.dtype
    if kind.kind not in "iufb" or kind.itemsize > 8 or kind.metadata:
        raise Refused(f"{key} holds no plain numbers ({kind})")
    return kind


def _attributes(file: h5py.File) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name in file.attrs:
        about = file.attrs.get_id(name)
        is_text = about.get_type().get_class() == h5py.h5t.STRING
        if about.shape != () or not (is_text or about.dtype.kind in "iufb"):
            raise Refused(f"attribute {name} is neither a text nor a number")
        value = file.attrs[name]
        found[name] = value if isinstance(value, str) else value.decode() if is_text else value.item()
    return found


def _limit_memory(more: int) -> None:
    if not os.path.exists(_SIZE):  # no Linux
        return
    with open(_SIZE, encoding="utf-8") as file:
        now = int(file.read().split()[0]) * resource.getpagesize()
    hard = resource.getrlimit(resource.RLIMIT_AS)[1]
    most = now + more
    resource.setrlimit(resource.RLIMIT_AS, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))


def main() -> None:
    """Answer until there are no more requests."""
    requests, out = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb", 1 << 20)
    os.dup2(2, 1)  # nothing that a library prints gets into an answer
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    _send(out, {"ready": True})
    out.flush()
    for line in requests:
        try:
            answer(json.loads(line), out)
        except Exception as error:  # whatever h5py makes of a damaged file
            _send(out, {"error": _said(error)})
        out.flush()


def _said(error: Exception) -> str:
    """The words of an error, plain ones for what the library says of files that are not whole."""
    said = str(error) or type(error).__name__
    plain = next((words for part, words in _PLAIN.items() if isinstance(error, OSError) and part in said), "")
    return plain or (said if isinstance(error, Refused) else f"{type(error).__name__}: {said}"[:300])


if __name__ == "__main__":
    main()
