"""Edges of the cells of a split mesh in the plane, numbered once, before its cells are cut on the ranks that have them."""

from __future__ import annotations

import numpy as np

from fracflow.mesh.data import Ints, SplitMesh
from fracflow.mesh.plane.cut import Counts
from fracflow.mesh.share import Edges


def number_edges(mesh: SplitMesh, cell_rank: Ints, cell_body: Ints, size: int) -> tuple[Edges, Counts]:
    """All edges of the cells, those of its near cells first, and the counts of the mesh.

    cell_rank  (m,) of so many ranks
    cell_body  (m,) rigid body of each cell, -1 for none
    """
    cells, many, near = mesh.cells, len(mesh.points), mesh.near_count
    is_quad = (cells >= 0).sum(axis=1) == 4
    row, corner = np.nonzero(cells >= 0)
    after = cells[row, (corner + 1) % np.where(is_quad[row], 4, 3)]
    key, at = np.unique(_key(cells[row, corner], after, many), return_inverse=True)
    of_cells = np.full(cells.shape, -1)
    of_cells[row, corner] = at
    of_faces = np.stack(
        [np.searchsorted(key, _key(face[:, 0], face[:, 1], many)) for face in (mesh.joint_bottom, mesh.joint_top)],
        axis=1,
    )
    # A fracture of one joint ends at both of its nodes: its faces have them in common.
    closed = np.flatnonzero(of_faces[:, 0] == of_faces[:, 1])
    above = mesh.joint_cells[closed, 1]
    anew = len(key) + np.arange(len(closed))
    of_cells[above, np.argmax(of_cells[above] == of_faces[closed, 1:], axis=1)] = anew
    of_faces[closed, 1] = anew
    total = len(key) + len(closed)

    is_near = np.zeros(total, dtype=bool)
    is_near[of_cells[:near][cells[:near] >= 0]] = True
    number = np.empty(total, dtype=np.int64)
    number[np.argsort(~is_near, kind="stable")] = np.arange(total)
    of_cells = np.where(cells >= 0, number[of_cells], -1)
    of_faces = number[of_faces]
    of_sides = number[np.searchsorted(key, _key(mesh.side_facets[:, 0], mesh.side_facets[:, 1], many))]
    edge = of_cells[row, corner]
    ends = np.empty((total, 2), dtype=np.int64)
    ends[edge] = np.stack([cells[row, corner], after], axis=1)
    turned = mesh.origin[ends[:, 0]] > mesh.origin[ends[:, 1]]
    ends[turned] = ends[turned][:, ::-1]
    origin = np.arange(total)
    origin[of_faces] = of_faces.min(axis=1)[:, None]
    owner = np.full(total, size, dtype=np.int64)
    np.minimum.at(owner, edge, cell_rank[row])
    body = np.full(total, -1, dtype=np.int64)
    np.maximum.at(body, edge, cell_body[row])
    alike = np.where(is_quad, np.cumsum(is_quad), np.cumsum(~is_quad)) - 1
    quads, nodes = int(is_quad[:near].sum()), many
    if near < len(cells):
        nodes = len(np.unique(cells[:near][cells[:near] >= 0]))
    counts = Counts(
        (nodes, many - nodes), (int(is_near.sum()), int((~is_near).sum())), (near - quads, _rest(~is_quad[near:])),
        (quads, _rest(is_quad[near:])), len(mesh.joint_flow), len(mesh.flow_origin),
    )  # fmt: skip
    return Edges(number=np.arange(total), origin=origin, owner=owner, body=body, ends=ends, of_cells=of_cells,
        of_faces=of_faces, of_sides=of_sides, alike=alike, cell_body=cell_body), counts  # fmt: skip


def _rest(flags: Ints) -> int:
    return int(np.count_nonzero(flags))


def _key(one: Ints, other: Ints, many: int) -> Ints:
    """A number for each pair of nodes, the same from either end."""
    return np.minimum(one, other) * many + np.maximum(one, other)
