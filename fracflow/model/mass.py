"""The inverse of a lumped mass, and the fastest vibration of the rock that it makes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from fracflow._petsc import MPI, PETSc, destroy
from fracflow.elements import solid
from fracflow.errors import InputError
from fracflow.integrators.explicit import critical_step
from fracflow.mesh.blocks import Blocks
from fracflow.mesh.data import Floats, Ints
from fracflow.model.layout import matrix_of
from fracflow.model.operators import Operators
from fracflow.model.solid import by_shape, deformable, elasticity, rock_values
from fracflow.model.terms.term import MeanDamping
from fracflow.scene.scene import Scene

if TYPE_CHECKING:
    from scipy import sparse

MOST_VECTORS = 120  # of Lanczos
CONVERGED = 1e-13  # relative, of the eigenvalue
PASSES = 2  # in which the stable step is found with D: none is above it


def _own_block(matrix: PETSc.Mat) -> sparse.csr_matrix:
    """The entries between this rank's unknowns."""
    from scipy import sparse

    start, stop = matrix.getOwnershipRange()
    indptr, indices, values = matrix.getValuesCSR()
    return sparse.csr_matrix((values, indices, indptr), shape=(stop - start, matrix.getSize()[1]))[:, start:stop]


def inverse_mass(operators: Operators, held: Ints) -> PETSc.Mat:
    """M^-1 of a lumped mass, nothing for the ``held`` (n,), local numbers: free blocks of rigid bodies are inverted whole.

    Raises InputError, on every rank, where a free unknown has no mass. The caller destroys the result. Collective.
    """
    from scipy import sparse

    matrix, block, comm = operators.mass, operators.blocks.solid, operators.layout.comm
    start, local = matrix.getOwnershipRange()[0], _own_block(matrix)
    free = np.ones(local.shape[0], dtype=bool)
    free[held] = False
    diagonal = local.diagonal()
    lacking = comm.allreduce(int(np.sum(free & ~(diagonal > 0.0))))
    if lacking:
        raise InputError(
            f'method.stepper = "explicit": {lacking} displacements have no mass, and it divides by it: give every rock a'
            ' density, and keep the mass of nodes on fractures, or use "newmark"'
        )
    bodies = block.body_unknown[block.body_owner == comm.rank] - start
    rows, cols = np.broadcast_arrays(bodies[:, :, None], bodies[:, None, :])
    both = free[rows] & free[cols]
    dense = np.asarray(local[rows.ravel(), cols.ravel()]).reshape(rows.shape) if len(bodies) else np.zeros(rows.shape)
    inverted = np.where(both, np.linalg.inv(np.where(both, dense, np.eye(bodies.shape[1]))), 0.0)
    free[bodies] = False
    alone = np.flatnonzero(free)
    values = np.concatenate([1.0 / diagonal[alone], inverted.ravel()])
    at = np.concatenate([alone, rows.ravel()]), np.concatenate([alone, cols.ravel()])
    kept = sparse.csr_matrix((values, at), shape=(len(diagonal), len(diagonal)))
    kept.eliminate_zeros()
    return matrix_of(matrix.getSizes(), (kept.indptr, kept.indices + start, kept.data), comm)


def longest_step(operators: Operators, scene: Scene, inverse: PETSc.Mat, damping: Sequence[MeanDamping]) -> float:
    """The longest stable step: 2/omega without D, else of 4 = dt^2 omega^2 of M^-1 (K + 2 D/dt) [time]. Collective.

    The cells and the K of terms bound it from below. A step below that bound cannot be the longest one.
    """
    springs = [term.stiffness for term in operators.terms if term.stiffness is not None]
    of_terms = sum(by_lanczos(operators, inverse, each) for each in springs)
    if not damping:
        # the lower of two bounds: the cells' is sharp on uniform meshes, the other includes supports and graded meshes
        return critical_step(min(fastest_cell(operators, scene) + of_terms, by_lanczos(operators, inverse)))
    scale = np.prod([each.scale for each in damping], axis=0)
    step = critical_step(fastest_cell(operators, scene, scale) + of_terms)
    for _ in range(PASSES):
        whole = operators.stiffness.copy()
        for each in damping:
            whole.axpy(2.0 / step, each.matrix, PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN)
        step = max(step, critical_step(by_lanczos(operators, inverse, whole)))
        whole.destroy()
    return step


def fastest_cell(operators: Operators, scene: Scene, scale: Floats | float = 1.0) -> float:
    """Largest eigenvalue of the lumped mass and the stiffness of single cells, a bound for those of the whole. Collective.

    scale  what the eigenvalues (m,) of this rank's cells are multiplied by
    """
    rates = cell_rates(operators.blocks, scene) * scale
    return float(operators.blocks.comm.allreduce(float(rates.max(initial=0.0)), op=MPI.MAX))


def cell_rates(blocks: Blocks, scene: Scene) -> Floats:
    """Largest eigenvalue (m,) of the lumped mass and the stiffness of each local cell by itself [1/time^2]; 0 where rigid."""
    chosen, points, rates = deformable(blocks, scene), blocks.solid.points, np.zeros(len(blocks.solid.cells))
    moduli, density = elasticity(blocks, scene), rock_values(blocks, scene, "density")
    for group, nodes in by_shape(blocks.solid.cells[chosen]):
        cells = chosen[group]
        lumped = np.repeat(solid.mass_lumped(points[nodes], density[cells]), blocks.sizes.dim, axis=1)
        scaled = solid.stiffness(points[nodes], moduli[cells]) / np.sqrt(lumped[:, :, None] * lumped[:, None, :])
        rates[cells] = np.linalg.eigvalsh(scaled)[:, -1]
    return rates


def by_lanczos(operators: Operators, inverse: PETSc.Mat, stiffness: PETSc.Mat | None = None) -> float:
    """Largest eigenvalue of M^-1 K_s, or of another stiffness, by Lanczos, its residual added. Collective."""
    stiff = operators.stiffness if stiffness is None else stiffness
    layout, numbers = operators.layout, np.arange(operators.layout.solid_count)
    now, before, moved, found = (layout.solid_vector() for _ in range(4))
    first = int(layout.solid_starts[layout.comm.rank])
    moved.setArray(np.sin(12.9898 * (numbers + first) ** 1.1 + 1.0))  # no vibration of the rock is orthogonal to it
    operators.mass.mult(moved, found)
    inverse.mult(found, now)  # nothing where held
    alpha: list[float] = []
    beta: list[float] = []
    largest = rest = 0.0
    for count in range(MOST_VECTORS):
        operators.mass.mult(now, moved)
        size = float(np.sqrt(max(now.dot(moved), 0.0)))
        if count:
            values, vectors = np.linalg.eigh(np.diag(alpha) + np.diag(beta, 1) + np.diag(beta, -1))
            largest, rest = float(values[-1]), size * abs(float(vectors[-1, -1]))
            beta.append(size)
        if rest <= CONVERGED * largest and (count or not size):
            break
        now.scale(1.0 / size)
        stiff.mult(now, moved)
        alpha.append(float(now.dot(moved)))
        inverse.mult(moved, found)
        found.axpy(-alpha[-1], now)
        if count:
            found.axpy(-size, before)
        before, now, found = now, found, before
    destroy(now, before, moved, found)
    return largest + rest if rest > CONVERGED * largest else largest
