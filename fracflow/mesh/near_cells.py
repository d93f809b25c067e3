"""Cells that rank 0 looks at itself come first: those at joints, sides and places. Of the others it need not have the children.

Whatever lies on near cells has lower numbers than all else, and keeps them when cells are cut; see ``mesh.plane.cut``.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fracflow.mesh.data import Bools, Floats, SplitMesh
from fracflow.mesh.locate import covering


def near_cells(mesh: SplitMesh, places: Floats) -> Bools:
    """Cells (m,) that touch joints, named sides and points, the farthest nodes, or cells at places (p, dim)."""
    is_on = np.zeros(len(mesh.points), dtype=bool)
    is_on[mesh.origin[mesh.joint_bottom]] = True
    is_on[mesh.origin[mesh.side_facets]] = True
    is_on[list(mesh.named_points.values())] = True
    is_on[mesh.origin[[*mesh.points.argmin(axis=0), *mesh.points.argmax(axis=0)]]] = True
    corners = mesh.origin[np.where(mesh.cells >= 0, mesh.cells, mesh.cells[:, :1])]
    for place in places:
        found = covering(mesh.points, mesh.cells, place)
        is_on[corners[found] if found is not None else []] = True
    return np.asarray(is_on[corners].any(axis=1))


def with_near_first(mesh: SplitMesh, is_near: Bools) -> SplitMesh:
    """The mesh with those cells (m,), and the nodes on them, before all others; else cells and nodes keep their order."""
    has = _nodes_on(mesh, is_near)
    cells, nodes = (np.argsort(~chosen, kind="stable") for chosen in (is_near, has))
    cell, node = np.empty_like(cells), np.empty(len(nodes) + 1, dtype=np.int64)
    cell[cells], node[nodes], node[-1] = np.arange(len(cells)), np.arange(len(nodes)), -1  # the last is that of padding
    return replace(
        mesh,
        points=mesh.points[nodes],
        origin=node[mesh.origin[nodes]],
        cells=node[mesh.cells[cells]],
        cell_rock=mesh.cell_rock[cells],
        joint_bottom=node[mesh.joint_bottom],
        joint_top=node[mesh.joint_top],
        joint_cells=cell[mesh.joint_cells],
        flow_origin=node[mesh.flow_origin],
        side_facets=node[mesh.side_facets],
        side_cell=cell[mesh.side_cell],
        named_points={name: int(node[at]) for name, at in mesh.named_points.items()},
        near=int(np.count_nonzero(is_near)),
    )


def has_near_first(mesh: SplitMesh) -> bool:
    """Whether the near cells have the first nodes and all joints and sides, as cutting them takes for granted."""
    if mesh.near < 0:
        return True
    has = _nodes_on(mesh, np.arange(len(mesh.cells)) < mesh.near)
    count = int(np.count_nonzero(has))
    used = (mesh.joint_bottom, mesh.joint_top, mesh.side_facets, mesh.flow_origin)
    cells = max(mesh.joint_cells.max(initial=-1), mesh.side_cell.max(initial=-1))
    return bool(has[:count].all() and cells < mesh.near and all(each.max(initial=-1) < count for each in used))


def _nodes_on(mesh: SplitMesh, chosen: Bools) -> Bools:
    """Nodes (n,) of the chosen cells (m,)."""
    has = np.zeros(len(mesh.points) + 1, dtype=bool)
    has[mesh.cells[chosen]] = True
    return has[:-1]


def near_nodes(mesh: SplitMesh) -> int:
    """How many nodes are on near cells; all, of a mesh whose cells stay as they are."""
    return len(mesh.points) if mesh.near < 0 else int(mesh.cells[: mesh.near].max(initial=-1)) + 1


def covers(mesh: SplitMesh, is_near: Bools) -> bool:
    """Whether all those cells (m,) come first."""
    return not is_near[mesh.near_count :].any()
