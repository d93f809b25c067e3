"""The solid and flow blocks as one rank holds them: local arrays that carry their original numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fracflow._petsc import MPI, PETSc
from fracflow.mesh.data import Floats, Ints
from fracflow.mesh.slabs import Order


@dataclass(frozen=True)
class SolidBlock:
    """Cells and split nodes of one rank; owned nodes come first, ghosts after them.

    node_ids      (n,)      number in the split mesh
    origin        (n,)      node of the raw mesh that it is a copy of
    node_global   (n,)      number in PETSc's order, contiguous on each rank
    points        (n, dim)  coordinates [length]
    owned         int       nodes owned by this rank
    cells         (m, c)    local nodes, -1 pads
    cell_ids      (m,)      number in the split mesh
    cell_rock     (m,)      index into ``rocks``
    side_facets   (s, k)    local nodes of the named boundary facets of this rank's cells
    side_of       (s,)      index into ``sides``
    side_cell     (s,)      local cell a side facet belongs to
    unknown       (n, dim)  PETSc number of the unknown of a deformable node, shared where nodes are tied; -1 on a rigid body
    unused        (t,)      numbers that no node has because it is tied to another, of all ranks, ascending
    body          (n,)      rigid body a node belongs to, -1 for none
    body_unknown  (b, r)    unknowns of each rigid body: dim translations, then the rotation
    body_center   (b, dim)  the point a body turns about [length]
    body_rock     (b,)      index into ``rocks``
    body_owner    (b,)      rank that owns its unknowns
    piece         (n,)      block of rock a node belongs to: what no joint cuts
    piece_rock    (p,)      index into ``rocks``, of the block's first cell
    piece_box     (p, 2, dim) lowest and highest coordinates of each block [length]
    unknown_starts (size + 1,) first unknown of each rank
    node_starts    (size + 1,) first node of each rank
    """

    node_ids: Ints
    origin: Ints
    node_global: Ints
    points: Floats
    owned: int
    cells: Ints
    cell_ids: Ints
    cell_rock: Ints
    rocks: tuple[str, ...]
    side_facets: Ints
    side_of: Ints
    side_cell: Ints
    sides: tuple[str, ...]
    unknown: Ints
    unused: Ints
    body: Ints
    body_unknown: Ints
    body_center: Floats
    body_rock: Ints
    body_owner: Ints
    piece: Ints
    piece_rock: Ints
    piece_box: Floats
    unknown_starts: Ints
    node_starts: Ints


@dataclass(frozen=True)
class JointBlock:
    """Joints owned by one rank (the rank of the bottom cell).

    ids       (j,)      number in the split mesh
    bottom    (j, k)    local nodes of the solid block
    top       (j, k)
    flow      (j, k)    PETSc numbers of the flow nodes
    flow_ids  (j, k)    their numbers in the split mesh
    fracture  (j,)      index into ``fractures``
    along     (j, k)    distance of each end from the start of its fracture [length]
    """

    ids: Ints
    bottom: Ints
    top: Ints
    flow: Ints
    flow_ids: Ints
    fracture: Ints
    fractures: tuple[str, ...]
    along: Floats


@dataclass(frozen=True)
class FlowBlock:
    """Flow nodes owned by one rank.

    ids     (q,)      number in the split mesh
    points  (q, dim)  coordinates [length]
    starts  (size + 1,) first PETSc number of each rank
    """

    ids: Ints
    points: Floats
    starts: Ints


@dataclass(frozen=True)
class Sizes:
    """Counts over all ranks."""

    dim: int
    nodes: int
    cells: int
    joints: int
    flow_nodes: int
    cut_joints: int


@dataclass(frozen=True)
class Blocks:
    """Everything of the mesh that one rank holds."""

    comm: MPI.Comm
    solid: SolidBlock
    joints: JointBlock
    flow: FlowBlock
    sizes: Sizes

    def gather(self, ids: Ints, values: NDArray[Any], total: int) -> NDArray[Any] | None:
        """Collect rows (n, ...) by their original numbers (n,): (total, ...) on rank 0, None elsewhere. Collective."""
        return Order(self.comm, ids, total).whole(values)


def owner_of(starts: Ints, numbers: Ints) -> Ints:
    """Rank (n,) that owns each number (n,), from the first number of each rank and the last of all (ranks + 1,)."""
    return np.searchsorted(starts, numbers, side="right") - 1


def petsc_ints(numbers: NDArray[Any]) -> NDArray[Any]:
    """Numbers (...) as PETSc's integers, which its calls insist on."""
    return np.ascontiguousarray(numbers, dtype=PETSc.IntType)
