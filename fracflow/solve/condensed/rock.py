"""The rock with elastic joints, factored, and its compliance between the jumps of all joints."""

from __future__ import annotations

import numpy as np

from fracflow._petsc import MPI, PETSc, destroy, timed
from fracflow.errors import NotConverged
from fracflow.integrators import Alphas
from fracflow.mesh.data import Floats
from fracflow.model.layout import local_rows
from fracflow.model.loads import Loads
from fracflow.solve.jacobian import JoinedMatrix

BLOCK = 64  # right sides at once: with more of them each takes no less time


class CondensedRock:
    """Factors of A and the compliance G A^-1 G' of all sections, dense: ``compliance`` (s dim, S dim) has this rank's rows."""

    @timed("FracCondense")
    def __init__(self, matrix: JoinedMatrix, loads: Loads, alphas: Alphas, elastic: Floats) -> None:
        """Factor and condense; ``elastic`` is D_0 (s, dim, dim). Raises NotConverged, on every rank. Collective."""
        self.operators, self.held = matrix.operators, loads.held
        matrix.fill(alphas, elastic, None, 1.0, "solid")
        self.matrix = matrix.matrix.copy()
        self.matrix.setOption(PETSc.Mat.Option.SPD, True)
        self.solver = PETSc.KSP().create(comm=matrix.layout.comm)
        self.solver.setOptionsPrefix("condensed_")
        alone = matrix.layout.comm.size == 1 and PETSc.Sys.hasExternalPackage("suitesparse")
        self.solver.getPC().setType("cholesky")
        self.solver.getPC().setFactorSolverType("cholmod" if alone else "mumps")  # 1/3 of the time of MUMPS for a solve
        self.solver.setFromOptions()
        self.solver.setOperators(self.matrix)
        nothing = self.operators.layout.solid_vector()
        try:
            self.solve(nothing)
        except (NotConverged, PETSc.Error) as error:  # CHOLMOD is on one rank, where all errors are agreed on
            self.destroy()
            raise NotConverged("the rock with elastic joints has no factors: nothing holds it") from error
        finally:
            nothing.destroy()
        self.compliance = self._compliance()

    def solve(self, force: PETSc.Vec) -> Floats:
        """A^-1 times a force on the solid unknowns: this rank's displacements (n,), nothing where held.

        Raises NotConverged, on every rank. Collective.
        """
        layout, scales = self.operators.layout, self.operators.scales
        right, found = layout.joined_vector(), layout.joined_vector()
        local = right.getArray()
        local[: layout.solid_count] = force.getArray(readonly=True) / scales.force
        local[self.held] = 0.0
        self.solver.solve(right, found)
        result: Floats = found.getArray()[: layout.solid_count] * scales.displacement
        destroy(right, found)
        if self.solver.getConvergedReason() < 0:
            raise NotConverged("no solution of the rock with elastic joints")
        return result

    def _compliance(self) -> Floats:
        """This rank's rows of G A^-1 G', in blocks of right sides. Collective."""
        layout, jump, scales = self.operators.layout, self.operators.joints.jump, self.operators.scales
        turned = jump.transpose(PETSc.Mat())
        rows = local_rows(turned)
        turned.destroy()
        moves = ~np.isin(rows.rows, self.held)
        count = jump.getSize()[0]
        result = np.empty((jump.getLocalSize()[0], count))
        right = _dense(layout.solid_count + layout.flow_count, layout.total, layout.comm)
        found = _dense(layout.solid_count + layout.flow_count, layout.total, layout.comm)
        rock = _dense(layout.solid_count, int(layout.solid_starts[-1]), layout.comm)
        factors = self.solver.getPC().getFactorMatrix()
        for first in range(0, count, BLOCK):
            here = moves & (rows.cols >= first) & (rows.cols < first + BLOCK)
            local = right.getDenseArray()
            local[:] = 0.0
            local[rows.rows[here], rows.cols[here] - first] = rows.values[here]
            right.assemble()
            factors.matSolve(right, found)
            rock.getDenseArray()[:] = found.getDenseArray()[: layout.solid_count]
            rock.assemble()
            strains = jump.matMult(rock)
            result[:, first : first + BLOCK] = strains.getDenseArray()[:, : count - first]
            strains.destroy()
        destroy(right, found, rock)
        result *= scales.displacement / scales.force
        return result

    def destroy(self) -> None:
        """Free the factors. Collective."""
        destroy(self.solver, self.matrix)


def _dense(here: int, total: int, comm: MPI.Comm) -> PETSc.Mat:
    matrix = PETSc.Mat().createDense(((here, total), (None, BLOCK)), comm=comm)
    matrix.setUp()
    matrix.assemble()
    return matrix
