"""What the plan looks at in a model that was set up, and the model that it leaves."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from time import process_time

import numpy as np

from fracflow._petsc import MPI, PETSc
from fracflow.advance.initial_state import rest, settle
from fracflow.mesh.data import Ints
from fracflow.model.operators import Operators
from fracflow.model.setup import Model
from fracflow.model.state import State
from fracflow.reduction.decision import Facts
from fracflow.reduction.idle_rock import without_idle
from fracflow.reduction.inertia import asks_period, reduced
from fracflow.reduction.tied_fractures import PART
from fracflow.reduction.tied_mesh import find_shut, tied
from fracflow.solve.period import longest_period

LARGEST = PETSc.NormType.INFINITY


def planned(model: Model, undone: Mapping[str, str] | None = None, cell_rank: Ints | None = None) -> Model:
    """The model without what its scene does not need; ``facts`` say why. It was settled before. Collective.

    undone     what an earlier try of the same run has taken back
    cell_rank  partition of an earlier run, on rank 0
    """
    shut, undone = (
        find_shut(model, Facts(model.scene, unknowns=int(model.operators.layout.solid_starts[-1]))),
        undone or {},
    )
    if shut.names and PART not in undone:
        model = tied(model, shut.names, cell_rank)
        settle(model)
    model, parts = without_idle(model)
    facts = replace(find_facts(model), shut=shut, parts=parts, undone=undone)
    return replace(model, scene=reduced(facts), facts=facts)


def find_facts(model: Model) -> Facts:
    """What decisions look at, but for the scene card, tied fractures and parts of the rock. Collective."""
    ops, scene = model.operators, model.scene
    facts = Facts(
        scene,
        unknowns=int(ops.layout.solid_starts[-1]),
        pressures=int(ops.layout.flow_starts[-1]),
        jumps=ops.layout.comm.allreduce(len(ops.joints.weights), op=MPI.SUM) * ops.joints.dim,
        ranks=ops.layout.comm.size,
        damps=ops.damping is not None,
    )
    if not facts.leaves_out or not asks_period(scene):
        return facts
    state = rest(model)
    period, unrest = longest_period(ops, model.loads, state.sections), _unrest(model, state)
    state.destroy()
    return replace(facts, period=period, unrest=unrest)


def _unrest(model: Model, state: State) -> float:
    """Largest force that the loads bring at once at the start, over the largest of the scene. Collective."""
    jump = model.operators.layout.solid_vector()
    model.loads.force(state.time, state.controls, jump)
    jump.axpy(-1.0, state.forces.load)
    model.loads.release(jump)
    found = float(jump.norm(LARGEST)) / model.operators.scales.force
    jump.destroy()
    return found


def why_inertia(old: State, new: State, period: float, left: float, most: float) -> str:
    """Why a step that the plan leaves without inertia should have it: something fails, or swings; empty if nothing. Collective.

    ``left`` and the vibration as in ``swing``, which may come to ``most``.
    """
    changed = np.any(new.sections.is_open != old.sections.is_open)
    changed |= np.any(
        new.sections.is_sliding | np.any(new.sections.inelastic[:, :-1] != old.sections.inelastic[:, :-1], axis=1)
    )
    if new.motion.velocity.comm.tompi4py().allreduce(bool(changed), op=MPI.LOR):
        return "joints slip or open"
    found = swing(old, new, period, left)
    return f"a vibration of {found:.3g} of the displacement would be left out, above {most:g}" if found > most else ""


def swing(old: State, new: State, period: float, left: float) -> float:
    """Amplitude of the vibration that a step without inertia leaves out, over the displacement to come [1]. Collective.

    A rate that changes by r sets off r T/(2 pi), and stopping again as much; ``left`` is how long loads go on at their rate
    """
    change = new.motion.velocity.copy()
    change.axpy(-1.0, old.motion.velocity)
    kick, rate = float(change.norm(LARGEST)), float(new.motion.velocity.norm(LARGEST))
    change.destroy()
    reach = float(new.motion.displacement.norm(LARGEST)) + rate * left
    return kick * period / (math.pi * reach) if reach > 0.0 else 0.0


def seconds_of_factors(operators: Operators) -> float:
    """CPU time of one LU factorisation of the rock's matrix, ordered before, on this process [s]. Collective."""
    matrix = operators.stiffness.copy()
    matrix.axpy(1.0, operators.mass)
    matrix.shift(float(matrix.getDiagonal().max()[1]) or 1.0)
    solver = PETSc.KSP().create(comm=matrix.comm)
    solver.setOperators(matrix)
    solver.setType("preonly")
    solver.getPC().setType("lu")
    solver.getPC().setFactorSolverType("mumps")
    solver.setUp()
    matrix.scale(2.0)  # another matrix of the same pattern
    solver.setOperators(matrix)
    began = process_time()
    solver.setUp()
    lasted = process_time() - began
    solver.destroy()
    matrix.destroy()
    return lasted
