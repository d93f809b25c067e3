"""A public problem: its published numbers, runs of several sizes, their errors and CPU, and other programs on it."""

from __future__ import annotations

import csv
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from figures_verification.case import Bar, Case, Outcome
from figures_verification.case import measure as outcomes_of
from figures_verification.runs import Found, solve
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[1] / "benches"))
from _peers_run import measured

Floats = NDArray[np.float64]
DATA = Path(__file__).parent / "data"
TINY = """
rock.rock = {youngs_modulus = 1, poissons_ratio = 0}
geometry = {domain = [0, 0, 1, 1], size = 1}
support = [{on = "south"}]
stage = [{kind = "steady", time_step = 1, steps = 1}]
"""


class Line(NamedTuple):
    """A curve of a picture: the places and values found, (n,), and those published or exact, (m,), without which none stand."""

    title: str
    x_label: str
    y_label: str
    found: tuple[Floats, Floats]
    right: tuple[Floats, Floats]


class Ran(NamedTuple):
    """Relative errors, one a bar; CPU seconds, those of the start included; the curves."""

    errors: tuple[float, ...]
    seconds: float
    lines: tuple[Line, ...] = ()


class Other(NamedTuple):
    """Another program on the same problem: the error of the first observable, its CPU seconds, and whether it ran here."""

    program: str
    error: float
    seconds: float
    here: bool


@dataclass(frozen=True)
class Benchmark:
    """A problem and how it is run.

    name       as a reader knows it; ``short`` on the chart
    source     of the published numbers, and what the errors are taken against
    open       what could not be verified
    bars       of its observables; the first is on the chart
    run        at a size: of cells or time steps (``by``), in the case's own unit
    sizes      falling; ``quick`` are those of the tests
    others     other programs, given the folder that one of them is installed in
    own_limit  errors are against finer runs of the program, for no numbers to be held against were at hand
    """

    name: str
    short: str
    source: str
    open: str
    bars: tuple[Bar, ...]
    run: Callable[[float], Ran]
    sizes: tuple[float, ...]
    quick: tuple[float, ...]
    by: str
    others: Callable[[Path], list[Other]] = lambda _: []
    own_limit: bool = False


class Result(NamedTuple):
    """A benchmark measured: runs by size, the outcome of each observable, and the other programs."""

    benchmark: Benchmark
    runs: tuple[Ran, ...]
    outcomes: list[Outcome]
    others: list[Other]

    @property
    def ok(self) -> bool:
        """Whether every error and order is within its bar."""
        return all(outcome.ok for outcome in self.outcomes)


def measure(benchmark: Benchmark, installed: Path | None = None, quick: bool = False) -> Result:
    """Run it at its sizes, and the other programs if a folder to install one in is given."""
    sizes = benchmark.quick if quick else benchmark.sizes
    runs = {size: benchmark.run(size) for size in sizes}
    case = Case(
        benchmark.name, benchmark.bars, lambda size: runs[size].errors, benchmark.sizes, benchmark.quick, benchmark.by
    )
    others = benchmark.others(installed) if installed else []
    return Result(benchmark, tuple(runs.values()), outcomes_of(case, quick), others)


def front(others: Iterable[Other]) -> list[Other]:
    """Those that none beats in error and in CPU, from cheap to exact."""
    best: list[Other] = []
    for other in sorted(others, key=lambda each: (each.seconds, each.error)):
        if not best or other.error < best[-1].error:
            best.append(other)
    return best


@cache
def start() -> float:
    """CPU seconds of a process that runs next to nothing, less those of the same run in a process that runs already."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "scene.toml").write_text(TINY, encoding="utf-8")
        solve(folder / "scene.toml")
        began = time.process_time()
        solve(folder / "scene.toml")
        again = time.process_time() - began
        command = [sys.executable, "-m", "fracflow", "run", "scene.toml", "-o", "run", "--set", "output.pictures=false"]
        whole = min(measured(command, folder).seconds for _ in range(2))
    return max(whole - again, 0.0)


def clocked(scene: str | Path, *settings: str, mesh: str = "") -> tuple[Found, float]:
    """Run a scene; see ``timed``."""
    return timed(lambda: solve(scene, *settings, mesh=mesh))


def timed(run: Callable[[], Found]) -> tuple[Found, float]:
    """The results of a run, and its CPU seconds from the start of a process to their reading."""
    before = start()
    began = time.process_time()
    found = run()
    return found, before + time.process_time() - began


def table_of(name: str) -> dict[str, Floats]:
    """Columns of a table of data/, without the lines of its source, which begin with #."""
    with (DATA / name).open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    return {key: np.array([float(row[key]) for row in rows]) for key in rows[0]}


def rms(wrong: Iterable[float], right: Iterable[float]) -> float:
    """Root mean square of differences over that of what should be."""
    return float(np.linalg.norm(np.asarray(wrong)) / np.linalg.norm(np.asarray(right)))


def along(where: Floats, values: Floats, places: Floats) -> Floats:
    """Values (n,) at places, from those at points (m,) of a line in any order; two at a point are one."""
    at, owner = np.unique(where.round(9), return_inverse=True)
    mean = np.bincount(owner, values) / np.bincount(owner)
    return np.interp(places, at, mean)
