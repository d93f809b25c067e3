"""The linear solver of Newton's method: its splits, its convergence test, and factors kept through a step.

Kept factors precondition FGMRES on the present matrix. Joints that change are few beside the rock, and a change of low rank
costs at most about so many iterations (Saad 2003, 6.11). The solution of Newton's method is the same. A step begins with
factors of its own, so that it does not depend on which steps this process has made before.
"""

from __future__ import annotations

from contextlib import AbstractContextManager
from typing import Any, Protocol

import numpy as np

from fracflow._petsc import PETSc, destroy, precondition_by
from fracflow.errors import Unsolved
from fracflow.integrators import Alphas
from fracflow.mesh.data import Ints
from fracflow.model.layout import Layout
from fracflow.model.operators import Operators
from fracflow.scene.scene import Scene
from fracflow.solve.condensed_cost import USUAL, solves_per_factor
from fracflow.solve.factors.free_block import factor_by_lapack, is_full
from fracflow.solve.factors.unpivoted import Unpivoted
from fracflow.solve.fractured_rock import FracturedRock, parts_of
from fracflow.solve.fractured_rock.rigid_motions import node_size, tell_rigid_motions
from fracflow.solve.jacobian import PARTS, JoinedMatrix
from fracflow.solve.options import factors_are_meant
from fracflow.solve.residual import over_ranks

STANDS = 10  # iterations in which a residual that still falls becomes less than half
BROKEN = 76  # PETSC_ERR_LIB: an external library reported an error
SOLVE_ROUND_OFF = 1e-6  # of the right side: a residual that stands still below is taken for round-off
REFINED = 1e-8  # above it a direct solve is refined
UNSOLVED = 1e-3  # above it there is no solution, but for rows of unlike size
NEARLY = 1e12  # |A| |x| / |b| from which on a matrix is called singular
NO_MEMORY, NO_PIVOT = (-5, -7, -8, -9, -11, -12, -13, -14, -15, -17, -18, -19, -20), (-6, -10)  # of MUMPS's INFOG(1)
UNSETTLED = 0.1  # of the solution: a refinement that changes it by less leaves Newton's method a step that serves


class KrylovTest:
    """As PETSc's own test, but also converged where the residual stagnates: Newton's next iterate is tested anyway.

    In an undrained fracture that conducts far more than its walls store, the pressure level has no more digits than that.
    """

    def __init__(self) -> None:
        """Nothing seen yet."""
        self._norms: list[float] = []
        self._given = 0.0

    def __call__(self, solver: PETSc.KSP, iteration: int, norm: float) -> PETSc.KSP.ConvergedReason | None:
        """The reason to stop after an iteration with this residual; None to go on."""
        reasons, (relative, absolute, divergence, most) = PETSc.KSP.ConvergedReason, solver.getTolerances()
        if iteration == 0:  # a first guess may leave far less than the right side, whose round-off it has, or far more
            is_plain = solver.getNormType() == PETSc.KSP.NormType.UNPRECONDITIONED
            self._norms, self._given = [], solver.getRhs().norm() if is_plain else norm
        self._norms.append(norm)
        first = self._norms[0]
        if norm != norm or norm > divergence * first:
            return reasons.DIVERGED_NANORINF if norm != norm else reasons.DIVERGED_DTOL
        if norm <= absolute:
            return reasons.CONVERGED_ATOL
        is_small = norm <= SOLVE_ROUND_OFF * max(first, self._given)
        stands = iteration >= STANDS and is_small and norm > 0.5 * self._norms[iteration - STANDS]
        if norm <= relative * min(first, self._given) or stands:
            return reasons.CONVERGED_RTOL
        return reasons.DIVERGED_MAX_IT if iteration >= most else None


def true_residual(matrix: PETSc.Mat, solution: PETSc.Vec, given: PETSc.Vec) -> tuple[float, PETSc.Vec]:
    """|A x - b| / |b|, largest entries, and A x - b, which the caller destroys. Collective."""
    left = given.duplicate()
    matrix.mult(solution, left)
    left.axpy(-1.0, given)
    size = given.norm(PETSc.NormType.INFINITY)
    return (left.norm(PETSc.NormType.INFINITY) / size if size > 0.0 else 0.0), left


def solves_both(solver: PETSc.KSP, given: PETSc.Vec, middle: int) -> bool:
    """Whether a solver, as it was last set up, leaves little of each of the two balances in ``given``. Collective.

    middle  unknowns of this rank before those of the flow
    """
    solution = given.duplicate()
    solver.solve(given, solution)
    _, left = true_residual(solver.getOperators()[0], solution, given)
    parts = [part for each in (left, given) for part in np.split(np.abs(each.getArray(readonly=True)), [middle])]
    destroy(solution, left)
    here = [float(np.where(np.isfinite(part), part, np.inf).max(initial=0.0)) for part in parts]
    left_solid, left_flow, solid, flow = over_ranks(here, given.getComm().tompi4py())
    return left_solid <= UNSOLVED * solid and left_flow <= UNSOLVED * flow


def check_solution(solver: PETSc.KSP, solution: PETSc.Vec, given: PETSc.Vec, what: str) -> None:
    """Refine a direct solution with a large residual, and raise Unsolved, on every rank, where there is none. Collective.

    Rows of tight joints are small beside others. Round-off in the others may then leave more than the right side, while the
    solution has many digits. A solution that a refinement hardly changes is therefore one, too.
    """
    matrix, is_direct = solver.getOperators()[0], solver.getType() == "preonly"
    relative, left = true_residual(matrix, solution, given)
    moves = np.inf
    if (is_direct and REFINED < relative < 1.0) or UNSOLVED < relative < np.inf:
        correction, size = solution.duplicate(), solution.norm(PETSc.NormType.INFINITY)
        solve = solver.getPC().apply if solver.getPC().getType() == "lu" else solver.solve
        solve(left, correction)
        if size > 0.0:
            moves = correction.norm(PETSc.NormType.INFINITY) / size
        correction.aypx(-1.0, solution)
        better, other = true_residual(matrix, correction, given)
        if better < relative:
            correction.copy(solution)
            relative = better
        destroy(other, correction)
    left.destroy()
    if not (relative <= UNSOLVED or moves <= UNSETTLED):
        raise Unsolved(
            f"{what}: the {'direct' if is_direct else solver.getType()} solve left |Ax - b| = {relative:.1e} |b|, the limit is"
            f" {UNSOLVED:g}: {_why_unsolved(solver, solution, given)}"
        )


def _why_unsolved(solver: PETSc.KSP, solution: PETSc.Vec, given: PETSc.Vec) -> str:
    """Why a solve failed, in words: a matrix is called singular only where a direct solve shows it. Collective.

    LU with pivots is backward stable. It loses all digits only where |A| |x| / |b|, which is at most the condition number of A,
    comes near the inverse of round-off.
    """
    if solver.getPC().getType() not in ("lu", "cholesky") and solver.getType() != "preonly":
        by = {"python": "multigrid"}.get(kind := solver.getPC().getType(), kind)
        return f"{solver.getIterationNumber()} iterations preconditioned by {by} do not suffice"
    code = _mumps_code(solver)
    if code in NO_MEMORY:
        return f"MUMPS found no memory for its factors (INFOG(1) = {code})"
    norm, size = PETSc.NormType.INFINITY, given.norm(PETSc.NormType.INFINITY)
    grown = solver.getOperators()[1].norm(norm) * solution.norm(norm) / size if size > 0.0 else 0.0
    if code in NO_PIVOT or not grown < NEARLY:
        return "the matrix is singular, or nearly so"
    said = f" (INFOG(1) = {code})" if code else ""
    return f"its factors have lost their digits{said}, while |A| |x| / |b| = {grown:.1e} shows no singular matrix"


def _mumps_code(solver: PETSc.KSP) -> int:
    """INFOG(1) of the last factorisation by MUMPS, 0 of another. Collective."""
    pc = solver.getPC()
    return int(pc.getFactorMatrix().getMumpsInfog(1)) if pc.getFactorSolverType() == "mumps" else 0


class System(Protocol):
    """A matrix that is filled again and again, with its unknowns."""

    matrix: PETSc.Mat

    def standing(self) -> AbstractContextManager[PETSc.Mat]:
        """The matrix without the joints, as long as that is needed; ``matrix`` may be that meanwhile. Collective."""

    @property
    def stood(self) -> Any:
        """By which that was filled: it is the same where this is."""

    @property
    def operators(self) -> Operators:
        """Those it is made of."""

    @property
    def layout(self) -> Layout:
        """Its unknowns."""

    @property
    def fixed(self) -> Ints:
        """Numbers (n,) of those held: all of this rank, and of others those in its rows and at its joints."""

    @property
    def alphas(self) -> Alphas | None:
        """Those of the last filling."""


def set_up(solver: PETSc.KSP, matrix: System) -> None:
    """Give a solver whose options are read the splits of the matrix, and the test above if it iterates. Collective."""
    if solver.getType() != "preonly":
        solver.setConvergenceTest(KrylovTest())
    if solver.getPC().getType() == "shell":
        operators = matrix.operators
        parts = parts_of(operators.blocks, matrix.layout, operators.scales.length, matrix.fixed)
        prefix = (solver.getOptionsPrefix() or "").removesuffix("_")
        precondition_by(solver, FracturedRock(parts, matrix, prefix, node_size(operators)))
    if solver.getPC().getType() == "fieldsplit":
        solid, flow = matrix.layout.index_sets()
        tell_rigid_motions(matrix.operators, solid)
        solver.getPC().setFieldSplitIS(*zip(PARTS, (solid, flow), strict=True))
        destroy(solid, flow)


def renew(solver: PETSc.KSP, matrix: JoinedMatrix) -> None:
    """Give a solver that broke another preconditioner with the same options and splits. Collective.

    PETSc counts solves that have begun and not ended, and refuses a third one.
    """
    old, new = solver.getPC(), PETSc.PC().create(comm=matrix.layout.comm)
    new.setOptionsPrefix(solver.getOptionsPrefix())
    new.setOperators(*old.getOperators())
    new.setFromOptions()
    was_ours = old.getType() == "python"
    if was_ours:
        old.setType("none")  # ends its context now: PETSc may keep the solver until Python has ended
    solver.setPC(new)
    set_up(solver, matrix)
    if was_ours and new.getType() != "python":  # multigrid is set up above
        factor_by_lapack(solver, matrix)


def drop_factors(solver: PETSc.KSP) -> None:
    """Drop factors that failed, with the operators; LU alone. Collective.

    MUMPS makes no new factors once it found a matrix singular, and a solve with those ends in an error of its own.
    """
    if solver.getPC().getType() == "lu":
        solver.getPC().reset()


def solve_nonlinear(snes: PETSc.SNES, unknowns: PETSc.Vec, name: str, refusals: list[BaseException]) -> None:
    """SNES from ``unknowns`` on. Raises Unsolved where a linear solve does, or breaks, and drops its factors. Collective.

    refusals  errors, the same on every rank, that the functions of the SNES put here instead of raising them: newer
              PETSc, 3.22 say, keeps a vector locked where a function raises. One is raised here, once the SNES has ended
    """
    refusals.clear()
    try:
        try:
            snes.solve(None, unknowns)
        except PETSc.Error as error:
            if not refusals:  # newer petsc4py wrap what a function of ours has raised: 3.22 does, 3.18 does not
                refusals.append(error.__cause__ or error)
        if refusals:
            raise refusals.pop()
    except (Unsolved, PETSc.Error) as error:
        solver = snes.getKSP()
        drop_factors(solver)
        if isinstance(error, Unsolved) or error.ierr != BROKEN:
            raise
        reason = str(error).splitlines()[-1].partition("] ")[2]
        raise Unsolved(f"{name}: the linear solver broke ({solver.getPC().getType()}): {reason}") from error


LEAST_WORTH = 2.0  # solves in the time of a factorisation: below, nothing is saved
KRYLOV_ERROR = 1e-5  # of the right side: what is left there costs Newton's method next to no iteration
MOST_BY_NEAR = 100  # iterations between restarts, with factors of near entries
WORTH_BY_NEAR = 10  # of them in the time of a factorisation
LONGEST_PAUSE = 32  # changes of the matrix
LONGEST = 2 * MOST_BY_NEAR  # iterations of a solve with factors of near entries


class NewFactors:
    """The solver that the options name, set up anew for each matrix; ``factored`` is the matrix that it is set up for."""

    def __init__(self, solver: PETSc.KSP, matrix: JoinedMatrix) -> None:
        """Change nothing."""
        self.solver, self.matrix, self.factored = solver, matrix, matrix.matrix

    @property
    def made(self) -> int:
        """How often the solver was set up."""
        return self.matrix.fills

    def begin(self) -> None:
        """A step begins."""

    def changed(self, must: bool = False) -> None:
        """Take notice of a matrix that was filled."""

    def renew(self) -> None:
        """They are those of the present matrix."""

    def check(self, given: PETSc.Vec, step: PETSc.Vec) -> int:
        """Iterations of the solve that was made."""
        return int(self.solver.getIterationNumber())

    def destroy(self) -> None:
        """Nothing is owned here."""


class KeptFactors:
    """LU of the matrix as it was in an earlier iteration of the step.

    New factors are made where FGMRES has cost more than a factorisation, in one solve or by iterations beyond ``USUAL`` since
    the last factors. So the total time is at most about twice the optimum. They are also made for a while after they served in
    no solve, for twice as many changes each time.
    """

    def __init__(self, solver: PETSc.KSP, matrix: JoinedMatrix) -> None:
        """Make FGMRES of a solver that is LU alone. Collective."""
        self.solver, self.matrix, self.made = solver, matrix, 0
        self.factored = matrix.matrix.duplicate()
        self._worth = solves_per_factor(matrix.layout.total, _is_by_umfpack(solver))
        self._most = max(int(self._worth), 2 * USUAL)
        self._fills = -1  # of the matrix, when it was factored
        self._unpivoted = Unpivoted(solver, matrix.layout.total)
        self.begin()
        solver.setType("fgmres")
        solver.setGMRESRestart(self._most)
        solver.setTolerances(rtol=KRYLOV_ERROR, max_it=self._most)

    def begin(self) -> None:
        """A step begins: factors of the step before are dropped."""
        self._spent, self._is_fresh, self._is_first = 0.0, False, True
        self._pause = self._wait = 0
        self._unpivoted.begin()

    def changed(self, must: bool = False) -> None:
        """Take notice of a matrix that was filled. Collective.

        must  the old factors are not to serve
        """
        is_other, is_first = self._fills != self.matrix.fills, self._is_first
        self._is_first = False
        if is_other and (must or is_first or self._spent > self._worth or self._wait > 0):
            self._wait = max(self._wait - 1, 0)
            self.renew()

    def renew(self) -> None:
        """Factors of the present matrix. Collective."""
        self.matrix.matrix.copy(self.factored, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        self.made, self._fills, self._spent, self._is_fresh = self.made + 1, self.matrix.fills, 0.0, True
        self._unpivoted.factor(self.factored)

    def check(self, given: PETSc.Vec, step: PETSc.Vec) -> int:
        """Iterations of the solve that was made; it is repeated with new factors where it did not converge. Collective."""
        taken = int(self.solver.getIterationNumber())
        if not self._is_fresh:
            serves = self.solver.getConvergedReason() > 0
            self._pause = 0 if serves else min(max(2 * self._pause, 1), LONGEST_PAUSE)
            self._wait = self._pause
            if not serves:
                self.renew()
                self.solver.solve(given, step)
                taken += int(self.solver.getIterationNumber())
            else:
                self._spent += max(taken - USUAL, 0)
        if self.solver.getConvergedReason() <= 0 and self.solver.getResidualNorm() > UNSOLVED * given.norm():
            # FGMRES fits the round-off of stiff rows where it exceeds the right side
            self.solver.getPC().apply(given, step)
            taken += 1
        self._is_fresh = False
        return taken

    def destroy(self) -> None:
        """Free the copy. Collective."""
        self.factored.destroy()


class NearFactors:
    """LU of the entries that the matrix has, which preconditions GMRES on all of it.

    Far walls are left out of the entries, and feel long waves of slip alone. A step begins with factors of its own. New ones
    are made where a solve takes so many more iterations than the quickest one with new factors that a factorisation costs less.

    GMRES is preconditioned from the left. Its residual is about the error of the solution, since the product of both matrices
    is near 1. That of the balances would not do: where no pressure drains a part, the rate pumped into it is 1e-11 of the
    forces on its walls. Round-off of these is more.
    """

    def __init__(self, solver: PETSc.KSP, matrix: JoinedMatrix) -> None:
        """Make GMRES of a solver that is LU alone. Collective."""
        self.solver, self.matrix, self.made = solver, matrix, 0
        self.factored = matrix.matrix.duplicate()
        self._fills = -1
        self.begin()
        solver.setType("gmres")
        solver.setPCSide(PETSc.PC.Side.LEFT)
        solver.setNormType(PETSc.KSP.NormType.PRECONDITIONED)
        solver.setGMRESRestart(MOST_BY_NEAR)
        solver.setTolerances(rtol=KRYLOV_ERROR, max_it=LONGEST)
        solver.setConvergenceTest(KrylovTest())

    def begin(self) -> None:
        """A step begins: factors of the step before are dropped."""
        self._least, self._is_fresh, self._is_worn = LONGEST, False, True

    def changed(self, must: bool = False) -> None:
        """Take notice of a matrix that was filled. Collective."""
        if self._fills != self.matrix.fills and (must or self._is_worn):
            self.renew()

    def renew(self) -> None:
        """Factors of the present matrix. Collective."""
        self.matrix.matrix.copy(self.factored, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        self.made, self._fills, self._is_worn, self._is_fresh = self.made + 1, self.matrix.fills, False, True

    def check(self, given: PETSc.Vec, step: PETSc.Vec) -> int:
        """Iterations of the solve that was made; it is repeated with new factors where it did not converge. Collective."""
        taken = int(self.solver.getIterationNumber())
        if self.solver.getConvergedReason() <= 0 and self._fills != self.matrix.fills:
            self.renew()
            self.solver.solve(given, step)
            taken += int(self.solver.getIterationNumber())
        if self._is_fresh:
            self._least, self._is_fresh = min(self._least, taken), False
        self._is_worn = taken > self._least + WORTH_BY_NEAR
        return taken

    def destroy(self) -> None:
        """Free the copy. Collective."""
        self.factored.destroy()


Factors = NewFactors | KeptFactors | NearFactors


def are_kept(scene: Scene, unknowns: int, swift: bool = False) -> bool:
    """Whether factors of so many unknowns are kept: the scene allows it, and a factorisation costs several solves.

    swift  they are those of UMFPACK
    """
    return scene.method.factors == "kept" and solves_per_factor(unknowns, swift) >= LEAST_WORTH


def _is_by_umfpack(solver: PETSc.KSP) -> bool:
    return bool(solver.getPC().getFactorSolverType() == "umfpack")


def factors_of(scene: Scene, solver: PETSc.KSP, matrix: JoinedMatrix) -> Factors:
    """Factors for a solver whose options are read. Collective."""
    is_direct = solver.getType() == "preonly" and solver.getPC().getType() == "lu"
    if is_direct and matrix.whole is not matrix.matrix:
        return NearFactors(solver, matrix)
    if is_direct and are_kept(scene, matrix.layout.total, _is_by_umfpack(solver)):
        return KeptFactors(solver, matrix)
    if is_direct and _suits_lapack(scene, solver, matrix):
        factor_by_lapack(solver, matrix)
    return NewFactors(solver, matrix)


def _suits_lapack(scene: Scene, solver: PETSc.KSP, matrix: JoinedMatrix) -> bool:
    """Whether unmeshed rock is solved for on one rank, and alone, where no other factorisation is asked for."""
    prefix = (solver.getOptionsPrefix() or "").removesuffix("_")
    is_alone = scene.is_unbounded and matrix.layout.comm.size == 1 and not factors_are_meant(prefix)
    return is_alone and is_full(matrix)
