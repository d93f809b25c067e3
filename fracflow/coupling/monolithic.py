"""Both balances solved together: FGMRES with PCFIELDSPLIT over the solid and flow splits, or LU of the whole matrix."""

from __future__ import annotations

from fracflow.assembly.loads import Loads
from fracflow.assembly.operators import Operators
from fracflow.coupling.accept import start_again, step_report
from fracflow.coupling.joined_matrix import JoinedMatrix
from fracflow.coupling.newton import Newton
from fracflow.coupling.step_problem import StepProblem
from fracflow.errors import NotConverged
from fracflow.scene import Scene
from fracflow.state import StepReport


class Monolithic:
    """Newton's method over displacements and pressures; a dry scene has the solid alone."""

    prefix = "monolithic"

    def __init__(self, scene: Scene, operators: Operators, loads: Loads) -> None:
        """Make matrix and solver, kept for the whole run. Collective."""
        self.matrix = JoinedMatrix(operators, loads)
        self.newton = Newton(scene, self.matrix, self.prefix if operators.flow is not None else "solid")

    def solve(self, problem: StepProblem) -> StepReport:
        """Bring the trial into balance. Raises SolveError, on every rank. Collective."""
        report = self.newton.solve(problem)
        return step_report(report, problem.residual, 1)

    def destroy(self) -> None:
        """Free matrix and solver. Collective."""
        self.newton.destroy()
        self.matrix.destroy()


class WholeLU(Monolithic):
    """The same with LU of the whole matrix."""

    prefix = "whole-lu"


class Auto(WholeLU):
    """The same, and FGMRES where that does not converge: fractures that are all but shut beside wide ones."""

    def __init__(self, scene: Scene, operators: Operators, loads: Loads) -> None:
        """Make matrix and solver; the other solver when it is first needed. Collective."""
        super().__init__(scene, operators, loads)
        self.scene = scene
        self.other: Newton | None = None

    def solve(self, problem: StepProblem) -> StepReport:
        """Bring the trial into balance. Raises SolveError, on every rank. Collective."""
        try:
            return super().solve(problem)
        except NotConverged:
            if self.other is None:
                self.other = Newton(self.scene, self.matrix, "monolithic")
        start_again(problem)
        problem.evaluate()
        return step_report(self.other.solve(problem), problem.residual, 1)

    def destroy(self) -> None:
        """Free matrix and solvers. Collective."""
        if self.other is not None:
            self.other.destroy()
        super().destroy()
