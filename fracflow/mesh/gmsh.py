"""Gmsh in a process of its own, talked to by files; its errors and crashes become one line."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fracflow.errors import InputError
from fracflow.mesh.data import Floats, Ints

PACKAGE_PARENT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Elements:
    """What a mesh file holds, before it means anything.

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


def open_in_gmsh(path: Path) -> Elements:
    """Read a .geo, which Gmsh meshes, or a .msh. Raises InputError with Gmsh's first error."""
    return run_worker({"file": str(path.resolve())}, str(path))


def run_worker(job: Mapping[str, Any], what: str) -> Elements:
    """Let the worker do ``job``. Raises InputError, naming ``what``, if Gmsh reports an error or crashes."""
    paths = [str(PACKAGE_PARENT), *filter(None, [os.environ.get("PYTHONPATH")])]
    with tempfile.TemporaryDirectory(prefix="fracflow-gmsh-") as name:
        folder = Path(name)
        (folder / "job.json").write_text(json.dumps(job), encoding="utf-8")
        done = subprocess.run(
            [sys.executable, "-m", "fracflow.mesh.gmsh_worker", name],
            cwd=name,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
        )
        report = folder / "error.txt"
        if report.exists():
            raise InputError(f"{what}: Gmsh: {report.read_text(encoding='utf-8')}; {_remedy(what)}")
        if done.returncode or not (folder / "mesh.npz").exists():
            raise InputError(f"{what}: {_end_of(done)}; {_remedy(what)}")
        with np.load(folder / "mesh.npz") as arrays:
            return Elements(
                points=arrays["points"],
                nodes={kind: arrays[kind] for kind in KINDS},
                members={kind: arrays[f"{kind}_member"] for kind in KINDS},
                others=tuple(str(other) for other in arrays["other"]),
                group_dims=arrays["group_dim"],
                group_tags=arrays["group_tag"],
                group_names=tuple(str(group) for group in arrays["group_name"]),
            )


def _remedy(what: str) -> str:
    if what.endswith(".msh"):
        return "save the mesh again"
    return "correct the file" if what.endswith(".geo") else "change the traces or the sizes"


def _end_of(done: subprocess.CompletedProcess[str]) -> str:
    if done.returncode < 0:
        return f"Gmsh crashed (signal {-done.returncode})"
    lines = done.stderr.strip().splitlines()
    return f"Gmsh failed: {lines[-1] if lines else 'it ended without a mesh'}"
