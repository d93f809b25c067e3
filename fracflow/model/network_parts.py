"""Connected components of the network, spread over the ranks: which elements conduct, and which nodes they join."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fracflow._petsc import MPI, PETSc
from fracflow.mesh.blocks import petsc_ints
from fracflow.mesh.data import Bools, Floats, Ints
from fracflow.mesh.graph import components
from fracflow.mesh.shared import Shared, lowest_joined
from fracflow.model.flow import Compression
from fracflow.model.layout import local_rows
from fracflow.model.operators import Operators

CONDUCTS = 1e-15
"""Of the conductance of all elements at its ends: an element with less is pinched, as it is lost in the balance there.
Elements elsewhere do not count: a thin fracture far from a wide one conducts."""
FIRM = 1e-12
"""Likewise: flow through an element with less has few digits in balances beside it. Sums of balances do not go beyond it."""


@dataclass(frozen=True)
class NetworkComponent:
    """A part of the network. All but ``nodes`` is the same on every rank.

    nodes      (n,) numbers of its flow nodes on this rank
    count      of its nodes on all ranks
    root       lowest number of its nodes, whose balance a closure replaces
    fractures  names of the fractures that its elements are of
    center     (dim,) mean of its nodes [length]
    """

    nodes: Ints
    count: int
    root: int
    fractures: tuple[str, ...]
    center: Floats

    def __str__(self) -> str:
        names = ", ".join(self.fractures)
        return f"{names} ({self.count} nodes around ({', '.join(f'{x:.6g}' for x in self.center)}))"


def beside(operators: Operators, conductance: Floats) -> Floats:
    """Conductance (j,) of all elements at the ends of each of this rank, itself too; the larger of both ends. Collective."""
    network, nodes = operators.network, operators.layout.flow_vector()
    network.taken_up(np.repeat(conductance, 2), nodes)
    found: Floats = network.at_ends(nodes).max(axis=1)
    nodes.destroy()
    return found


def conducting(operators: Operators, conductance: Floats) -> Bools:
    """Which elements (j,) of this rank conduct. Collective."""
    return np.asarray(conductance > CONDUCTS * beside(operators, conductance))


def holding(operators: Operators, compression: Compression | None) -> Bools:
    """Which flow nodes (q,) of this rank hold fluid that is compressible: none where walls meet. Collective."""
    network, layout = operators.network, operators.layout
    if compression is None:
        return np.zeros(layout.flow_count, dtype=bool)
    here = 0.5 * network.compressibility * network.length[:, None] * np.abs(network.aperture)
    weight, volume = (network.at_nodes(at_ends) for at_ends in (compression.weight, here))
    return np.asarray(weight > CONDUCTS * volume)


def leaving(operators: Operators, by_memory: bool = False) -> Bools:
    """Which flow nodes (q,) of this rank fluid leaves by terms with a memory, or by others, and so settles. Collective."""
    layout, flow = operators.layout, operators.blocks.joints.flow
    joints = [term.joints() for term in operators.terms if term.drains and term.has_memory == by_memory]
    here = np.unique(flow[np.concatenate([np.zeros(0, dtype=np.int64), *joints])])
    marks = layout.flow_vector()
    marks.setValues(petsc_ints(here), np.ones(len(here)), addv=PETSc.InsertMode.ADD_VALUES)
    marks.assemble()
    found = marks.getArray() > 0.0
    marks.destroy()
    return np.asarray(found)


class NetworkComponents:
    """The connected components of the network, spread over the ranks.

    Each rank knows those that its flow nodes, its joint ends or its walls touch, here called its k parts.

    roots  (k,) lowest number among the flow nodes of each, ascending
    own    (q,) which of the k parts each flow node of this rank is in
    ends   (j, 2) likewise each joint end
    sizes  (k,) flow nodes of each, over all ranks
    count  of all components of the network
    """

    def __init__(self, operators: Operators, conducts: Bools) -> None:
        """Find the components that the conducting elements (j,) of each rank make. Collective."""
        self._operators, blocks, layout = operators, operators.blocks, operators.layout
        comm, first, total = layout.comm, int(layout.flow_starts[layout.comm.rank]), int(layout.flow_starts[-1])
        here = first + np.arange(layout.flow_count)
        beside_walls = local_rows(operators.network.storage_coupling).cols
        self._numbers = np.unique(np.concatenate([here, blocks.joints.flow.ravel(), beside_walls]))
        links = np.searchsorted(self._numbers, blocks.joints.flow)
        tree = components(links[conducts, 0], links[conducts, 1], len(self._numbers))
        label = lowest_joined(comm, layout.flow_count, total, self._numbers, tree)
        self.roots, self._of = np.unique(label, return_inverse=True)
        self.own, self.ends = self._of[np.searchsorted(self._numbers, here)], self._of[links]
        self._shared = Shared(comm, layout.flow_count, total, self.roots)
        self._is_mine = (self.roots >= first) & (self.roots < first + layout.flow_count)
        self.sizes = self.summed(np.bincount(self.own, minlength=len(self.roots))).astype(np.int64)
        self.count = int(comm.allreduce(int(self._is_mine.sum())))

    def at(self, numbers: Ints) -> Ints:
        """Which of the k parts flow nodes (n,) are in that this rank knows."""
        return self._of[np.searchsorted(self._numbers, numbers)]

    def summed(self, values: Floats | Ints) -> Floats:
        """Sum (k,) over the ranks of what each has for its parts (k,). Collective."""
        return self._shared.summed(np.asarray(values, dtype=float))

    def largest(self, values: Floats) -> Floats:
        """Largest (k,) of what ranks have for their parts (k,). Collective."""
        return self._shared.largest(values)

    def any_of(self, nodes: Bools) -> Bools:
        """Whether any of the flow nodes (q,) of this rank, or of others, is in each of the parts (k,). Collective."""
        return np.asarray(self.summed(np.bincount(self.own[nodes], minlength=len(self.roots))) > 0.0)

    def root_at(self, node: int) -> int:
        """The root of the part of any flow node, by its number. Collective."""
        here = int(self.roots[self.at(np.array([node]))[0]]) if node in self._numbers else -1
        return int(self._operators.layout.comm.allreduce(here, op=MPI.MAX))

    def listed(self, chosen: Bools, most: int | None = None) -> tuple[Ints, int]:
        """Roots of the chosen parts (k,), the same on every rank, and how many there are. Collective.

        most  of them that are listed, the largest first; without it all of them, in ascending order
        """
        comm, mine = self._operators.layout.comm, np.flatnonzero(chosen & self._is_mine)
        if most is not None:
            mine = mine[np.argsort(-self.sizes[mine], kind="stable")][:most]
        parts = comm.allgather((self.roots[mine], self.sizes[mine]))
        roots, sizes = (np.concatenate(each) for each in zip(*parts, strict=True))
        count = int(comm.allreduce(int(np.count_nonzero(chosen & self._is_mine))))
        order = np.argsort(roots) if most is None else np.lexsort([roots, -sizes])[:most]
        return roots[order], count

    def named(self, roots: Ints) -> tuple[NetworkComponent, ...]:
        """The parts of some roots (n,), which are the same on every rank. Collective."""
        if not len(roots):
            return ()
        blocks, joints, count = self._operators.blocks, self._operators.blocks.joints, len(roots)
        place, order, known = np.full(len(self.roots), count), np.argsort(roots), np.isin(self.roots, roots)
        place[known] = order[np.searchsorted(roots[order], self.roots[known])]
        of_node = place[self.own]
        sums = np.zeros((count + 1, 1 + blocks.sizes.dim))
        np.add.at(sums, of_node, np.insert(blocks.flow.points, 0, 1.0, axis=1))
        blocks.comm.Allreduce(MPI.IN_PLACE, sums, op=MPI.SUM)
        pairs = np.stack([place[self.ends].ravel(), np.repeat(joints.fracture, self.ends.shape[1])], axis=1)
        here = {(part, joints.fractures[f]) for part, f in np.unique(pairs, axis=0).tolist() if part < count}
        names: list[list[str]] = [[] for _ in roots]
        for part, name in sorted(set().union(*blocks.comm.allgather(here))):
            names[part].append(name)
        in_order = np.argsort(of_node, kind="stable")
        ends = np.cumsum(np.bincount(of_node, minlength=count))[:count]
        nodes = np.split(in_order + int(blocks.flow.starts[blocks.comm.rank]), ends)
        return tuple(
            NetworkComponent(nodes[k], int(sums[k, 0]), int(root), tuple(names[k]), sums[k, 1:] / sums[k, 0])
            for k, root in enumerate(roots)
        )

    def at_root(self, facts: Bools, part: NetworkComponent) -> bool:
        """Whether a component has a fact that each rank knows of its parts (k,), the same on every rank. Collective."""
        here = bool(facts[self.roots == part.root].any())
        return bool(self._operators.layout.comm.allreduce(here, op=MPI.LOR))

    def destroy(self) -> None:
        """Free the way between the ranks. Collective."""
        self._shared.destroy()
