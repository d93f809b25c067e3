"""Both balances solved together: FGMRES with PCFIELDSPLIT over the solid and flow splits, or LU of the whole matrix."""

from __future__ import annotations

from fracflow._petsc import destroy
from fracflow.errors import NotConverged, StatusCycling, Unsolved
from fracflow.model.loads import Loads
from fracflow.model.operators import Operators
from fracflow.model.state import StepReport
from fracflow.scene.scene import Scene
from fracflow.solve.accept import step_report, without_suction
from fracflow.solve.condensed_cost import Condensing
from fracflow.solve.failure import FLOATING
from fracflow.solve.jacobian import JoinedMatrix
from fracflow.solve.newton import Newton
from fracflow.solve.problem import StepProblem
from fracflow.solve.rock_cost import direct, rock_choice

UNSOLVED_SHARE = 0.1  # of the largest terms of a balance: a residual that another linear solver would not remove


class Monolithic:
    """Newton's method over displacements and pressures; a dry scene has the solid alone."""

    prefix = "monolithic"

    def __init__(self, scene: Scene, operators: Operators, loads: Loads) -> None:
        """Make matrix and solver, kept for the whole run. Collective."""
        self.scene, self.matrix = scene, JoinedMatrix(operators, loads)
        self.newton = Newton(scene, self.matrix, self.prefix if operators.flow is not None else "solid")
        self.rock: Newton | None = None

    def expect(self, planned: Condensing) -> None:
        """Planned steps have no influence here."""

    def solve(self, problem: StepProblem, newton: Newton | None = None) -> StepReport:
        """Bring the trial into balance, from where it is or else from open fractures; by another ``newton`` where one is given.

        Raises SolveError, on every rank. Collective.
        """
        newton = newton or self.newton
        try:
            report = newton.solve(problem)
        except NotConverged as failure:
            if _is_left(problem, failure) or not self._open(problem):
                raise
            report = newton.solve(problem)
        return step_report(report, problem.residual, 1)

    def _open(self, problem: StepProblem) -> bool:
        """Start the step again with the apertures without suction; return whether that is another start. Collective.

        Walls that open draw fluid through a nearly closed fracture, at c d^3 (k (d_1 - d)) = d - d_0 in short. Once d_0 is too
        wide for a root beside it, the only one is near d_1: uphill from d_0, and downhill all the way from d_1.
        """
        if not without_suction(problem):
            return False
        self.rock = self.rock or Newton(self.scene, self.matrix, "solid", "solid")
        try:
            self.rock.solve(problem)
        except NotConverged:
            return False
        return True

    def destroy(self) -> None:
        """Free matrix and solvers. Collective."""
        destroy(self.rock, self.newton, self.matrix)


class WholeLU(Monolithic):
    """The same with LU of the whole matrix."""

    prefix = "whole-lu"


class Auto(WholeLU):
    """The same, and FGMRES where LU leaves much of a balance: nearly closed fractures beside wide ones."""

    second = "monolithic"

    def __init__(self, scene: Scene, operators: Operators, loads: Loads) -> None:
        """Make matrix and solver; the other solver when it is first needed. Collective."""
        super().__init__(scene, operators, loads)
        self.other: Newton | None = None

    def solve(self, problem: StepProblem, newton: Newton | None = None) -> StepReport:
        """Bring the trial into balance. Raises SolveError, on every rank. Collective."""
        try:
            return super().solve(problem, newton)
        except NotConverged as failure:
            if _is_left(problem, failure) or not (
                isinstance(failure, Unsolved) or self._solves_badly(problem, failure)
            ):
                raise
            self.other, first = self.other or self._second(failure), failure
        problem.begin_again()
        problem.evaluate()
        try:
            return super().solve(problem, self.other)
        except Unsolved as failure:
            if isinstance(first, Unsolved):
                raise Unsolved(f"{failure}; before it, {str(first).partition('; largest')[0]}") from first
            raise first from failure  # which says more than that this linear solver fails as well

    def _second(self, failure: NotConverged) -> Newton:
        """The other solver, for a step that the first one has failed in. Collective."""
        return Newton(self.scene, self.matrix, self.second)

    def _solves_badly(self, problem: StepProblem, failure: NotConverged) -> bool:
        """Whether the linear solver may be why Newton's method came near a solution and not to it. Collective."""
        if failure.kind == FLOATING or max(problem.residual.solid, problem.residual.flow) > UNSOLVED_SHARE:
            return False
        return not self.newton.solves_both(problem)

    def destroy(self) -> None:
        """Free matrix and solvers. Collective."""
        destroy(self.other)
        super().destroy()


class Multigrid(Auto):
    """FGMRES with multigrid for the rock, and LU of the whole for steps in which its linear solves do not converge.

    LU is not begun where its factors would not fit into memory: the system would end the run without a word.
    """

    prefix, second = "monolithic", "whole-lu"

    def _second(self, failure: NotConverged) -> Newton:
        layout = self.matrix.layout
        rock = rock_choice(self.scene, layout.comm, int(layout.solid_starts[-1]))
        if rock.lacks_room:
            needed, there = direct(rock.unknowns).bytes, rock.memory
            raise Unsolved(
                f"{failure}; LU of the whole, which would be tried next, needs about {needed / 1e9:.3g} GB, and"
                f" {there / 1e9:.3g} GB are at hand: take more machines, a smaller time_step, or a coarser mesh"
            ) from failure
        return super()._second(failure)

    def _solves_badly(self, problem: StepProblem, failure: NotConverged) -> bool:
        return False


def _is_left(problem: StepProblem, failure: NotConverged) -> bool:
    """Whether a failed step is not tried in other ways: it may be shorter, and its statuses cycled."""
    return problem.request.expects_failure and isinstance(failure, StatusCycling)
