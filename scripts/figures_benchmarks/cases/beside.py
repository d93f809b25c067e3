"""A crack that slides, and Wijesinghe's fracture, as ``scripts/bench peers`` has them: both programs, whole processes."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from subprocess import CalledProcessError

import numpy as np
from figures_verification.case import Bar

from figures_benchmarks.benchmark import Benchmark, Line, Other, Ran

sys.path.insert(0, str(Path(__file__).parents[2] / "benches"))
import peers
from _peers_cases import Problem, h1, h2, similarity
from _peers_run import Failed, environment, measured, prepare_fracflow, read_fracflow

PLACES = 25


def ours(problem: Problem, options: Mapping[str, object], names: tuple[str, ...], lines: Callable[..., Line]) -> Ran:
    """Run fracflow alone."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        cost = measured(prepare_fracflow(problem, options, folder), folder)
        found = read_fracflow(folder)
    errors = problem.errors(found)
    return Ran(tuple(errors[each] for each in names), cost.seconds, (lines(found),))


def sliding(cells: float) -> Ran:
    """H1 on so many cells of the crack, graded to its tips."""

    def line(found: peers.Found) -> Line:
        x = np.linspace(0.0, 2.0, PLACES)
        largest = 4.0 * (1.0 - 0.25**2) / 10e9 * (8e6 - 10e6 * np.tan(np.radians(30.0)))
        right = largest * np.sqrt(np.maximum(1.0 - (x - 1.0) ** 2, 0.0))
        return Line(
            "slip",
            "along the crack [m]",
            "slip [mm]",
            (found.along.ravel(), found.slip.ravel() * 1e3),
            (x, right * 1e3),
        )

    return ours(h1(round(1 / cells), "graded"), {}, ("slip",), line)


def injected(step: float) -> Ran:
    """H2 in so many steps, on joints that grow from the well on."""
    n = round(1 / step)
    problem = h2(*next(size for size in peers.FEW if size[1] == n))

    def line(found: peers.Found) -> Line:
        x = np.linspace(0.0, 12.0, PLACES)
        right = 1e11 * 1e-5 * (similarity(1.9)(x / np.sqrt(4 * 100 * 1e-15 * 1e11 / 12e-3)) - 1.0) / 1e6
        near = found.along <= 12.0
        return Line(
            "pressure",
            "along the fracture [m]",
            "pressure over that at rest [MPa]",
            (found.along[near], found.pressure[near] / 1e6),
            (x, right),
        )

    return ours(problem, peers.FILM | {"coupling": "auto"}, ("pressure", "aperture"), line)


def opengeosys(case: str, observable: str, most: int) -> Callable[[Path], list[Other]]:
    """OpenGeoSys in every way that ``scripts/bench peers`` has, on the first ``most`` grids of each."""

    def run(folder: Path) -> list[Other]:
        try:
            program = environment(folder)
        except CalledProcessError as error:
            print(f"OpenGeoSys cannot be installed ({error}), and is not shown")
            return []
        found = []
        for curve in peers.CURVES:
            if (curve.case, curve.program) != (case, peers.THEIRS):
                continue
            for size in curve.sizes[:most]:
                with tempfile.TemporaryDirectory() as name:
                    try:
                        cost, errors, _ = peers.once(curve, size, Path(name) / "run", program)
                    except Failed as error:
                        print(f"{case} {curve.name} {size}: {error}")
                        continue
                found.append(Other("OpenGeoSys", errors[observable], cost.seconds, True))
        return found

    return run


POREPY = ((0.171, 2.95), (0.089, 3.31), (0.047, 5.34), (0.020, 13.6))
"""Error and CPU seconds of PorePy 1.11 on uniform grids of 10, 20, 40 and 100 cells, as surveyed in November 2026."""


def all_of_h1(folder: Path) -> list[Other]:
    """OpenGeoSys, and PorePy as it was found."""
    return [*opengeosys("h1", "slip", 6)(folder), *(Other("PorePy", *pair, False) for pair in POREPY)]


BENCHMARKS = (
    Benchmark(
        "Crack that slides", "friction crack",
        "Sneddon's crack in shear: slip 4 (1 - nu^2)/E (tau + mu sigma) sqrt(a^2 - x^2) of the infinite body",
        "PorePy's numbers are of an earlier survey on another day, and not run here", (Bar("slip", 0.006, 1.4),),
        sliding, (1 / 12, 1 / 28, 1 / 56), (), "cells of the crack", all_of_h1,
    ),
    Benchmark(
        "Injection into a long fracture (Wijesinghe)", "Wijesinghe",
        "Wijesinghe 1986 as in OpenGeoSys's test single_fracture; the similarity solution by shooting",
        "the similarity solution has no rock that bends: of a block 0.05 m high it changes 1e-3",
        (Bar("pressure", 8e-4, 1.0), Bar("aperture", 1.2e-3, 0.7)),
        injected, (1 / 10, 1 / 25, 1 / 60), (), "steps and joints", opengeosys("h2", "pressure", 3),
    ),
)  # fmt: skip
