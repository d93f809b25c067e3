"""(4.5) The report's staggered cycle: the flow with the walls held, then the solid with the pressures held.

An error in the pressures goes through a cycle multiplied by J_pp^-1 J_pu J_uu^-1 J_up, blocks of the joint Jacobian. Its
spectral radius, found by power iteration before the first cycle of a step, predicts whether (4.5) converges at all.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from fracflow._petsc import PETSc
from fracflow.assembly.loads import Loads
from fracflow.assembly.operators import Operators
from fracflow.coupling.joined_matrix import JoinedMatrix
from fracflow.coupling.newton import Newton
from fracflow.coupling.step_problem import StepProblem
from fracflow.errors import SolveError
from fracflow.scene import Scene
from fracflow.state import StepReport

POWER_ITERATIONS = 40
SINGULAR = 1e12  # a factor that only a singular flow matrix makes


class FixedPoint:
    """The cycle (4.5a,b) until the pressures stand still and both balances hold."""

    def __init__(self, scene: Scene, operators: Operators, loads: Loads) -> None:
        """Make one matrix and solver for each split. Collective."""
        self.scene = scene
        self.whole_matrix = JoinedMatrix(operators, loads)
        self.solid_matrix = JoinedMatrix(operators, loads)
        self.flow_matrix = JoinedMatrix(operators, loads)
        self.solid = Newton(scene, self.solid_matrix, "solid", "solid")
        self.flow = Newton(scene, self.flow_matrix, "flow", "flow")
        self.predicted: dict[float, float] = {}

    def solve(self, problem: StepProblem) -> StepReport:
        """Cycle until converged. Raises SolveError with the predicted and measured factor, on every rank. Collective."""
        accuracy = self.scene.accuracy
        newton = krylov = fills = 0
        factor = self._prediction(problem)
        if not np.isfinite(factor):
            raise SolveError(
                f'time {problem.time:.6g}: coupling = "fixed-point" cannot work here: part of the network has no prescribed'
                ' pressure, so its flow has no solution while the walls are held: set method.coupling = "monolithic",'
                " or give a [[well]] with a pressure"
            )
        changes: list[float] = []
        for cycle in range(1, accuracy.max_cycles + 1):
            problem.branch = problem.state.sections.past  # no section slips for a pressure that was on its way
            before = problem.pressure.copy()
            try:
                reports = [self.flow.solve(problem), self.solid.solve(problem)]
            except SolveError as error:
                before.destroy()
                raise SolveError(self._diverged(problem, factor, changes) + f" (in cycle {cycle}: {error})") from error
            newton += sum(r.newton for r in reports)
            krylov += sum(r.krylov for r in reports)
            fills += sum(r.fills for r in reports)
            before.axpy(-1.0, problem.pressure)
            changes.append(before.norm(PETSc.NormType.INFINITY))
            before.destroy()
            size = max(problem.pressure.norm(PETSc.NormType.INFINITY), 1e-300)
            if changes[-1] <= accuracy.pressure * size and problem.residual.flow <= accuracy.residual:
                residual = problem.residual
                return StepReport(newton, krylov, cycle, fills, residual.solid, residual.flow)
            growing = len(changes) > 3 and changes[-1] > changes[-2] > changes[-3]
            if growing or not np.isfinite(changes[-1]):
                raise SolveError(self._diverged(problem, factor, changes))
        raise SolveError(self._diverged(problem, factor, changes))

    def _diverged(self, problem: StepProblem, factor: float, changes: list[float]) -> str:
        ratios = [b / a for a, b in pairwise(changes) if a > 0.0]
        measured = f"{ratios[-1]:.3g} measured" if ratios else "none measured"
        at = f'time {problem.time:.6g}: coupling = "fixed-point"'
        what = f"the error of the pressures is multiplied by {factor:.3g} a cycle (predicted; {measured})"
        if factor >= 1.0:
            return (
                f'{at} diverges: {what}, it must be below 1: set method.coupling = "monolithic"; a smaller time_step'
                " does not help"
            )
        return (
            f"{at} did not converge in {len(changes)} cycles: {what}: raise accuracy.max_cycles, or set method.coupling"
            ' = "monolithic"'
        )

    def _prediction(self, problem: StepProblem) -> float:
        """Spectral radius of one cycle, linearised where the step starts; once for each alpha_1. Collective."""
        if problem.alphas.a1 in self.predicted:
            return self.predicted[problem.alphas.a1]
        problem.evaluate()
        self.whole_matrix.fill(problem.alphas, problem.sections.tangent, problem.conduction, problem.flow_scale())
        splits = self.whole_matrix.layout.index_sets()
        blocks = [[self.whole_matrix.matrix.createSubMatrix(row, col) for col in splits] for row in splits]
        factor = spectral_radius(blocks)
        for thing in [*splits, *blocks[0], *blocks[1]]:
            thing.destroy()
        self.predicted[problem.alphas.a1] = factor
        return factor

    def destroy(self) -> None:
        """Free matrices and solvers. Collective."""
        for thing in (self.solid, self.flow, self.whole_matrix, self.solid_matrix, self.flow_matrix):
            thing.destroy()


def spectral_radius(blocks: list[list[PETSc.Mat]]) -> float:
    """Largest factor of J_pp^-1 J_pu J_uu^-1 J_up, by power iteration. Collective."""
    solvers = []
    for i in range(2):
        solver = PETSc.KSP().create(comm=blocks[i][i].getComm())
        solver.setOperators(blocks[i][i])
        solver.setOptionsPrefix("solid_" if i == 0 else "flow_fieldsplit_flow_")
        solver.setFromOptions()
        solvers.append(solver)
    pressure, rate = blocks[1][1].createVecs()
    wall, force = blocks[0][0].createVecs()
    first = pressure.getOwnershipRange()[0]
    pressure.setArray(1.0 + 0.1 * np.cos(1.0 + first + np.arange(pressure.getLocalSize())))
    radius = 0.0
    for _ in range(POWER_ITERATIONS):
        size = pressure.norm()
        if size == 0.0:
            break
        pressure.scale(1.0 / size)
        blocks[0][1].mult(pressure, force)
        solvers[0].solve(force, wall)
        blocks[1][0].mult(wall, rate)
        solvers[1].solve(rate, pressure)
        radius = pressure.norm()
        if radius > SINGULAR or not np.isfinite(radius):
            radius = np.inf
            break
    for thing in (*solvers, pressure, rate, wall, force):
        thing.destroy()
    return float(radius)
