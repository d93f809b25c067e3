"""A preconditioner of the rock: exact on the walls of joints and some layers of nodes beside them, BoomerAMG everywhere."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sparse
import scipy.sparse.linalg as linalg

from fracflow._petsc import PETSc

NAME = "_strip.Strip"
"""As PETSc's options name it."""


class Strip:
    """Multiplicative: LU of the strip, BoomerAMG, LU of the strip; for one rank.

    walls  unknowns of the joints' walls, set before a solver is made
    """

    walls: ClassVar[Any] = None
    layers: ClassVar[int] = 2

    def setUp(self, pc: Any) -> None:
        """Factor the strip and set BoomerAMG up."""
        matrix = pc.getOperators()[1]
        indptr, indices, values = matrix.getValuesCSR()
        self.matrix = sparse.csr_matrix((values, indices, indptr))
        graph = sparse.csr_matrix((np.ones_like(values), indices, indptr))
        marked = np.zeros(graph.shape[0], dtype=bool)
        marked[self.walls] = True
        for _ in range(self.layers):
            marked |= graph @ marked > 0
        self.rows = np.flatnonzero(marked)
        self.factors = linalg.splu(self.matrix[self.rows][:, self.rows].tocsc())
        self.coarse = PETSc.PC().create(PETSc.COMM_SELF)
        self.coarse.setOptionsPrefix("strip_")
        self.coarse.setOperators(matrix)
        self.coarse.setType("hypre")
        self.coarse.setUp()

    def apply(self, pc: Any, given: Any, result: Any) -> None:
        """Once forth and back."""
        right = given.getArray(readonly=True)
        found = np.zeros(len(right))
        found[self.rows] = self.factors.solve(right[self.rows])
        left, far = given.duplicate(), given.duplicate()
        left.setArray(right - self.matrix @ found)
        self.coarse.apply(left, far)
        found += far.getArray()
        found[self.rows] += self.factors.solve((right - self.matrix @ found)[self.rows])
        result.setArray(found)
        left.destroy()
        far.destroy()
