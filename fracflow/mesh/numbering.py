"""From the shares of all ranks to their blocks. PETSc's numbers of ghosts come from the ranks that own them."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fracflow._petsc import MPI
from fracflow.mesh.blocks import Blocks, FlowBlock, JointBlock, Sizes, SolidBlock
from fracflow.mesh.data import Floats, Ints
from fracflow.mesh.locate import representatives
from fracflow.mesh.share import Share


@dataclass(frozen=True)
class Common:
    """Values of a mesh that all ranks know.

    ties        (m, 2) pairs of node * dim + component that move alike
    body_center (b, dim), body_rock (b,), body_owner (b,) of the rigid bodies
    piece_rock  (p,), piece_box (p, 2, dim) of the blocks of rock
    """

    sizes: Sizes
    rocks: tuple[str, ...]
    sides: tuple[str, ...]
    fractures: tuple[str, ...]
    ties: Ints
    body_center: Floats
    body_rock: Ints
    body_owner: Ints
    piece_rock: Ints
    piece_box: Floats


def blocks_of(share: Share, common: Common, comm: MPI.Comm) -> Blocks:
    """The blocks of this rank: nodes that it owns first, each part in the order of the numbers of the mesh. Collective."""
    dim, rank = share.points.shape[1], comm.rank
    order = np.lexsort([share.node, share.owner != rank])
    local = np.empty(len(order) + 1, dtype=np.int64)
    local[order], local[-1] = np.arange(len(order)), -1  # the last entry keeps the padding at -1
    is_sorted = bool((order[1:] > order[:-1]).all())  # as on one rank: then arrays are the mesh's own, not copies

    def ordered(values: NDArray[Any]) -> NDArray[Any]:
        return values if is_sorted else values[order]

    node, owner, body = ordered(share.node), ordered(share.owner), ordered(share.body)
    owned = int(np.count_nonzero(owner == rank))
    free = np.where(body[:owned] >= 0, 0, dim)
    rotations = dim * (dim - 1) // 2
    own_bodies = np.bincount(common.body_owner, minlength=comm.size) * (dim + rotations)
    node_starts = _starts(comm, owned)
    before = np.array(comm.allgather(int(free.sum())))
    unknown_starts = np.concatenate([[0], np.cumsum(before + own_bodies)])
    first = unknown_starts[rank] + np.cumsum(free) - free
    mine = np.stack([node_starts[rank] + np.arange(owned), first], axis=1)
    numbers = np.concatenate([mine, from_owners(comm, owner[owned:], node[owned:], node[:owned], mine)])
    unknown = numbers[:, 1:] + np.arange(dim)
    unknown[body >= 0] = -1
    by_owner = np.argsort(common.body_owner, kind="stable")
    rank_of = common.body_owner[by_owner]
    place = np.arange(len(by_owner)) - np.searchsorted(rank_of, rank_of)
    body_first = np.empty(len(by_owner), dtype=np.int64)
    body_first[by_owner] = (unknown_starts[:-1] + before)[rank_of] + place * (dim + rotations)
    unknown, unused = _tied(comm, common.ties, node, unknown, owned)
    solid = SolidBlock(
        node_ids=node,
        origin=ordered(share.origin),
        node_global=numbers[:, 0].copy(),
        points=ordered(share.points),
        owned=owned,
        cells=share.cells if is_sorted else local[share.cells],
        cell_ids=share.cell,
        cell_rock=share.cell_rock,
        rocks=common.rocks,
        side_facets=local[share.side_facets],
        side_of=share.side_of,
        side_cell=share.side_cell,
        sides=common.sides,
        unknown=unknown,
        unused=unused,
        body=body,
        body_unknown=body_first[:, None] + np.arange(dim + rotations),
        body_center=common.body_center,
        body_rock=common.body_rock,
        body_owner=common.body_owner,
        piece=ordered(share.piece),
        piece_rock=common.piece_rock,
        piece_box=common.piece_box,
        unknown_starts=unknown_starts,
        node_starts=node_starts,
    )
    is_own = share.flow_owner == rank
    flow = FlowBlock(share.flow_node[is_own], share.flow_points[is_own], _starts(comm, int(is_own.sum())))
    flow_global = np.empty((len(is_own), 1), dtype=np.int64)
    flow_global[is_own, 0] = flow.starts[rank] + np.arange(len(flow.ids))
    others = share.flow_owner[~is_own], share.flow_node[~is_own]
    flow_global[~is_own] = from_owners(comm, *others, flow.ids, flow_global[is_own])
    joints = JointBlock(
        ids=share.joint,
        bottom=local[share.faces[:, 0]],
        top=local[share.faces[:, 1]],
        flow=flow_global[share.flow, 0],
        flow_ids=share.flow_node[share.flow],
        fracture=share.fracture,
        fractures=common.fractures,
        along=share.along,
    )
    return Blocks(comm, solid, joints, flow, common.sizes)


def _starts(comm: MPI.Comm, count: int) -> Ints:
    """First number of each rank and last of all (size + 1,), of so many on this rank. Collective."""
    return np.concatenate([[0], np.cumsum(comm.allgather(count))])


def from_owners(comm: MPI.Comm, owner: Ints, wanted: Ints, own: Ints, values: Ints) -> Ints:
    """Values (g, k) of things (g,) of other ranks from their owners (g,). Collective.

    own, values  what is on this rank, (n,) ascending, and the values (n, k)
    """
    order = np.argsort(owner, kind="stable")
    ends = np.searchsorted(owner[order], np.arange(comm.size + 1))
    questions = comm.alltoall([wanted[order[a:b]] for a, b in pairwise(ends)])
    answers = comm.alltoall([values[np.searchsorted(own, each)] for each in questions])
    found = np.empty((len(wanted), values.shape[1]), dtype=values.dtype)
    found[order] = np.concatenate(answers)
    return found


def _tied(comm: MPI.Comm, ties: Ints, node: Ints, unknown: Ints, owned: int) -> tuple[Ints, Ints]:
    """Unknowns (n, dim) where those of tied nodes are one, and the numbers (t,) that no node has then. Collective."""
    if not len(ties):
        return unknown, np.zeros(0, dtype=np.int64)
    tied, pairs = np.unique(ties, return_inverse=True)
    lowest = representatives(pairs.reshape(-1, 2), len(tied))
    dim = unknown.shape[1]
    key = node[:, None] * dim + np.arange(dim)
    row = np.minimum(np.searchsorted(tied, key), len(tied) - 1)
    is_tied = tied[row] == key
    own = is_tied[:owned]
    number = np.empty(len(tied), dtype=np.int64)
    for rows, numbers in comm.allgather((row[:owned][own], unknown[:owned][own])):
        number[rows] = numbers
    unused = np.sort(number[lowest != np.arange(len(tied))])
    return np.where(is_tied, number[lowest][row], unknown), unused
