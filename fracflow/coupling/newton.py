"""(4.7) Newton's method on one step: SNES, with the safety that joints need.

The statuses of the last step are tried first. Once the balances hold with them, every section that has left its status is
given the next one, and Newton goes on from there, until none has: so the elastic root is preferred, and no section slips
because an iterate overshot. No iteration takes a joint past its closure.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fracflow._petsc import MPI, PETSc
from fracflow.coupling.joined_matrix import PARTS, JoinedMatrix
from fracflow.coupling.step_problem import StepProblem
from fracflow.errors import SolveError
from fracflow.scene import Scene

MOST_CHANGES = 50  # rounds of status changes in one step


@dataclass(frozen=True)
class NewtonReport:
    """Iterations of Newton and of the Krylov solvers inside, and refills of the Jacobian."""

    newton: int
    krylov: int
    fills: int


class Newton:
    """Newton's method over all unknowns, or over one split while the other is held.

    prefix  of the PETSc options; ``only`` None, "solid" or "flow".
    """

    def __init__(self, scene: Scene, matrix: JoinedMatrix, prefix: str, only: str | None = None) -> None:
        """Make the SNES. Collective."""
        self.scene, self.matrix, self.prefix, self.only = scene, matrix, prefix, only
        layout = matrix.layout
        self.unknowns, self.balance = layout.joined_vector(), layout.joined_vector()
        self.snes = PETSc.SNES().create(comm=layout.comm)
        self.snes.setOptionsPrefix(f"{prefix}_")
        self.snes.setType("newtonls")
        self.snes.setFunction(self._function, self.balance)
        self.snes.setJacobian(self._jacobian, matrix.matrix, matrix.matrix)
        self.snes.setConvergenceTest(self._converged)
        self.snes.setTolerances(max_it=scene.accuracy.max_iterations)
        self.snes.setLineSearchPreCheck(self._pre_check)
        self.snes.setMaxLinearSolveFailures(scene.accuracy.max_iterations)
        database = PETSc.Options()
        database[f"{prefix}_snes_linesearch_type"] = "basic"
        self.snes.setFromOptions()
        preconditioner = self.snes.getKSP().getPC()
        if preconditioner.getType() == "fieldsplit":
            solid, flow = layout.index_sets()
            preconditioner.setFieldSplitIS(*zip(PARTS, (solid, flow), strict=True))
            solid.destroy()
            flow.destroy()
        self.problem: StepProblem | None = None
        self._krylov = 0
        self._step = np.inf
        self._restless = np.zeros(0, dtype=bool)

    def solve(self, problem: StepProblem) -> NewtonReport:
        """Bring the trial of ``problem`` into balance. Raises SolveError, on every rank. Collective."""
        self.problem, self._krylov, self._step = problem, 0, np.inf
        fills, iterations, comm = self.matrix.fills, 0, self.matrix.layout.comm
        for _ in range(MOST_CHANGES):
            self._pack(problem)
            self.snes.solve(None, self.unknowns)
            iterations += self.snes.getIterationNumber()
            self._unpack(self.unknowns)
            if self.snes.getConvergedReason() <= 0:
                raise SolveError(self._diagnosis(self.snes.getConvergedReason(), iterations))
            if self.only == "flow":
                break
            self._restless = problem.change_statuses()
            if not comm.allreduce(bool(self._restless.any()), op=MPI.LOR):
                break
        else:
            raise SolveError(self._diagnosis(0, iterations))
        return NewtonReport(iterations, self._krylov, self.matrix.fills - fills)

    def _pack(self, problem: StepProblem) -> None:
        scales, middle = self.matrix.operators.scales, self.matrix.layout.solid_count
        local = self.unknowns.getArray()
        local[:middle] = problem.displacement.getArray(readonly=True) / scales.displacement
        local[middle:] = problem.pressure.getArray(readonly=True) / scales.pressure

    def _unpack(self, unknowns: PETSc.Vec) -> None:
        assert self.problem is not None
        scales, middle = self.matrix.operators.scales, self.matrix.layout.solid_count
        local = unknowns.getArray(readonly=True)
        if self.only != "flow":
            self.problem.displacement.setArray(local[:middle] * scales.displacement)
        if self.only != "solid":
            self.problem.pressure.setArray(local[middle:] * scales.pressure)
        self.problem.loads.impose(self.problem.time, self.problem.displacement, self.problem.pressure)

    def _function(self, snes: PETSc.SNES, unknowns: PETSc.Vec, balance: PETSc.Vec) -> None:
        problem = self.problem
        assert problem is not None
        self._unpack(unknowns)
        problem.evaluate()
        middle = self.matrix.layout.solid_count
        local = balance.getArray()
        local[:middle] = problem.solid_balance.getArray(readonly=True) / self.matrix.operators.scales.force
        local[middle:] = problem.flow_balance.getArray(readonly=True) / problem.flow_scale()
        if self.only == "solid":
            local[middle:] = 0.0
        elif self.only == "flow":
            local[:middle] = 0.0

    def _jacobian(self, snes: PETSc.SNES, unknowns: PETSc.Vec, jacobian: PETSc.Mat, _: PETSc.Mat) -> None:
        problem = self.problem
        assert problem is not None
        self.matrix.fill(problem.alphas, problem.sections.tangent, problem.conduction, problem.flow_scale(), self.only)

    def _pre_check(self, unknowns: PETSc.Vec, step: PETSc.Vec) -> bool:
        problem, layout = self.problem, self.matrix.layout
        assert problem is not None
        self._krylov += self.snes.getKSP().getIterationNumber()
        change = layout.solid_vector()
        scale = self.matrix.operators.scales.displacement
        change.setArray(step.getArray(readonly=True)[: layout.solid_count] * -scale)
        self._step = change.norm()
        joints = self.matrix.operators.joints
        allowed = joints.step_limit(problem.sections.strain, joints.strain(change))
        change.destroy()
        fraction = layout.comm.allreduce(allowed, op=MPI.MIN)
        if fraction < 1.0:
            step.scale(fraction)
            self._step = np.inf
        return bool(fraction < 1.0)

    def _converged(self, snes: PETSc.SNES, iteration: int, norms: tuple[float, float, float]) -> int:
        reasons = PETSc.SNES.ConvergedReason
        problem, accuracy = self.problem, self.scene.accuracy
        assert problem is not None
        if self._balanced(problem, iteration):
            return int(reasons.CONVERGED_FNORM_RELATIVE)
        return int(reasons.DIVERGED_MAX_IT if iteration >= accuracy.max_iterations else reasons.ITERATING)

    def _balanced(self, problem: StepProblem, iteration: int) -> bool:
        accuracy, residual = self.scene.accuracy, problem.residual
        flow = self.only == "solid" or residual.flow <= accuracy.residual
        if self.only == "flow":
            return residual.flow <= accuracy.residual
        if self.scene.method.newton_test == "displacement":
            size = problem.displacement.norm()
            return flow and iteration > 0 and self._step <= accuracy.displacement * size
        if self.scene.method.newton_test == "out-of-balance" and accuracy.out_of_balance is not None:
            return flow and residual.out_of_balance < accuracy.out_of_balance
        return flow and residual.solid <= accuracy.residual

    def _diagnosis(self, reason: int, iterations: int) -> str:
        problem, blocks = self.problem, self.matrix.operators.blocks
        assert problem is not None
        points = len(problem.sections.strain) // max(1, len(blocks.joints.ids))
        restless = np.flatnonzero(self._restless) // max(1, points)
        names = {blocks.joints.fractures[f] for f in blocks.joints.fracture[restless]}
        fractures = sorted(set().union(*blocks.comm.allgather(names)))
        where = f"sections of {', '.join(fractures)} keep changing between sticking and sliding; " if fractures else ""
        names_of_reason = {v: k for k, v in vars(PETSc.SNES.ConvergedReason).items() if isinstance(v, int)}
        return (
            f"time {problem.time:.6g}: Newton did not converge in {iterations} iterations"
            f" ({names_of_reason.get(reason, reason)}): {where}relative residual of the solid {problem.residual.solid:.2e},"
            f" of the flow {problem.residual.flow:.2e}, wanted {self.scene.accuracy.residual:.0e};"
            " try a smaller time_step, or raise accuracy.max_iterations"
        )

    def destroy(self) -> None:
        """Free the solver. Collective."""
        for thing in (self.snes, self.unknowns, self.balance):
            thing.destroy()
