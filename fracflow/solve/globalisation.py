"""Globalisation of Newton's method: active-set cycling, and how far to go along a step.

Sections that open and close, or stick and slide, may come back to statuses they had. From then on the length of a step is
chosen by the residual, or by the energy; both are seen only through a function of the fraction.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from fracflow._petsc import MPI
from fracflow.laws.base import Bools
from fracflow.mesh.data import Floats
from fracflow.solve.problem import StepProblem

JUST_PAST = 1e-6  # relative: how far past a change of status an iteration that is stopped there ends
MOST_TURNS = 5
Statuses = NDArray[np.int8]


class StatusHistory:
    """The statuses (s, k) of this rank's sections, one column a kind, as the iteration has seen them.

    changed  (s, k) which of them changed since all were the same before, or else since the last time
    still    for how many iterations none has changed
    is_new   whether the last statuses were not seen before
    """

    def __init__(self, comm: MPI.Comm) -> None:
        """Start without statuses."""
        self.comm = comm
        self.begin()

    def begin(self) -> None:
        """Drop all statuses seen."""
        self._seen: list[Statuses] = []
        self._bytes: list[bytes] = []
        self.changed, self.still, self.is_new = np.zeros((0, 2), dtype=bool), 0, True

    def see(self, statuses: Statuses) -> bool:
        """Whether all sections of all ranks had these statuses before, and others in between. Collective."""
        now = statuses.tobytes()
        same = [now == old for old in self._bytes]
        if self.comm.size > 1:
            everywhere = np.array(same, dtype=np.int32)
            self.comm.Allreduce(MPI.IN_PLACE, everywhere, op=MPI.MIN)
            same = everywhere.astype(bool).tolist()
        self.is_new = not any(same)
        since = -1 if self.is_new else max(np.flatnonzero(same))
        self.changed = np.zeros(statuses.shape, dtype=bool)
        for old in self._seen[since:]:
            self.changed |= statuses != old
        self._seen.append(statuses)
        self._bytes.append(now)
        is_last = bool(same) and same[-1]
        self.still = self.still + 1 if is_last else 0
        return not self.is_new and not is_last


PERIODS = (2, 3)  # iterations after which Newton's method is where it was, seen where laws have a kink and status stays
SAME = 1e-3  # of a residual: two that near are one


class Repetition:
    """Residuals (n,) of the iterates of Newton's method, and whether they repeat: it takes the same steps for ever then."""

    def __init__(self, least: float) -> None:
        """Nothing seen yet; residuals below the ``least`` are alike."""
        self._least = least
        self.begin()

    def begin(self) -> None:
        """Forget all that was seen."""
        self._seen: list[list[float]] = []

    def see(self, *residuals: float) -> bool:
        """Whether those of the last period are those of the period before, and not all the same."""
        self._seen.append([max(residual, self._least) for residual in residuals])
        return any(self._has(period) for period in PERIODS)

    def _has(self, period: int) -> bool:
        if len(self._seen) < 2 * period:
            return False
        now, before = np.array(self._seen[-period:]), np.array(self._seen[-2 * period : -period])
        return bool(np.all(np.abs(now - before) <= SAME * now) and np.any(np.ptp(now, axis=0) > SAME * now.max(axis=0)))


def statuses(problem: StepProblem) -> Statuses:
    """Whether each section (s, 2) of this rank is open, and whether and which way it slides, as signs."""
    found = np.zeros((len(problem.sections.strain), 2), dtype=np.int8)
    found[:, 0] = problem.sections.is_open
    for group, past in zip(problem.operators.joints.laws, problem.trial_status, strict=True):
        for name in group.law.status:
            way = past[name] if past[name].ndim > 1 else past[name][:, None]
            found[group.sections, 1] = np.where(way[:, 0] < 0.0, -1, way.any(axis=1))
    return found


def all_changed(problem: StepProblem, last: Bools, inner: StatusHistory, outer: StatusHistory) -> tuple[Bools, Bools]:
    """Which sections (s,) of this rank changed between sticking and sliding, and within a round between open and closed.

    last  (s,) those that changed last, empty where none has
    """
    none = np.zeros((len(problem.sections.strain), 2), dtype=bool)
    within, between = (each.changed if len(each.changed) else none for each in (inner, outer))
    return within[:, 1] | between[:, 1] | (last if len(last) else none[:, 1]), within[:, 0]


class ActiveSetRounds:
    """Rounds of a step: whenever its balances hold, sections that have left their status get the next one.

    seen     the statuses with which balances held
    is_lost  statuses cycle, and no remedy has helped
    """

    def __init__(self, problem: StepProblem) -> None:
        """Before the first."""
        self.seen, self.is_lost = StatusHistory(problem.operators.layout.comm), False
        self._before, self._turns = problem.increment.getArray().copy(), 0
        self._lets = 0

    def change(self, problem: StepProblem, searches: bool) -> Bools:
        """Give the next statuses; return which sections (s,) of this rank have changed. Collective.

        searches  ``reset_cycling`` is tried where their status cycles
        """
        circles, comm = self.seen.see(statuses(problem)), self.seen.comm
        changed, here = problem.change_statuses(), problem.increment.getArray().copy()
        slides = self.seen.changed[:, 1] & (statuses(problem)[:, 1] != 0)
        if circles and comm.allreduce(bool(slides.any()), op=MPI.LOR):
            self.is_lost = not searches or self._turns == MOST_TURNS or not reset_cycling(problem, self._before, slides)
            self._turns += 1
            if not self.is_lost:
                self.seen.begin()
        self._before = here
        return changed

    def let_slide(self, problem: StepProblem, parted: Bools) -> bool:
        """Let sections that have ``parted`` (s,) and stick slide; return whether any was let. Collective.

        One that sticks keeps its shear traction to the last of its pressure, and loses it all at once as it opens: neither may
        be in balance. One that slides loses both together.
        """
        joints, before = problem.operators.joints, problem.trial_status
        chosen = parted & (statuses(problem)[:, 1] == 0) & (self._lets < MOST_TURNS)
        problem.trial_status = joints.with_other_status(problem.sections.strain, before, chosen)
        changed = joints.have_changed(before, problem.trial_status)
        self._lets += 1
        return bool(self.seen.comm.allreduce(bool(changed.any()), op=MPI.LOR))


def reset_cycling(problem: StepProblem, before: Floats, changing: Bools) -> bool:
    """Move a trial against the way that led to it from ``before``, until a section that is ``changing`` (s,) opens.

    before  what the unknowns (n,) of this rank had moved when those sections last had their other status

    Slip may change the normal traction by more than it relieves the shear, f |K_nt| / K_tt > 1. The balance with a sliding
    section then lies where it would slide the other way, so that its status cycles. One that really slides on loses its
    strength until it opens. Returns whether the trial was moved. Collective.
    """
    joints, comm = problem.operators.joints, problem.operators.layout.comm
    here = problem.increment.getArray().copy()
    change = problem.operators.layout.solid_vector()
    change.setArray(here - before)
    strains = joints.strain(change)
    change.destroy()
    now = problem.sections
    first = joints.change_at(now.strain, strains * changing[:, None], now)
    fraction = comm.allreduce(first, op=MPI.MIN) * (1.0 + JUST_PAST)
    allowed = joints.step_limit(now.strain, fraction * strains, now) if np.isfinite(fraction) else 0.0
    if comm.allreduce(allowed, op=MPI.MIN) < 1.0:
        return False
    problem.move(here + fraction * (here - before))
    return True


DECREASE = 1e-4  # share of the residual that a fraction of 1 must take away
SHORTEST = 1e-4
POWER_LEFT = 0.5  # a whole step that leaves at most this share of the power, backwards, is not shortened
POWER_SOUGHT = 0.1
NARROW = 1e-6  # of a fraction: two that near have a change of status between them
MOST_TRIALS = 60


def by_residual(size: Callable[[float], float], before: float, change: float) -> float:
    """The first fraction of 1, just past the first ``change`` of a status, 1/2, 1/4 ... that lowers the residual.

    size    fraction -> residual there, inf where the laws have no response
    before  residual at fraction 0
    change  fraction at which the first joint opens or closes, inf if none does
    """
    trials = [1.0, *([change] if change < 1.0 else []), *(0.5**n for n in range(1, 14))]
    best, lowest = 1.0, float("inf")
    for fraction in trials:
        found = size(fraction)
        if found <= (1.0 - DECREASE * fraction) * before:
            return fraction
        if found < lowest:
            best, lowest = fraction, found
    return max(best, SHORTEST)


def by_energy(power: Callable[[float], float], before: float, change: float) -> float:
    """The first fraction of 1, just past the first ``change`` of a status, that does not overshoot the lowest energy.

    Where all of them do, the fraction before at which the unbalanced forces do little work along the step.

    power   fraction -> out-of-balance force times step, positive while the energy falls
    before  power at fraction 0; not positive where the step does not lower the energy: then all of it is taken
    change  fraction at which the first joint opens or closes, inf if none does
    """
    after = power(1.0)
    if before <= 0.0 or after >= -POWER_LEFT * before:
        return 1.0
    end = 1.0
    if change < 1.0:
        end, after = change, power(change)
        if after >= -POWER_SOUGHT * before:
            return change
    low, high, at_low, at_high = 0.0, end, before, after
    for trial in range(MOST_TRIALS):
        chord = (low * at_high - high * at_low) / (at_high - at_low)
        fraction = chord if trial % 2 == 0 and low < chord < high else 0.5 * (low + high)
        here = power(fraction)
        if abs(here) <= POWER_SOUGHT * before:
            return fraction
        if here > 0.0:
            low, at_low = fraction, here
        else:
            high, at_high = fraction, here
        if high - low <= NARROW * high:
            break
    return high
