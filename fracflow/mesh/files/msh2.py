"""Meshes of Gmsh's format 2, read by meshio in the worker."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fracflow.mesh.files.others import MESHIO_KINDS
from fracflow.mesh.files.sets import CORNERS, DIMS, Found, Rows


def read_msh2(path: Path) -> Found:
    """Points, nodes and members of each kind, other types, and tag, dimension and name of the groups.

    Version 2 has one physical tag an element; one in two groups stands twice. Raises ValueError of one line.
    """
    import meshio  # imports much

    try:
        mesh = meshio.gmsh.read(path)
    except MemoryError:
        raise
    except (Exception, SystemExit) as error:  # meshio raises whatever its parser meets
        reason = " ".join(str(error).split()) if isinstance(error, meshio.ReadError) else "it is cut off or damaged"
        raise ValueError(f"cannot be read as a Gmsh mesh: {reason}") from error
    groups = _groups(path)
    tags = mesh.cell_data.get("gmsh:physical", [np.zeros(len(block.data), np.int64) for block in mesh.cells])
    nodes: dict[str, list[Rows]] = {kind: [] for kind in CORNERS}
    members: dict[str, list[Rows]] = {kind: [] for kind in CORNERS}
    number = {(dim, tag): index for index, (tag, dim, _) in enumerate(groups)}
    others = sorted({block.type for block in mesh.cells} - MESHIO_KINDS.keys())
    for block, tag in zip(mesh.cells, tags, strict=True):
        if block.type in others:
            continue
        kind = MESHIO_KINDS[block.type]
        first = sum(len(rows) for rows in nodes[kind])
        nodes[kind].append(np.asarray(block.data, dtype=np.int64))
        if np.any((nodes[kind][-1] < 0) | (nodes[kind][-1] >= len(mesh.points))):
            raise ValueError("an element has a node that the file does not have")
        for value in np.unique(tag[tag > 0]):
            key = (DIMS[kind], int(value))
            if key not in number:
                number[key] = len(groups)
                groups.append((key[1], key[0], ""))
            rows = first + np.flatnonzero(tag == value)
            members[kind].append(np.stack([rows, np.full(len(rows), number[key])], axis=1))
    return np.asarray(mesh.points, dtype=float).reshape(-1, 3), nodes, members, others, groups


def _groups(path: Path) -> list[tuple[int, int, str]]:
    """Tag, dimension and name of the groups; meshio keeps only one of two that share a name."""
    text = path.read_bytes().partition(b"$PhysicalNames")[2].partition(b"$EndPhysicalNames")[0]
    rows = [line.split(None, 2) for line in text.decode("utf-8", "replace").splitlines()]
    return [(int(row[1]), int(row[0]), row[2].strip().strip('"')) for row in rows if len(row) == 3]
