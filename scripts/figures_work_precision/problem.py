"""A problem: methods that solve it at several levels, the cost and error of each, and the Pareto front."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from statistics import median
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fracflow._petsc import PETSc, logged
from fracflow.errors import SolveError

Floats = NDArray[np.float64]
EXACT = 1e-12  # errors below are of round-off, and as good as each other
CLOSE = 0.99  # errors nearer to each other are the same
WORK = {
    "factorisations": ("MatLUFactorNum", "MatLUFactor", "MatCholFctrNum"),  # MatLUFactor in place, by LAPACK
    "solves": ("MatSolve", "MatMatSolve"),
    "products": ("MatMult", "MatMultAdd", "MatMultTranspose"),
}
"""Work -> events of PETSc's log that it is counted by; small matrices of rows and jumps count as large ones do, a block of
right sides as one solve, and the dense matrices of a condensed rock not at all: CPU seconds have it all."""


class Answer(NamedTuple):
    """Relative error of a run, its CPU seconds, and the nodes of its mesh where they tell of the work what counts do not."""

    error: float
    seconds: float
    nodes: int = 0


@dataclass(frozen=True)
class Method:
    """A way to solve a problem: a run at each of its levels, from coarse to fine.

    default  whether it is what the program does of its own accord
    fails    it cannot solve the problem, and says so at every level
    most     error on its second level that the tests allow, where it is not that of the problem
    """

    name: str
    run: Callable[[float], Answer]
    levels: tuple[float, ...]
    default: bool = False
    fails: bool = False
    most: float | None = None


class Order(NamedTuple):
    """By which the error falls at a level from a method to another with a finer mesh; the least that is asked for."""

    coarse: str
    fine: str
    level: float
    ratio: float
    least: float

    def of(self, points: Sequence[Point]) -> float:
        """Its value."""
        found = {point.method.name: point.error for point in points if point.level == self.level}
        errors = found[self.coarse], found[self.fine]
        return float(np.log(errors[0] / errors[1]) / np.log(self.ratio))


@dataclass(frozen=True)
class Problem:
    """Methods on one problem; ``level`` and ``error`` say what they are.

    most     error that every method keeps below on its second level, by which the tests see that none rots
    prepare  what is done once before, and not counted as work
    orders   of methods on two meshes
    """

    name: str
    title: str
    level: str
    error: str
    methods: tuple[Method, ...]
    most: float
    prepare: Callable[[], object] = lambda: None
    orders: tuple[Order, ...] = ()


class Point(NamedTuple):
    """A method at a level: error, median of the CPU seconds, work by name; a run that failed has no error but a reason."""

    method: Method
    level: float
    error: float
    seconds: float
    work: dict[str, int]
    reason: str = ""


def nodes_of(mesh: str) -> int:
    """Of a text in Gmsh's format 2.2."""
    return int(mesh.partition("$Nodes\n")[2].partition("\n")[0])


def counts() -> dict[str, int]:
    """Work so far, of this process."""
    return {name: int(sum(logged(event, "count") for event in events)) for name, events in WORK.items()}


def measure(problem: Problem, repeats: int, levels: int | None = None) -> list[Point]:
    """Every method at its levels, or at the coarsest of them only; runs are repeated for their CPU seconds."""
    PETSc.Log.begin()
    problem.prepare()
    return [point(method, level, repeats) for method in problem.methods for level in method.levels[:levels]]


def point(method: Method, level: float, repeats: int) -> Point:
    """A method at one level. Only a solve that failed is an answer; anything else is an error of ours."""
    before = counts()
    try:
        answer = method.run(level)
    except SolveError as failure:
        return Point(method, level, np.nan, np.nan, {}, str(failure).partition("\n")[0])
    work = {name: count - before[name] for name, count in counts().items()}
    work["nodes"] = answer.nodes
    seconds = [answer.seconds, *(method.run(level).seconds for _ in range(repeats - 1))]
    return Point(method, level, max(answer.error, EXACT), median(seconds), work)


def front(points: Iterable[Point]) -> list[Point]:
    """Points that no other beats in both, from cheap to exact."""
    found: list[Point] = []
    for each in sorted((p for p in points if not p.reason), key=lambda p: (p.seconds, p.error)):
        if not found or each.error < CLOSE * found[-1].error:
            found.append(each)
    return found


def cheapest(points: Sequence[Point], error: float) -> tuple[float, str]:
    """CPU seconds for which some method has that error, and the method, interpolated in logarithms between its levels."""
    found = []
    for method in {id(point.method): point.method for point in points}.values():
        own = front(point for point in points if point.method is method)
        if own and own[-1].error <= error * (1 + 1e-9):
            errors, costs = np.log([point.error for point in own]), np.log([point.seconds for point in own])
            found.append((float(np.exp(np.interp(-np.log(error), -errors, costs))), method.name))
    return min(found)


def over_front(points: Sequence[Point]) -> tuple[float, Point, str]:
    """How many times the CPU seconds of the front at its own error the default takes, at worst; there, and who is cheapest."""
    worst = max(
        front(point for point in points if point.method.default),
        key=lambda point: point.seconds / cheapest(points, point.error)[0],
    )
    seconds, name = cheapest(points, worst.error)
    return worst.seconds / seconds, worst, name
