"""From the split mesh on rank 0 to the blocks of every rank.

Cells go where the partitioner sends them. A node belongs to the lowest rank that has a cell with it, and a joint to the
rank of its bottom cell. A flow node belongs to the lowest rank that has a joint with it. PETSc numbers are contiguous
on each rank and within a rank follow the original numbers.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Collection
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from fracflow._petsc import MPI, PETSc, destroy
from fracflow.mesh.blocks import Blocks, Sizes
from fracflow.mesh.data import Floats, Ints, SplitMesh
from fracflow.mesh.edges import number_edges
from fracflow.mesh.facets import half_facets, joined_by_cells, match
from fracflow.mesh.numbering import Common, blocks_of
from fracflow.mesh.plane.cut import Counts, cut
from fracflow.mesh.share import Owners, share_of

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
    """Send each rank its share, let it cut its cells, and number all. ``mesh`` is given on rank 0, else None. Collective.

    Of a mesh that was made from a coarse one, ranks get the cells of that.

    ties       (m, 2) pairs of node * dim + component that move alike, on rank 0; none of a rigid rock
    cell_rank  (m,) where the cells go, as they are before they are cut, on rank 0; else the partitioner says
    """
    from mpi4py.util.pkl5 import Intracomm  # sends arrays as they are, which may be larger than 2 GiB

    messages = Intracomm(comm)
    common: Common | None = None
    counts: Counts | None = None
    if mesh is not None:
        mesh = mesh.uncut
        cell_rank = partition_cells(mesh, comm.size) if cell_rank is None else cell_rank
        owners, common, counts = owned(mesh, cell_rank, comm.size, rigid_rocks)
        common = replace(common, ties=np.zeros((0, 2), np.int64) if ties is None else ties)
        joint_rank, side_rank = cell_rank[mesh.joint_cells[:, 0]], cell_rank[mesh.side_cell]
        for rank in reversed(range(comm.size)):  # one after another, its own the last: never more than one of others
            here = (np.flatnonzero(ranks == rank) for ranks in (cell_rank, joint_rank, side_rank))
            share = share_of(mesh, owners, rank, *here)
            if rank:
                messages.send(share, dest=rank)
        del owners
    else:
        share = messages.recv(source=0)
    common, counts, cuts = messages.bcast((common, counts, mesh.cuts if mesh is not None else 0), root=0)
    for _ in range(cuts):
        share, counts = cut(share, counts), counts.cut()
    return blocks_of(share, common, comm)


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


def owned(
    mesh: SplitMesh, cell_rank: Ints, size: int, rigid_rocks: Collection[str]
) -> tuple[Owners, Common, Counts | None]:
    """Owners, values that all ranks know, and counts where cells are to be cut; cell_rank (m,) of so many ranks."""
    dim = mesh.points.shape[1]
    node_owner = np.full(len(mesh.points), size, dtype=np.int64)
    for nodes in mesh.cells.T:
        used = nodes >= 0
        np.minimum.at(node_owner, nodes[used], cell_rank[used])
    joint_rank = cell_rank[mesh.joint_cells[:, 0]]
    flow_owner = _lowest_rank(
        np.repeat(joint_rank, mesh.joint_flow.shape[1]), mesh.joint_flow.ravel(), len(mesh.flow_origin), size
    )
    body, body_rock = rigid_bodies(mesh, rigid_rocks)
    on_body = np.flatnonzero(body >= 0)
    center = np.zeros((len(body_rock), dim))
    np.add.at(center, body[on_body], mesh.points[on_body])
    center /= np.bincount(body[on_body], minlength=len(body_rock))[:, None]
    body_owner = _lowest_rank(node_owner[on_body], body[on_body], len(body_rock), size)
    piece, piece_rock, piece_box = pieces_of_rock(mesh)
    edges, counts = None, None
    if mesh.cuts:
        is_rigid = np.isin(mesh.cell_rock, [i for i, rock in enumerate(mesh.rocks) if rock in rigid_rocks])
        cell_body = np.where(is_rigid, body[mesh.cells[:, 0]], -1)
        edges, counts = number_edges(mesh, cell_rank, cell_body, size)
    cut_joints = int(np.count_nonzero(joint_rank != cell_rank[mesh.joint_cells[:, 1]]))
    sizes = Sizes(dim, len(mesh.points), len(mesh.cells), len(mesh.joint_bottom), len(mesh.flow_origin), cut_joints)
    if counts is not None:
        fine = counts
        for _ in range(mesh.cuts):
            fine = fine.cut()
        sizes = Sizes(dim, sum(fine.nodes), sum(fine.cells), fine.joints, fine.flow_nodes, cut_joints << mesh.cuts)
    none = np.zeros((0, 2), dtype=np.int64)
    common = Common(
        sizes, mesh.rocks, mesh.sides, mesh.fractures, none, center, body_rock, body_owner, piece_rock, piece_box
    )
    return Owners(cell_rank, node_owner, flow_owner, body, piece, edges), common, counts
