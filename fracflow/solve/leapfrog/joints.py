"""Joints at the end of an explicit step without a fluid, cluster by cluster.

They solve e = e_free - S G M^-1 G' W (f(e) - f_old).
As in ``sections``, with fewer evaluations of the laws. The first trial is that of ``guess``, which the laws mostly confirm.
Else it follows from the tangents of the last step. Laws may change statuses at each trial; while none does, their answer is
also that of the statuses held.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracflow._petsc import MPI
from fracflow.errors import NotConverged
from fracflow.laws import LawStep
from fracflow.mesh.data import Floats
from fracflow.model.operators import Operators
from fracflow.model.state import Sections
from fracflow.solve.clusters import Clusters
from fracflow.solve.failure import fractures_of
from fracflow.solve.leapfrog.guess import JointGuess, joint_guess
from fracflow.solve.newton import MOST_CHANGES
from fracflow.solve.residual import over_ranks
from fracflow.solve.sections import MOTION_ROUND_OFF, TIGHT
from fracflow.solve.statuses import Statuses


class Solved(NamedTuple):
    """Sections in balance, iterations to there, what is left of motions over the largest, and whether a guess was refused."""

    sections: Sections
    iterations: int
    left: float
    is_refused: bool = False


class JointSolver:
    """Newton's method over all clusters of sections at once."""

    def __init__(self, operators: Operators, clusters: Clusters, most: int) -> None:
        """Keep what is constant; ``most`` iterations while no section changes its status."""
        self.operators, self.clusters, self.most = operators, clusters, most
        self.guess = joint_guess(operators, clusters, most)
        self._is_alone, self._share = operators.layout.comm.size == 1, np.nan
        self._weights = operators.joints.weights[:, None]

    def _scale(self, share: float) -> None:
        if share != self._share:
            self._share = share
            self._compliances = [share * batch.compliance for batch in self.clusters.batches]
            self._sizes = [np.abs(each) for each in self._compliances]

    def solve(self, before: Sections, free: Floats, share: float, step: LawStep) -> Solved:
        """The sections after a step from ``before``, by their motion (s, dim) under its tractions.

        share  S of ``integrators.explicit``; ``step.hold`` keeps all statuses
        Raises NotConverged, on every rank. Collective.
        """
        self._scale(share)
        guesses = self.guess is not None and not step.hold
        guessed = self._confirmed(self.guess, before, free, share, step) if self.guess is not None and guesses else None
        if guessed is not None:
            return guessed
        joints, comm, held = (
            self.operators.joints,
            self.operators.layout.comm,
            LawStep(step.time, step.dt, step.inertia, True),
        )
        statuses, change = Statuses.of(before), np.zeros_like(free)
        left, moduli = free, self._weights[:, :, None] * before.tangent
        rounds = since = total = 0
        while since <= self.most:
            total, since = total + 1, since + 1
            correction = self._correction(left, moduli)
            limit = joints.step_limit(before.strain + change, correction, before)
            change = change + (limit if self._is_alone else comm.allreduce(limit, op=MPI.MIN)) * correction
            found = joints.evaluate(before.strain + change, statuses.history, step)
            answer = found
            if not step.hold and joints.have_changed(statuses.history, found.history).any():
                answer = joints.evaluate(before.strain + change, statuses.history, held)
            next_ones, changed = statuses.after(joints, before.history, answer, found)
            left, moduli, size = self._balance(before, free, change, answer)
            beyond = np.abs(left) - MOTION_ROUND_OFF * size
            here = [float(each.max(initial=0.0)) for each in (np.abs(change), beyond, np.abs(left))]
            finite = np.isfinite(answer.traction).all()
            moved, most, worst, is_bad, changes = over_ranks([*here, float(not finite), float(changed.any())], comm)
            if is_bad:
                break
            if most > TIGHT * moved:
                continue
            if not changes or step.hold:
                return Solved(answer, total, worst / moved if moved > 0.0 else 0.0, guesses)
            rounds, since = rounds + 1, 0
            if rounds == MOST_CHANGES:
                where = fractures_of(self.operators.blocks, changed) or "the network"
                raise NotConverged(
                    f"time {step.time:.6g}: {where} keeps changing between sticking and sliding within one"
                    " explicit step: take a smaller time_step",
                    kind="statuses",
                )
            statuses = next_ones
            answer = joints.evaluate(before.strain + change, statuses.history, held)
            left, moduli, _ = self._balance(before, free, change, answer)
        where = fractures_of(self.operators.blocks, (beyond > TIGHT * moved).any(axis=1)) or "the network"
        raise NotConverged(
            f"time {step.time:.6g}: {where} found no balance of joints in"
            f" {self.most} iterations of an explicit step (motion of sections out by {worst:.1e}): take a smaller time_step",
            kind="sections",
        )

    def _confirmed(
        self, guess: JointGuess, before: Sections, free: Floats, share: float, step: LawStep
    ) -> Solved | None:
        """The sections at a guess; None where the laws find no balance there or change a status. Collective.

        Tractions that are those of the guess, to the bit, are in balance as it found them.
        """
        joints, trial = self.operators.joints, guess.solve(before, free, share)
        answer, is_bad, is_same, comm = trial.answer, trial.iterations < 0, True, self.operators.layout.comm
        if answer is None:
            answer = joints.evaluate(trial.strain, trial.status, step)
            is_bad |= bool(joints.have_changed(trial.status, answer.history).any())
            is_same = bool((answer.traction == trial.traction).all())
        worst, beyond = trial.worst, 0.0
        if not (is_same if comm.size == 1 else comm.allreduce(is_same, op=MPI.LAND)):
            left, _, size = self._balance(before, free, trial.change, answer)
            is_bad |= not np.isfinite(answer.traction).all()
            beyond = float((np.abs(left) - MOTION_ROUND_OFF * size).max(initial=0.0))
            worst = float(np.abs(left).max(initial=0.0))
        here = [trial.moved, worst, beyond]
        moved, worst, most, has_bad, iterations = over_ranks([*here, float(is_bad), float(trial.iterations)], comm)
        if has_bad or not most <= TIGHT * moved:
            return None
        return Solved(answer, round(iterations), worst / moved if moved > 0.0 else 0.0)

    def _balance(
        self, before: Sections, free: Floats, change: Floats, answer: Sections
    ) -> tuple[Floats, Floats, Floats]:
        """Residual (s, dim) of the motion of sections, W D (s, dim, dim), and sizes of the terms (s, dim). Collective."""
        weights = self._weights
        moduli = weights[:, :, None] * answer.tangent
        push = weights * (answer.traction - before.traction)
        known = (np.abs(moduli) @ np.abs(answer.strain)[:, :, None])[:, :, 0] + 2.0 * weights * np.abs(answer.traction)
        pulled, sizes = self._by_clusters((self._compliances, push), (self._sizes, known))
        return free - change - pulled, moduli, np.abs(free) + np.abs(change) + sizes

    def _by_clusters(self, *products: tuple[list[Floats], Floats]) -> list[Floats]:
        """Matrices of all clusters times values (s, dim) of this rank's sections, for each pair of both. Collective."""
        given = [values for _, values in products]
        if not self._is_alone:
            given = np.split(self.clusters.exchange.there(np.hstack(given)), len(products), axis=1)
        found = [np.empty(values.shape) for values in given]
        for (matrices, _), values, result in zip(products, given, found, strict=True):
            for batch, matrix in zip(self.clusters.batches, matrices, strict=True):
                rows = values[batch.sections].reshape(len(batch.sections), -1, 1)
                result[batch.sections] = (matrix @ rows).reshape(*batch.sections.shape, values.shape[1])
        if not self._is_alone:
            found = np.split(self.clusters.exchange.back(np.hstack(found)), len(products), axis=1)
        return found

    def _correction(self, left: Floats, moduli: Floats) -> Floats:
        """Newton's correction (s, dim) of the motion of sections: (1 + S G M^-1 G' W D)^-1 of what is left. Collective."""
        count, dim = left.shape
        there, stiff = left, moduli
        if not self._is_alone:
            rows = self.clusters.exchange.there(np.hstack([left, moduli.reshape(count, dim**2)]))
            there, stiff = rows[:, :dim], rows[:, dim:].reshape(-1, dim, dim)
        result = np.empty_like(there)
        for batch, matrix in zip(self.clusters.batches, self._compliances, strict=True):
            number, members = batch.sections.shape
            columns = matrix.reshape(number, members * dim, members, dim).transpose(0, 2, 1, 3)
            tangent = (columns @ stiff[batch.sections]).transpose(0, 2, 1, 3).reshape(number, members * dim, -1)
            tangent[:, np.arange(members * dim), np.arange(members * dim)] += 1.0
            answer = np.linalg.solve(tangent, there[batch.sections].reshape(number, -1, 1))
            result[batch.sections] = answer.reshape(number, members, dim)
        return result if self._is_alone else self.clusters.exchange.back(result)
