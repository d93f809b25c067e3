"""Every cell of a mesh cut in four before the split, to compare others with: nodes, names, traces and sides stay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fracflow.mesh.data import Ints, RawMesh


def refined(raw: RawMesh) -> RawMesh:
    """The mesh with the middles of all edges, and of all quads, as new nodes behind the old ones.

    Cells of half the size in the place of their parent, four by four; facets two by two, each in the direction of its own.
    """
    is_quad = (raw.cells >= 0).sum(axis=1) == 4
    triangles, quads = raw.cells[~is_quad, :3], raw.cells[is_quad]
    known = np.unique(np.concatenate([_edge(part, raw) for part in (triangles, quads)]))
    count = len(raw.points)
    ends = np.stack([known // count, known % count], axis=1)
    middles = raw.points[ends].mean(axis=1)
    centres = raw.points[quads].mean(axis=1) if len(quads) else raw.points[:0]

    def between(nodes: Ints) -> Ints:
        """New node on each edge of a polygon (m, k), or in the middle of each facet (m, 2)."""
        return count + np.searchsorted(known, _edge(nodes, raw)).reshape(nodes.shape)

    parts = np.full((len(raw.cells), 4, raw.cells.shape[1]), -1)
    corner, side = triangles.T, between(triangles).T
    inner = [(corner[i], side[i], side[i - 1]) for i in range(3)] + [tuple(side)] if len(triangles) else []
    for i, child in enumerate(inner):
        parts[~is_quad, i, :3] = np.stack(child, axis=1)
    if len(quads):
        corner, side, centre = quads.T, between(quads).T, count + len(known) + np.arange(len(quads))
        for i in range(4):
            parts[is_quad, i] = np.stack([corner[i], side[i], centre, side[i - 1]], axis=1)

    def halves(facets: Ints) -> Ints:
        middle = between(facets)[:, :1]
        return np.concatenate([facets[:, :1], middle, middle, facets[:, 1:]], axis=1).reshape(-1, 2)

    return replace(
        raw,
        points=np.concatenate([raw.points, middles, centres]),
        cells=parts.reshape(-1, raw.cells.shape[1]),
        cell_rock=np.repeat(raw.cell_rock, 4),
        fracture_facets=halves(raw.fracture_facets),
        fracture_of=np.repeat(raw.fracture_of, 2),
        side_facets=halves(raw.side_facets),
        side_of=np.repeat(raw.side_of, 2),
    )


def _edge(nodes: Ints, raw: RawMesh) -> Ints:
    """A number for each edge of polygons (m, k), the same from either end."""
    after = np.roll(nodes, -1, axis=1)
    return (np.minimum(nodes, after) * len(raw.points) + np.maximum(nodes, after)).ravel()
