"""`scripts/bench sliding_3d` in small: both ways to solve it agree, on any ranks; its files say what they should."""

from __future__ import annotations

import numpy as np
import pytest
import sliding_3d as bench

from fracflow._petsc import MPI, PETSc
from fracflow.mesh.distribute import distribute

COUNT = 6


def system(comm, tetrahedra, normal=1e11, shear=1e6):
    mesh = bench.mesh_of(COUNT, tetrahedra) if comm.rank == 0 else None
    blocks = distribute(mesh, comm)
    found = bench.assemble(blocks, COUNT, normal, shear)
    return found, bench.describe(blocks, found.matrix)


@pytest.mark.parametrize("tetrahedra", [False, True])
def test_solvers_and_ranks_agree(tetrahedra, comm):
    found = []
    for of in (comm, MPI.COMM_SELF):
        given, places = system(of, tetrahedra)
        for unknowns in bench.SOLVERS.values():
            result, facts = bench.solve(given, unknowns)
            assert facts["reason"] > 0 and facts["true_residual"] < 1e-8 and facts["krylov"] <= 15
            found.append((given.sections, result.norm(), result.norm(PETSc.NormType.INFINITY)))
            result.destroy()
        for each in (given.matrix, given.right, places):
            each.destroy()
    assert np.allclose(found, found[0], rtol=1e-6)


@pytest.mark.serial
def test_files_and_symmetry(tmp_path):
    """Read back, the system is the same; it is symmetric without friction, and the planes take the motions of a body."""
    given, places = system(MPI.COMM_SELF, False)
    matrix, right = given.matrix, given.right
    bench.write(tmp_path, matrix, right, places)
    viewer = PETSc.Viewer().createBinary(str(tmp_path / "matrix.petsc"), "r", comm=MPI.COMM_SELF)
    again = PETSc.Mat().load(viewer)
    viewer.destroy()
    assert again.equal(matrix) and again.getBlockSize() == 3
    skew = matrix.transpose(PETSc.Mat())
    skew.axpy(-1.0, matrix)
    viewer = PETSc.Viewer().createBinary(str(tmp_path / "motions.petsc"), "r", comm=MPI.COMM_SELF)
    motions = np.array([PETSc.Vec().load(viewer).getArray().copy() for _ in range(6)])
    viewer.destroy()
    assert np.allclose(motions @ motions.T, np.eye(6), atol=1e-12)
    largest = float(np.max(bench.moduli(1, 1e11, 1e6)))
    assert 1e-3 < skew.norm(PETSc.NormType.INFINITY) / (largest * bench.SIZE**2) < 10.0
    for each in (matrix, right, places, again, skew):
        each.destroy()


@pytest.mark.serial
@pytest.mark.parametrize("tetrahedra", [False, True])
def test_rigid_motions_do_not_strain_the_block(tetrahedra):
    """Neither rock nor planes, before the sides are held; places are those of the motions."""
    from fracflow.laws.elastic import solid_stiffness
    from fracflow.model.joints import jump_matrix
    from fracflow.model.solid import stiffness_of

    blocks = distribute(bench.mesh_of(COUNT, tetrahedra), MPI.COMM_SELF)
    cells = len(blocks.solid.cells)
    matrix = stiffness_of(blocks, np.arange(cells), np.repeat(solid_stiffness(1.0, 0.25), cells, axis=0))
    nodes = blocks.joints.bottom.shape[1]
    jump = jump_matrix(blocks, bench.facet.RULES["gauss2"][nodes].natural, None)
    bench.describe(blocks, matrix).destroy()
    force, strain = matrix.createVecLeft(), jump.createVecLeft()
    for motion in matrix.getNearNullSpace().getVecs():
        matrix.mult(motion, force)
        jump.mult(motion, strain)
        assert force.norm() < 1e-12 * matrix.norm() and strain.norm() < 1e-12
    for each in (matrix, jump, force, strain):
        each.destroy()
