"""The process that reads HDF5 files: the library may crash, hang or ask for any memory over a damaged or forged one.

It answers requests, a line of JSON each on standard input: ``path``, ``names`` of the datasets that are wanted (null for
all), ``live`` for a file that may have a writer. An answer is a line of JSON with attributes and layout; for each dataset a
line with its name, type and shape, and its bytes; and a line with ``end``. A line with ``error`` ends an answer too.

Read are numbers in datasets of the file itself: no link but hard ones, nothing stored elsewhere, no filters, not more
than the file can hold.
"""

import os
import sys

if __name__ == "__main__":
    del sys.path[0]  # the folder of this file has modules with common names

import ctypes
import json
import resource
from collections.abc import Iterator
from math import prod
from typing import Any, BinaryIO

import h5py
import numpy as np

MOST_SETS, MOST_GROUPS, DEEPEST = 20_000, 20_000, 16
ATTEMPTS = 26  # at metadata of a live file; HDF5 makes a hundred and sleeps 1 ns, 2 ns, 4 ns, ...: for ever
_MAPS, _SIZE = "/proc/self/maps", "/proc/self/statm"
SPARE = 256 << 20  # bytes of memory beside those of the file


class Refused(Exception):
    """The file holds something that no run writes."""


def bound(size: int) -> int:
    """Most bytes that datasets of a file of ``size`` bytes may have in all."""
    return 2 * size + (1 << 20)


def answer(request: dict[str, Any], out: BinaryIO) -> None:
    """Read one file and send what is asked for."""
    size = os.stat(request["path"]).st_size
    _limit_memory(4 * size + SPARE)
    with _opened(request["path"], request["live"]) as file:
        found = dict(_datasets(file, "", 0, [0]))
        layout = [(name, _type(name, dataset).str, [int(n) for n in dataset.shape]) for name, dataset in found.items()]
        if sum(np.dtype(kind).itemsize * prod(shape) for _, kind, shape in layout) > bound(size):
            raise Refused(f"its datasets claim more than the {size} bytes of the file hold")
        _send(out, {"attributes": _attributes(file), "layout": layout})
        rows = min((shape[0] for _, _, shape in layout if shape), default=0) if request["live"] else None
        wanted = found if request["names"] is None else [name for name in request["names"] if name in found]
        for name in wanted:
            dataset = found[name]
            values = np.ascontiguousarray(dataset[()] if rows is None or not dataset.shape else dataset[:rows])
            _send(out, {"name": name, "dtype": values.dtype.str, "shape": list(values.shape)})
            out.write(values.data if values.size else b"")
    _send(out, {"end": True})


def _send(out: BinaryIO, line: dict[str, Any]) -> None:
    out.write(json.dumps(line).encode() + b"\n")


def _opened(path: str, live: bool) -> h5py.File:
    if not live:
        return h5py.File(path, "r")
    access = h5py.h5p.create(h5py.h5p.FILE_ACCESS)
    access.set_libver_bounds(h5py.h5f.LIBVER_LATEST, h5py.h5f.LIBVER_LATEST)
    access.set_fclose_degree(h5py.h5f.CLOSE_STRONG)
    _limit_attempts(access.id)
    # after a kill the file is still marked as being written: only a SWMR reader is let in
    return h5py.File(h5py.h5f.open(os.fsencode(path), h5py.h5f.ACC_RDONLY | h5py.h5f.ACC_SWMR_READ, access))


def _limit_attempts(access: int) -> None:
    """h5py has no name for this call of the library; without it the patience of who asks is the bound."""
    if not os.path.exists(_MAPS):
        return
    with open(_MAPS, encoding="utf-8") as maps:
        names = {line.split()[-1] for line in maps if "libhdf5" in line}
    for name in sorted(names):
        call = getattr(ctypes.CDLL(name), "H5Pset_metadata_read_attempts", None)
        if call is not None:
            call.argtypes = [ctypes.c_int64, ctypes.c_uint]
            call(access, ATTEMPTS)
            return


def _datasets(group: h5py.Group, prefix: str, depth: int, seen: list[int]) -> Iterator[tuple[str, h5py.Dataset]]:
    for name in group:
        seen[0] += 1
        if seen[0] > MOST_SETS + MOST_GROUPS or depth > DEEPEST:
            raise Refused("it has more datasets, or groups in groups, than any run writes")
        key = f"{prefix}{name}"
        if group.id.links.get_info(os.fsencode(name)).type != h5py.h5l.TYPE_HARD:
            raise Refused(f"{key} is a link to elsewhere")
        item = group[name]
        if isinstance(item, h5py.Group):
            yield from _datasets(item, f"{key}/", depth + 1, seen)
        elif isinstance(item, h5py.Dataset):
            yield key, _plain(key, item)
        else:
            raise Refused(f"{key} is no dataset")


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
    for line in requests:
        try:
            answer(json.loads(line), out)
        except Exception as error:  # whatever h5py makes of a damaged file
            said = str(error) or type(error).__name__
            _send(out, {"error": said if isinstance(error, Refused) else f"{type(error).__name__}: {said}"[:300]})
        out.flush()


if __name__ == "__main__":
    main()
