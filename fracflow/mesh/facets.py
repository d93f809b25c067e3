"""Facets of cells: edges of triangles and quads, triangles of tetrahedra, quadrilaterals of hexahedra."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fracflow.errors import InputError
from fracflow.mesh.data import Floats, Ints
from fracflow.mesh.graph import components
from fracflow.mesh.places import extent_of, place_text

# (dim, corners of a cell) -> corners of its facets. In their order the normal of a facet (s turned left; of a surface, by the
# right hand) points into the cell. A mesh in space has one kind of cell, so that all its facets have as many nodes.
FACETS = {
    (2, 3): np.array([[0, 1], [1, 2], [2, 0]]),
    (2, 4): np.array([[0, 1], [1, 2], [2, 3], [3, 0]]),
    (3, 4): np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]]),
    (3, 8): np.array([[0, 1, 2, 3], [4, 7, 6, 5], [0, 4, 5, 1], [1, 5, 6, 2], [2, 6, 7, 3], [3, 7, 4, 0]]),
}
LARGEST_KEY = 2**62


@dataclass(frozen=True)
class HalfFacets:
    """Facets as their cells see them: a facet inside the mesh appears twice.

    nodes   (q, k)  with the cell on the left, on the side of the normal
    cell    (q,)    row of the cell
    corner  (q, k)  corner of the cell at each node
    """

    nodes: Ints
    cell: Ints
    corner: Ints


@dataclass(frozen=True)
class Matches:
    """Half facets that belong to wanted facets, as rows of the half facets.

    count   (f,)  cells that have the wanted facet
    first   (f,)  one of them, -1 if there is none
    second  (f,)  the other, -1 if there is none
    inside  (g, 2)  the pairs of all other facets shared by two cells
    crowded (h,)  one half facet of each facet shared by more than two cells
    """

    count: Ints
    first: Ints
    second: Ints
    inside: Ints
    crowded: Ints


def half_facets(cells: Ints, dim: int) -> HalfFacets:
    """All facets (f, k) of all cells (m, n), in the order of the cells of each shape.

    Raises InputError for a mesh in space of more than one kind of cell.
    """
    counts = np.sum(cells >= 0, axis=1)
    nodes, owners, corners = [], [], []
    for (cell_dim, size), table in FACETS.items():
        rows = np.flatnonzero(counts == size)
        if cell_dim == dim and len(rows):
            nodes.append(cells[rows][:, table].reshape(-1, table.shape[1]))
            owners.append(np.repeat(rows, len(table)))
            corners.append(np.tile(table, (len(rows), 1)))
    if not nodes:
        empty = np.zeros((0, 2 if dim == 2 else 3 if cells.shape[1] == 4 else 4), dtype=np.int64)
        return HalfFacets(empty, np.zeros(0, dtype=np.int64), empty)
    if len({each.shape[1] for each in nodes}) > 1:
        raise InputError("mesh: tetrahedra and hexahedra in one mesh: mesh it with one of them")
    return HalfFacets(np.concatenate(nodes), np.concatenate(owners), np.concatenate(corners))


def number_rows(rows: Ints) -> Ints:
    """Give equal rows (m, k) of numbers >= 0 the same number (m,), in lexicographic order."""
    key, bound = rows[:, 0], int(rows[:, 0].max(initial=0)) + 1
    for column in rows.T[1:]:
        width = int(column.max(initial=0)) + 1
        if bound * width > LARGEST_KEY:
            key = np.unique(key, return_inverse=True)[1]
            bound = len(rows)
        key, bound = key * width + column, bound * width
    return np.unique(key, return_inverse=True)[1]


def number_facets(*tables: Ints) -> list[Ints]:
    """Give facets (f, k) with the same nodes the same number, over all tables."""
    number = number_rows(np.sort(np.concatenate(tables), axis=1))
    return np.split(number, np.cumsum([len(table) for table in tables])[:-1])


def match(half: HalfFacets, facets: Ints) -> Matches:
    """Find the wanted ``facets`` (f, k) among the half facets."""
    number, wanted = number_facets(half.nodes, facets)
    total = 1 + max(number.max(initial=-1), wanted.max(initial=-1))
    count = np.bincount(number, minlength=total)
    order = np.argsort(number, kind="stable")
    start = np.cumsum(count) - count
    padded = np.append(order, [-1, -1])
    first = np.where(count > 0, padded[start], -1)
    second = np.where(count > 1, padded[start + 1], -1)
    is_wanted = np.zeros(total, dtype=bool)
    is_wanted[wanted] = True
    others = np.flatnonzero((count == 2) & ~is_wanted)
    inside = np.stack([first[others], second[others]], axis=1)
    return Matches(count[wanted], first[wanted], second[wanted], inside, first[count > 2])


def count_cells_at(cells: Ints, facets: Ints) -> Ints:
    """Cells that have each of ``facets`` (f, k): 2 inside the mesh, 1 on its boundary, 0 elsewhere."""
    return match(half_facets(near(cells, facets), min(facets.shape[1], 3)), facets).count


def outer_besides(cells: Ints, facets: Ints) -> Ints:
    """Facets (u, k) of only one of cells (m, n), without those of ``facets`` (f, k)."""
    nodes = half_facets(cells, min(facets.shape[1], 3)).nodes
    number, known = number_facets(nodes, facets)
    return nodes[(np.bincount(number)[number] == 1) & ~np.isin(number, known)]


def near(cells: Ints, facets: Ints) -> Ints:
    """Those of cells (m, k) with at least as many nodes among those of ``facets`` (f, dim) as a facet has."""
    return cells[rows_near(cells, facets, facets.shape[1])]


def rows_near(cells: Ints, facets: Ints, least: int) -> Ints:
    """Rows (n,) of cells (m, k) with at least ``least`` nodes among those of ``facets`` (f, dim)."""
    is_on = np.zeros(1 + max(cells.max(initial=-1), facets.max(initial=-1)), dtype=bool)
    is_on[facets] = True
    # Padding looks up the last node; the second factor takes it out again.
    return np.flatnonzero(np.sum(is_on[cells] & (cells >= 0), axis=1) >= least) if len(cells) else np.zeros(0, np.int64)


def ridges(facets: Ints) -> Ints:
    """Boundaries of facets (f, k), where they meet: the ends (f, 2, 1) of lines, the edges (f, k, 2) of surfaces."""
    return facets[..., None] if facets.shape[1] == 2 else np.stack([facets, np.roll(facets, -1, axis=1)], axis=2)


def joined_by_cells(cells: Ints, count: int) -> tuple[Ints, Ints]:
    """Nodes (q,) of cells (m, k), cell by cell, and the component (count,) of each of all nodes, which cells join."""
    cell, corner = np.nonzero(cells >= 0)
    nodes = cells[cell, corner]
    return nodes, components(cells[cell, 0], nodes, count)


def spot(points: Floats, nodes: Ints) -> str:
    """Coordinates of the middle of ``nodes`` (k,), for messages; points (n, dim)."""
    return place_text(points[nodes].mean(axis=0), extent_of(points))
