"""Pieces of rock whose cells are on many ranks: each rank names its own, and the lowest name of all goes round."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fracflow._petsc import MPI
from fracflow.mesh.data import Bools, Ints
from fracflow.mesh.facets import joined_by_cells
from fracflow.mesh.slices.directory import Directory


@dataclass(frozen=True)
class Pieces:
    """Pieces of a mesh, numbered by their lowest nodes.

    roots  lowest node (p,) of each
    label  (s,) that of the piece of each node of this rank's range, the number of all nodes where it is on none
    """

    nodes: Directory
    roots: Ints
    label: Ints

    def of(self, node: Ints) -> Ints:
        """Piece (n,) of each node (n,), -1 for none. Collective."""
        label = self.nodes.look_up(self.label, node)
        return np.where(label < self.nodes.total, np.searchsorted(self.roots, label), -1)


def owners(nodes: Directory, node: Ints) -> tuple[Ints, Ints]:
    """Lowest and highest rank (s,) that has each node of the range, by the nodes (n,) on the cells of each. Collective."""
    rank = np.full(len(node), nodes.comm.rank, dtype=np.int64)
    return nodes.lowest(node, rank, nodes.comm.size), -nodes.lowest(node, -rank, 1)


def joined(nodes: Directory, node: Ints, is_shared: Bools, cells: Ints) -> Pieces:
    """The pieces that some cells of all ranks make. Collective.

    node       (n,) on cells of this rank, ascending
    is_shared  (n,) whether other ranks have them too
    cells      (m, c) places of the nodes of the chosen cells among these, -1 pads
    """
    comm, total = nodes.comm, nodes.total
    on, part = joined_by_cells(cells, len(node))
    on = np.unique(on)
    lowest = np.full(int(part.max(initial=-1)) + 1, total, dtype=np.int64)
    np.minimum.at(lowest, part[on], node[on])
    edge = on[is_shared[on]]
    changes = True
    while changes:  # at most as often as ranks are beside one another
        known = nodes.look_up(nodes.lowest(node[edge], lowest[part[edge]], total), node[edge])
        lower = lowest.copy()
        np.minimum.at(lower, part[edge], known)
        changes = comm.allreduce(bool((lower < lowest).any()), op=MPI.LOR)
        lowest = lower
    label = nodes.lowest(node[on], lowest[part[on]], total)
    roots = np.concatenate(comm.allgather(nodes.numbers[label == nodes.numbers]))
    return Pieces(nodes, roots, label)
