"""Formats of meshes of other programs, by the endings of their files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

FORMATS = {".inp": "abaqus", ".vtu": "vtu", ".e": "exodus", ".exo": "exodus", ".xdmf": "xdmf"}


def sizes_beside(path: Path) -> Mapping[str, int]:
    """Sizes [bytes] of a mesh file and of HDF5 files that may be its data."""
    names = [path, *path.parent.glob("*.h5"), *path.parent.glob("*.hdf5")] if path.suffix == ".xdmf" else [path]
    return {each.name: each.stat().st_size for each in names if each.is_file()}
