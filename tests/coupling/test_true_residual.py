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
        NotConverged, match=r"here: the direct solve left .* the limit is 0\.001: the matrix is singular"
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
