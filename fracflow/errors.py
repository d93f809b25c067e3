"""The ways a run can end badly, and those that are no failure. Every message is one line that says what would be right."""

from __future__ import annotations

import sys
from collections.abc import Mapping

LONGEST = 1500  # letters of a message
MOST_NAMED = 5  # names that a message lists


class InputError(Exception):
    """The scene, the mesh or the command line is wrong: exit code 2.

    Its message is one line, whatever names and values of the input stand in it; of one too long the middle is left out.
    """

    def __init__(self, message: str = "") -> None:
        """Say what is wrong, and what would be right."""
        line = " ".join(message.splitlines())
        super().__init__(line if len(line) <= LONGEST else f"{line[: LONGEST // 2]} ... {line[-LONGEST // 2 :]}")


class SolveError(Exception):
    """The equations of a step could not be solved: exit code 3, the last good state is on disk.

    newton  iterations of Newton's method that were spent in vain
    trials  of steps that were thrown away
    """

    def __init__(self, message: str = "", newton: int = 0, trials: int = 0) -> None:
        """Say what failed, and what was spent on it."""
        super().__init__(message)
        self.newton, self.trials = newton, trials


class NotConverged(SolveError):
    """An iteration did not converge; a shorter step may.

    kind  of the failure, where its class does not say it; the same in whichever fracture it is
    """

    def __init__(self, message: str = "", newton: int = 0, trials: int = 0, kind: str = "") -> None:
        """Say what failed, and what was spent on it."""
        super().__init__(message, newton, trials)
        self.kind = kind

    def after(self, newton: int) -> NotConverged:
        """The same failure, on which so many iterations were spent in all."""
        self.newton = newton
        return self


class StatusCycling(NotConverged):
    """Joint sections kept changing their status, whatever the linear solver; a shorter step may converge."""


class Unsolved(NotConverged):
    """A linear solve left too much."""


class ReductionInvalid(Exception):
    """Something that the plan left out may matter: the run begins anew with it. ``undone``: "part, stage" -> when and why."""

    def __init__(self, decision: str, time: float, why: str) -> None:
        """Of a decision, by what a step has shown."""
        self.undone = {decision: f"time {time:.9g}: {why}"}
        super().__init__(f"{decision}: time {time:.9g}: {why}")


class OtherRock(Exception):
    """The run goes on from its last state in the other rock: with a mesh as an event begins, without one once it is over.

    why       in words
    progress  of its stage, as ``advance.step.Progress``
    newton    iterations of Newton's method spent in vain since that state, on so many ``trials`` of steps
    """

    def __init__(self, why: str, progress: Mapping[str, float], newton: int = 0, trials: int = 0) -> None:
        """By a stage that has come so far."""
        super().__init__(why)
        self.why, self.progress, self.newton, self.trials = why, progress, newton, trials


class DiskError(Exception):
    """A file of the run folder cannot be written, or read again: exit code 3, the state that was saved last is on disk."""

    @classmethod
    def of(cls, error: OSError, where: object, remedy: str = "") -> DiskError:
        """The error of the system on a file, or of any below ``where``, and a remedy."""
        remedy = remedy or "make room, or look at the disk"
        return cls(f"{error.filename or where}: {error.strerror or error}; {remedy}")


class Interrupted(Exception):
    """The run was asked to stop; its state is saved. Exit code 130."""


def is_alone() -> bool:
    """Whether an error is on its way that other ranks may not have: this one must not wait for them then.

    Solvers are freed by all ranks together; a rank that runs out of memory would wait there for ever.
    """
    error = sys.exc_info()[1]
    return error is not None and not isinstance(error, _AGREED)


_AGREED = (InputError, SolveError, DiskError, ReductionInvalid, OtherRock, Interrupted, GeneratorExit)
