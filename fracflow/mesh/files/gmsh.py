"""Gmsh, or meshio, in a process of its own, talked to by files; its errors and crashes become one line."""

from __future__ import annotations

import json
import os
import re
import signal
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from fracflow.errors import MOST_NAMED, InputError
from fracflow.mesh.data import Floats, Ints
from fracflow.mesh.files.geo_depth import Checked
from fracflow.mesh.files.msh_check import check_msh
from fracflow.storage.child import LONGEST_REPORT, run_module, temporary_folder

SECONDS, MEMORY = ("FRACFLOW_GMSH_SECONDS", 600), ("FRACFLOW_GMSH_GIB", 8)  # variables, and what holds without them
# To read a mesh file of any size, and more for each of its bytes: memory [bytes] and CPU time [s].
LEAST_MEMORY, MEMORY_PER_BYTE = 1 << 30, 100
LEAST_SECONDS, BYTES_PER_SECOND = 20, 100_000
FORMATS = {".inp": "abaqus", ".vtu": "vtu", ".e": "exodus", ".exo": "exodus", ".xdmf": "xdmf"}  # of other programs
OUT_OF_MEMORY = ("bad_alloc", "MemoryError", "Unable to allocate", "ut of memory")


@dataclass(frozen=True)
class Elements:
    """Content of a mesh file, before it means anything.

    points      (n, 2 or 3)  coordinates [length]
    nodes       kind -> (m, k) rows of ``points``; kinds "point", "line", "triangle", "quad"
    members     kind -> (q, 2) element, group; an element without a group has no row
    others      names of all other types of elements in the file
    group_dims, group_tags, group_names  the physical groups; an unnamed one has the name ""
    """

    points: Floats
    nodes: Mapping[str, Ints]
    members: Mapping[str, Ints]
    others: tuple[str, ...]
    group_dims: Ints
    group_tags: Ints
    group_names: tuple[str, ...]


KINDS = ("point", "line", "triangle", "quad")


class Crashed(InputError):
    """Gmsh has ended without a mesh or a report, by a signal that is not negative then."""

    def __init__(self, message: str, signal: int) -> None:
        """Keep the signal."""
        super().__init__(message)
        self.signal = signal


def open_checked(path: Path, checked: Checked) -> Elements:
    """Mesh a .geo that was checked, from what was made of it. Raises InputError with Gmsh's first error."""
    texts = {name: text.encode("utf-8", "surrogateescape") for name, text in checked.texts.items()}
    try:
        return run_worker({"file": next(iter(texts))}, str(path), texts, checked.sources)
    except Crashed as error:
        if error.signal != signal.SIGFPE or not checked.remainders:
            raise
        where = ", ".join(checked.remainders[:MOST_NAMED])
        raise InputError(f"{where}: Gmsh crashed over a division by zero: after % stands 0; correct the file") from None


def open_msh(path: Path) -> Elements:
    """Read a .msh, of version 2 by meshio, of version 4 by Gmsh. Raises InputError with their first error."""
    version = check_msh(path)
    # Gmsh would run a program that lies beside the file, under its name and .opt; beside the link there is none.
    job = {"msh2" if version == 2 else "file": "mesh.msh", "link": str(path.resolve()), "bytes": path.stat().st_size}
    return run_worker(job, str(path), sources={"mesh.msh": path})


def open_other(path: Path) -> Elements:
    """Read a mesh of another program by meshio. Raises InputError with its first error."""
    job = {"meshio": str(path.absolute()), "bytes": sum(sizes_beside(path).values())}
    return run_worker(job, str(path))


def sizes_beside(path: Path) -> Mapping[str, int]:
    """Sizes [bytes] of a mesh file and of HDF5 files that may be its data."""
    names = [path, *path.parent.glob("*.h5"), *path.parent.glob("*.hdf5")] if path.suffix == ".xdmf" else [path]
    return {each.name: each.stat().st_size for each in names if each.is_file()}


@dataclass(frozen=True)
class Limits:
    """Limits of the process of Gmsh: CPU time [s], memory and the size of a file it writes [bytes]."""

    seconds: int
    memory: int

    @property
    def wall(self) -> float:
        """How long it may take on a busy machine [s]."""
        return 4.0 * self.seconds + 60.0


def limits(size: int | None = None) -> Limits:
    """The limits, lower for a mesh file of some ``size`` [bytes]. Raises InputError for a variable that is no number."""
    found = {}
    for name, usual in (SECONDS, MEMORY):
        text = os.environ.get(name, "") or str(usual)
        if not re.fullmatch(r"\d{1,6}", text) or not int(text):
            raise InputError(f'{name} = "{text}": must be a whole number from 1 to 999999; set it right or unset it')
        found[name] = int(text)
    seconds, memory = found[SECONDS[0]], found[MEMORY[0]] << 30
    if size is not None:
        seconds = min(seconds, LEAST_SECONDS + size // BYTES_PER_SECOND)
        memory = min(memory, LEAST_MEMORY + MEMORY_PER_BYTE * size)
    return Limits(seconds, memory)


def run_worker(
    job: Mapping[str, Any],
    what: str,
    texts: Mapping[str, bytes] | None = None,
    sources: Mapping[str, Path] | None = None,
) -> Elements:
    """Let the worker do ``job`` beside files of ``texts``, whose names in its errors become those of their ``sources``.

    Raises InputError, naming ``what``, if Gmsh reports an error, crashes or needs more than its limits, or if the folder
    for temporary files is full.
    """
    try:
        return _work(job, what, texts or {}, sources or {})
    except OSError as error:
        where = error.filename or tempfile.gettempdir()
        raise InputError(
            f"{what}: {_name(what)} cannot be run: {where}: {error.strerror}; make room, or set TMPDIR"
        ) from None


def _work(job: Mapping[str, Any], what: str, texts: Mapping[str, bytes], sources: Mapping[str, Path]) -> Elements:
    allowed = limits(job.get("bytes"))
    with temporary_folder("gmsh") as folder:
        for each, text in texts.items():
            (folder / each).write_bytes(text)
        if "link" in job:
            (folder / "mesh.msh").symlink_to(job["link"])
        given = {**job, "seconds": allowed.seconds, "memory": allowed.memory, "parent": os.getpid()}
        (folder / "job.json").write_text(json.dumps(given), encoding="utf-8")
        code, said = _run(folder, allowed)
        if code is None or code == -signal.SIGXCPU:
            why = f"{allowed.seconds} s of CPU time" if code else f"{allowed.wall:.0f} s"
            remedy = f"let it make fewer cells, or set {SECONDS[0]} to more seconds"
            raise InputError(f"{what}: {_name(what)} did not end within {why}; {remedy}")
        report = folder / "error.txt"
        if report.exists():
            line = report.read_text(encoding="utf-8", errors="replace")[:LONGEST_REPORT]
            for each, source in sources.items():
                line = line.replace(str(folder / each), str(source)).replace(f"'{each}'", f"'{source}'")
            raise InputError(f"{what}: {line}; {_remedy(what, line, allowed)}")
        if code or not (folder / "mesh").exists():
            last = (said.strip().splitlines() or ["it ended without a mesh"])[-1]
            how = f"crashed (signal {-code})" if code < 0 else f"failed: {last}"
            raise Crashed(f"{what}: {_name(what)} {how}; {_remedy(what, said, allowed)}", -code)
        with (folder / "mesh").open("rb") as file:
            head = json.loads(file.readline())
            arrays = {
                name: np.fromfile(file, kind, prod(shape)).reshape(shape)
                for name, (kind, shape) in head["arrays"].items()
            }
        return Elements(
            points=arrays["points"],
            nodes={kind: arrays[kind] for kind in KINDS},
            members={kind: arrays[f"{kind}_member"] for kind in KINDS},
            others=tuple(head["other"]),
            group_dims=arrays["group_dim"],
            group_tags=arrays["group_tag"],
            group_names=tuple(head["group_name"]),
        )


def _run(folder: Path, allowed: Limits) -> tuple[int | None, str]:
    """Run the worker in its folder: its exit code, None if it took too long, and the end of what it said."""
    return run_module("fracflow.mesh.files.gmsh_worker", [str(folder)], folder, allowed.wall)


def _remedy(what: str, said: str, allowed: Limits) -> str:
    if any(word in said for word in OUT_OF_MEMORY):
        return f"it may use {allowed.memory / 2**30:.3g} GiB; let it make fewer cells, or set {MEMORY[0]} to more GiB"
    if "netCDF4" in said:
        return "pip install netCDF4"
    if "ModuleNotFoundError" in said:
        return "install that module beside fracflow, or set it up again"
    if what.endswith(".msh"):
        return "save it again from Gmsh"
    if Path(what).suffix in FORMATS:
        return "save it again, or as a Gmsh .msh"
    return "correct the file" if what.endswith(".geo") else "change the traces or the sizes"


def _name(what: str) -> str:
    """Of the library that reads it."""
    return "meshio" if Path(what).suffix in FORMATS else "Gmsh"
