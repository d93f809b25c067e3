"""Grids of quadrilaterals along a fracture, and the files that hold them: Gmsh's for fracflow, VTK's for OpenGeoSys."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import meshio
import numpy as np
from grids import Floats, Ints, edges_of, msh, quads_of, rims

PAIRS = ((0, 1), (1, 2), (2, 3), (3, 0))


@dataclass(frozen=True)
class Grid:
    """Quadrilaterals in rows, with a fracture along one of the lines between rows.

    points    (n, 2)     corners
    quads     (m, 4)     counter-clockwise
    fracture  (k, 2)     edges along the fracture, from its start
    sides     (., 2)     edges of each of SIDES
    owners    (.,)       the quads these edges belong to
    """

    points: Floats
    quads: Ints
    fracture: Ints
    sides: dict[str, Ints]
    owners: dict[str, Ints]


def grid(x: Floats, y: Floats, row: int, columns: slice = slice(None), heights: Floats | None = None) -> Grid:
    """The product of lines ``x`` (p,) and ``y`` (q,), fractured along ``row`` between the given columns.

    ``heights`` (q, p) of the nodes take the place of ``y`` where the lines are not horizontal.
    """
    p, q = len(x), len(y)
    number, cell = np.arange(p * q).reshape(q, p), np.arange((p - 1) * (q - 1)).reshape(q - 1, p - 1)
    tall = np.broadcast_to(y[:, None], (q, p)) if heights is None else heights
    points = np.stack([np.broadcast_to(x, (q, p)), tall], axis=-1).reshape(-1, 2)
    sides = {name: edges_of(nodes) for name, nodes in rims(number).items()}
    return Grid(points, quads_of(number), edges_of(number[row, columns]), sides, rims(cell))


def write_msh(made: Grid, path: Path, names: dict[str, str], points: dict[str, int]) -> None:
    """Gmsh's format 2.2: the rock, the ``names`` of "fracture" and of sides, and named points."""
    blocks = [("rock", made.quads)]
    blocks += [(name, made.fracture if part == "fracture" else made.sides[part]) for part, name in names.items()]
    blocks += [(name, np.array([[node]])) for name, node in points.items()]
    path.write_text(msh(made.points, blocks), encoding="utf-8")


def write_vtu(made: Grid, folder: Path, order: int, points: dict[str, int]) -> None:
    """OpenGeoSys's files: domain.vtu with rock (material 0) and fracture (1), one of each side, one of each point.

    With ``order`` 2 the quads have eight nodes and the edges three.
    """
    bent, middles = _with_middles(made) if order == 2 else (made.points, {})
    solid = np.zeros((len(bent), 3))
    solid[:, :2] = bent

    def lines(edges: Ints) -> Ints:
        if order == 1:
            return edges
        return np.column_stack([edges, [middles[min(a, b), max(a, b)] for a, b in edges.tolist()]])

    quads = made.quads
    if order == 2:
        corners = made.quads.tolist()
        extra = [[middles[min(c[a], c[b]), max(c[a], c[b])] for a, b in PAIRS] for c in corners]
        quads = np.column_stack([made.quads, extra])
    cell, line = ("quad8", "line3") if order == 2 else ("quad", "line")
    crack = lines(made.fracture)
    material = [np.zeros(len(quads), np.int32), np.ones(len(crack), np.int32)]
    meshio.write(
        folder / "domain.vtu", meshio.Mesh(solid, [(cell, quads), (line, crack)], cell_data={"MaterialIDs": material})
    )
    parts = {name: (line, lines(edges), made.owners[name]) for name, edges in made.sides.items()}
    parts |= {name: ("vertex", np.array([[node]]), np.array([0])) for name, node in points.items()}
    for name, (kind, nodes, owners) in parts.items():
        used, local = np.unique(nodes, return_inverse=True)
        part = meshio.Mesh(
            solid[used],
            [(kind, local.reshape(nodes.shape))],
            point_data={"bulk_node_ids": used.astype(np.uint64)},
            cell_data={"bulk_element_ids": [owners.astype(np.uint64)]},
        )
        meshio.write(folder / f"{name}.vtu", part)


def _with_middles(made: Grid) -> tuple[Floats, dict[tuple[int, int], int]]:
    """Points with the middles of all edges after them, and the number of each edge's middle."""
    edges = np.sort(np.concatenate([made.quads[:, pair] for pair in PAIRS]), axis=1)
    edges = np.unique(edges, axis=0)
    numbers = range(len(made.points), len(made.points) + len(edges))
    middles = {(a, b): number for (a, b), number in zip(edges.tolist(), numbers, strict=True)}
    return np.concatenate([made.points, made.points[edges].mean(axis=1)]), middles
