"""Terms of the rock's balance that motion makes: inertia, absorbing sides, and loads not yet applied within a step."""

from __future__ import annotations

from dataclasses import dataclass

from fracflow._petsc import PETSc
from fracflow.integrators import Alphas
from fracflow.mesh.data import Floats
from fracflow.model.balance import static_balance_of
from fracflow.model.loads import Loads
from fracflow.model.operators import Operators
from fracflow.model.state import State
from fracflow.scene.time_table import JUST_AFTER, Around
from fracflow.solve.residual import CANCELLATION, largest


@dataclass(frozen=True)
class Lag:
    """Part of the prescribed displacements and pressures (an array a support, or well) unapplied at the end of a step."""

    displacement: tuple[Floats, ...] = ()
    pressure: tuple[Floats, ...] = ()

    @staticmethod
    def of(loads: Loads, state: State, share: float, of_wells: bool, load: PETSc.Vec, source: PETSc.Vec) -> Lag:
        """A share of the values that ``state`` lacks, jumps there included. Collective.

        Forces that lack, and rates ``of_wells``, go into ``load`` and ``source``.
        """
        for total, term, had, now in (
            (load, load.duplicate(), state.forces.load, loads.force),
            (source, source.duplicate(), state.forces.source, loads.source),
        ):
            now(state.time, state.controls, term, JUST_AFTER)
            if total is load or of_wells:
                total.axpy(share, had)
                total.axpy(-share, term)
            term.destroy()
        return Lag(*(
            tuple(share * (vector.getArray(readonly=True)[part.numbers] - part.value(state.time, JUST_AFTER)) for part in parts)
            for vector, parts in ((state.motion.displacement, loads.supports), (state.pressure, loads.pressures))
        ))  # fmt: skip


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


@dataclass(frozen=True)
class Absorption:
    """Dashpots C and the forces of waves at the end of a step; all None where no side absorbs, as without inertia.

    anchor    static reactions that the sides carry on as loads; the state's own
    incident  power that the waves bring in [energy/time per thickness]
    """

    damping: PETSc.Mat | None = None
    wave: PETSc.Vec | None = None
    anchor: PETSc.Vec | None = None
    incident: float = 0.0

    @staticmethod
    def of(
        operators: Operators, loads: Loads, state: State, time: float, around: Around, load: PETSc.Vec
    ) -> Absorption:
        """That of a step to ``time`` from a state; what the sides carry is added to ``load``. Collective."""
        if operators.damping is None or loads.at_rest:
            return Absorption()
        wave = operators.layout.solid_vector() if loads.waves else None
        if wave is not None:
            for each in loads.waves:
                each.add_force(time, around, wave)
        if state.forces.anchor is not None:
            load.axpy(1.0, state.forces.anchor)
        incident = sum(each.power(time, around) for each in loads.waves)
        return Absorption(operators.damping, wave, state.forces.anchor, incident)

    def force(self, velocity: PETSc.Vec) -> PETSc.Vec | None:
        """What the sides absorb at a velocity, in a new vector; None where nothing does. Collective."""
        if self.damping is None:
            return None
        result = velocity.duplicate()
        self.damping.mult(velocity, result)
        if self.wave is not None:
            result.axpy(-1.0, self.wave)
        return result

    def destroy(self) -> None:
        """Free what is of this step."""
        if self.wave is not None:
            self.wave.destroy()


def carried_on(operators: Operators, loads: Loads, state: State) -> PETSc.Vec | None:
    """What absorbing sides go on to carry: their reactions where they were held. The caller destroys a new one."""
    if operators.damping is None or state.forces.anchor is not None:
        return state.forces.anchor
    anchor = state.forces.support.duplicate()
    anchor.set(0.0)
    anchor.getArray()[loads.resting] = state.forces.support.getArray(readonly=True)[loads.resting]
    return anchor
