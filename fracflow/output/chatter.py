"""Whether contact chatters: fracture nodes that open and close from step to step, which no wave does that the steps resolve."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

STEPS = 20  # of a stage that are looked at together
CHANGES = 6  # of a node within them: resolved, it would not have parted and met three times


class Chatter:
    """Counts how often each of the nodes, given by the names of their fractures, opens and closes; one report a stage."""

    def __init__(self, fractures: Sequence[str]) -> None:
        self._fractures = list(fractures)
        self._stage, self._told = -1, False
        self._before: NDArray[np.bool_] | None = None
        self._changes: deque[NDArray[np.bool_]] = deque(maxlen=STEPS)

    def update(self, stage: int, is_open: NDArray[np.bool_]) -> str:
        """Count a step of a stage with the nodes (n,) that are open at its end; what is to be told, mostly nothing."""
        if stage != self._stage:
            self._stage, self._told = stage, False
            self._changes.clear()
        if self._before is not None:
            self._changes.append(is_open != self._before)
        self._before = is_open.copy()
        if self._told or not len(is_open) or not self._changes:
            return ""
        counts = np.sum(np.array(self._changes), axis=0)
        worst = int(np.argmax(counts))
        if counts[worst] < CHANGES:
            return ""
        self._told = True
        return (
            f"contact opened and closed {counts[worst]} times in {len(self._changes)} steps on {self._fractures[worst]}"
        )
