"""A split mesh with its cells cut in four, as one rank needs it that looks at all of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fracflow.mesh.data import SplitMesh
from fracflow.mesh.edges import number_edges
from fracflow.mesh.plane.cut import cut
from fracflow.mesh.share import Owners, share_of


def cut_mesh(mesh: SplitMesh) -> SplitMesh:
    """The mesh with each cell cut in four, ``cuts`` times, in the numbers that ranks give to the cells that they cut.

    Nodes on near cells and flow nodes of ``mesh``, its ``coarse`` one, keep their numbers.
    """
    return _cut(mesh, len(mesh.cells)) if mesh.cuts else mesh


def near_mesh(mesh: SplitMesh) -> SplitMesh:
    """The near cells of ``cut_mesh``, which are its first, with its first nodes. Joints, flow nodes and sides are on them."""
    return _cut(mesh, mesh.near_count) if mesh.cuts else mesh


def whole_mesh(mesh: SplitMesh) -> SplitMesh:
    """All cells, of a mesh that may have the near ones alone, with the ``coarse`` one."""
    assert mesh.sums is None  # ranks have the others: they are gathered first
    return mesh if len(mesh.cells) == mesh.children * len(mesh.uncut.cells) else cut_mesh(mesh.uncut)


def sizes_of(mesh: SplitMesh) -> tuple[int, int]:
    """How many cells and nodes there are once all cells are cut."""
    uncut = mesh.uncut
    cells = np.zeros(len(uncut.cells), np.int64)
    if not uncut.cuts:
        return len(mesh.cells), len(mesh.points)
    counts = number_edges(uncut, cells, cells, 1)[1]
    for _ in range(uncut.cuts):
        counts = counts.cut()
    return sum(counts.cells), sum(counts.nodes)


def _cut(mesh: SplitMesh, count: int) -> SplitMesh:
    """The first ``count`` cells, all or the near ones, with all joints and sides."""
    cells, nodes, flow_nodes = (np.zeros(len(each), np.int64) for each in (mesh.cells, mesh.points, mesh.flow_origin))
    edges, counts = number_edges(mesh, cells, cells - 1, 1)
    chosen = (np.arange(each) for each in (count, len(mesh.joint_flow), len(mesh.side_facets)))
    share = share_of(mesh, Owners(cells, nodes, flow_nodes, nodes - 1, nodes, edges), 0, *chosen)
    del edges
    for _ in range(mesh.cuts):
        share, counts = cut(share, counts), counts.cut()
    assert share.edges is not None
    numbered = np.append(share.node, -1)
    points = np.zeros((counts.nodes[0] if count < len(mesh.cells) else sum(counts.nodes), mesh.points.shape[1]))
    points[share.node] = share.points
    origin = np.arange(len(points))
    origin[share.node] = share.origin
    bottom, top = numbered[share.faces[:, 0]], numbered[share.faces[:, 1]]
    joint_flow = share.flow_node[share.flow]
    flow_origin = np.empty(counts.flow_nodes, dtype=np.int64)
    flow_origin[joint_flow] = origin[bottom]
    flow_origin[: len(mesh.flow_origin)] = mesh.flow_origin  # of joined ends the first
    cell_of = np.empty(len(share.edges.number), dtype=np.int64)
    row, corner = np.nonzero(share.edges.of_cells >= 0)
    cell_of[share.edges.of_cells[row, corner]] = row
    return replace(
        mesh,
        points=points,
        origin=origin,
        cells=numbered[share.cells],
        cell_rock=share.cell_rock,
        joint_bottom=bottom,
        joint_top=top,
        joint_cells=cell_of[share.edges.of_faces],
        joint_flow=joint_flow,
        joint_fracture=share.fracture,
        joint_along=share.along,
        flow_origin=flow_origin,
        side_facets=numbered[share.side_facets],
        side_cell=share.side_cell,
        side_of=share.side_of,
        cuts=0,
        near=-1,
        coarse=mesh,
    )
