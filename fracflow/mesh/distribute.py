"""From the split mesh on rank 0 to the blocks of every rank.

Cells go where the partitioner sends them. A node belongs to the lowest rank that has a cell with it, and a joint to the
rank of its bottom cell. A flow node belongs to the lowest rank that has a joint with it. PETSc numbers are contiguous
on each rank and within a rank follow the original numbers.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Collection
from typing import TYPE_CHECKING, Any

import numpy as np

from fracflow._petsc import MPI, PETSc, destroy
from fracflow.mesh.blocks import Blocks, FlowBlock, JointBlock, Sizes, SolidBlock
from fracflow.mesh.data import Floats, Ints, SplitMesh
from fracflow.mesh.facets import half_facets, joined_by_cells, match
from fracflow.mesh.locate import representatives

if TYPE_CHECKING:
    from scipy import sparse

JOINT_WEIGHT = 1000  # a cut joint costs ghosts on both faces; a cut facet next to nothing


def cell_graph(mesh: SplitMesh) -> sparse.csr_matrix:
    """Symmetric graph of cells (m, m): weight 1 for two cells that share a facet, JOINT_WEIGHT across a joint."""
    count, dim = len(mesh.cells), mesh.points.shape[1]
    half = half_facets(mesh.cells, dim)
    one, other = half.cell[match(half, np.zeros((0, half.nodes.shape[1]), dtype=np.int64)).inside].T
    below, above = mesh.joint_cells.T
    row = np.concatenate([one, other, below, above])
    col = np.concatenate([other, one, above, below])
    weight = np.concatenate([np.ones(2 * len(one)), np.full(2 * len(below), float(JOINT_WEIGHT))])
    from scipy import sparse  # imports much

    graph = sparse.csr_matrix((weight, (row, col)), shape=(count, count))
    graph.sum_duplicates()
    return graph


def partition_cells(mesh: SplitMesh, ranks: int) -> Ints:
    """Rank (m,) of each cell, the same whenever it is asked: by one rank, for partitioners differ from run to run on more."""
    if ranks == 1:
        return np.zeros(len(mesh.cells), dtype=np.int64)
    graph = cell_graph(mesh)
    csr = (graph.indptr.astype(PETSc.IntType), graph.indices.astype(PETSc.IntType), graph.data)
    adjacency = PETSc.Mat().createAIJ(graph.shape, csr=csr, comm=PETSc.COMM_SELF)
    adjacency.convert("mpiadj")
    options, given = PETSc.Options(), {"mat_partitioning_use_edge_weights": None, "mat_partitioning_nparts": ranks}
    for name, value in given.items():
        options[name] = value
    partitioner, result = PETSc.MatPartitioning().create(PETSc.COMM_SELF), PETSc.IS().create(PETSc.COMM_SELF)
    partitioner.setAdjacency(adjacency)
    partitioner.setType("ptscotch")
    partitioner.setFromOptions()
    _begin_anew()
    partitioner.apply(result)
    found = result.getIndices().astype(np.int64)
    for name in given:
        options.delValue(name)
    destroy(result, partitioner, adjacency)
    return found


def _begin_anew() -> None:
    """Let Scotch find the same partition again: one thread, since threads race, and its random numbers from the first on."""
    os.environ.setdefault("SCOTCH_PTHREAD_NUMBER", "1")
    reset = getattr(ctypes.CDLL(PETSc.__file__), "SCOTCH_randomReset", None)  # found among the libraries of PETSc
    if reset is not None:
        reset()


def distribute(
    mesh: SplitMesh | None,
    comm: MPI.Comm,
    rigid_rocks: Collection[str] = (),
    ties: Ints | None = None,
    cell_rank: Ints | None = None,
) -> Blocks:
    """Send each rank its blocks. ``mesh`` is given on rank 0 and None elsewhere. Collective.

    ties       (m, 2) pairs of node * dim + component that move alike, on rank 0; none of a rigid rock
    cell_rank  (m,) where the cells go, on rank 0; else the partitioner says
    """
    pieces: Any = None
    if mesh is not None:
        cell_rank = partition_cells(mesh, comm.size) if cell_rank is None else cell_rank
        pieces = _pieces(mesh, cell_rank, comm.size, rigid_rocks, np.zeros((0, 2), np.int64) if ties is None else ties)
    return Blocks(comm, *comm.scatter(pieces, root=0))


def rigid_bodies(mesh: SplitMesh, rigid_rocks: Collection[str]) -> tuple[Ints, Ints]:
    """Body (nodes,) of each node, -1 for none, and rock (bodies,) of each body: connected pieces of rigid rock."""
    is_rigid = np.isin(mesh.cell_rock, [i for i, rock in enumerate(mesh.rocks) if rock in rigid_rocks])
    return _numbered(mesh, np.flatnonzero(is_rigid))


def _numbered(mesh: SplitMesh, chosen: Ints) -> tuple[Ints, Ints]:
    """Number (nodes,) of the piece that the chosen cells make around each node, -1 for none; rock of its last cell (p,)."""
    nodes, label = joined_by_cells(mesh.cells[chosen], len(mesh.points))
    used, number = np.unique(label[nodes], return_inverse=True)
    piece = np.full(len(mesh.points), -1, dtype=np.int64)
    piece[nodes] = number
    rock = np.zeros(len(used), dtype=np.int64)
    rock[piece[mesh.cells[chosen, 0]]] = mesh.cell_rock[chosen]
    return piece, rock


def pieces_of_rock(mesh: SplitMesh) -> tuple[Ints, Ints, Floats]:
    """Block of rock of each node, what no joint cuts; rock (p,) and box (p, 2, dim) of each block."""
    piece, rock = _numbered(mesh, np.arange(len(mesh.cells))[::-1])  # the first cell of a block comes last
    used, box = np.flatnonzero(piece >= 0), np.empty((len(rock), 2, mesh.points.shape[1]))
    box[:, 0], box[:, 1] = np.inf, -np.inf
    np.minimum.at(box[:, 0], piece[used], mesh.points[used])
    np.maximum.at(box[:, 1], piece[used], mesh.points[used])
    return piece, rock, box


def _lowest_rank(rank: Ints, numbers: Ints, total: int, size: int) -> Ints:
    owner = np.full(total, size, dtype=np.int64)
    np.minimum.at(owner, numbers, rank)
    return owner


def _renumber(owner: Ints, size: int, width: Ints | None = None) -> tuple[Ints, Ints]:
    """New first number of each item, contiguous by owner, and the starts; an item takes ``width`` numbers."""
    width = np.ones(len(owner), dtype=np.int64) if width is None else width
    order = np.argsort(owner, kind="stable")
    first = np.empty(len(owner), dtype=np.int64)
    first[order] = np.concatenate([[0], np.cumsum(width[order])[:-1]]) if len(owner) else 0
    counts = np.bincount(owner, weights=width, minlength=size).astype(np.int64)
    return first, np.concatenate([[0], np.cumsum(counts)])


def _pieces(mesh: SplitMesh, cell_rank: Ints, size: int, rigid_rocks: Collection[str], ties: Ints) -> list[Any]:
    dim = mesh.points.shape[1]
    cell, corner = np.nonzero(mesh.cells >= 0)
    node_owner = _lowest_rank(cell_rank[cell], mesh.cells[cell, corner], len(mesh.points), size)
    node_global, node_starts = _renumber(node_owner, size)
    joint_rank = cell_rank[mesh.joint_cells[:, 0]]
    rank_of_ends = np.repeat(joint_rank, mesh.joint_flow.shape[1])
    flow_owner = _lowest_rank(rank_of_ends, mesh.joint_flow.ravel(), len(mesh.flow_origin), size)
    flow_global, flow_starts = _renumber(flow_owner, size)

    body, body_rock = rigid_bodies(mesh, rigid_rocks)
    bodies = len(body_rock)
    rotations = dim * (dim - 1) // 2
    center = np.zeros((bodies, dim))
    body_owner = np.zeros(bodies, dtype=np.int64)
    on_body = np.flatnonzero(body >= 0)
    if bodies:
        count = np.bincount(body[on_body], minlength=bodies)[:, None]
        np.add.at(center, body[on_body], mesh.points[on_body])
        center /= count
        body_owner = _lowest_rank(node_owner[on_body], body[on_body], bodies, size)
    free = np.where(body >= 0, 0, dim)
    owner = np.concatenate([node_owner, body_owner])
    first, starts = _renumber(owner, size, np.concatenate([free, np.full(bodies, dim + rotations)]))
    unknown = first[: len(body), None] + np.arange(dim)
    unknown[body >= 0] = -1
    body_unknown = first[len(body) :, None] + np.arange(dim + rotations)
    piece, piece_rock, piece_box = pieces_of_rock(mesh)
    unused = np.zeros(0, dtype=np.int64)
    if len(ties):
        leader = representatives(ties, unknown.size)
        unused = np.sort(unknown.ravel()[leader != np.arange(unknown.size)])
        unknown = unknown.ravel()[leader].reshape(unknown.shape)

    cut_joints = int(np.count_nonzero(joint_rank != cell_rank[mesh.joint_cells[:, 1]]))
    sizes = Sizes(dim, len(mesh.points), len(mesh.cells), len(mesh.joint_bottom), len(mesh.flow_origin), cut_joints)
    pieces = []
    for rank in range(size):
        cells = np.flatnonzero(cell_rank == rank)
        joints = np.flatnonzero(joint_rank == rank)
        sides = np.flatnonzero(cell_rank[mesh.side_cell] == rank)
        owned = np.flatnonzero(node_owner == rank)
        corners = mesh.cells[cells]
        bottom, top = mesh.joint_bottom[joints], mesh.joint_top[joints]
        touched = np.unique(np.concatenate([corners[corners >= 0], bottom.ravel(), top.ravel()]))
        ghosts = touched[node_owner[touched] != rank]
        nodes = np.concatenate([owned, ghosts])
        local = np.full(len(mesh.points) + 1, -1, dtype=np.int64)  # the last entry keeps the padding at -1
        local[nodes] = np.arange(len(nodes))
        solid = SolidBlock(
            node_ids=nodes,
            origin=mesh.origin[nodes],
            node_global=node_global[nodes],
            points=mesh.points[nodes],
            owned=len(owned),
            cells=local[corners],
            cell_ids=cells,
            cell_rock=mesh.cell_rock[cells],
            rocks=mesh.rocks,
            side_facets=local[mesh.side_facets[sides]],
            side_of=mesh.side_of[sides],
            side_cell=np.searchsorted(cells, mesh.side_cell[sides]),
            sides=mesh.sides,
            unknown=unknown[nodes],
            unused=unused,
            body=body[nodes],
            body_unknown=body_unknown,
            body_center=center,
            body_rock=body_rock,
            body_owner=body_owner,
            piece=piece[nodes],
            piece_rock=piece_rock,
            piece_box=piece_box,
            unknown_starts=starts,
            node_starts=node_starts,
        )
        flow_nodes = np.flatnonzero(flow_owner == rank)
        joint = JointBlock(
            ids=joints,
            bottom=local[bottom],
            top=local[top],
            flow=flow_global[mesh.joint_flow[joints]],
            flow_ids=mesh.joint_flow[joints],
            fracture=mesh.joint_fracture[joints],
            fractures=mesh.fractures,
            along=mesh.joint_along[joints],
        )
        flow = FlowBlock(flow_nodes, mesh.points[mesh.flow_origin[flow_nodes]], flow_starts)
        pieces.append((solid, joint, flow, sizes))
    return pieces
