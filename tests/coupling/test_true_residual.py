"""A direct solve of a singular matrix is caught by what it leaves, whatever the solver says of itself."""

import numpy as np
import pytest

from fracflow._petsc import PETSc
from fracflow.errors import NotConverged
from fracflow.solve.linear import check_solution, true_residual


def _solved(diagonal, given, comm):
    """A chain of springs (n - 1) to ground springs ``diagonal`` (n,), solved by MUMPS."""
    n = len(diagonal)
    matrix = PETSc.Mat().createAIJ((n, n), nnz=3, comm=comm)
    first, last = matrix.getOwnershipRange()
    for i in range(first, last):
        matrix.setValue(i, i, diagonal[i] + (i > 0) + (i < n - 1))
        for j in (i - 1, i + 1):
            if 0 <= j < n:
                matrix.setValue(i, j, -1.0)
    matrix.assemble()
    solution, right = matrix.createVecs()
    right.setArray(given[first:last])
    solver = PETSc.KSP().create(comm=comm)
    solver.setOperators(matrix)
    solver.setType("preonly")
    solver.getPC().setType("lu")
    solver.getPC().setFactorSolverType("mumps")
    solver.solve(right, solution)
    return matrix, solver, solution, right


def test_a_good_solution_passes_and_a_spoiled_one_is_refined(comm):
    given = np.arange(12.0)
    matrix, solver, solution, right = _solved(np.ones(12), given, comm)
    check_solution(solver, solution, right, "here")
    assert true_residual(matrix, solution, right)[0] < 1e-14
    right.scale(1.0 + 1e-5)
    assert true_residual(matrix, solution, right)[0] == pytest.approx(1e-5, rel=1e-3)
    check_solution(solver, solution, right, "here")
    assert true_residual(matrix, solution, right)[0] < 1e-14
    solution.scale(0.9)
    check_solution(solver, solution, right, "here")
    solution.set(1e18)
    with pytest.raises(
        NotConverged, match=r"here: the direct solve left .* the limit is 0\.001: its factors have lost their digits"
    ):
        check_solution(solver, solution, right, "here")


def test_rows_of_unlike_size_are_no_singular_matrix(comm):
    """The stiff row leaves round-off far above the right side, and the solution has all its digits."""
    matrix = PETSc.Mat().createAIJ((2, 2), nnz=2, comm=comm)
    matrix.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
    entries = [(0, 0, 1e-12), (0, 1, 1e-13), (1, 0, 1e6), (1, 1, 1.7e6)]
    first, last = matrix.getOwnershipRange()
    for row, column, value in entries:
        if first <= row < last:
            matrix.setValue(row, column, value)
    matrix.assemble()
    solution, right = matrix.createVecs()
    right.setArray(np.array([2.3e-10, 0.0])[first:last])
    solution.setArray(np.array([2.3e-10 * 1.7 * (1.0 + 1e-15), -2.3e-10])[first:last] / 1.6e-12)
    assert true_residual(matrix, solution, right)[0] > 1.0
    solver = PETSc.KSP().create(comm=comm)
    solver.setOperators(matrix)
    solver.setType("preonly")
    solver.getPC().setType("lu")
    solver.getPC().setFactorSolverType("mumps")
    check_solution(solver, solution, right, "here")
    solution.set(1e18)
    with pytest.raises(NotConverged, match="singular"):
        check_solution(solver, solution, right, "here")


def test_what_floats_is_caught(comm):
    """No ground spring, and a force: MUMPS makes something of it, or nothing."""
    _, solver, solution, right = _solved(np.zeros(12), np.ones(12), comm)
    with pytest.raises(NotConverged, match="singular"):
        check_solution(solver, solution, right, "here")


def _square(count, comm):
    """A plate of springs (count^2) to its neighbours and to ground, far from singular; PETSc's solver, matrix, right side."""
    matrix = PETSc.Mat().createAIJ((count**2,) * 2, nnz=5, comm=comm)
    for row in range(*matrix.getOwnershipRange()):
        i, j = divmod(row, count)
        near = [i * count + j + d for d in (-1, 1) if 0 <= j + d < count]
        near += [(i + d) * count + j for d in (-1, 1) if 0 <= i + d < count]
        matrix.setValues([row], [row, *near], [4.1] + [-1.0] * len(near))
    matrix.assemble()
    solution, right = matrix.createVecs()
    right.set(1.0)
    solver = PETSc.KSP().create(comm=comm)
    solver.setOperators(matrix)
    return solver, solution, right


def test_a_matrix_that_is_not_singular_is_not_called_so(comm):
    """Iterations that do not suffice, factors that find no memory, and digits lost: each by its name."""
    solver, solution, right = _square(60, comm)
    solver.setType("gmres")
    solver.getPC().setType("jacobi")
    solver.setTolerances(max_it=3)
    solver.solve(right, solution)
    with pytest.raises(NotConverged, match="3 iterations preconditioned by jacobi do not suffice"):
        check_solution(solver, solution, right, "here")
    solver.setType("preonly")
    solver.getPC().setType("lu")
    solver.getPC().setFactorSolverType("mumps")
    solver.getPC().setFactorSetUpSolverType()
    solver.getPC().getFactorMatrix().setMumpsIcntl(23, 1)  # MB
    solver.solve(right, solution)
    with pytest.raises(NotConverged, match=r"MUMPS found no memory for its factors \(INFOG\(1\) = -\d+\)"):
        check_solution(solver, solution, right, "here")
    solver, solution, right = _square(60, comm)
    solver.setType("preonly")
    solver.getPC().setType("lu")
    solver.getPC().setFactorSolverType("mumps")
    solver.solve(right, solution)
    check_solution(solver, solution, right, "here")
    other = solver.getOperators()[0].duplicate(copy=True)
    other.shift(-9.0)  # another matrix than that of the factors
    solver.getPC().setReusePreconditioner(True)
    solver.setOperators(other)
    with pytest.raises(NotConverged, match=r"lost their digits, while .* shows no singular matrix"):
        check_solution(solver, solution, right, "here")
