"""What multigrid must know of the displacements: that two unknowns are a node, and which motions cost no energy."""

from __future__ import annotations

import numpy as np

from fracflow._petsc import PETSc
from fracflow.assembly.operators import Operators
from fracflow.mesh.blocks import Blocks
from fracflow.mesh.data import Floats


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


def tell_rigid_motions(operators: Operators, solid: PETSc.IS) -> None:
    """Give the split ``solid`` its rigid motions as near null space, and its block size where all unknowns are nodes'.

    PCFIELDSPLIT hands both on to the matrix of the split. Collective.
    """
    blocks, layout = operators.blocks, operators.layout
    if operators.expand is None:
        solid.setBlockSize(blocks.sizes.dim)
    vectors: list[PETSc.Vec] = []
    for motion in rigid_motions(blocks).T:
        vector = layout.solid_vector()
        vector.setArray(motion)
        for other in vectors:  # PETSc wants them orthonormal
            vector.axpy(-vector.dot(other), other)
        vector.normalize()
        vectors.append(vector)
    space = PETSc.NullSpace().create(vectors=vectors, comm=layout.comm)
    solid.compose("nearnullspace", space)
    for thing in (*vectors, space):
        thing.destroy()
