"""Fractures become joints: corners joined across all other facets are one copy of a node.

Distances along a fracture count from its start; walls of locked fractures, which never part, are merged again.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from fracflow.elements.facet import frame
from fracflow.errors import InputError
from fracflow.mesh.data import Bools, Floats, Ints, RawMesh, SplitMesh, is_unmeshed
from fracflow.mesh.facets import (
    HalfFacets,
    Matches,
    half_facets,
    joined_by_cells,
    match,
    number_facets,
    ridges,
    rows_near,
    spot,
)
from fracflow.mesh.graph import components, distances
from fracflow.mesh.plane.quality import worst_cells


def arc_length(points: Floats, facets: Ints, fracture_of: Ints) -> Floats:
    """Distance (f, 2) of both ends of each facet from the start of its fracture, along the trace [length].

    points (n, dim); facets (f, 2), each head to tail in the direction of its trace; fracture_of (f,). A fracture in
    several pieces starts anew on each; a closed loop starts at the tail of its first facet. Surfaces (f, 3) and (f, 4) have
    no such distance: 0.
    """
    if not len(facets) or facets.shape[1] > 2:
        return np.zeros(facets.shape)
    key = fracture_of[:, None] * (facets.max() + 1) + facets
    vertex, place = np.unique(key, return_inverse=True)
    tail, head = place.reshape(facets.shape).T
    step = np.linalg.norm(points[facets[:, 1]] - points[facets[:, 0]], axis=1)
    piece = components(tail, head, len(vertex))
    is_start = np.zeros(len(vertex), dtype=bool)
    is_start[tail] = True
    is_start[head] = False
    first_facet = np.unique(piece[tail], return_index=True)[1]
    is_loop = ~np.isin(piece[tail[first_facet]], piece[is_start])
    is_start[tail[first_facet[is_loop]]] = True
    distance = distances(tail, head, step, np.flatnonzero(is_start), len(vertex))
    ends = np.stack([distance[tail], distance[tail] + step], axis=1)
    return np.asarray(ends, dtype=np.float64)


def split(raw: RawMesh) -> SplitMesh:
    """Give a fracture node one copy for each piece of rock around it, and a fracture facet two faces.

    A corner (cell, node) on a fracture is joined to that of the neighbour across each facet that is not on a fracture.
    The connected components are the copies. The first copy, that of the lowest cell, keeps the node's number. A tip has
    one copy: its section has no jump. The top of a joint is on the cell left of its facet, that to which the normal of
    a surface points, the bottom on the other. Raises InputError, naming fracture and place, for facets that have no
    cell on one side or are not in the mesh.
    """
    dim = raw.points.shape[1]
    facets = raw.fracture_facets
    rows = rows_near(raw.cells, facets, 1)
    half = half_facets(raw.cells[rows], dim)
    matches = match(half, facets)
    _check_fractures(raw, half, matches)

    cells, origin = _copy_nodes(raw, rows, half, matches.inside)
    bottom, top = _below_and_above(raw, half, matches)
    flow_origin, joint_flow = np.unique(facets, return_inverse=True)
    side_facets, side_cell = _sides(raw, cells)
    return SplitMesh(
        points=raw.points[origin],
        origin=origin,
        cells=cells,
        cell_rock=raw.cell_rock,
        rocks=raw.rocks,
        joint_bottom=_nodes_facing(cells[rows], half, bottom, facets),
        joint_top=_nodes_facing(cells[rows], half, top, facets),
        joint_cells=rows[half.cell[np.stack([bottom, top], axis=1)]],
        joint_flow=joint_flow.reshape(facets.shape),
        joint_fracture=raw.fracture_of,
        joint_along=arc_length(raw.points, facets, raw.fracture_of),
        fractures=raw.fractures,
        flow_origin=flow_origin,
        side_facets=side_facets,
        side_cell=side_cell,
        side_of=raw.side_of,
        sides=raw.sides,
        named_points=raw.named_points,
        notes=raw.notes,
    )


def summary(mesh: SplitMesh) -> dict[str, Any]:
    """Counts of cells, nodes, copies, joints, junctions, tips and separate blocks; fracture lengths, or areas in space.

    In the plane angles of cells too. In space junctions and tips are edges of facets. Rock that is not meshed has no cells.
    """
    length = np.bincount(mesh.joint_fracture, frame(mesh.points[mesh.joint_bottom])[1], len(mesh.fractures))
    nodes, piece = joined_by_cells(mesh.cells, len(mesh.points))
    of_cells: dict[str, Any] = {"blocks": len(np.unique(piece[nodes]))}
    if mesh.points.shape[1] == 2:
        of_cells |= worst_cells(mesh.points, mesh.cells)
    unmeshed = is_unmeshed(mesh.cells)
    return {
        "cells": 0 if unmeshed else len(mesh.cells),
        "nodes": len(mesh.points),
        "copies": int(np.sum(mesh.origin != np.arange(len(mesh.origin)))),
        "joints": len(mesh.joint_flow),
        "junctions": int(np.sum(np.bincount(_meeting(mesh)) > 2)),
        "tips": tip_count(mesh),
        **({} if unmeshed else of_cells),
        "lengths": {name: float(value) for name, value in zip(mesh.fractures, length, strict=True)},
    }


def tip_count(mesh: SplitMesh) -> int:
    """The number of ends of fractures inside the rock, where their sides meet."""
    number = _meeting(mesh)
    closed = ridges(mesh.joint_bottom == mesh.joint_top).all(axis=2).ravel()
    return int(np.sum(np.bincount(number)[number[closed]] == 1))


def _meeting(mesh: SplitMesh) -> Ints:
    """A number for each end (2 f,) of the joints, or each edge (k f,), the same for those that lie in one place."""
    each = ridges(mesh.joint_flow)
    (number,) = number_facets(each.reshape(-1, each.shape[2]))
    return number


def _copy_nodes(raw: RawMesh, rows: Ints, half: HalfFacets, inside: Ints) -> tuple[Ints, Ints]:
    """Cells with the new node numbers, and the raw node of each."""
    is_on = np.zeros(len(raw.points), dtype=bool)
    is_on[raw.fracture_facets] = True
    near = raw.cells[rows]
    width = near.shape[1]
    # Both halves of a facet list its nodes in ascending order, so that their corners face each other.
    by_node = np.argsort(half.nodes, axis=1)
    node = np.take_along_axis(half.nodes, by_node, axis=1)
    corner = half.cell[:, None] * width + np.take_along_axis(half.corner, by_node, axis=1)
    is_joined = is_on[node[inside[:, 0]]]
    label = components(corner[inside[:, 0]][is_joined], corner[inside[:, 1]][is_joined], near.size)

    corners = np.flatnonzero((near >= 0).ravel() & is_on[near].ravel())
    piece, first, member = np.unique(label[corners], return_index=True, return_inverse=True)
    piece_node = near.ravel()[corners[first]]
    order = np.lexsort([first, piece_node])
    is_copy = np.zeros(len(piece), dtype=bool)
    is_copy[order[1:]] = piece_node[order[1:]] == piece_node[order[:-1]]
    copies = order[is_copy[order]]
    number = piece_node.copy()
    number[copies] = len(raw.points) + np.arange(len(copies))

    renamed = near.ravel().copy()
    renamed[corners] = number[member]
    cells = raw.cells.copy()
    cells[rows] = renamed.reshape(near.shape)
    return cells, np.concatenate([np.arange(len(raw.points)), piece_node[copies]])


def _places(half: HalfFacets, chosen: Ints, facets: Ints) -> Ints:
    """Place of each facet's nodes within the chosen half facets (f, k)."""
    return np.argmax(half.nodes[chosen][:, None, :] == facets[:, :, None], axis=2)


def _nodes_facing(cells: Ints, half: HalfFacets, chosen: Ints, facets: Ints) -> Ints:
    """New nodes of the chosen half facets, in the order of ``facets``."""
    corner = np.take_along_axis(half.corner[chosen], _places(half, chosen, facets), axis=1)
    return cells[half.cell[chosen][:, None], corner]


def _below_and_above(raw: RawMesh, half: HalfFacets, matches: Matches) -> tuple[Ints, Ints]:
    """The half facets of the cells on the right and on the left of each fracture facet."""
    facets = raw.fracture_facets
    left, other = (_runs_alike(_places(half, chosen, facets)) for chosen in (matches.first, matches.second))
    if np.any(left == other):
        place = spot(raw.points, facets[np.argmax(left == other)])
        raise InputError(f"mesh: the cells at {place} overlap or turn clockwise; order them all alike")
    return np.where(left, matches.second, matches.first), np.where(left, matches.first, matches.second)


def _runs_alike(places: Ints) -> Bools:
    """Whether facets run as the half facets in which their nodes have these places (f, k)."""
    step = places[:, 1] - places[:, 0]
    return step == 1 if places.shape[1] == 2 else step % places.shape[1] == 1


def _sides(raw: RawMesh, cells: Ints) -> tuple[Ints, Ints]:
    """New nodes of the named boundary facets, cell on the left, and their cells."""
    rows = rows_near(raw.cells, raw.side_facets, raw.side_facets.shape[1])
    half = half_facets(raw.cells[rows], raw.points.shape[1])
    matches = match(half, raw.side_facets)
    for is_bad, what in (
        (matches.count == 0, "no edge of the mesh; give edges of cells that name"),
        (matches.count > 1, "inside the mesh; name it as a fracture, or leave it without a name"),
    ):
        if np.any(is_bad):
            worst = int(np.argmax(is_bad))
            name, place = raw.sides[raw.side_of[worst]], spot(raw.points, raw.side_facets[worst])
            raise InputError(f'side "{name}": the facet at {place} is {what}')
    chosen = matches.first
    owner = rows[half.cell[chosen]]
    return cells[owner[:, None], half.corner[chosen]], owner


def _check_fractures(raw: RawMesh, half: HalfFacets, matches: Matches) -> None:
    """Raise InputError for the first facet that cannot become a joint."""
    if len(matches.crowded):
        place = spot(raw.points, half.nodes[matches.crowded[0]])
        raise InputError(f"mesh: more than two cells share the edge at {place}; cells must not overlap")
    one_sided = "has a cell on one side only: on the outer boundary, or where the mesh does not conform; mesh it anew"
    (number,) = number_facets(raw.fracture_facets)
    for is_bad, what in (
        (matches.count == 0, "is no edge of the mesh; embed it in its surface"),
        (matches.count == 1, one_sided),
        (matches.count > 2, "has more than two cells; cells must not overlap"),
        (np.bincount(number)[number] > 1, "stands twice; fractures must not overlap"),
    ):
        if np.any(is_bad):
            worst = int(np.argmax(is_bad))
            ends = " to ".join(spot(raw.points, node) for node in raw.fracture_facets[worst][:, None])
            raise InputError(f'fracture "{raw.fractures[raw.fracture_of[worst]]}": the facet {ends} {what}')


def groups(mesh: SplitMesh) -> Ints:
    """Which fractures (f,) hang together: those that share nodes, directly or by others, have one number."""
    count = len(mesh.fractures)
    fracture = np.repeat(mesh.joint_fracture, mesh.joint_flow.shape[1])
    return components(fracture, count + mesh.joint_flow.ravel(), count + len(mesh.flow_origin))[:count]


def ends_on_side(mesh: SplitMesh, side: str) -> Ints:
    """Flow nodes (n,) on a side: where fractures reach it."""
    nodes = np.unique(mesh.origin[mesh.side_facets[mesh.side_of == mesh.sides.index(side)]])
    found: Ints = np.unique(mesh.joint_flow[np.isin(mesh.origin[mesh.joint_bottom], nodes)])
    return found


def joined_ends(mesh: SplitMesh, ends: Ints) -> SplitMesh:
    """The mesh where flow nodes (n,) are one, the first of them, as if a wide pipe joined them."""
    number = np.arange(len(mesh.flow_origin))
    number[ends] = ends[0]
    kept = number == np.arange(len(number))
    compact = np.cumsum(kept) - 1
    return replace(mesh, joint_flow=compact[number[mesh.joint_flow]], flow_origin=mesh.flow_origin[kept])


def merged_nodes(mesh: SplitMesh, chosen: Bools) -> tuple[Ints, Bools]:
    """Node (n,) of ``merged_faces`` that each node becomes, and whether (n,) it is the one that stays for it."""
    is_shut = np.zeros(len(mesh.points), dtype=bool)
    is_shut[mesh.flow_origin[mesh.joint_flow[chosen[mesh.joint_fracture]]]] = True
    same = np.arange(len(mesh.points))
    one = np.where(is_shut[mesh.origin], mesh.origin, same)  # of all copies the first one
    return (np.cumsum(one == same) - 1)[one], one == same


def merged_faces(mesh: SplitMesh, chosen: Bools) -> SplitMesh:
    """The mesh, before its cells are cut, as if there were none of the fractures chosen (f,), which share no node with others.

    Cells keep their numbers, and nodes their order; copies, joints, flow nodes and fractures are numbered anew.
    """
    out = chosen[mesh.joint_fracture]
    stays, (renamed, kept) = ~out, merged_nodes(mesh, chosen)
    is_open = np.ones(len(mesh.flow_origin), dtype=bool)
    is_open[mesh.joint_flow[out]] = False
    flow = np.cumsum(is_open) - 1
    return replace(
        mesh,
        points=mesh.points[kept],
        origin=renamed[mesh.origin[kept]],
        cells=np.where(mesh.cells >= 0, renamed[mesh.cells], -1),
        joint_bottom=renamed[mesh.joint_bottom[stays]],
        joint_top=renamed[mesh.joint_top[stays]],
        joint_cells=mesh.joint_cells[stays],
        joint_flow=flow[mesh.joint_flow[stays]],
        joint_fracture=(np.cumsum(~chosen) - 1)[mesh.joint_fracture[stays]],
        joint_along=mesh.joint_along[stays],
        fractures=tuple(name for name, is_out in zip(mesh.fractures, chosen, strict=True) if not is_out),
        flow_origin=renamed[mesh.flow_origin[is_open]],
        side_facets=renamed[mesh.side_facets],
        named_points={name: int(renamed[node]) for name, node in mesh.named_points.items()},
    )
