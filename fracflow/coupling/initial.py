"""(4.1e) Pressures and accelerations of the first instant of a stage."""

from __future__ import annotations

import numpy as np

from fracflow._petsc import PETSc
from fracflow.assembly.loads import Loads
from fracflow.assembly.operators import Operators
from fracflow.coupling.joined_matrix import JoinedMatrix
from fracflow.coupling.newton import Newton
from fracflow.coupling.step_problem import StepProblem
from fracflow.coupling.true_residual import check_solution
from fracflow.errors import SolveError
from fracflow.scene import Scene


def starting_pressure(scene: Scene, operators: Operators, loads: Loads, problem: StepProblem) -> None:
    """(4.1e) H_0 = K_F^-1 (Q_0 - B_F' v_0), for wells that pump from the first instant. Raises SolveError. Collective."""
    matrix = JoinedMatrix(operators, loads)
    newton = Newton(scene, matrix, "flow", "flow")
    try:
        newton.solve(problem)
    except SolveError as error:
        raise SolveError(
            f"time {problem.time:.6g}: no initial pressures: wells pump at once into fractures that nothing drains;"
            " let flow_rate start at 0, or give a [[well]] with a pressure"
        ) from error
    finally:
        newton.destroy()
        matrix.destroy()


def starting_rate(operators: Operators, problem: StepProblem, dt: float) -> PETSc.Vec:
    """C p' = Q - B_F' v - K_F p: rates at which a compressible fluid starts, in a new vector, from an evaluated trial.

    Prescribed pressures start at the rate at which they change over ``dt`` [time]; fluid without volume at none. Collective.
    """
    network = operators.flow
    assert network is not None
    rate, volume = problem.pressure.duplicate(), problem.pressure.duplicate()
    rate.set(1.0)
    volume.set(0.0)
    aperture = network.apertures(problem.displacement, operators.joints.openings(problem.sections.strain))
    network.taken_up(network.compress(aperture, rate).weight, volume)
    weight, balance = volume.getArray(), problem.flow_balance.getArray(readonly=True)
    rate.setArray(np.divide(-balance, weight, out=np.zeros(len(weight)), where=weight > 0.0))
    if dt > 0.0:
        for part in problem.loads.pressures:
            rate.getArray()[part.numbers] = (part.value(problem.time + dt) - part.value(problem.time)) / dt
    volume.destroy()
    return rate


def initial_acceleration(operators: Operators, problem: StepProblem, acceleration: PETSc.Vec) -> None:
    """(4.1e) a_0 = M^-1 (R_0 + B H_0 - K(d_0)); zero where held. Collective."""
    matrix, solver = _with_diagonal(operators.mass), PETSc.KSP().create(comm=operators.layout.comm)
    start = matrix.getOwnershipRange()[0]
    held = np.concatenate([start + part.numbers for part in problem.loads.supports] or [np.zeros(0)])
    matrix.zeroRowsColumns(held.astype(PETSc.IntType), 1.0)
    solver.setOperators(matrix)
    solver.setOptionsPrefix("mass_")
    solver.setFromOptions()
    solver.solve(problem.solid_balance, acceleration)
    check_solution(solver, acceleration, problem.solid_balance, f"time {problem.time:.6g}: first accelerations")
    acceleration.scale(-1.0)
    solver.destroy()
    matrix.destroy()


def _with_diagonal(matrix: PETSc.Mat) -> PETSc.Mat:
    """A copy with an entry on every diagonal: unknowns that no node has, where nodes are tied, have none."""
    zeros = PETSc.Mat().createAIJ(matrix.getSizes(), nnz=1, comm=matrix.getComm())
    first, last = zeros.getOwnershipRange()
    rows = np.arange(first, last, dtype=PETSc.IntType)
    zeros.setValuesIJV(np.arange(len(rows) + 1, dtype=PETSc.IntType), rows, np.zeros(len(rows)))
    zeros.assemble()
    copy = matrix.copy()
    copy.axpy(1.0, zeros, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
    zeros.destroy()
    return copy
