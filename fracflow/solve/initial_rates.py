"""(4.1e) Pressures and accelerations of the first instant of a stage."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from fracflow._petsc import PETSc, destroy
from fracflow.errors import SolveError, is_alone
from fracflow.mesh.blocks import petsc_ints
from fracflow.mesh.data import Floats, Ints
from fracflow.model.joints import entry_sizes
from fracflow.model.layout import FewEntries, create_matrix, product
from fracflow.model.loads import Loads
from fracflow.model.operators import Operators
from fracflow.scene.scene import Scene
from fracflow.scene.time_table import JUST_AFTER, JUST_BEFORE
from fracflow.solve.jacobian import JoinedMatrix
from fracflow.solve.linear import check_solution
from fracflow.solve.newton import Newton
from fracflow.solve.options import solver_of
from fracflow.solve.problem import StepProblem


@dataclass(frozen=True)
class EnclosedComponent:
    """A network component that nothing drains.

    nodes  local numbers of its flow nodes on this rank
    walls  change of its volume with the displacements [area]
    rate   sum of the rates at which its wells' flow rates change [area/time^2]
    """

    nodes: Ints
    walls: FewEntries
    rate: float


def starting_pressure(scene: Scene, operators: Operators, loads: Loads, problem: StepProblem) -> None:
    """(4.1e) H_0 = K_F^-1 (Q_0 - B_F' v_0), for wells that pump from the first instant. Raises SolveError. Collective."""
    matrix = JoinedMatrix(operators, loads)
    newton = Newton(scene, matrix, "flow", "flow")
    try:
        newton.solve(problem)
    except SolveError as error:
        raise SolveError(f"time {problem.time:.6g}: no initial pressures: {error}") from error
    finally:
        if not is_alone():
            destroy(newton, matrix)


def starting_rate(operators: Operators, problem: StepProblem, dt: float) -> PETSc.Vec:
    """Rates Q - B_F' v - K_F p at which a compressible fluid is taken up, in a new vector, from an evaluated trial.

    Prescribed pressures start at the rate at which they change over ``dt`` [time]; fluid without volume at none. Collective.
    """
    network, held = operators.network, problem.conduction.compression if problem.conduction is not None else None
    assert held is not None
    rate, weight, given = (operators.layout.flow_vector() for _ in range(3))
    network.taken_up(held.weight, weight)
    balance = problem.flow_balance.getArray(readonly=True)
    rate.setArray(np.where(weight.getArray() > 0.0, -balance, 0.0))
    if dt > 0.0:
        parting = product(network.opening, problem.state.motion.velocity).reshape(-1, 2)
        network.taken_up(held.slope * parting, given)
        for part in problem.loads.pressures:
            change = (part.value(problem.time + dt, JUST_BEFORE) - part.value(problem.time, JUST_AFTER)) / dt
            walls, fluid = given.getArray()[part.numbers], weight.getArray()[part.numbers]
            rate.getArray()[part.numbers] = walls + fluid * change
    destroy(weight, given)
    return rate


def initial_acceleration(
    operators: Operators, problem: StepProblem, acceleration: PETSc.Vec, lasting: Iterable[PETSc.Vec] = ()
) -> None:
    """(4.1e) a_0 = M^-1 (R_0 + B H_0 - K(d_0)), less ``lasting`` forces on the left; zero where held. Collective.

    Walls whose mass was moved inward move with the nodes that carry it, P a = a, where their forces act: M a = P' f.
    """
    matrix, solver = _mass(operators, problem.loads)
    balance = problem.solid_balance.copy()
    for each in lasting:
        balance.axpy(1.0, each)
    problem.loads.release(balance)
    force = balance.copy()
    if operators.inward is not None:
        operators.inward.multTranspose(balance, force)
        problem.loads.release(force)
    solver.solve(force, acceleration)
    check_solution(solver, acceleration, force, f"time {problem.time:.6g}: first accelerations")
    acceleration.scale(-1.0)
    destroy(balance, force, solver, matrix)


def impulse(operators: Operators, loads: Loads, gained: PETSc.Vec) -> None:
    """Add what free unknowns gain in velocity as held ones gain theirs at once: M_ff v_f = -M_fh v_h. In place. Collective."""
    push = gained.duplicate()
    if operators.inward is None:
        operators.mass.mult(gained, push)
    else:
        whole = with_diagonal(operators.mass)
        _bind(whole, operators.inward)
        whole.mult(gained, push)
        whole.destroy()
    loads.release(push)
    if push.norm() > 0.0:  # of lumped masses there is none
        matrix, solver = _mass(operators, loads)
        shared = gained.duplicate()
        solver.solve(push, shared)
        check_solution(solver, shared, push, "velocities as supports begin to move")
        gained.axpy(-1.0, shared)
        destroy(shared, solver, matrix)
    push.destroy()


def first_levels(
    operators: Operators, problem: StepProblem, acceleration: PETSc.Vec, parts: Sequence[EnclosedComponent]
) -> Floats:
    """Changes (k,) of the pressures of components, so that their walls take up the inflow from the start.

    The sum of (3.20) over an undrained component, w v = sum Q, leaves its level undetermined. Its rate determines it, w a =
    sum Q', where a level adds M^-1 w to the ``acceleration``. Collective.
    """
    if not parts:
        return np.zeros(0)
    lacks = [part.rate - part.walls.dot(acceleration) for part in parts]
    added, moved = levels(operators, problem.loads, parts, np.array(lacks))
    moved.destroy()
    return added


def levels(
    operators: Operators, loads: Loads, parts: Sequence[EnclosedComponent], lacks: Floats
) -> tuple[Floats, PETSc.Vec]:
    """Changes (k,) of the pressures of parts, and of accelerations, so that w a grows by ``lacks`` (k,).

    Levels c add sum c M^-1 w, in a new vector; zero where held. Collective.
    """
    matrix, solver = _mass(operators, loads)
    gives, (push, moved) = np.zeros((len(parts), len(parts))), (operators.layout.solid_vector() for _ in range(2))
    for row in range(len(parts)):
        _push(operators, loads, parts[row : row + 1], np.ones(1), push)
        solver.solve(push, moved)
        gives[:, row] = [other.walls.dot(moved) for other in parts]
    added: Floats = np.linalg.lstsq(gives, lacks, rcond=None)[0]
    _push(operators, loads, parts, added, push)
    solver.solve(push, moved)
    destroy(push, solver, matrix)
    return added, moved


def _push(
    operators: Operators, loads: Loads, parts: Sequence[EnclosedComponent], levels: Floats, result: PETSc.Vec
) -> None:
    """``result`` = sum c w, zero where held, for levels c (k,); where masses were moved inward, forces on these. Collective."""
    result.set(0.0)
    for part, level in zip(parts, levels, strict=True):
        part.walls.add_to(result, level)
    if operators.inward is not None:
        outer = result.copy()
        operators.inward.multTranspose(outer, result)
        outer.destroy()
    loads.release(result)


def _mass(operators: Operators, loads: Loads) -> tuple[PETSc.Mat, PETSc.KSP]:
    """The mass matrix with what is held left out, and its solver; the caller destroys both. Collective."""
    matrix = with_diagonal(operators.mass)
    if operators.inward is not None:
        _bind(matrix, operators.inward)
    matrix.zeroRowsColumns(petsc_ints(matrix.getOwnershipRange()[0] + loads.held), 1.0)
    return matrix, solver_of(matrix, "mass_")


def _bind(mass: PETSc.Mat, inward: PETSc.Mat) -> None:
    """Add (1 - P)' S (1 - P) to M, which keeps accelerations without mass at P a; S masses of nodes nearby. Collective."""
    diagonal, sizes, apart = mass.getDiagonal(), entry_sizes(inward), inward.copy()
    near = diagonal.duplicate()
    sizes.mult(diagonal, near)
    near.sqrtabs()
    apart.scale(-1.0)
    apart.shift(1.0)
    apart.diagonalScale(near)
    square = apart.transposeMatMult(apart)
    mass.axpy(1.0, square, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
    destroy(diagonal, near, sizes, apart, square)


def with_diagonal(matrix: PETSc.Mat) -> PETSc.Mat:
    """A copy with an entry on every diagonal: unknowns that no node has, where nodes are tied, have none. Collective."""
    zeros = create_matrix(matrix.getSizes(), 1, matrix.getComm())
    first, last = zeros.getOwnershipRange()
    rows = np.arange(first, last, dtype=PETSc.IntType)
    zeros.setValuesIJV(np.arange(len(rows) + 1, dtype=PETSc.IntType), rows, np.zeros(len(rows)))
    zeros.assemble()
    copy = matrix.copy()
    copy.axpy(1.0, zeros, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
    zeros.destroy()
    return copy
