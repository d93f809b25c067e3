"""Where the trial of a step begins, and how it becomes the state at its end."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from fracflow._petsc import MPI, PETSc
from fracflow.mesh.data import Floats
from fracflow.model.balance import static_balance
from fracflow.model.compressibility import taken_between
from fracflow.model.contact_mass import follow
from fracflow.model.operators import Operators
from fracflow.model.state import Forces, Motion, PreviousStep, State, StepReport
from fracflow.solve.flow_round_off import flow_power
from fracflow.solve.newton import NewtonReport
from fracflow.solve.problem import StepProblem
from fracflow.solve.residual import Residual
from fracflow.solve.sections import SectionProblem


def without_suction(problem: StepProblem) -> bool:
    """Put the trial back too, with no pressure below the given least one; return whether that lifted any. Collective."""
    before, comm = problem.state.pressure.getArray(readonly=True), problem.operators.layout.comm
    lowest = min(before.min(initial=np.inf), problem.pressure.getArray(readonly=True).min(initial=np.inf))
    problem.begin_again()
    pressure = problem.pressure.getArray()
    given = min((pressure[part.numbers].min(initial=np.inf) for part in problem.loads.pressures), default=np.inf)
    lowest, given = comm.allreduce(float(lowest), op=MPI.MIN), comm.allreduce(float(given), op=MPI.MIN)
    if not lowest < given < np.inf:
        return False
    np.maximum(pressure, given, out=pressure)
    problem.evaluate()
    return True


def accept(problem: StepProblem, energy: Mapping[str, float]) -> State:
    """The state at the end of the step, from the trial at which the balances were last evaluated. Collective."""
    motion = Motion(problem.displacement.copy(), problem.velocity(), problem.acceleration())
    if problem.alphas.a0 > 0.0:
        follow(problem.operators, motion.velocity)
        follow(problem.operators, motion.acceleration)
    drive = 0.0 if problem.conduction is None else float(np.abs(problem.conduction.pressure).max(initial=0.0))
    forces = balanced_forces(problem, motion)
    given = problem.loads.given_pressures
    power = flow_power(problem.operators, problem.conduction, problem.pressure, forces.source, given)
    pressure, controls = problem.pressure.copy(), dict(problem.controls)
    new = State(problem.time, motion, pressure, problem.recorded(), forces, controls, energy, uptake=problem.uptake())
    new = replace(new, memory=memories_after(problem), stage_start=problem.state.stage_start)
    drive = max(problem.state.max_overpressure, problem.operators.layout.comm.allreduce(drive, op=MPI.MAX))
    return replace(new, max_overpressure=drive, max_dissipation=max(problem.state.max_dissipation, power))


def balanced_forces(problem: StepProblem, motion: Motion, lasting: Mapping[str, PETSc.Vec] | None = None) -> Forces:
    """Terms of both balances at one instant, with the reactions of what is held; the caller owns them. Collective.

    lasting  forces of terms that follow from the step before, and not from the motion at the instant, by their names
    """
    ops = problem.operators
    of_terms = problem.terms.forces(motion.velocity)
    of_terms |= {name: force.copy() for name, force in (lasting or {}).items()}
    support = static_balance(
        ops, motion.displacement, problem.sections.traction, problem.pressure, problem.load, of_terms.values()
    )
    ops.mass.multAdd(motion.acceleration, support, support)
    conduction, source = ops.layout.flow_vector(), problem.source.copy()
    if ops.flow is not None:
        assert problem.conduction is not None
        ops.flow.outflow(problem.conduction, conduction)
        if problem.loads.faint is not None:
            given, left = problem.loads.given_pressures, problem.flow_left()
            conduction.setArray(problem.loads.faint.balanced(conduction.getArray(), left, given))
        drawn = ops.layout.flow_vector()
        ops.flow.storage_coupling.multTranspose(motion.velocity, drawn)
        drawn.axpy(1.0, conduction)
        if (uptake := problem.uptake()) is not None:
            drawn.axpy(1.0, uptake)
            uptake.destroy()
        for part in problem.loads.pressures:
            source.getArray()[part.numbers] = drawn.getArray()[part.numbers]
        drawn.destroy()
    held = np.zeros(ops.layout.solid_count, dtype=bool)
    held[problem.loads.held] = True
    support.getArray()[~held] = 0.0
    anchor = None if problem.terms.anchor is None else problem.terms.anchor.copy()
    return Forces(problem.load.copy(), support, conduction, source, of_terms, problem.terms.powers, anchor)


def memories_after(problem: SectionProblem) -> dict[str, Floats]:
    """Memories (j, 2, m) of terms at the end of the step. Collective."""
    network, memory = problem.operators.flow, problem.state.memory
    if network is None or not memory:
        return {}
    pressure, step = network.at_ends(problem.pressure), problem.term_step()
    return {term.name: term.memory_after(pressure, step) for term in network.terms if term.name in memory}


def step_report(report: NewtonReport, residual: Residual, cycles: int) -> StepReport:
    """Report of a step that one solve by Newton's method made."""
    spent, left = (report.newton, report.krylov, cycles, report.fills), (residual.solid, residual.flow)
    return StepReport(*spent, *left, report.out_of_balance, round_off=residual.round_off)


def remember(operators: Operators, old: State, new: State, dt: float, through: Mapping[str, float]) -> PreviousStep:
    """The step between two states as the next one uses it; mean flow rates ``through`` wells that have limits."""
    velocity = new.motion.displacement.duplicate()
    before, after = old.motion.displacement.getArray(readonly=True), new.motion.displacement.getArray(readonly=True)
    velocity.setArray((after - before) / dt)
    taken = None if new.uptake is None else taken_between(operators, old, new)
    if taken is not None:
        taken.scale(1.0 / dt)
    return PreviousStep(dt, velocity, taken, through)
