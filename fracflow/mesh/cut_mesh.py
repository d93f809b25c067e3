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

    Nodes and flow nodes of ``mesh``, its ``coarse`` one, keep their numbers.
    """
    if not mesh.cuts:
        return mesh
    cells, nodes, flow_nodes = (np.zeros(len(each), np.int64) for each in (mesh.cells, mesh.points, mesh.flow_origin))
    edges, counts = number_edges(mesh, len(cells), cells, cells - 1, 1)
    everything = (np.arange(len(each)) for each in (mesh.cells, mesh.joint_flow, mesh.side_facets))
    share = share_of(mesh, Owners(cells, nodes, flow_nodes, nodes - 1, nodes, edges), 0, *everything)
    for _ in range(mesh.cuts):
        share, counts = cut(share, counts), counts.cut()
    assert share.edges is not None
    numbered = np.append(share.node, -1)
    points = np.concatenate([mesh.points, np.zeros((sum(counts.nodes) - len(mesh.points), mesh.points.shape[1]))])
    points[share.node] = share.points
    origin = np.arange(len(points))
    origin[: len(mesh.points)] = mesh.origin
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
        coarse=mesh,
    )
