"""Joints and fluid at the end of an explicit step, by the motion of sections alone, for ``SectionSolver``."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fracflow._petsc import MPI, PETSc, destroy
from fracflow.laws import LawStep
from fracflow.mesh.data import Floats, Ints
from fracflow.model.compressibility import compression_of
from fracflow.model.flow import Conduction
from fracflow.model.operators import Operators
from fracflow.model.state import Sections, State
from fracflow.model.terms.term import TermStep
from fracflow.solve.accept import memories_after
from fracflow.solve.flow_round_off import flow_power
from fracflow.solve.request import StepRequest, StepRule
from fracflow.solve.sections import given_before
from fracflow.solve.statuses import Statuses


class FluidStep:
    """One step from ``state``, whose motion may be that of an earlier one. Writes nothing into it."""

    def __init__(self, operators: Operators, state: State, request: StepRequest, rule: StepRule) -> None:
        """Sample wells at the end of the step. Collective."""
        self.operators, self.state, self.request, self.rule, layout = operators, state, request, rule, operators.layout
        self.loads, self.alphas, self.time, self.controls = request.loads, rule.alphas, request.time, request.controls
        self.source, self.flow_balance, self.pressure = (
            layout.flow_vector(),
            layout.flow_vector(),
            state.pressure.copy(),
        )
        self.loads.source(self.time, self.controls, self.source, rule.adjacent)
        for part in self.loads.pressures:
            self.pressure.getArray()[part.numbers] = part.value(self.time, rule.adjacent)
        self.displacement = state.motion.displacement  # openings are those of the sections
        self.sections = state.sections
        self.trial_status, self._refused = Statuses.of(state.sections)
        self.fluid_before = compression_of(operators, state)
        self.conduction: Conduction | None = None
        self.taken_up: Floats | None = None

    def evaluate_joints(self, strain: Floats, hold: bool = True) -> Sections:
        """(2.10b) Response of the sections to strains (s, dim), from their last accepted history with the present statuses."""
        return self.operators.joints.evaluate(strain, self.trial_status, self.law_step(hold))

    def law_step(self, hold: bool = True) -> LawStep:
        """The ``LawStep`` of this step."""
        return LawStep(self.time, self.request.length, True, hold)

    def term_step(self) -> TermStep:
        """The same for terms with a memory."""
        return TermStep(self.state.memory, self.alphas, self.request.length)

    def change_statuses(self) -> np.ndarray:
        """Give every section that has left its status the next one; return which (s,) of this rank did."""
        now, before = Statuses(self.trial_status, self._refused), self.state.sections.history
        found = self.evaluate_joints(self.sections.strain, hold=False)
        (self.trial_status, self._refused), changed = now.after(self.operators.joints, before, self.sections, found)
        return changed

    def undetermined(self, nodes: Ints) -> float:
        """Nothing of what nodes (n,) draw is taken for round-off."""
        return 0.0

    def opened(self, change: Floats) -> PETSc.Vec:
        """Volumes that walls open at the flow nodes as sections move by (s, dim), new [volume per thickness]. Collective."""
        result = self.operators.layout.flow_vector()
        self.operators.network.taken_up((self.operators.joints.weights * change[:, -1]).reshape(-1, 2), result)
        return result

    def accepted(self, opened: PETSc.Vec) -> State:
        """The state at the end of the step, but for its motion, energy and volumes; its vectors of the flow are new.

        opened  see there
        Collective.
        """
        assert self.conduction is not None
        network, layout, state = self.operators.network, self.operators.layout, self.state
        conduction, source = layout.flow_vector(), self.source.copy()
        network.outflow(self.conduction, conduction)
        drawn, given = opened.copy(), given_before(self)
        drawn.scale(self.alphas.a1)
        drawn.axpy(1.0, conduction)
        uptake = None
        if self.taken_up is not None:
            uptake = layout.flow_vector()
            uptake.setArray(self.taken_up)
            drawn.axpy(1.0, uptake)
        given.axpy(-1.0, self.source)
        drawn.axpy(-1.0, given)
        numbers = self.loads.given_pressures
        source.getArray()[numbers] = drawn.getArray()[numbers]
        destroy(drawn, given)
        power = flow_power(self.operators, self.conduction, self.pressure, source, numbers)
        driven = float(np.abs(self.conduction.pressure).max(initial=0.0))
        return replace(
            state,
            time=self.time,
            pressure=self.pressure.copy(),
            sections=self.sections,
            forces=replace(state.forces, conduction=conduction, source=source),
            controls=dict(self.controls),
            uptake=uptake,
            memory=memories_after(self),
            max_overpressure=max(state.max_overpressure, layout.comm.allreduce(driven, op=MPI.MAX)),
            max_dissipation=max(state.max_dissipation, power),
            adjacent_steps=self.rule.adjacent,
        )

    def destroy(self) -> None:
        """Free the vectors of the trial."""
        destroy(self.source, self.pressure, self.flow_balance)


def free_flow(state: State) -> None:
    """Free the vectors of the flow of a state that ``FluidStep`` made."""
    destroy(state.pressure, state.forces.conduction, state.forces.source, state.uptake)
