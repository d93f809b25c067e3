"""Motions of rock that cost no energy, as PETSc's solvers take them."""

from __future__ import annotations

import numpy as np

from fracflow._petsc import PETSc, destroy
from fracflow.mesh.blocks import Blocks
from fracflow.mesh.data import Floats
from fracflow.model.operators import Operators


def rigid_motions(blocks: Blocks) -> Floats:
    """The translations and the rotation of the plane as this rank's unknowns (n, 3), about the middle of the mesh. Collective.

    Nodal unknowns get the motion of their node, a rigid body's its own translation and turn.
    """
    block, comm, dim = blocks.solid, blocks.comm, blocks.sizes.dim
    start, end = block.unknown_starts[comm.rank : comm.rank + 2]
    middle = comm.allreduce(block.points[: block.owned].sum(axis=0)) / blocks.sizes.nodes
    motions = np.zeros((int(end - start), dim + 1))

    def turn(points: Floats) -> Floats:
        arm = points - middle
        return np.stack([-arm[:, 1], arm[:, 0]], axis=1)

    places = [(block.unknown, block.points), (block.body_unknown[:, :dim], block.body_center)]
    for unknowns, points in places:
        for axis in range(dim):
            here = np.flatnonzero((unknowns[:, axis] >= start) & (unknowns[:, axis] < end))
            rows = unknowns[here, axis] - start
            motions[rows, axis] = 1.0
            motions[rows, dim] = turn(points[here])[:, axis]
    turned = block.body_unknown[:, dim]
    motions[turned[(turned >= start) & (turned < end)] - start, dim] = 1.0
    return motions


def near_null_space(operators: Operators) -> PETSc.NullSpace:
    """The rigid motions, orthonormal, as PETSc has them. The caller destroys it. Collective."""
    blocks, layout = operators.blocks, operators.layout
    vectors: list[PETSc.Vec] = []
    for motion in rigid_motions(blocks).T:
        vector = layout.solid_vector()
        vector.setArray(motion)
        for other in vectors:
            vector.axpy(-vector.dot(other), other)
        vector.normalize()
        vectors.append(vector)
    space = PETSc.NullSpace().create(vectors=vectors, comm=layout.comm)
    destroy(*vectors)
    return space


def node_size(operators: Operators) -> int:
    """Unknowns of a node, where all unknowns are nodes'; else 1, which says nothing."""
    return operators.blocks.sizes.dim if operators.expand is None else 1


def tell_rigid_motions(operators: Operators, solid: PETSc.IS) -> None:
    """Give the split ``solid`` both; PCFIELDSPLIT passes them to the matrix of the split. Collective."""
    solid.setBlockSize(node_size(operators))
    space = near_null_space(operators)
    solid.compose("nearnullspace", space)
    space.destroy()
