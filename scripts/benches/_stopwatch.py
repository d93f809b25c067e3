"""A stopwatch for the parts of a run: CPU and wall time of the functions that make up each, and memory."""

from __future__ import annotations

import importlib
import resource
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

REST = "all else"
COLUMNS = ("cpu", "wall", "memory", "helper_memory")


def cpu_seconds() -> float:
    """CPU time of this process and of those that it started and that have ended [s]."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(part.ru_utime + part.ru_stime for part in used)


def peak(who: int) -> float:
    """Largest memory so far [GB]."""
    return resource.getrusage(who).ru_maxrss / 1024**2


class Stopwatch:
    """Times of parts that may lie inside each other; each gets its own time only."""

    def __init__(self, places: Mapping[str, list[str]]) -> None:
        """Put it around all functions of ``places``: part -> the functions it consists of, module:name."""
        self.parts = {name: dict.fromkeys(COLUMNS, 0.0) for name in (*places, REST)}
        self._stack = [REST]
        self._last = (cpu_seconds(), time.perf_counter())
        for name, functions in places.items():
            for place in functions:
                module, _, path = place.partition(":")
                owner: Any = importlib.import_module(f"fracflow.{module}")
                *outer, last = path.split(".")
                for step in outer:
                    owner = getattr(owner, step)
                setattr(owner, last, self._around(name, getattr(owner, last)))

    def lap(self) -> None:
        """Book the time since the last call on the part that runs."""
        now, part = (cpu_seconds(), time.perf_counter()), self.parts[self._stack[-1]]
        part["cpu"] += now[0] - self._last[0]
        part["wall"] += now[1] - self._last[1]
        part["memory"] = peak(resource.RUSAGE_SELF)
        part["helper_memory"] = peak(resource.RUSAGE_CHILDREN)
        self._last = now

    @contextmanager
    def within(self, name: str) -> Iterator[None]:
        """Book on ``name`` meanwhile."""
        self.lap()
        self._stack.append(name)
        try:
            yield
        finally:
            self.lap()
            self._stack.pop()

    def _around(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """The function, its time booked on ``name``."""

        def timed(*arguments: Any, **options: Any) -> Any:
            with self.within(name):
                return function(*arguments, **options)

        return timed
