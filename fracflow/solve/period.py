"""The longest period of vibration of a scene whose joints stick: the time after which it may count as at rest."""

from __future__ import annotations

import numpy as np

from fracflow._petsc import PETSc, destroy
from fracflow.laws.base import HELD
from fracflow.mesh.data import Floats
from fracflow.model.layout import matrix_of
from fracflow.model.loads import Loads
from fracflow.model.operators import Operators
from fracflow.model.state import Sections
from fracflow.solve.initial_rates import with_diagonal
from fracflow.solve.options import solver_of

MOST_SHAPES, MOST_STARTS = 20, 10  # of a basis, and of bases
CONVERGED = 1e-7  # residual of the shape over its eigenvalue, whose own error is the square of that
SOFT = 1e-10  # of the first Rayleigh quotient: stiffness of a block that nothing else holds


def longest_period(operators: Operators, loads: Loads, sections: Sections) -> float:
    """2 pi over the lowest frequency [1/time] of K_s + G' W D G and M, D of joints that stick.

    Absorbing sides stay where they are; a fluid, which is left out, makes periods shorter. Infinite where nothing moves.
    Collective.
    """
    held, layout, joints = loads.standing().held, operators.layout, operators.joints
    sticking = joints.with_other_status(sections.strain, sections.history, sections.is_sliding)
    stiff = sprung(operators, joints.evaluate(sections.strain, sticking, HELD).tangent)
    mass = with_diagonal(operators.mass)
    numbers = (stiff.getOwnershipRange()[0] + held).astype(PETSc.IntType)
    mass.zeroRowsColumns(numbers, 0.0)
    stiff.zeroRowsColumns(numbers, 1.0)
    shape, force = layout.solid_vector(), layout.solid_vector()
    shape.set(1.0)
    shape.getArray()[held] = 0.0
    stiff.mult(shape, force)
    rigidity = shape.dot(force)
    mass.mult(shape, force)
    inertia = shape.dot(force)
    if inertia > 0.0:
        stiff.axpy(SOFT * rigidity / inertia, mass)
        force.scale(1.0 / inertia)
        pull = force.duplicate()  # slip of all joints, so that no mode that joints take part in is missed
        pull.set(0.0)
        joints.force(np.ones_like(joints.initial), pull)
        pull.getArray()[held] = 0.0
        force.axpy(force.norm() / max(pull.norm(), 1e-300), pull)
        pull.destroy()
    lowest = _lowest(stiff, mass, shape, force) if inertia > 0.0 else 0.0
    destroy(stiff, mass, shape, force)
    return float(2.0 * np.pi / np.sqrt(lowest)) if lowest > 0.0 else float("inf")


def sprung(operators: Operators, moduli: np.ndarray) -> PETSc.Mat:
    """K_s + G' W D G with D (s, dim, dim) of this rank's sections, in a new matrix. Collective."""
    joints, dim = operators.joints, operators.blocks.sizes.dim
    moduli = joints.weights[:, None, None] * moduli
    count = len(moduli) * dim
    first = joints.jump.getOwnershipRange()[0]
    columns = first + np.repeat(np.arange(count).reshape(-1, dim), dim, axis=0)
    rows = np.arange(count + 1) * dim
    local = joints.jump.getSizes()[0]
    springs = matrix_of((local, local), (rows, columns.ravel(), moduli.ravel()), joints.jump.getComm())
    product = springs.PtAP(joints.jump)
    stiff = with_diagonal(operators.stiffness)
    stiff.axpy(1.0, product, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
    destroy(springs, product)
    return stiff


def _lowest(stiff: PETSc.Mat, mass: PETSc.Mat, shape: PETSc.Vec, force: PETSc.Vec) -> float:
    """Lowest eigenvalue of K x = w M x, from a first force, by Lanczos; both vectors are used up. Collective.

    T is K^-1 M on an M-orthonormal basis (Parlett 1998, 15.11). A basis that is full begins anew with the shape it found.
    """
    solver, largest, weights = solver_of(stiff, "period_"), 0.0, np.zeros(0)
    for _ in range(MOST_STARTS):
        solver.solve(force, shape)
        basis: list[PETSc.Vec] = []
        moved: list[PETSc.Vec] = []
        diagonal, beside = np.zeros(MOST_SHAPES), np.zeros(MOST_SHAPES)
        while len(basis) < MOST_SHAPES:
            for _ in range(2 if basis else 0):  # round-off of the first pass is left to the second
                shape.maxpy([-shape.dot(each) for each in moved], basis)
            mass.mult(shape, force)
            size = np.sqrt(max(shape.dot(force), 0.0))
            if basis:
                beside[len(basis) - 1] = size
                values, shapes = _of_tridiagonal(diagonal, beside, len(basis))
                largest, weights = values[-1], shapes[:, -1]
                if size * abs(weights[-1]) <= CONVERGED * largest:
                    break
            elif size == 0.0:
                break
            basis.append(shape.copy())
            moved.append(force.copy())
            basis[-1].scale(1.0 / size)
            moved[-1].scale(1.0 / size)
            solver.solve(moved[-1], shape)
            diagonal[len(basis) - 1] = shape.dot(moved[-1])
        is_found = len(basis) < MOST_SHAPES
        if not is_found:
            force.set(0.0)
            force.maxpy(weights, moved[:-1])
        destroy(*basis, *moved)
        if is_found:
            break
    solver.destroy()
    return float(1.0 / largest) if largest > 0.0 else 0.0


def _of_tridiagonal(diagonal: Floats, beside: Floats, count: int) -> tuple[Floats, Floats]:
    """Eigenvalues, ascending, and eigenvectors of the first ``count`` rows."""
    values, shapes = np.linalg.eigh(np.diag(diagonal[:count]) + np.diag(beside[: count - 1], -1))
    return values, shapes
