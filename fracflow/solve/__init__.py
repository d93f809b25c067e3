"""One nonlinear step: the balances of rock and fluid solved together."""

from typing import Protocol

from fracflow.model.loads import Loads
from fracflow.model.operators import Operators
from fracflow.model.state import StepReport
from fracflow.scene.scene import Scene
from fracflow.solve.condensed import Condensed
from fracflow.solve.condensed_cost import Condensing
from fracflow.solve.fixed_point.iteration import FixedPoint
from fracflow.solve.monolithic import Auto, Monolithic, Multigrid, WholeLU
from fracflow.solve.problem import StepProblem


class Coupling(Protocol):
    """A way to bring both balances of a step into equilibrium; it keeps its solvers from step to step."""

    def __init__(self, scene: Scene, operators: Operators, loads: Loads) -> None: ...

    def solve(self, problem: StepProblem) -> StepReport:
        """Bring the trial into balance. Raises SolveError, on every rank. Collective."""

    def expect(self, planned: Condensing) -> None:
        """Prepare for the planned steps, before the first one and again where events add some."""

    def destroy(self) -> None:
        """Free matrices and solvers. Collective."""


COUPLINGS: dict[str, type[Coupling]] = {
    "auto": Auto,
    "monolithic": Monolithic,
    "fixed-point": FixedPoint,
    "whole-lu": WholeLU,
    "condensed": Condensed,
}

__all__ = ["COUPLINGS", "Coupling", "Multigrid"]
