"""The row that closes an undrained component of the network: its walls, its fluid or its level in place of one balance.

Where a component stores fluid, but less than the round-off of what it conducts, the sum of its balances is that row. Flow from
node to node is not in the sum.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from fracflow._petsc import PETSc, destroy
from fracflow.mesh.blocks import owner_of
from fracflow.mesh.data import Bools, Floats, Ints
from fracflow.model.flow import Conduction
from fracflow.model.layout import FewEntries, Layout, add_blocks, create_matrix, local_rows, product
from fracflow.model.network_parts import NetworkComponent, NetworkComponents
from fracflow.model.operators import Operators

FREE = 1e-10  # of the volume that single nodes take up by a wall's motion: less is round-off


@dataclass(frozen=True)
class Closure:
    """The row in place of the balance at one node of an undrained component without storage.

    The balances of its nodes add up to zero, so one of them is redundant and the level is undetermined.

    by       "walls": it keeps its volume. "fluid": it keeps its compressible fluid. "level": it keeps its mean pressure,
             as its walls cannot move. So does one node pinched on all sides, which must be free to open again
    row      local number of the node on the rank that owns it, empty elsewhere
    weights  at each displacement that the volume depends on, its change with it; for "level" shares of pressures in the mean
    size     of a volume, by which that of "walls" and "fluid" is divided [area]
    number   of the flow node that has the row, the same on every rank
    nodes    (n,) numbers of the flow nodes of the component on this rank
    ends     joints (n,) of this rank and which end of them (n,), in a component that keeps its fluid
    """

    by: Literal["walls", "fluid", "level"]
    row: Ints
    weights: FewEntries
    size: float
    number: int
    nodes: Ints
    ends: tuple[Ints, Ints]


def change_volume(operators: Operators, parts: NetworkComponents, held: Ints) -> Bools:
    """Whether the volume of each part (k,) changes when its walls move, with ``held`` displacements (n,). Collective.

    Nor does it change where walls open on one side as much as they close on another, as around a floating rigid block.
    """
    walls, count = local_rows(operators.network.storage_coupling), len(parts.roots)
    moves = np.ones(operators.layout.solid_count, dtype=bool)
    moves[held] = False
    free = moves[walls.rows]
    keys, inverse = np.unique(walls.rows[free] * count + parts.at(walls.cols[free]), return_inverse=True)
    room, size = np.zeros(len(keys)), np.zeros(len(keys))
    np.add.at(room, inverse, walls.values[free])
    np.add.at(size, inverse, np.abs(walls.values[free]))
    largest, gives = np.zeros(count), np.zeros(count)
    np.maximum.at(largest, keys % max(count, 1), size)
    largest = parts.largest(largest)
    np.logical_or.at(gives, keys % max(count, 1), np.abs(room) > FREE * largest[keys % max(count, 1)])
    return np.asarray(parts.largest(gives) > 0.0)


def close(
    operators: Operators, parts: NetworkComponents, part: NetworkComponent, gives: bool, holds: bool = False
) -> Closure:
    """The closure of an undrained component, by whether its walls can move. Collective.

    holds  whether it holds a fluid that is compressible, in a step that stores nothing
    """
    layout, network, scales = operators.layout, operators.network, operators.scales
    local = part.nodes - int(layout.flow_starts[layout.comm.rank])
    row = local[part.nodes == part.root]
    size, nothing = scales.length * scales.displacement, np.zeros(0, dtype=np.int64)
    if not holds and (part.count == 1 or not gives):
        shares = FewEntries(local, np.full(len(local), 1.0 / part.count))
        return Closure("level", row, shares, size, part.root, part.nodes, (nothing, nothing))
    inside = layout.flow_vector()
    inside.getArray()[local] = 1.0
    weights = product(network.storage_coupling, inside)
    inside.destroy()
    if not holds:
        return Closure("walls", row, _entries(weights), size, part.root, part.nodes, (nothing, nothing))
    ends, walls = parts.roots[parts.ends] == part.root, local_rows(network.storage_coupling)
    volume = float(np.sum(np.where(ends, 0.5 * network.length[:, None] * np.maximum(network.aperture, 0.0), 0.0)))
    soft = network.compressibility * scales.pressure * layout.comm.allreduce(volume)
    touched = np.unique(walls.rows[parts.roots[parts.at(walls.cols)] == part.root])
    fluid, (joint, end) = max(size if gives else 0.0, soft) or size, np.nonzero(ends)
    return Closure("fluid", row, _entries(weights, touched), fluid, part.root, part.nodes, (joint, end))


def _entries(weights: Floats, *also: Ints) -> FewEntries:
    at = np.union1d(np.flatnonzero(weights), np.concatenate([np.zeros(0, dtype=np.int64), *also]))
    return FewEntries(at, weights[at])


def closure_row(closure: Closure, layout: Layout) -> tuple[Ints, Floats]:
    """Joined numbers (n,) of the unknowns in a closure's row, and weights (n,); none on ranks without it. Collective."""
    entries, is_level = closure.weights, closure.by == "level"
    first = int((layout.flow_starts if is_level else layout.solid_starts)[layout.comm.rank])
    number = layout.flow_numbers if is_level else layout.solid_numbers
    fluid = layout.flow_numbers(closure.nodes) if closure.by == "fluid" else closure.nodes[:0]
    here = number(entries.at + first), fluid, entries.values, np.zeros(len(fluid))
    gathered = layout.comm.gather(here, root=int(owner_of(layout.flow_starts, np.array([closure.number]))[0]))
    if gathered is None:
        return closure.nodes[:0], entries.values[:0]
    walls, held, weights, nothing = (np.concatenate(each) for each in zip(*gathered, strict=True))
    return np.concatenate([walls, held]), np.concatenate([weights, nothing])


@dataclass(frozen=True, eq=False)
class SummedBalances:
    """Components in which the sum of all balances takes the place of that of one node, their root.

    Such a row is divided by alpha_1 times a volume of ``sizes``; others are divided by the size of flows. ``rate`` below is
    alpha_1 over that size. So the row is of the size of others, however slow the storage is.

    members  1 in the row of each root, at the flow nodes of its component; other rows are empty
    roots    (r,) local numbers of the roots on this rank
    sizes    (r,) of volumes there [area]
    root_at  (j, 2) number of the root of each joint end of this rank, -1 in other components
    size_at  (j, 2) the sizes there, 1 in other components
    """

    members: PETSc.Mat
    roots: Ints
    sizes: Floats
    root_at: Ints
    size_at: Floats

    def with_sums(self, values: Floats, rate: float) -> Floats:
        """Values (n,) at this rank's flow nodes; at roots sums over their components, over ``rate`` * size. Collective."""
        found = values.copy()
        found[self.roots] = self._sums(values) / (rate * self.sizes)
        return found

    def without_sums(self, values: Floats, rate: float) -> Floats:
        """The values (n,) of which ``with_sums`` makes these. Collective."""
        found = values.copy()
        found[self.roots] = 0.0
        found[self.roots] = values[self.roots] * rate * self.sizes - self._sums(found)
        return found

    @property
    def is_joining(self) -> Bools:
        """Elements (j,) that join two components: flow through them has few digits in the balances beside them."""
        return np.asarray(self.root_at[:, 0] != self.root_at[:, 1])

    def between(self, conduction: Conduction) -> Conduction:
        """Flow from component to component alone, which is in the sums; nothing is stored or lost."""
        conductance, slope = np.where(self.is_joining, conduction.conductance, 0.0), conduction.slope
        return Conduction(conductance, np.where(self.is_joining[:, None], slope, 0.0), conduction.pressure)

    def add_diagonal(self, matrix: PETSc.Mat, values: Floats, rate: float) -> None:
        """Add values (n,) at this rank's flow nodes to a matrix of pressures, whose rows at roots are such sums. Collective."""
        added, diagonal = self.members.copy(), self.members.createVecRight()
        diagonal.setArray(values)
        added.diagonalScale(None, diagonal)
        other, own = diagonal.duplicate(), values.copy()
        other.set(1.0)
        other.getArray()[self.roots] = 1.0 / (rate * self.sizes)
        added.diagonalScale(other, None)
        matrix.axpy(1.0, added, PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN)
        own[self.roots] = 0.0
        add_diagonal(matrix, own)
        destroy(added, diagonal, other)

    def _sums(self, values: Floats) -> Floats:
        """Sums (r,) of values (n,) over the components of this rank's roots. Collective."""
        nodes = self.members.createVecRight()
        nodes.setArray(values)
        found = product(self.members, nodes)[self.roots]
        nodes.destroy()
        return found

    def destroy(self) -> None:
        """Free the matrix. Collective."""
        self.members.destroy()


@dataclass(frozen=True, eq=False)
class FaintParts:
    """Parts of the network (k,) that store less than the round-off of what they conduct.

    Pressures there differ by less than their round-off, and so does the flow that they drive from node to node. The volumes
    that the parts store have all digits. Balances say how much flows, and how much prescribed pressures bring.

    count  (k,) prescribed pressures in each
    roots  (k,) of the sums, as of ``sum_balances``
    """

    parts: NetworkComponents
    faint: Bools
    count: Floats
    roots: Ints

    def balanced(self, conduction: Floats, left: Floats, given: Ints) -> Floats:
        """``conduction`` (q,) at this rank's flow nodes, with which their balances are exact [volume rate per thickness].

        left (q,) imbalance of (3.20), 0 at the ``given`` local numbers (n,) of prescribed pressures. These bring what is
        lacking, each of a part an equal share. Collective.
        """
        at = self.parts.own
        wrong = np.where(self.faint[at], left, 0.0)
        lacks = self.parts.summed(np.bincount(at, wrong, len(self.faint)))
        found: Floats = conduction - wrong
        found[given] += (lacks / np.maximum(self.count, 1.0))[at[given]]
        return found

    def known(self, given: Ints) -> Bools:
        """Whether each of those nodes (n,) is the only one of such a part, so that its inflow has all digits."""
        at = self.parts.own[given]
        return np.asarray(self.faint[at] & (self.count[at] == 1.0))


def add_diagonal(matrix: PETSc.Mat, values: Floats) -> None:
    """Add values (n,) of this rank's rows to the diagonal. Collective."""
    diagonal = matrix.getDiagonal()
    diagonal.setArray(diagonal.getArray() + values)
    matrix.setDiagonal(diagonal)
    diagonal.destroy()


def sum_balances(operators: Operators, parts: NetworkComponents, roots: Ints, gives: Bools) -> SummedBalances:
    """The sums of parts (k,), by whether walls change their volume (k,). The caller owns them. Collective.

    roots  (k,) numbers of the nodes whose balances they replace, the same on every rank; -1 where there is no sum

    The sizes do not depend on a state, since a run that is resumed must have the same.
    """
    layout, network, scales = operators.layout, operators.network, operators.scales
    first, last = layout.flow_starts[layout.comm.rank : layout.comm.rank + 2]
    sizes = (layout.flow_count, int(layout.flow_starts[-1]))
    to_roots = create_matrix((sizes, sizes), 1, layout.comm)
    own = np.flatnonzero(roots[parts.own] >= 0)
    add_blocks(to_roots, first + own[:, None], roots[parts.own[own]][:, None], np.ones((len(own), 1, 1)))
    to_roots.assemble()
    members = to_roots.transpose(PETSc.Mat())
    to_roots.destroy()
    half = 0.5 * network.length[:, None]
    soft = network.compressibility * half * np.maximum(network.aperture, 0.0)
    opened = gives[parts.ends] * half * network.length[:, None] * scales.displacement / scales.force
    volume = scales.pressure * parts.summed(np.bincount(parts.ends.ravel(), (soft + opened).ravel(), len(parts.roots)))
    volume = np.where(volume > 0.0, volume, scales.length * scales.displacement)
    here = np.flatnonzero((roots >= first) & (roots < last))
    return SummedBalances(
        members,
        roots[here] - int(first),
        volume[here],
        roots[parts.ends],
        np.where(roots[parts.ends] >= 0, volume[parts.ends], 1.0),
    )
