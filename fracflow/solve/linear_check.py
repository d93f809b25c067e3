"""The true residual of a linear solve: direct solvers give a solution of a singular matrix too."""

from __future__ import annotations

from fracflow._petsc import PETSc, destroy
from fracflow.errors import Unsolved

REFINED = 1e-8  # above it a direct solve is refined
UNSOLVED = 1e-3  # above it there is no solution


def true_residual(matrix: PETSc.Mat, solution: PETSc.Vec, given: PETSc.Vec) -> tuple[float, PETSc.Vec]:
    """|A x - b| / |b|, largest entries, and A x - b, which the caller destroys. Collective."""
    left = given.duplicate()
    matrix.mult(solution, left)
    left.axpy(-1.0, given)
    size = given.norm(PETSc.NormType.INFINITY)
    return (left.norm(PETSc.NormType.INFINITY) / size if size > 0.0 else 0.0), left


def check_solution(solver: PETSc.KSP, solution: PETSc.Vec, given: PETSc.Vec, what: str) -> None:
    """Refine a direct solution with a large residual, and raise Unsolved, on every rank, where there is none. Collective."""
    matrix, is_direct = solver.getOperators()[0], solver.getType() == "preonly"
    relative, left = true_residual(matrix, solution, given)
    if is_direct and REFINED < relative < 1.0:
        correction = solution.duplicate()
        solver.solve(left, correction)
        correction.aypx(-1.0, solution)
        better, other = true_residual(matrix, correction, given)
        if better < relative:
            correction.copy(solution)
            relative = better
        destroy(other, correction)
    left.destroy()
    if not relative <= UNSOLVED:
        raise Unsolved(
            f"{what}: the {'direct' if is_direct else solver.getType()} solve left |Ax - b| = {relative:.1e} |b|, the limit is"
            f" {UNSOLVED:g}: the matrix is singular, or nearly so"
        )
