"""The rock with elastic joints, A = alpha_0 M + K_s + alpha_1 C + G' W D_0 G, factored once, and what it leaves on the joints.

Nothing that slips, opens or flows changes A: all of that acts on the rock through the joints alone, u = A^-1 (r - G' q).
"""

from __future__ import annotations

import numpy as np

from fracflow._petsc import MPI, PETSc
from fracflow.errors import NotConverged
from fracflow.integrators import Alphas
from fracflow.mesh.data import Floats
from fracflow.model.layout import local_rows
from fracflow.model.loads import Loads
from fracflow.solve.clusters import Batch, Clusters, Exchange
from fracflow.solve.jacobian import JoinedMatrix

BLOCK = 64  # right sides at once: with more of them each takes no less time


class Rock:
    """Factors of A and the compliance G A^-1 G' of all sections, dense, on rank 0."""

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
        self.clusters = _one_cluster(self._compliance(), len(elastic), self.operators.layout.comm)

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
        right.destroy()
        found.destroy()
        if self.solver.getConvergedReason() < 0:
            raise NotConverged("no solution of the rock with elastic joints")
        return result

    def _compliance(self) -> Floats | None:
        """G A^-1 G' on rank 0, in blocks of right sides. Collective."""
        layout, jump, scales = self.operators.layout, self.operators.joints.jump, self.operators.scales
        turned = jump.transpose(PETSc.Mat())
        rows = local_rows(turned)
        turned.destroy()
        free = ~np.isin(rows.rows, self.held)
        count, parts = jump.getSize()[0], []
        right = _dense(layout.solid_count + layout.flow_count, layout.total, layout.comm)
        found = _dense(layout.solid_count + layout.flow_count, layout.total, layout.comm)
        rock = _dense(layout.solid_count, int(layout.solid_starts[-1]), layout.comm)
        factors = self.solver.getPC().getFactorMatrix()
        for first in range(0, count, BLOCK):
            here = free & (rows.cols >= first) & (rows.cols < first + BLOCK)
            local = right.getDenseArray()
            local[:] = 0.0
            local[rows.rows[here], rows.cols[here] - first] = rows.values[here]
            right.assemble()
            factors.matSolve(right, found)
            rock.getDenseArray()[:] = found.getDenseArray()[: layout.solid_count]
            rock.assemble()
            strains = jump.matMult(rock)
            parts.append(strains.getDenseArray()[:, : count - first].copy())
            strains.destroy()
        for matrix in (right, found, rock):
            matrix.destroy()
        gathered = layout.comm.gather(np.hstack(parts), root=0)
        return None if gathered is None else np.vstack(gathered) * (scales.displacement / scales.force)

    def destroy(self) -> None:
        """Free the factors. Collective."""
        self.solver.destroy()
        self.matrix.destroy()


def _dense(here: int, total: int, comm: MPI.Comm) -> PETSc.Mat:
    matrix = PETSc.Mat().createDense(((here, total), (None, BLOCK)), comm=comm)
    matrix.setUp()
    matrix.assemble()
    return matrix


def _one_cluster(compliance: Floats | None, here: int, comm: MPI.Comm) -> Clusters:
    """All sections of all ranks, of which this one has ``here``, as one cluster that rank 0 solves for. Collective."""
    counts = np.array(comm.allgather(here), dtype=np.int64)
    sent, received = np.zeros(comm.size, dtype=np.int64), np.zeros(comm.size, dtype=np.int64)
    sent[0] = here
    if comm.rank == 0:
        received = counts
    exchange = Exchange(comm, np.arange(here), sent, received)
    all_sections = np.arange(counts.sum())[None]
    return Clusters(exchange, () if compliance is None else (Batch(all_sections, compliance[None]),))
