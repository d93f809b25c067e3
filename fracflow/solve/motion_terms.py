"""Terms of the rock's balance that motion makes: inertia, what it looks back at, and what sides absorb."""

from __future__ import annotations

from dataclasses import dataclass

from fracflow._petsc import PETSc
from fracflow.integrators import Alphas
from fracflow.model.balance import static_balance_of
from fracflow.model.operators import Operators
from fracflow.model.state import State
from fracflow.solve.absorption import Absorption
from fracflow.solve.residual import CANCELLATION, largest


@dataclass(frozen=True)
class MovingTerms:
    """M (inertia a_new + inertia_old a) + balance_old S + C v_new - waves, as ``stepping.Alphas`` weighs them.

    before  S at the start of the step; None where it takes no part
    """

    mass: PETSc.Mat
    alphas: Alphas
    absorption: Absorption
    state: State
    before: PETSc.Vec | None

    @staticmethod
    def of(operators: Operators, state: State, alphas: Alphas, absorption: Absorption) -> MovingTerms:
        """Those of a step from ``state``. Collective."""
        before = static_balance_of(operators, state) if alphas.balance_old else None
        return MovingTerms(operators.mass, alphas, absorption, state, before)

    def add(
        self, acceleration: PETSc.Vec, velocity: PETSc.Vec, displacement: PETSc.Vec, balance: PETSc.Vec
    ) -> list[float]:
        """Add them to ``balance``, which was zero; this rank's largest terms. Collective.

        A share CANCELLATION of alpha_0 M u, and of alpha_1 C u, counts as a term.
        """
        alphas, term = self.alphas, balance.duplicate()
        met = acceleration.copy()
        if alphas.looks_back:
            met.scale(alphas.inertia)
            met.axpy(alphas.inertia_old, self.state.motion.acceleration)
        self.mass.mult(met, balance)
        sizes = [largest(balance)]
        self.mass.mult(displacement, term)
        sizes.append(CANCELLATION * alphas.mass * largest(term))
        if self.before is not None:
            balance.axpy(alphas.balance_old, self.before)
            sizes.append(alphas.balance_old * largest(self.before))
        absorbed = self.absorption.force(velocity)
        if absorbed is not None and self.absorption.damping is not None:
            balance.axpy(1.0, absorbed)
            self.absorption.damping.mult(displacement, term)
            sizes += [largest(absorbed), CANCELLATION * alphas.a1 * largest(term)]
            absorbed.destroy()
        met.destroy()
        term.destroy()
        return sizes

    def destroy(self) -> None:
        """Free what is of this step."""
        self.absorption.destroy()
        if self.before is not None:
            self.before.destroy()
