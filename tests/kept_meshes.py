"""Meshes that Gmsh has made already: to start its process takes as long as many of the runs in the tests do."""

from __future__ import annotations

import atexit
import hashlib
import os
import pickle
import shutil
import tempfile
from pathlib import Path

from fracflow.mesh.files import gmsh

FOLDER = "FRACFLOW_TEST_MESHES"
"""Variable that names the folder of kept meshes; the processes of one session share it."""
make = gmsh._work


def prepare() -> None:
    """Name a folder, where none is named yet, for this process and those that it starts."""
    if FOLDER not in os.environ:
        os.environ[FOLDER] = tempfile.mkdtemp(prefix="fracflow-meshes-")
        atexit.register(shutil.rmtree, os.environ[FOLDER], ignore_errors=True)


def use(kept: bool) -> None:
    """Let what asks Gmsh for a mesh from here on get a kept one, or have each made anew."""
    gmsh._work = find if kept else make


def find(job, what, texts, sources):
    """The mesh that Gmsh made of the same job, beside the same texts, within the same limits; now where none is kept.

    Only a job whose input is known is looked up: the same bytes, in a .msh of whatever name. No error is kept.
    """
    if "meshio" in job or ("file" in job and "link" not in job and job["file"] not in texts):
        return make(job, what, texts, sources)
    read = hashlib.sha256(Path(job["link"]).read_bytes()).hexdigest() if "link" in job else None
    whole = repr((sorted({**job, "link": read}.items()), sorted(texts.items()), gmsh.limits(job.get("bytes"))))
    file = Path(os.environ[FOLDER]) / hashlib.sha256(whole.encode()).hexdigest()
    if not file.exists():
        new = file.with_suffix(f".{os.getpid()}")
        new.write_bytes(pickle.dumps(make(job, what, texts, sources)))
        new.replace(file)  # another process finds all of it, or nothing
    return pickle.loads(file.read_bytes())
