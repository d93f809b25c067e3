"""Walls of fractures that never part are one again, and what of a mesh hangs together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fracflow.mesh.data import Bools, Ints, SplitMesh
from fracflow.mesh.facets import components


def groups(mesh: SplitMesh) -> Ints:
    """Which fractures (f,) hang together: those that share nodes, directly or by others, have one number."""
    count = len(mesh.fractures)
    fracture = np.repeat(mesh.joint_fracture, mesh.joint_flow.shape[1])
    return components(fracture, count + mesh.joint_flow.ravel(), count + len(mesh.flow_origin))[:count]


def parts(mesh: SplitMesh, ties: Ints) -> Ints:
    """Which nodes (n,) hang together by cells, by joints, or by ``ties``, pairs (m, 2) of node * dim + component."""
    cell, corner = np.nonzero(mesh.cells >= 0)
    tied = ties // mesh.points.shape[1]
    first = np.concatenate([mesh.cells[cell, 0], mesh.joint_bottom.ravel(), tied[:, 0]])
    second = np.concatenate([mesh.cells[cell, corner], mesh.joint_top.ravel(), tied[:, 1]])
    return components(first, second, len(mesh.points))


def glued(mesh: SplitMesh, chosen: Bools) -> SplitMesh:
    """The mesh as if there were none of the fractures chosen (f,), which share no node with the others.

    Cells keep their numbers, and nodes those of the raw mesh; copies, joints, flow nodes and fractures are numbered anew.
    """
    stays = ~chosen[mesh.joint_fracture]
    is_shut = np.zeros(len(mesh.points), dtype=bool)
    is_shut[mesh.flow_origin[mesh.joint_flow[~stays]]] = True
    same = np.arange(len(mesh.points))
    one = np.where(is_shut[mesh.origin], mesh.origin, same)  # of all copies the first one
    node, flow = (np.cumsum(kept) - 1 for kept in (one == same, ~is_shut[mesh.flow_origin]))
    renamed = node[one]
    return replace(
        mesh,
        points=mesh.points[one == same],
        origin=mesh.origin[one == same],
        cells=np.where(mesh.cells >= 0, renamed[mesh.cells], -1),
        joint_bottom=renamed[mesh.joint_bottom[stays]],
        joint_top=renamed[mesh.joint_top[stays]],
        joint_cells=mesh.joint_cells[stays],
        joint_flow=flow[mesh.joint_flow[stays]],
        joint_fracture=(np.cumsum(~chosen) - 1)[mesh.joint_fracture[stays]],
        joint_along=mesh.joint_along[stays],
        fractures=tuple(name for name, out in zip(mesh.fractures, chosen, strict=True) if not out),
        flow_origin=mesh.flow_origin[~is_shut[mesh.flow_origin]],
        side_facets=renamed[mesh.side_facets],
    )
