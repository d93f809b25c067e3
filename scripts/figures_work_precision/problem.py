"""What a problem is: methods that solve it at several levels, what each costs and how wrong it is, and the Pareto front."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from statistics import median
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fracflow._petsc import PETSc
from fracflow.errors import SolveError

Floats = NDArray[np.float64]
EXACT = 1e-12  # errors below are of round-off, and as good as each other
WORK = {
    "factorisations": ("MatLUFactorNum", "MatCholFctrNum"),
    "solves": ("MatSolve",),
    "products": ("MatMult", "MatMultAdd", "MatMultTranspose"),
}
"""Work -> events of PETSc's log that it is counted by; small matrices of rows and jumps count as large ones do."""


class Answer(NamedTuple):
    """Relative error of a run, and its CPU seconds."""

    error: float
    seconds: float


@dataclass(frozen=True)
class Method:
    """A way to solve a problem: a run at each of its levels, from coarse to fine.

    default  whether it is what the program does of its own accord
    fails    it cannot solve the problem, and says so at every level
    """

    name: str
    run: Callable[[float], Answer]
    levels: tuple[float, ...]
    default: bool = False
    fails: bool = False


@dataclass(frozen=True)
class Problem:
    """Methods on one problem; ``level`` and ``error`` say what they are.

    most  error that every method keeps below on its second level, by which the tests see that none rots
    """

    name: str
    title: str
    level: str
    error: str
    methods: tuple[Method, ...]
    most: float


class Point(NamedTuple):
    """A method at a level: error, median of the CPU seconds, work by name; a run that failed has no error but a reason."""

    method: Method
    level: float
    error: float
    seconds: float
    work: dict[str, int]
    reason: str = ""


def counts() -> dict[str, int]:
    """Work so far, of this process."""
    return {
        name: sum(PETSc.Log.Event(event).getPerfInfo()["count"] for event in events) for name, events in WORK.items()
    }


def measure(problem: Problem, repeats: int, levels: int | None = None) -> list[Point]:
    """Every method at its levels, or at the coarsest of them only; runs are repeated for their CPU seconds."""
    PETSc.Log.begin()
    return [point(method, level, repeats) for method in problem.methods for level in method.levels[:levels]]


def point(method: Method, level: float, repeats: int) -> Point:
    """A method at one level. Only a solve that failed is an answer; anything else is an error of ours."""
    before = counts()
    try:
        answer = method.run(level)
    except SolveError as failure:
        return Point(method, level, np.nan, np.nan, {}, str(failure).partition("\n")[0])
    work = {name: count - before[name] for name, count in counts().items()}
    seconds = [answer.seconds, *(method.run(level).seconds for _ in range(repeats - 1))]
    return Point(method, level, max(answer.error, EXACT), median(seconds), work)


def front(points: Iterable[Point]) -> list[Point]:
    """Points that no other beats in both, from cheap to exact."""
    found: list[Point] = []
    for each in sorted((p for p in points if not p.reason), key=lambda p: (p.seconds, p.error)):
        if not found or each.error < found[-1].error:
            found.append(each)
    return found


def over_front(points: Sequence[Point]) -> tuple[float, Point, Point]:
    """How many times the CPU seconds of the front at its own error the default takes, at worst.

    With that point of the default's, and the first point of the front that is as exact. Between its points the front is
    interpolated in logarithms.
    """
    best = front(points)
    cost, error = (np.log([getattr(p, name) for p in best]) for name in ("seconds", "error"))

    def ratio(each: Point) -> float:
        return float(each.seconds / np.exp(np.interp(-np.log(each.error), -error, cost)))

    worst = max(front(p for p in points if p.method.default), key=ratio)
    return ratio(worst), worst, next(p for p in best if p.error <= worst.error)
