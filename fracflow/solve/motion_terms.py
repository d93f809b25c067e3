"""Terms of the rock's balance that motion makes: inertia, dashpots, and loads not yet applied within a step."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from fracflow._petsc import PETSc, destroy
from fracflow.integrators import Alphas, driven_acceleration
from fracflow.mesh.data import Floats, Ints
from fracflow.model.loads import Loads
from fracflow.model.operators import Operators
from fracflow.model.state import State
from fracflow.model.terms.term import Term
from fracflow.scene.time_table import JUST_AFTER, Around
from fracflow.solve.request import StepRule
from fracflow.solve.residual import CANCELLATION, largest


@dataclass(frozen=True)
class Unapplied:
    """Part of the prescribed displacements and pressures (an array a support, or well) unapplied at the end of a step."""

    displacement: tuple[Floats, ...] = ()
    pressure: tuple[Floats, ...] = ()

    @staticmethod
    def of(loads: Loads, state: State, share: float, of_wells: bool, load: PETSc.Vec, source: PETSc.Vec) -> Unapplied:
        """A share of the prescribed values not yet in ``state``, jumps there included. Collective.

        Unapplied forces, and rates ``of_wells``, go into ``load`` and ``source``.
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
        return Unapplied(*(
            tuple(share * (vector.getArray(readonly=True)[part.numbers] - part.value(state.time, JUST_AFTER)) for part in parts)
            for vector, parts in ((state.motion.displacement, loads.supports), (state.pressure, loads.pressures))
        ))  # fmt: skip


@dataclass(frozen=True)
class MovingTerms:
    """M (inertia a_new + inertia_old a) + balance_old S + C v_new - what comes in, as ``stepping.Alphas`` weighs them.

    acceleration  a, at the start of the step
    before        S there; None where it takes no part
    """

    mass: PETSc.Mat
    alphas: Alphas
    terms: TermsOfStep
    acceleration: PETSc.Vec
    before: PETSc.Vec | None

    def add(
        self, acceleration: PETSc.Vec, velocity: PETSc.Vec, displacement: PETSc.Vec, balance: PETSc.Vec
    ) -> list[float]:
        """Add them to ``balance``, which was zero; this rank's largest terms. Collective.

        A share CANCELLATION of alpha_0 M u, and of alpha_1 C u, counts as a term.
        """
        alphas, term, sizes = self.alphas, balance.duplicate(), [0.0]
        if alphas.mass > 0.0 or alphas.looks_back:
            met = acceleration.copy()
            if alphas.looks_back:
                met.scale(alphas.inertia)
                met.axpy(alphas.inertia_old, self.acceleration)
            self.mass.mult(met, balance)
            self.mass.mult(displacement, term)
            sizes += [largest(balance), CANCELLATION * alphas.mass * largest(term)]
            met.destroy()
        if self.before is not None:
            balance.axpy(alphas.balance_old, self.before)
            sizes.append(alphas.balance_old * largest(self.before))
        forces = self.terms.forces(velocity)
        for each in self.terms.acting:
            assert each.damping is not None
            force = forces[each.name]
            balance.axpy(1.0, force)
            each.damping.mult(displacement, term)
            sizes += [largest(force), CANCELLATION * alphas.a1 * largest(term)]
            force.destroy()
        term.destroy()
        return sizes

    def destroy(self) -> None:
        """Free what is of this step."""
        destroy(self.terms, self.before)


@dataclass(frozen=True)
class TermsOfStep:
    """Terms with a C over one step, ``acting``, and the forces ``incoming`` by them at its end; none without inertia.

    powers  of the incoming forces [energy/time per thickness], by the names of terms
    anchor  static reactions that terms carry on as loads; the state's own
    """

    acting: tuple[Term, ...] = ()
    incoming: Mapping[str, PETSc.Vec] = field(default_factory=dict)
    powers: Mapping[str, float] = field(default_factory=dict)
    anchor: PETSc.Vec | None = None

    @staticmethod
    def of(
        operators: Operators, loads: Loads, anchor: PETSc.Vec | None, time: float, around: Around, load: PETSc.Vec
    ) -> TermsOfStep:
        """Those of a step to ``time`` from a state with an ``anchor``, which is added to ``load``. Collective."""
        if loads.at_rest:
            return TermsOfStep()
        acting = tuple(term for term in operators.terms if term.damping is not None)
        incoming, powers = {}, {}
        for term in acting:
            force = operators.layout.solid_vector()
            power = term.incoming(time, around, force)
            if power is None:
                force.destroy()
            else:
                incoming[term.name], powers[term.name] = force, power
        anchor = anchor if acting else None
        if anchor is not None:
            load.axpy(1.0, anchor)
        return TermsOfStep(acting, incoming, powers, anchor)

    def forces(self, velocity: PETSc.Vec) -> dict[str, PETSc.Vec]:
        """C v less what comes in, of each term by its name, in new vectors. Collective."""
        found = {}
        for term in self.acting:
            assert term.damping is not None
            found[term.name] = velocity.duplicate()
            term.damping.mult(velocity, found[term.name])
            if term.name in self.incoming:
                found[term.name].axpy(-1.0, self.incoming[term.name])
        return found

    def destroy(self) -> None:
        """Free what is of this step."""
        destroy(*self.incoming.values())


class Driven(NamedTuple):
    """Unknowns (n,), local numbers, that the scene moves where not the integrator does, at the end of a step.

    beside_rates  part of their motion in the step that their speeds, as the rule weighs them, lack [length]
    """

    numbers: Ints
    speed: float | Floats
    acceleration: float | Floats
    beside_rates: float | Floats


def driven_by(loads: Loads, state: State, rule: StepRule, time: float) -> list[Driven]:
    """Those of a step from a state to a time; none of a rule whose velocity is d/dt, which does not ring.

    Speeds are means over halves of the steps around. A rule weighs each by gamma in the step that it ends, by 1 - gamma in the
    next one. There it lacks a part of the motion between the middles of both, or from where a stage begins.
    """
    alphas, (dt, ahead), (last, planned), found = rule.alphas, rule.adjacent, state.adjacent_steps, []
    if not alphas.a0 or not max(rule.adjacent) or alphas.is_difference:
        return []
    begin, gamma = state.time, alphas.gamma
    for part in loads.supports:
        was, speed, pushed = (vector.getArray(readonly=True)[part.numbers] for vector in state.motion.vectors)
        new = part.speed(time, rule.adjacent)
        missed = part.value(begin + 0.5 * dt) - (part.value(begin - 0.5 * last) if last > 0.0 else was)
        missed = missed - (gamma * last + (1.0 - gamma) * dt) * speed
        if ahead == 0.0:
            missed = missed - (gamma - 0.5) * dt * new
        mean = part.speed_over(begin, dt, was)
        brought = part.speed_over(begin, planned, was) - 0.5 * planned * pushed if planned > 0.0 else mean
        then = part.speed_over(time, ahead, part.value(time)) if ahead > 0.0 else mean
        push = driven_acceleration(gamma, dt, ahead or dt, then, brought, pushed)
        found.append(Driven(part.numbers, new, push, missed))
    return found


def volumes_beside_rates(operators: Operators, driven: Iterable[Driven]) -> Floats:
    """Volumes (n,) that this part of the motion of walls opens at the flow nodes [volume per thickness]. Collective."""
    moved, opened = operators.layout.solid_vector(), operators.layout.flow_vector()
    for each in driven:
        moved.getArray()[each.numbers] = each.beside_rates
    operators.network.storage_coupling.multTranspose(moved, opened)
    result: Floats = opened.getArray().copy()
    destroy(moved, opened)
    return result


def carried_on(operators: Operators, loads: Loads, state: State) -> PETSc.Vec | None:
    """Loads that terms go on to carry: the reactions of held unknowns. The caller destroys a new one. Collective."""
    if operators.damping is None or state.forces.anchor is not None:
        return state.forces.anchor
    anchor = state.forces.support.duplicate()
    anchor.set(0.0)
    anchor.getArray()[loads.resting] = state.forces.support.getArray(readonly=True)[loads.resting]
    return anchor
