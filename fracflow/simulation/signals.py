"""Signals to a run: which one saves, which one stops it, and on what its ranks agree."""

from __future__ import annotations

import signal
import time as clock
from enum import IntEnum
from types import FrameType
from typing import Any

from fracflow._petsc import MPI


class RunRequest(IntEnum):
    """A request to be met at the end of a step."""

    GO_ON = 0
    SAVE = 1
    STOP = 2


SIGNALS = dict.fromkeys((signal.SIGUSR2, signal.SIGTERM, signal.SIGINT), RunRequest.STOP)
SIGNALS[signal.SIGUSR1] = RunRequest.SAVE


class SignalWatch:
    """Takes signals while a run is under way: USR1 saves, USR2, TERM and INT save and stop; a second one stops at once.

    every    save every so many steps, 0 for never
    seconds  save when so long has passed since the last time
    """

    def __init__(self, comm: MPI.Comm, every: int, seconds: float) -> None:
        self.comm, self.every, self.seconds = comm, every, seconds
        self._asked, self._saved = RunRequest.GO_ON, clock.monotonic()
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> SignalWatch:
        try:
            self._before = {number: signal.signal(number, self._note) for number in SIGNALS}
        except ValueError:  # not in the main thread: whoever calls keeps the signals
            self._before = {}
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _note(self, number: int, frame: FrameType | None) -> None:
        self._asked = max(self._asked, SIGNALS[signal.Signals(number)])
        if self._asked is RunRequest.STOP:
            for each, handler in self._before.items():
                signal.signal(each, handler)

    def request(self, steps: int, must_stop: bool = False) -> RunRequest:
        """The request that all ranks agree on after so many steps; one rank that must stop stops all. Collective."""
        here = RunRequest.STOP if must_stop else self._asked
        is_late = self.comm.rank == 0 and clock.monotonic() - self._saved >= self.seconds
        if is_late or (self.every and steps % self.every == 0):
            here = max(here, RunRequest.SAVE)
        agreed = RunRequest(self.comm.allreduce(int(here), op=MPI.MAX))
        if agreed is not RunRequest.GO_ON:
            self._saved = clock.monotonic()
        if self._asked <= agreed:  # what came while ranks agreed on less is met after the next step
            self._asked = RunRequest.GO_ON
        return agreed
