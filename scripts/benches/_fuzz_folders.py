"""Run folders out of order: any file damaged as bytes, HDF5 as structure, JSON and CSV as text, names as links."""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
from pathlib import Path
from typing import Any

import _fuzz_damage as damage
import h5py
import numpy as np
from _fuzz_scenes import MESHES

from fracflow.errors import Interrupted
from fracflow.scene.scene import load
from fracflow.simulation.run import run

SCENE = "report_5_3/scene.toml"
SETTINGS = ("stage.failure.steps=9", "output.pictures=false", "output.fields_every=4", "stage.pumping.tolerance=1e-2")
STOPS_AFTER = 5  # steps of the last stage
FILES = (
    "history.h5", "history.h5", "checkpoint.h5", "checkpoint.h5", "checkpoint.h5", "mesh.h5", "mesh.h5",
    "events.csv", "status.json", "plan.json", "log.txt", "scene.toml", ".fracflow", "fields",
)  # fmt: skip
HUGE = (1 << 20, 1 << 33, 1 << 45)


def make(folder: Path, hang: Path) -> None:
    """A run that was stopped on its way, in ``folder``; its scene and mesh are in ``hang``. In a process of its own."""
    hang.mkdir(parents=True, exist_ok=True)
    for file in (MESHES / SCENE).parent.iterdir():
        if file.suffix in (".toml", ".geo"):
            shutil.copy(file, hang)
    taken = 0

    def stop(step: object) -> None:
        nonlocal taken
        taken += 1
        if taken == STOPS_AFTER:
            os.kill(os.getpid(), signal.SIGUSR2)

    try:
        run(load(hang / "scene.toml", SETTINGS), folder, progress=stop)
    except Interrupted:
        return
    raise RuntimeError("the run that is to be damaged was not stopped on its way")


def draw_file(r: random.Random, template: Path) -> tuple[str, bytes, bytes | None, str]:
    """Name of a file of a run folder, what it holds, what it is to hold (None: it is gone), and how that was made."""
    name = r.choice(FILES)
    if name == "fields":
        name = str(r.choice(sorted(template.glob("fields/*.h5"))).relative_to(template))
    old = (template / name).read_bytes()
    if r.random() < 0.02:
        return name, old, None, "gone"
    if name.endswith(".h5"):
        if r.random() < 0.5:
            new, how = damage.damaged(r, old, damage.BYTES)
            return name, old, new, how
        return name, old, *restructured(r, old)
    if name.endswith(".json") and r.random() < 0.5:
        return name, old, *_json(r, old)
    new, how = damage.damaged(r, old, damage.TEXT)
    return name, old, new, how


def link(r: random.Random, path: Path, outside: Path) -> str:
    """Put a link, a pipe, a device's name or a folder in the place of a file; gives the name of it."""
    path.unlink(missing_ok=True)
    what = r.choice(("link out", "link out", "dangling", "loop", "pipe", "folder", "zero", "hard link"))
    if what == "pipe":
        os.mkfifo(path)
    elif what == "folder":
        path.mkdir()
    elif what == "hard link":
        os.link(outside / "canary", path)
    else:
        targets = {"link out": outside / "canary", "dangling": outside / "new", "loop": path, "zero": Path("/dev/zero")}
        path.symlink_to(targets[what])
    return what


def _json(r: random.Random, data: bytes) -> tuple[bytes, str]:
    """Values and keys of a JSON text replaced."""
    found = json.loads(data)
    values = (None, [], {}, "", "x", 0, -1, 1e308, True, [[]], {"x": 1}, "\x1b[31m", "a\nb", "x" * 5000, 10**30, [{}])
    for _ in range(r.choice((1, 1, 2, 4))):
        here, key = None, None
        inside: Any = found
        while isinstance(inside, dict | list) and inside:
            here, key = inside, r.choice(sorted(inside)) if isinstance(inside, dict) else r.randrange(len(inside))
            inside = inside[key]  # type: ignore[index]
            if r.random() < 0.3:
                break
        if here is None or key is None:
            found = r.choice(values)
        elif r.random() < 0.7:
            here[key] = r.choice(values)  # type: ignore[index]
        else:
            del here[key]  # type: ignore[arg-type]
    text = json.dumps(found, indent=2)
    if r.random() < 0.1:
        text = r.choice(
            ("[" * 5000, text.replace("0", "NaN"), text.replace("1", "Infinity"), text.replace("1", "1" * 5000))
        )
    return text.encode(), "json"


def restructured(r: random.Random, data: bytes) -> tuple[bytes, str]:
    """An HDF5 file with one dataset, group or attribute replaced by one of another kind."""
    with _in_memory(data) as file:
        sets: list[str] = []
        file.visititems(lambda name, item: sets.append(name) if isinstance(item, h5py.Dataset) else None)
        name, way = r.choice(sets), r.choice(WAYS)
        way(r, file, name)
        file.flush()
        return file.id.get_file_image(), way.__name__.strip("_")


def _in_memory(data: bytes) -> h5py.File:
    """A copy of an HDF5 file to change; the mark that it is being written is taken off."""
    access = h5py.h5p.create(h5py.h5p.FILE_ACCESS)
    access.set_fapl_core(backing_store=False)
    access.set_file_image(data)
    return h5py.File(h5py.h5f.open(b"fuzz", h5py.h5f.ACC_RDWR, access))


def _put(file: h5py.File, name: str, values: Any, **how: Any) -> None:
    del file[name]
    file.create_dataset(name, data=values, **how)


def _values(r: random.Random, file: h5py.File, name: str) -> None:
    """The same shape, numbers that no state has."""
    old = file[name][()]
    if isinstance(old, np.ndarray) and old.size and old.dtype.kind in "fiu":
        flat = old.reshape(-1).copy()
        strange = (
            (np.nan, np.inf, -np.inf, 1e308, -1.0, 0.0, 1e-320)
            if old.dtype.kind == "f"
            else (-1, 0, 1, 7, 10**6, -(10**9))
        )
        flat[r.sample(range(flat.size), min(flat.size, r.choice((1, 1, 5))))] = np.array(r.choice(strange)).astype(
            old.dtype
        )
        file[name][...] = flat.reshape(old.shape)


def _bit(r: random.Random, file: h5py.File, name: str) -> None:
    """One bit of one number."""
    old = np.atleast_1d(file[name][()])
    if old.size and old.dtype.kind in "fiub":
        raw = old.reshape(-1).view(np.uint8).copy()
        raw[r.randrange(raw.size)] ^= 1 << r.randrange(8)
        file[name][...] = raw.view(old.dtype).reshape(file[name].shape)


def _dtype(r: random.Random, file: h5py.File, name: str) -> None:
    """Numbers of another type, or no numbers."""
    old = file[name][()]
    kind = r.choice(("f2", "f4", ">f8", "i1", "i8", "u8", "c16", "?", "S8", "V3"))
    with np.errstate(all="ignore"):
        new = np.zeros(np.shape(old), kind) if kind[0] in "SV" else np.asarray(old).astype(kind)
    _put(file, name, new)


def _strings(r: random.Random, file: h5py.File, name: str) -> None:
    """Text in the place of numbers."""
    shape = np.shape(file[name])
    _put(file, name, np.full(shape, "x", dtype=object), dtype=h5py.string_dtype())


def _compound(r: random.Random, file: h5py.File, name: str) -> None:
    """Records, references or rows of different lengths in the place of numbers."""
    shape = np.shape(file[name])
    kind = r.randrange(3)
    if kind == 0:
        _put(file, name, np.zeros(shape, [("a", "f8"), ("b", "S3")]))
    elif kind == 1:
        _put(file, name, np.full(shape, file.ref, dtype=h5py.ref_dtype), dtype=h5py.ref_dtype)
    else:
        del file[name]
        file.create_dataset(name, shape, h5py.vlen_dtype(np.float64))


def _shape(r: random.Random, file: h5py.File, name: str) -> None:
    """Rows or columns more or less, or another number of dimensions."""
    old = np.asarray(file[name][()])
    kind = r.randrange(7)
    if kind == 0:
        new = old[: len(old) // 2] if old.ndim else np.zeros(3, old.dtype)
    elif kind == 1:
        new = np.concatenate([np.atleast_1d(old)] * 2)
    elif kind == 2:
        new = old[..., None]
    elif kind == 3:
        new = old.reshape(-1)[:1].reshape(()) if old.size else np.zeros((), old.dtype)
    elif kind == 4:
        new = np.zeros((0, *old.shape[1:]), old.dtype)
    elif kind == 5:
        new = old.T
    else:
        new = np.zeros((2,) * 20, "i1")
    _put(file, name, new)


def _empty(r: random.Random, file: h5py.File, name: str) -> None:
    """A dataset that holds nothing, not even no rows."""
    dtype = file[name].dtype
    del file[name]
    file[name] = h5py.Empty(dtype)


def _huge(r: random.Random, file: h5py.File, name: str) -> None:
    """A shape that no memory holds, in a small file."""
    dtype, rest = file[name].dtype, np.shape(file[name])[1:]
    del file[name]
    shape = (r.choice(HUGE), *rest)
    packed = {"compression": "gzip"} if r.random() < 0.5 else {}
    file.create_dataset(name, shape, dtype, chunks=tuple(min(n, 4096) or 1 for n in shape), **packed)


def _gone(r: random.Random, file: h5py.File, name: str) -> None:
    """Not there any more."""
    del file[name]


def _group(r: random.Random, file: h5py.File, name: str) -> None:
    """A group in its place, with or without something in it."""
    del file[name]
    file.create_group(name)
    if r.random() < 0.5:
        file[name]["x"] = np.arange(3.0)


def _elsewhere(r: random.Random, file: h5py.File, name: str) -> None:
    """A link to itself, to another, to nothing, to another file, or data kept in other files."""
    shape, dtype, kind = np.shape(file[name]), file[name].dtype, r.randrange(7)
    del file[name]
    if kind == 0:
        file[name] = h5py.SoftLink(f"/{name}")
    elif kind == 1:
        file[name] = h5py.SoftLink("/nowhere")
    elif kind == 2:
        file[name] = h5py.ExternalLink(
            r.choice(("/etc/passwd", "mesh.h5", "../outside/other.h5", "history.h5")),
            r.choice(("/", "/time", "points")),
        )
    elif kind == 3:
        file[name] = file["/"]
    elif kind == 4 and shape and shape[0]:
        file.create_dataset(name, shape, dtype, external=[("/etc/passwd", 0, h5py.h5f.UNLIMITED)])
    elif kind == 5 and shape and shape[0]:
        layout = h5py.VirtualLayout(shape, dtype)
        layout[...] = h5py.VirtualSource("../outside/other.h5", "x", shape)
        file.create_virtual_dataset(name, layout)
    else:
        file[name] = h5py.SoftLink(f"/{name.rpartition('/')[0]}")


def _more(r: random.Random, file: h5py.File, name: str) -> None:
    """Things that belong to no run of ours."""
    kind = r.randrange(6)
    if kind == 0:
        file["strange"] = np.arange(3.0)
    elif kind == 1:
        file["probe/../x\x1b[31m"] = np.arange(3.0)
    elif kind == 2:
        file["a" + "/a" * 400] = 1.0
    elif kind == 3:
        file["type"] = np.dtype("f8")
    elif kind == 4:
        file["text"] = "text"
    else:
        for number in range(300):
            file[f"many/{number}"] = 0.0


def _attribute(r: random.Random, file: h5py.File, name: str) -> None:
    """An attribute gone, of another type, or a text out of order."""
    names = sorted(file.attrs)
    if not names:
        return
    key = r.choice(names)
    old, kind = file.attrs[key], r.randrange(9)
    del file.attrs[key]
    texts = {
        1: "", 2: "{", 3: "[" * 5000, 4: "null", 5: "[]", 6: str(old)[:-3],
    }  # fmt: skip
    if kind in texts:
        file.attrs[key] = texts[kind]
    elif kind == 7:
        file.attrs[key] = np.arange(3.0)
    elif kind == 8:
        try:
            file.attrs[key] = _json(r, str(old).encode())[0].decode()
        except ValueError:
            file.attrs[key] = b"\xff\xfe"


WAYS = (
    _values, _values, _values, _bit, _bit, _dtype, _dtype, _strings, _compound, _shape, _shape, _empty, _huge, _gone,
    _group,
    _elsewhere, _elsewhere, _more, _attribute, _attribute, _attribute,
)  # fmt: skip
