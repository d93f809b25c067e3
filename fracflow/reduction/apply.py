"""Input of the plan from a model that was set up, and the model that the plan leaves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from time import process_time

from fracflow._petsc import MPI, PETSc
from fracflow.advance.initial_state import equilibrium_state, refuse_imbalance
from fracflow.mesh.data import Ints
from fracflow.model.operators import Operators
from fracflow.model.setup import Model, SlowLoads
from fracflow.model.state import State
from fracflow.reduction.decision import ReductionInput
from fracflow.reduction.inertia import asks_period, key_of, reduced, slow_stages
from fracflow.reduction.locked_fractures import EARLIER, PART
from fracflow.reduction.locked_mesh import find_locked, tied
from fracflow.reduction.unloaded_blocks import without_idle
from fracflow.solve.period import longest_period
from fracflow.solve.rock_cost import rock_choice

LARGEST = PETSc.NormType.INFINITY


def planned(
    model: Model, undone: Mapping[str, str] | None = None, cell_rank: Ints | None = None
) -> tuple[Model, ReductionInput]:
    """The model without the parts that its scene does not need, and the facts for that. It was settled before. Collective.

    undone     decisions that an earlier try of the same run has undone
    cell_rank  partition (cells,) of an earlier run, on rank 0
    """
    shut = find_locked(model, ReductionInput(model.scene, unknowns=int(model.operators.layout.solid_starts[-1])))
    undone = {PART if part == EARLIER else part: when for part, when in (undone or {}).items()}
    if shut.names and PART not in undone:
        model = tied(model, shut.names, cell_rank)
        refuse_imbalance(model)
    model, parts = without_idle(model)
    facts = replace(reduction_input(model), locked=shut, parts=parts, sides=model.sides, undone=undone)
    slow = {number: SlowLoads(facts.tolerance, key_of(number, stage)) for number, stage in slow_stages(facts).items()}
    return replace(model, scene=reduced(facts), slow=slow), facts


def reduction_input(model: Model) -> ReductionInput:
    """The input of decisions, except the pre-run checks, locked fractures and blocks of the rock. Collective."""
    ops, scene = model.operators, model.scene
    facts = ReductionInput(
        scene,
        unknowns=int(ops.layout.solid_starts[-1]),
        pressures=int(ops.layout.flow_starts[-1]),
        jumps=ops.layout.comm.allreduce(len(ops.joints.weights), op=MPI.SUM) * ops.joints.dim,
        ranks=ops.layout.comm.size,
        damps=ops.damping is not None,
        rock=rock_choice(scene, ops.layout.comm, int(ops.layout.solid_starts[-1]), ops.far is not None),
    )
    if not facts.leaves_out or not asks_period(scene):
        return facts
    state = equilibrium_state(model)
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
