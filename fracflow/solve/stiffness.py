"""The stiffness by which an iteration corrects: (4.7) Newton, (4.10) modified Newton, and the secant method of 5.1.

Each is exact where joints behave linearly; they differ in the moduli of the joints, and in how long they keep them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fracflow.mesh.data import Floats
from fracflow.model.operators import Scales
from fracflow.solve.problem import StepProblem

SOFT = 1e-6  # of the natural stiffness: it holds a loose block on its way to the next contact


@dataclass(frozen=True)
class NewtonReport:
    """Iterations of Newton and of the Krylov solvers inside, refills of the Jacobian, and (4.9a) from the start on."""

    newton: int
    krylov: int
    fills: int
    out_of_balance: tuple[float, ...]


class SingularMatrix(Exception):
    """A matrix that a method without the tangent may come to."""


@dataclass(frozen=True)
class Stiffness:
    """How an iteration makes its matrix.

    moduli     moduli (s, dim, dim) of this rank's joint sections at the trial of a problem [stress/length]
    is_kept    the matrix of a step's first iteration serves for the whole step
    weakness   why it may fail where joints have slipped; empty if it does not
    """

    moduli: Callable[[StepProblem], Floats]
    is_kept: bool = False
    weakness: str = ""


def tangent_moduli(problem: StepProblem) -> Floats:
    """(2.22) d f / d eps (s, dim, dim) of the laws' response."""
    return problem.sections.tangent


def secant_moduli(problem: StepProblem) -> Floats:
    """(f - f_0) / eps (s, dim, dim), component by component, from the initial state to here; the tangent at eps = 0.

    Back at eps = 0 with plastic slip there is no secant: it is as steep there as round-off of eps lets it be.
    """
    joints, sections = problem.operators.joints, problem.recorded()
    strain, tangent = sections.strain, np.diagonal(sections.tangent, axis1=1, axis2=2)
    least = np.where(strain < 0.0, -1.0, 1.0) * np.maximum(np.abs(strain), sections.blur)
    moved = least != 0.0
    slope = np.where(moved, (sections.traction - joints.initial) / np.where(moved, least, 1.0), tangent)
    return np.asarray(slope[:, :, None] * np.eye(joints.dim))


def softly_held(moduli: Floats, scales: Scales) -> Floats:
    """Moduli (s, dim, dim) with a trace of stiffness where a joint has none: a loose block moves to its next contact."""
    soft = SOFT * scales.force / (scales.displacement * scales.length)
    return moduli + soft * ~np.any(moduli != 0.0, axis=1)[:, :, None] * np.eye(moduli.shape[1])


NEWTON_METHODS = {
    "newton": Stiffness(tangent_moduli),
    "modified": Stiffness(
        tangent_moduli,
        is_kept=True,
        weakness="it keeps the stiffness of the step's start, which is not that of joints that stop sliding",
    ),
    "secant": Stiffness(secant_moduli, weakness="it has no plastic slip in it, so joints that unload do not converge"),
}
