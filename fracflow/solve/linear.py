"""The linear solver of Newton: its splits, and when it is done."""

from __future__ import annotations

from fracflow._petsc import PETSc
from fracflow.errors import Unsolved
from fracflow.solve.jacobian import PARTS, JoinedMatrix
from fracflow.solve.near_null import tell_rigid_motions

STANDS = 10  # iterations in which a residual that still falls becomes less than half
BROKEN = 76  # PETSC_ERR_LIB: an external library told of an error
ROUND_OFF = 1e-6  # of the right side: a residual that stands still below is taken for round-off


class KrylovTest:
    """As PETSc's own test, but done too where the residual stands still: Newton's next iterate tells what it was worth.

    A fluid that conducts far more than its walls store, in a fracture that nothing drains, leaves no more digits of its
    level than that.
    """

    def __init__(self) -> None:
        """Nothing seen yet."""
        self._norms: list[float] = []

    def __call__(self, solver: PETSc.KSP, iteration: int, norm: float) -> PETSc.KSP.ConvergedReason | None:
        """The reason to stop after an iteration with this residual; None to go on."""
        reasons, (relative, absolute, divergence, most) = PETSc.KSP.ConvergedReason, solver.getTolerances()
        if iteration == 0:
            self._norms = []
        self._norms.append(norm)
        first = self._norms[0]
        if norm != norm or norm > divergence * first:
            return reasons.DIVERGED_NANORINF if norm != norm else reasons.DIVERGED_DTOL
        if norm <= absolute:
            return reasons.CONVERGED_ATOL
        stands = iteration >= STANDS and norm <= ROUND_OFF * first and norm > 0.5 * self._norms[iteration - STANDS]
        if norm <= relative * first or stands:
            return reasons.CONVERGED_RTOL
        return reasons.DIVERGED_MAX_IT if iteration >= most else None


def set_up(solver: PETSc.KSP, matrix: JoinedMatrix) -> None:
    """Tell a solver whose options are read the splits of the matrix, and the test above if it iterates. Collective."""
    if solver.getType() != "preonly":
        solver.setConvergenceTest(KrylovTest())
    if solver.getPC().getType() == "fieldsplit":
        solid, flow = matrix.layout.index_sets()
        tell_rigid_motions(matrix.operators, solid)
        solver.getPC().setFieldSplitIS(*zip(PARTS, (solid, flow), strict=True))
        solid.destroy()
        flow.destroy()


def solve_nonlinear(snes: PETSc.SNES, unknowns: PETSc.Vec, name: str) -> None:
    """SNES from ``unknowns`` on. Raises Unsolved where a linear solve does, or breaks, and forgets its factors. Collective.

    MUMPS asked for a solution by factors that failed ends in an error of its own.
    """
    try:
        snes.solve(None, unknowns)
    except (Unsolved, PETSc.Error) as error:
        solver = snes.getKSP()
        if solver.getPC().getType() == "lu":
            solver.getPC().reset()
        if isinstance(error, Unsolved) or error.ierr != BROKEN:
            raise
        raise Unsolved(f"{name}: the linear solver broke: the matrix is singular, or nearly so") from error
