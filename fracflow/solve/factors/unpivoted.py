"""LU without pivots of small matrices, by PETSc itself, in place of UMFPACK's.

The balance of the rock is nearly symmetric and positive definite, and needs no pivots; nor do pressures that are well drained.
A pressure between walls that are nearly shut may need them, and so may joints that weaken. Factors are therefore tried on a
vector first. UMFPACK makes them where a row lost digits, until the step has ended.
"""

from __future__ import annotations

import numpy as np

from fracflow._petsc import PETSc, destroy
from fracflow.solve.options import factors_are_meant
from fracflow.solve.rock_cost import UNPIVOTED_TO

PIVOTED, UNPIVOTED, ORDERING = "umfpack", "petsc", "amd"
LOST = 1e-9
"""Of the terms of a row, which factors may leave. With pivots they leave 1e-15, without mostly 1e-15 to 1e-11."""


class Unpivoted:
    """The choice between both for a solver that is LU by UMFPACK, on one rank."""

    def __init__(self, solver: PETSc.KSP, unknowns: int) -> None:
        """Nothing is chosen for many unknowns, or where the scene or the command line chooses."""
        self._solver = solver
        prefix = (solver.getOptionsPrefix() or "").removesuffix("_")
        is_free = solver.getPC().getFactorSolverType() == PIVOTED and not factors_are_meant(prefix)
        self._suits = is_free and unknowns <= UNPIVOTED_TO

    def begin(self) -> None:
        """A step begins: its first factors are tried without pivots, whatever earlier steps needed."""
        if self._suits and not self._tries:
            self._take(UNPIVOTED)

    def factor(self, matrix: PETSc.Mat) -> None:
        """Make factors of the matrix, with pivots where they are needed."""
        if not self._suits or not self._tries:
            return
        factors = self._solver.getPC()
        factors.setOperators(matrix)
        factors.setUp()
        if worst_row(factors, matrix) > LOST:
            self._take(PIVOTED)
            factors.setOperators(matrix)

    @property
    def _tries(self) -> bool:
        return bool(self._solver.getPC().getFactorSolverType() == UNPIVOTED)

    def _take(self, package: str) -> None:
        factors = self._solver.getPC()
        factors.reset()
        factors.setFactorSolverType(package)
        if package == UNPIVOTED:
            factors.setFactorOrdering(ORDERING)


def worst_row(factors: PETSc.PC, matrix: PETSc.Mat) -> float:
    """|A x - b| over |A| |x|, the largest of all rows, where factors solve for x; infinite without a number.

    b is the product of A with signs that follow each other as if at random. Collective.
    """
    signs, result = matrix.createVecs()
    count = signs.getLocalSize()
    signs.setArray(np.where(np.random.default_rng(count).random(count) < 0.5, -1.0, 1.0))
    given = result.duplicate()
    matrix.mult(signs, given)
    factors.apply(given, signs)
    matrix.mult(signs, result)
    starts, columns, values = matrix.getValuesCSR()
    with np.errstate(all="ignore"):  # factors that failed are no numbers
        terms = np.add.reduceat(np.abs(values * signs.getArray(readonly=True)[columns]), starts[:-1])
        left = np.abs(result.getArray(readonly=True) - given.getArray(readonly=True))
        worst = float(np.max(left / terms))
    destroy(signs, result, given)
    return worst if worst == worst else np.inf
