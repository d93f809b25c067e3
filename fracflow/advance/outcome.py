"""From one state to the next: the protocol of every way to advance, and its outcome."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from fracflow.model.state import State, StepReport
from fracflow.solve.request import StepRequest

Log = Callable[[str], None]


@dataclass(frozen=True)
class Outcome:
    """End and cost of an advance.

    reached   fraction of the stage's step, less than requested where it ended at an event or jump
    error     estimated, over the allowed one [1]; 0 without an estimate
    foreseen  it ended early because something prescribed jumps or bends there, which is no event
    length    of the substep of a stage's step that was advanced [time]
    """

    state: State
    report: StepReport
    reached: float = 1.0
    error: float = 0.0
    foreseen: bool = False
    length: float = 0.0


class Advance(Protocol):
    """A way from one state to the next: a single step, or a wrapper of another way.

    ``Substepped``, ``SplitAtJumps``, ``ErrorControlled``, ``StableSlip`` and ``EventLocated`` wrap one, down to the
    ``SingleStep`` or ``ExplicitSubsteps``. A stage puts together the ones that it needs.
    """

    def advance(self, state: State, request: StepRequest) -> Outcome:
        """The state that a request leads to; the one it begins from stays as it is.

        Raises SolveError, on every rank, and leaves no trace then. Collective.
        """
        ...
