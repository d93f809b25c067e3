"""What absorbing sides do in one step: C v against the motion, less what the waves that come in bring."""

from __future__ import annotations

from dataclasses import dataclass

from fracflow._petsc import PETSc
from fracflow.model.loads import Loads
from fracflow.model.operators import Operators
from fracflow.model.state import State
from fracflow.scene.time_table import Around


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
