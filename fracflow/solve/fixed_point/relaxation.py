"""How the pressures go on from cycle to cycle of (4.5): pure rules on what was tried and what a plain cycle would add.

The error of a plain cycle is multiplied by a matrix whose eigenvalues lie between -rho and 0. So a share of 2 / (2 + rho) of
what it would add always converges; Aitken and Anderson find better shares from what the cycles have shown.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Together = Callable[[Floats], Floats]
"""Adds up over all ranks."""

DEPTH = 5  # cycles that Anderson's rule looks back
PARALLEL = 1e-8  # of a column's own length: what is left of it beside the others says nothing


@dataclass(frozen=True)
class Cycles:
    """The last cycles of a step.

    factor   rho, by which a plain cycle is predicted to multiply the error
    tried    pressures (n,) of this rank from which the last cycles started
    added    what a plain cycle would have added to each (n,)
    share    share of it that was taken last; 0 before the first cycle
    """

    factor: float
    tried: tuple[Floats, ...] = field(default=())
    added: tuple[Floats, ...] = field(default=())
    share: float = 0.0

    def then(self, tried: Floats, added: Floats) -> Cycles:
        """One cycle more, from ``tried`` (n,) with the change ``added`` (n,); the oldest is forgotten."""
        keep = slice(-DEPTH, None)
        return Cycles(self.factor, (*self.tried[keep], tried), (*self.added[keep], added), self.share)

    def taking(self, share: float) -> Cycles:
        """The same with the share that was taken."""
        return Cycles(self.factor, self.tried, self.added, share)

    @property
    def safe_share(self) -> float:
        """2 / (2 + rho): halves of the worst and the best mode's errors."""
        return 2.0 / (2.0 + self.factor) if np.isfinite(self.factor) else 1.0


Rule = Callable[[Cycles, Together], tuple[Floats, float]]
"""(cycles, together) -> what to add to the last pressures (n,), and the share that this is."""


def plain(cycles: Cycles, together: Together) -> tuple[Floats, float]:
    """(4.5) The whole change (n,) of a plain cycle."""
    return cycles.added[-1], 1.0


def aitken(cycles: Cycles, together: Together) -> tuple[Floats, float]:
    """The share of the change (n,) that would have left least of the last one, had it been taken then; at most all."""
    share = cycles.safe_share
    if cycles.share > 0.0 and len(cycles.added) > 1:
        old, new = cycles.added[-2:]
        turn = new - old
        along, size = together(np.array([old @ turn, turn @ turn]))
        share = min(abs(cycles.share * along / size), 1.0) if size > 0.0 else cycles.share
    return share * cycles.added[-1], share


def anderson(cycles: Cycles, together: Together) -> tuple[Floats, float]:
    """The combination of the last cycles that leaves least change, and a safe share of that: a change (n,)."""
    share, added = cycles.safe_share, cycles.added[-1]
    if len(cycles.added) < 2:
        return share * added, share
    columns = [new - old for old, new in zip(cycles.added, cycles.added[1:], strict=False)]
    moves = [new - old for old, new in zip(cycles.tried, cycles.tried[1:], strict=False)]
    weights = least_squares(columns, added, together)
    step = share * added
    for weight, column, move in zip(weights, columns, moves, strict=True):
        step = step - weight * (move + share * column)
    return step, share


def least_squares(columns: list[Floats], target: Floats, together: Together) -> Floats:
    """Weights (m,) of columns (n,), spread over ranks, that leave least of ``target``; 0 for those others make up.

    Newest first, so that an old column gives way to a new one.
    """
    count, basis = len(columns), list[Floats]()
    upper, right, used = np.zeros((count, count)), np.zeros(count), []
    for index in reversed(range(count)):
        rest, length = columns[index], float(np.sqrt(together(np.array([columns[index] @ columns[index]]))[0]))
        row = np.zeros(len(basis))
        for _ in range(2):  # twice is enough for orthogonality
            overlap = together(np.array([q @ rest for q in basis])) if basis else np.zeros(0)
            row = row + overlap
            rest = rest - sum((w * q for w, q in zip(overlap, basis, strict=True)), np.zeros(len(rest)))
        left = float(np.sqrt(together(np.array([rest @ rest]))[0]))
        if not left > PARALLEL * length:
            continue
        upper[: len(basis), len(basis)] = row
        upper[len(basis), len(basis)] = left
        basis.append(rest / left)
        right[len(basis) - 1] = together(np.array([basis[-1] @ target]))[0]
        used.append(index)
    weights, size = np.zeros(count), len(used)
    if size:
        weights[used] = np.linalg.solve(upper[:size, :size], right[:size])
    return weights


RELAXATIONS: dict[str, Rule] = {"plain": plain, "aitken": aitken, "anderson": anderson, "added-storage": plain}
"""method.fixed_point -> rule; added storage changes the flow's equation instead (``contraction.added_storage``)."""
