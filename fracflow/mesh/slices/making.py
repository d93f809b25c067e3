"""A large mesh read or made, and split, by a process of its own: ``python -m fracflow.mesh.slices.making FOLDER PARENT``.

It leaves the mesh in a file, of which ranks take slices. No rank holds the mesh, nor what splitting it takes.
"""

from __future__ import annotations

import os
import pickle
import sys
from pathlib import Path

from fracflow.errors import InputError
from fracflow.mesh.read import MeshSource
from fracflow.mesh.split import split
from fracflow.mesh.store import save_mesh
from fracflow.storage.child import end_with, run_module

SOURCE, SPLIT_MESH, ERROR = "source", "mesh.h5", "error.txt"


def made(source: MeshSource, folder: Path) -> Path:
    """The file in a folder that a process of its own has written the split mesh into.

    Raises InputError, and OSError where there is no room.
    """
    with (folder / SOURCE).open("wb") as file:
        pickle.dump(source, file)
    code, said = run_module("fracflow.mesh.slices.making", [str(folder), str(os.getpid())], folder)
    if (error := folder / ERROR).exists():
        raise InputError(error.read_text(encoding="utf-8", errors="surrogateescape"))
    last = (said.strip().splitlines() or ["it said nothing"])[-1]
    if code == os.EX_IOERR:
        raise OSError(None, last, str(folder))
    if code:
        how = f"was ended by signal {-code}" if code < 0 else f"failed: {last}"
        raise InputError(f"mesh: the process that makes it {how}; give it more memory, or a mesh with fewer cells")
    return folder / SPLIT_MESH


def main(folder: Path, parent: int) -> int:
    """Write the split mesh of the source in a folder; 0 if it is there, 1 if error.txt is, 74 without room for it."""
    end_with(parent)
    try:
        # of the rank that waits for it, in a folder that no other user can write to
        source: MeshSource = pickle.loads((folder / SOURCE).read_bytes())
        save_mesh(split(source.raw()), folder / SPLIT_MESH)
    except InputError as error:
        (folder / ERROR).write_text(str(error), encoding="utf-8", errors="surrogateescape")
        return 1
    except OSError as error:
        print(error.strerror or error, file=sys.stderr)
        return os.EX_IOERR
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), int(sys.argv[2])))
