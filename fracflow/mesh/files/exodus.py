"""Meshes of Exodus: blocks of cells and side sets, which meshio leaves out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from fracflow.mesh.files.sets import FileFault, Set
from fracflow.storage.files import shown_plain


def exodus_sets(path: Path, mesh: Any) -> list[Set]:
    """Blocks of cells and side sets by their names, or their numbers; edges of side sets join the mesh as a block each."""
    import meshio
    import netCDF4

    with netCDF4.Dataset(path) as file:
        file.set_auto_mask(False)
        keys = [key for key in file.variables if key.startswith("connect")]
        numbers = [int(key[7:] or 1) for key in keys]
        found = [
            (name, block, np.arange(len(mesh.cells[block].data)))
            for block, name in enumerate(_exodus_names(file, "eb", numbers))
        ]
        kinds = [str(getattr(file.variables[key], "elem_type", "")).upper() for key in keys]
        is_space = "num_dim" in file.dimensions and len(file.dimensions["num_dim"]) == 3
        faces = [2 if kind.startswith("SHELL") or (is_space and kind.startswith("TRI")) else 0 for kind in kinds]
        order = sorted(range(len(numbers)), key=numbers.__getitem__)  # elements are numbered through the blocks
        ends = np.cumsum([len(mesh.cells[block].data) for block in order])
        sides = sorted(int(key[7:]) for key in file.variables if key.startswith("elem_ss"))
        for name, side in zip(_exodus_names(file, "ss", sides), sides, strict=True):
            element, edge = (file.variables[f"{key}_ss{side}"][:].astype(np.int64) - 1 for key in ("elem", "side"))
            edges = []
            for at, number, length in zip(np.searchsorted(ends, element, "right"), element, edge, strict=True):
                cells = mesh.cells[order[at]].data if number >= 0 and at < len(order) else np.zeros((0, 2))
                start, corners = length - faces[order[at]] if len(cells) else -1, cells.shape[1]
                if not 0 <= start < corners or corners not in (3, 4):
                    raise FileFault(
                        shown_plain(f'the side set "{name}" has a side that no triangle or quadrilateral has')
                    )
                cell = cells[number - ends[at]]  # from the end of its block
                edges.append((cell[start], cell[(start + 1) % corners]))
            if edges:
                mesh.cells.append(meshio.CellBlock("line", np.array(edges)))
                found.append((name, len(mesh.cells) - 1, np.arange(len(edges))))
    return found


def _exodus_names(file: Any, kind: str, numbers: list[int]) -> list[str]:
    """Names of the blocks ("eb") or side sets ("ss") of these places in the file, or else their numbers."""
    names = [b"".join(row).decode("utf-8", "replace").strip("\0 ") for row in file.variables.get(f"{kind}_names", [])]
    marks = [str(each) for each in file.variables.get(f"{kind}_prop1", [])]
    return [
        next((each[number - 1] for each in (names, marks) if number <= len(each) and each[number - 1]), str(number))
        for number in numbers
    ]
