"""Instants at which motions stay and accelerations jump: a stage begins, a joint changes its status, a well its rate."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace

import numpy as np

from fracflow._petsc import MPI, destroy
from fracflow.advance.network import FlowNetwork
from fracflow.integrators import Alphas, Stepper
from fracflow.mesh.data import Bools
from fracflow.model.energy import compressed, dissipated, jumped, pushed, switch, update_balance
from fracflow.model.energy_motion import Scheme, kinetic_energy
from fracflow.model.loads import Loads
from fracflow.model.operators import Operators
from fracflow.model.setup import Model
from fracflow.model.state import Motion, PreviousStep, SectionHistory, State, forgetful
from fracflow.scene.time_table import JUST_BEFORE
from fracflow.solve.accept import balanced_forces
from fracflow.solve.initial_rates import (
    first_levels,
    impulse,
    initial_acceleration,
    levels,
    starting_pressure,
    starting_rate,
)
from fracflow.solve.motion_terms import carried_on
from fracflow.solve.problem import StepProblem
from fracflow.solve.request import StepRequest, StepRule, sides_of

KEEPS_PACE = 1e-9  # of rates of flow and of walls: what less changes in a step is round-off


def enter(model: Model, network: FlowNetwork, loads: Loads, state: State, stepper: Stepper, dt: float) -> State:
    """A new state, as a stage takes it over. Collective.

    With inertia prescribed pressures hold from the first instant: they jump, and (4.1e) gives others and accelerations. They
    then follow their mean rate in the first step, of length ``dt``. Pressures of a compressible fluid stay as they are, and the
    balance gives its rate of uptake. Supports that are elsewhere come to their places during the first step. Without inertia,
    motion is dropped and what is prescribed arrives during the first step.

    Walls without a fluid go on at their mean velocity over the last step. That at its end, by a multistep rule, goes back
    in the step after a jump of a load, and no error has shortened such steps.
    """
    ops = model.operators
    if not stepper.inertia:
        kept = forgetful(state)
        kept.motion.velocity.set(0.0)
        destroy(kept.forces.anchor, kept.uptake)
        return replace(kept, forces=replace(kept.forces, anchor=None), energy=switch(state.energy, 0.0), uptake=None)
    motion, mean = state.motion.copy(), state.previous_step.velocity
    if ops.flow is None and mean is not None:
        mean.copy(motion.velocity)
    energy = switch(state.energy, kinetic_energy(ops, motion.velocity))
    if dt > 0.0:
        _set_off(ops, loads, state, motion, stepper, dt)
    energy = pushed(energy, kinetic_energy(ops, motion.velocity))
    was, around = state.sections, (0.0, dt)
    begun = replace(state, motion=motion, uptake=None, energy=energy, adjacent_steps=around)
    start = _first_instant(model, network, loads, begun, was.history, dt)
    # nothing moved in an instant: no section came nearer to a choice
    sections = replace(start.sections, strain=was.strain, blur=was.blur, record=was.record, margin=was.margin)
    start = replace(start, sections=sections)
    if start.uptake is None:
        return start
    return replace(start, energy=jumped(start.energy, compressed(ops, state, start)))


def _set_off(ops: Operators, loads: Loads, state: State, motion: Motion, stepper: Stepper, dt: float) -> None:
    """Give supports their velocity over the first half step, and what their masses share with free nodes to these. Collective.

    A mean velocity m of a step that follows one of m_0 by central differences makes free nodes of M_fh/M_ff begin by m - m_0.
    Rules whose velocity is d/dt begin by the velocity of the first half step.
    """
    gained, before = motion.velocity.duplicate(), state.adjacent_steps[0]
    gained.set(0.0)
    is_difference = stepper.alphas(dt).is_difference
    for moved in loads.supports:
        at = moved.numbers
        now, had = motion.displacement.getArray(readonly=True)[at], motion.velocity.getArray(readonly=True)[at]
        first = moved.first_speed(state.time, dt, now)
        if before > JUST_BEFORE[0] and not is_difference:
            left = motion.acceleration.getArray(readonly=True)[at]
            had = moved.speed_over(state.time, -before, now) - 0.5 * before * left
        gained.getArray()[at] = (first if is_difference else moved.speed_over(state.time, dt, now)) - had
        motion.velocity.getArray()[at] = first
    impulse(ops, loads, gained)
    gained.getArray()[loads.held] = 0.0
    motion.velocity.axpy(1.0, gained)
    gained.destroy()


def change(model: Model, network: FlowNetwork, loads: Loads, state: State, leaving: Bools) -> State:
    """A new state at the same instant, where the friction of the sections (s,) has the other status. Collective.

    Displacements and velocities stay, tractions drop, and accelerations follow. The energy that the drop frees is dissipated.
    """
    ops = model.operators
    status = ops.joints.with_other_status(state.sections.strain, state.sections.history, leaving)
    new = _first_instant(model, network, loads, replace(state, motion=state.motion.copy()), status)
    # they were brought to their threshold on purpose
    settled = replace(new.sections, margin=np.where(leaving, np.inf, state.sections.margin))
    new = replace(new, sections=settled, energy=update_balance(ops, state, new, 0.0, Scheme()))
    new = replace(new, friction=state.friction + dissipated(state.sections, settled))
    return new if state.uptake is None else replace(new, uptake=state.uptake.copy())


def keep_pace(model: Model, network: FlowNetwork, state: State, request: StepRequest, stepper: Stepper) -> State | None:
    """The state in which the walls of undrained components take up the volume that wells pump in a step. Collective.

    The sum of (3.20) over such a part, w v = sum Q, has a rate, w a = sum Q', that jumps where Q bends; the level of its
    pressures jumps with it. A rule that uses the previous acceleration would oscillate about both for ever, as nothing else
    damps them. Motions are as they were; None where all walls already move at the rate of the step.
    """
    ops, loads, dt = model.operators, request.loads, request.length
    around = sides_of(stepper, dt, request.next_length)
    parts = network.enclosed(loads, state, 0.0)
    if not parts:
        return None
    with ExitStack() as done:
        source, speed = ops.layout.flow_vector(), state.motion.velocity.copy()
        done.callback(destroy, source, speed)
        loads.source(request.time, request.controls, source, around)
        for moved in loads.supports:
            speed.getArray()[moved.numbers] = moved.speed(request.time, around)
        here = np.zeros((len(parts), 3))
        for row, part in zip(here, parts, strict=True):
            pumped, taken = source.getArray()[part.nodes], part.walls.times(speed)
            before = part.walls.times(state.motion.acceleration)[~np.isin(part.walls.at, loads.held)]
            row[:] = pumped.sum() - taken.sum(), before.sum(), np.abs(pumped).sum() + np.abs(taken).sum()
        change, paces, sizes = ops.layout.comm.allreduce(here, op=MPI.SUM).T
        lacks = change / dt - paces
        if np.all(np.abs(lacks) * dt <= KEEPS_PACE * sizes):
            return None
        added, moves = levels(ops, loads, parts, lacks)
        push, reaction, level = speed, moves.duplicate(), ops.layout.flow_vector()
        done.callback(destroy, moves, reaction, level)
        for part, more in zip(parts, added, strict=True):
            level.getArray()[part.nodes] += more
        start, held = forgetful(state), loads.held
        start.pressure.axpy(1.0, level)
        start.motion.acceleration.axpy(1.0, moves)
        assert ops.flow is not None
        ops.flow.pressure_load.mult(level, push)
        ops.mass.mult(moves, reaction)
        start.forces.support.getArray()[held] += reaction.getArray()[held] - push.getArray()[held]
    return start


def _first_instant(
    model: Model, network: FlowNetwork, loads: Loads, begun: State, status: SectionHistory, dt: float | None = None
) -> State:
    """(4.1e) The state with the pressures and accelerations that follow from its motion and statuses. Collective.

    ``begun`` owns its motion, which the new state takes over; it is freed where there is none. With ``dt``, a compressible
    fluid gets its first rates.
    """
    ops, motion = model.operators, begun.motion
    with ExitStack() as done, ExitStack() as failed:
        failed.callback(motion.destroy)
        closed = loads
        if ops.flow is not None:
            network.update(begun)
            closed = network.level(loads, begun)
        now, rate = Alphas(a4=-1.0), None  # no change of displacement, velocity and pressure rate as they are
        known, anchor = begun.forces.anchor, carried_on(ops, loads, begun)
        if anchor is not None and anchor is not known:
            done.callback(anchor.destroy)
        begun = replace(begun, forces=replace(begun.forces, anchor=anchor))
        request = StepRequest(begun.time, 0.0, begun.controls, closed)
        problem = StepProblem(ops, begun, request, StepRule(now, begun.adjacent_steps, inertia=True))
        done.callback(problem.destroy)
        problem.trial_status = status
        problem.evaluate()
        # explicit steps damp the mean motion of a step: that force stays, where a stage goes on with them
        follows = [term.name for term in ops.terms if term.damping is not None]
        lasting = {name: force for name, force in begun.forces.of_terms.items() if name not in follows}
        compressible = ops.flow is not None and ops.flow.compressibility > 0.0
        if compressible and dt is not None:
            rate = starting_rate(ops, problem, dt)
            failed.callback(rate.destroy)
            problem.state = replace(begun, uptake=rate)
            problem.evaluate()
        elif not compressible and problem.residual.flow > model.scene.accuracy.residual:
            starting_pressure(model.scene, ops, closed, problem)
            problem.evaluate()
        driven, inertia = motion.acceleration.duplicate(), motion.acceleration.duplicate()
        done.callback(destroy, driven, inertia)
        driven.set(0.0)
        if dt is None:  # at an event supports go on; as a stage begins, what they gain at once is in velocities
            driven.getArray()[loads.held] = motion.acceleration.getArray(readonly=True)[loads.held]
        ops.mass.mult(driven, inertia)
        others = [*lasting.values(), inertia]
        initial_acceleration(ops, problem, motion.acceleration, others)
        parts = network.enclosed(loads, begun, dt or 0.0) if ops.flow is not None else []
        for part, level in zip(parts, first_levels(ops, problem, motion.acceleration, parts), strict=True):
            problem.pressure.getArray()[part.nodes] += level
        if parts:
            problem.evaluate()
            initial_acceleration(ops, problem, motion.acceleration, others)
        motion.acceleration.axpy(1.0, driven)
        forces = balanced_forces(problem, motion, lasting)
        failed.pop_all()
        start = replace(begun, pressure=problem.pressure.copy(), sections=problem.recorded(), forces=forces)
    return replace(start, previous_step=PreviousStep(), uptake=rate)
