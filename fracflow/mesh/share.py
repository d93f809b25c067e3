"""The share of a split mesh that one rank gets: its cells, and the joints, sides, nodes and edges on them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fracflow.mesh.data import Floats, Ints, SplitMesh


@dataclass(frozen=True)
class Edges:
    """Edges of plane cells, which a mesh needs whose cells are to be cut. The two faces of a joint are two edges.

    number    (e,)    in the mesh
    origin    (e,)    number of the first copy, as of nodes
    owner     (e,)    lowest rank that has a cell with it
    body      (e,)    rigid body, -1 for none
    ends      (e, 2)  local nodes, first that of the lower origin
    of_cells  (m, c)  local edges, each from its corner to the next one; -1 pads
    of_faces  (j, 2)  those of bottom and top of each joint
    of_sides  (s,)    those of the named sides
    alike     (m,)    number of each cell among the cells of as many corners
    cell_body (m,)    rigid body of each cell, -1 for none
    """

    number: Ints
    origin: Ints
    owner: Ints
    body: Ints
    ends: Ints
    of_cells: Ints
    of_faces: Ints
    of_sides: Ints
    alike: Ints
    cell_body: Ints


@dataclass(frozen=True)
class Share:
    """Some cells of a split mesh with what is on them. Numbers are those of the mesh, unless they are local.

    rank        int       whose it is
    node        (n,)      numbers
    points      (n, dim)  coordinates [length]
    origin      (n,)      number of the first copy
    owner       (n,)      lowest rank that has a cell with it
    body        (n,)      rigid body, -1 for none
    piece       (n,)      block of rock: what no joint cuts
    cell        (m,)      numbers, ascending
    cells       (m, c)    local nodes, -1 pads
    cell_rock   (m,)      index into the rocks
    joint       (j,)      numbers, ascending
    faces       (j, 2, k) local nodes of bottom and top
    fracture    (j,)      index into the fractures
    along       (j, k)    distance of each end from the start of its fracture [length]
    flow        (j, k)    local flow nodes
    flow_node   (q,)      numbers, ascending
    flow_points (q, dim)  coordinates [length]
    flow_owner  (q,)      lowest rank that has a joint with it
    side_facets (s, k)    local nodes
    side_of     (s,)      index into the sides
    side_cell   (s,)      local cell
    edges       None where no cell is to be cut
    """

    rank: int
    node: Ints
    points: Floats
    origin: Ints
    owner: Ints
    body: Ints
    piece: Ints
    cell: Ints
    cells: Ints
    cell_rock: Ints
    joint: Ints
    faces: Ints
    fracture: Ints
    along: Floats
    flow: Ints
    flow_node: Ints
    flow_points: Floats
    flow_owner: Ints
    side_facets: Ints
    side_of: Ints
    side_cell: Ints
    edges: Edges | None = None


@dataclass(frozen=True)
class Owners:
    """Values of all nodes, flow nodes and edges of a split mesh, from which shares are taken; see ``Share``.

    ``edges`` are numbered as in the mesh, and so are the nodes of their ends.
    """

    cell_rank: Ints
    node: Ints
    flow: Ints
    body: Ints
    piece: Ints
    edges: Edges | None = None


def share_of(mesh: SplitMesh, owners: Owners, rank: int, cells: Ints, joints: Ints, sides: Ints) -> Share:
    """Those cells (m,), joints (j,) and named facets (s,) of a mesh, with all nodes on them."""
    corners, facets = taken(mesh.cells, cells), mesh.side_facets[sides]
    faces = np.stack([mesh.joint_bottom[joints], mesh.joint_top[joints]], axis=1)
    node, local = _picked(len(mesh.points), corners, faces)
    has_all = len(node) == len(mesh.points)
    flow_node, local_flow = _picked(len(mesh.flow_origin), mesh.joint_flow[joints])
    return Share(
        rank=rank,
        node=node,
        points=taken(mesh.points, node),
        origin=taken(mesh.origin, node),
        owner=taken(owners.node, node),
        body=taken(owners.body, node),
        piece=taken(owners.piece, node),
        cell=cells,
        cells=corners if has_all else local[corners],
        cell_rock=taken(mesh.cell_rock, cells),
        joint=joints,
        faces=local[faces],
        fracture=mesh.joint_fracture[joints],
        along=mesh.joint_along[joints],
        flow=local_flow[mesh.joint_flow[joints]],
        flow_node=flow_node,
        flow_points=mesh.points[mesh.flow_origin[flow_node]],
        flow_owner=owners.flow[flow_node],
        side_facets=local[facets],
        side_of=mesh.side_of[sides],
        side_cell=np.searchsorted(cells, mesh.side_cell[sides]),
        edges=None if owners.edges is None else _edges_of(owners.edges, local, cells, joints, sides),
    )


def taken(values: NDArray[Any], rows: Ints) -> NDArray[Any]:
    """Some rows (k,) of an array (n, ...), ascending: where they are all it is that array itself, and takes no memory."""
    return values if len(rows) == len(values) else values[rows]


def _edges_of(edges: Edges, local: Ints, cells: Ints, joints: Ints, sides: Ints) -> Edges:
    of_cells, of_faces = edges.of_cells[cells], edges.of_faces[joints]
    number, here = _picked(len(edges.number), of_cells, of_faces)
    return Edges(
        number=number,
        origin=edges.origin[number],
        owner=edges.owner[number],
        body=edges.body[number],
        ends=local[edges.ends[number]],
        of_cells=here[of_cells],
        of_faces=here[of_faces],
        of_sides=here[edges.of_sides[sides]],
        alike=edges.alike[cells],
        cell_body=edges.cell_body[cells],
    )


def _picked(total: int, *tables: Ints) -> tuple[Ints, Ints]:
    """Numbers (n,) that are in any of the tables, ascending, and the place (total + 1,) of each in them; -1 of padding."""
    is_here = np.zeros(total + 1, dtype=bool)
    for table in tables:
        is_here[table] = True
    is_here[-1] = False  # which padding looks up
    found = np.flatnonzero(is_here)
    place = np.full(total + 1, -1, dtype=np.int64)
    place[found] = np.arange(len(found))
    return found, place
