"""Files of an earlier run, compared with the seals of its checkpoint before a file is changed."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fracflow.mesh.store import mesh_root
from fracflow.output.history import read_rows
from fracflow.storage.files import read_bytes
from fracflow.storage.sealed import AGAIN, digest

UNSEALED = "an earlier version left no seals here: damage to its files would not have been seen; from now on it is"
EDITED = "scene.toml is not as it was at the last checkpoint: the run goes on with the scene as it is now"


class Before:
    """The files beside a checkpoint with ``notes``.

    rows, attrs  of history.h5, up to the checkpoint
    mesh         root of the seal of mesh.h5, empty without one
    told         lines for the user
    """

    def __init__(self, folder: Path, notes: Mapping[str, Any]) -> None:
        """Read them. Raises InputError for a changed file."""
        seals = notes["seals"]
        self.rows, self.attrs = read_rows(folder / "history.h5", notes["totals"]["steps"], seals.get("history", ""))
        self.mesh = mesh_root(folder / "mesh.h5")
        self.told = [] if seals else [f"{folder}: {UNSEALED}"]
        if seals.get("scene", "") not in ("", scene_seal(folder)):
            self.told.append(f"{folder}: {EDITED}")


def scene_seal(folder: Path) -> str:
    """Digest of the scene of a run folder, in hexadecimal digits. Raises InputError where there is none."""
    return digest(read_bytes(folder / "scene.toml", AGAIN)).hex()
