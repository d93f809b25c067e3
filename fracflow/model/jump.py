"""(2.3)-(2.9) The jump operator G: strains of all joint sections from the displacements of both walls."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fracflow._petsc import PETSc
from fracflow.elements import joint
from fracflow.mesh.blocks import Blocks
from fracflow.mesh.data import Floats, Ints
from fracflow.model.layout import add_blocks, create_matrix
from fracflow.model.solid import nodal_layout, node_unknowns


@dataclass(frozen=True)
class SectionGroup:
    """Sections with equal numbers of unknowns: numbers (n,), their unknowns (n, k), and their rows of G (n, dim, k)."""

    sections: Ints
    unknowns: Ints
    jump: Floats


def jump_matrix(blocks: Blocks, points: Floats, expand: PETSc.Mat | None) -> PETSc.Mat:
    """(2.3)-(2.9) G for sections at natural coordinates ``points`` (q,). The caller destroys it. Collective."""
    block, dim = blocks.joints, blocks.sizes.dim
    frame, _ = joint.frame(blocks.solid.points[block.bottom])
    operators = joint.jump_operator(frame, points)
    count = len(block.ids) * len(points) * dim
    matrix = create_matrix(((count, blocks.comm.allreduce(count)), nodal_layout(blocks)), 4 * dim, blocks.comm)
    start = matrix.getOwnershipRange()[0]
    faces = node_unknowns(blocks, np.stack([block.bottom, block.top], axis=1))  # (joint, face, end, component)
    shape = operators.reshape(len(block.ids), len(points), dim, 2, dim, dim)
    ends_of = [np.flatnonzero([not np.isclose(abs(xi), 1.0) or xi == end for end in (-1.0, 1.0)]) for xi in points]
    for point, ends in enumerate(ends_of):
        first = start + (np.arange(len(block.ids)) * len(points) + point) * dim
        width = 2 * len(ends) * dim
        cols = faces[:, :, ends].reshape(len(block.ids), width)
        values = shape[:, point][:, :, :, ends].reshape(len(block.ids), dim, width)
        add_blocks(matrix, first[:, None] + np.arange(dim), cols, values)
    matrix.assemble()
    if expand is None:
        return matrix
    product = matrix.matMult(expand)
    matrix.destroy()
    return product


def entry_sizes(matrix: PETSc.Mat) -> PETSc.Mat:
    """The absolute values of a matrix, entry by entry. The caller destroys it. Collective."""
    indptr, indices, values = matrix.getValuesCSR()
    return PETSc.Mat().createAIJ(matrix.getSizes(), csr=(indptr, indices, np.abs(values)), comm=matrix.getComm())


def section_groups(jump: PETSc.Mat, dim: int) -> tuple[SectionGroup, ...]:
    """Rows of G gathered by section; all rows of a section share their columns."""
    indptr, indices, values = jump.getValuesCSR()
    first, width = indptr[:-1:dim], np.diff(indptr)[::dim]
    groups = []
    for k in np.unique(width):
        chosen = np.flatnonzero(width == k)
        rows = (first[chosen, None] + np.arange(dim * k)).reshape(len(chosen), dim, k)
        groups.append(SectionGroup(chosen, indices[rows[:, 0]].astype(np.int64), values[rows]))
    return tuple(groups)
