"""Steady flow through the 63 traces of the Sotra outcrop, from west to east, against a network of pipes solved by itself.

The traces are those of case 4 of Flemisch et al. 2018, whose rock conducts; here fractures alone do, all with one conductance.
The pipes know nothing of a mesh: traces are cut where they cross, and ends within SNAP of another trace are put on it.
"""

from __future__ import annotations

import csv
from itertools import combinations

import numpy as np
from figures_verification.case import Bar
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import spsolve

from figures_benchmarks.benchmark import DATA, Benchmark, Floats, Line, Ran, clocked

WIDTH, HEIGHT, SNAP, CONDUCTANCE, HIGH, LOW = 700.0, 600.0, 0.525, 1e-9, 5.1e6, 5.0e6
SCENE = """
rock.rock = {{youngs_modulus = 50e9, poissons_ratio = 0.25, density = 2700}}
fluid = {{viscosity = 1e-3, initial_pressure = 5e6}}
initial_stress = {{xx = -13e6, yy = -25e6, zz = -15e6}}
support = [{{on = ["west", "east", "south", "north"]}}]
well = [
  {{name = "west", at = {{fracture = "24", end = "start"}}, pressure = {high}}},
  {{name = "22", at = {{fracture = "22", end = "end"}}, pressure = {low}}},
  {{name = "31", at = {{fracture = "31", end = "end"}}, pressure = {low}}},
]
stage = [{{kind = "steady", time_step = 1, steps = 1}}]
geometry = {{domain = [0, 0, 700, 600], size = 60, size_at_fractures = {size}, snap = {snap}, fracture = [{traces}]}}
[fracture.default]
normal_stiffness = 50e9
shear_stiffness = 20e9
aperture = 0.2e-3
conductance = {conductance}
friction_coefficient = 0.6
"""


def traces() -> Floats:
    """Ends (n, 2, 2) of the traces."""
    with (DATA / "sotra.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    return np.array([[[float(row[f"{axis}{end}"]) for axis in "xy"] for end in "12"] for row in rows])


def pipes() -> tuple[Floats, Floats, float]:
    """Points (n, 2) where traces end or cross, the pressure there, NaN where no flow comes, and the flow."""
    ends = traces()
    for number, end in np.ndindex(len(ends), 2):
        point = ends[number, end]
        for other in np.delete(np.arange(len(ends)), number):
            a, b = ends[other]
            foot = a + np.clip((point - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1) * (b - a)
            if np.linalg.norm(point - foot) < SNAP:
                ends[number, end] = point = foot
    cuts: list[list[float]] = [[0.0, 1.0] for _ in ends]
    for one, other in combinations(range(len(ends)), 2):
        (a, b), (c, d) = ends[one], ends[other]
        turn = np.stack([b - a, c - d], axis=1)
        if abs(np.linalg.det(turn)) > 1e-9 * np.linalg.norm(b - a) * np.linalg.norm(d - c):
            s, t = np.linalg.solve(turn, c - a)
            if -1e-6 < s < 1 + 1e-6 and -1e-6 < t < 1 + 1e-6:
                cuts[one].append(s)
                cuts[other].append(t)
    places = [a + np.sort(np.clip(cut, 0, 1))[:, None] * (b - a) for (a, b), cut in zip(ends, cuts, strict=True)]
    points, names = np.unique(np.concatenate(places).round(5), axis=0, return_inverse=True)
    split = np.split(names.ravel(), np.cumsum([len(place) for place in places])[:-1])
    edges = np.concatenate([np.stack([part[:-1], part[1:]], axis=1) for part in split])
    lengths = np.linalg.norm(np.diff(points[edges], axis=1)[:, 0], axis=1)
    edges, lengths = edges[lengths > 1e-3], lengths[lengths > 1e-3]
    n, (i, j), g = len(points), edges.T, CONDUCTANCE / lengths
    laplace = coo_array((np.r_[g, g, -g, -g], (np.r_[i, j, i, j], np.r_[i, j, j, i])), (n, n)).tocsr()
    wells = [int(np.argmin(np.linalg.norm(points - end, axis=1))) for end in (ends[23, 0], ends[21, 1], ends[30, 1])]
    part = connected_components(laplace, directed=False)[1]
    wet = part == part[wells[0]]
    free, pressure = wet.copy(), np.full(n, np.nan)
    free[wells], pressure[wells] = False, (HIGH, LOW, LOW)
    pressure[free] = spsolve(laplace[free][:, free].tocsc(), -laplace[free][:, wells] @ pressure[wells])
    return points, pressure, float(laplace[wells[:1]][:, wet] @ pressure[wet])


def run(size: float) -> Ran:
    """On joints of at most ``size`` metres: errors of the pressure at ends and crossings, and of the flow."""
    known = ", ".join(f'{{name = "{i}", points = {ends.tolist()}}}' for i, ends in enumerate(traces(), 1))
    scene = SCENE.format(
        high=HIGH, low=LOW, size=size, snap=SNAP, traces=known, conductance=CONDUCTANCE,
    )  # fmt: skip
    found, seconds = clocked(scene)
    points, pressure, flow = pipes()
    state, there = found.fractures[-1], ~np.isnan(pressure)
    nearest = np.linalg.norm(state.points[None] - points[there, None], axis=2).argmin(axis=1)
    got, right = state.point["pressure"][nearest], pressure[there]
    line = Line(
        "pressure at ends and crossings",
        "by pipes [MPa]",
        "pressure at ends and crossings [MPa]",
        (right / 1e6, got / 1e6),
        (right / 1e6, right / 1e6),
    )
    rate = float(found.history["well/west/rate"][-1])
    return Ran((float(np.abs(got - right).max() / (HIGH - LOW)), abs(abs(rate) / flow - 1)), seconds, (line,))


BENCHMARK = Benchmark(
    "Flow of a mapped network (Sotra)", "Sotra network",
    "traces of case 4 of Flemisch et al. 2018, Adv. Water Resour. 111, 239-258; pipes between crossings, solved by SciPy",
    "the published pressures are of rock that conducts too, which this program has not",
    (Bar("pressure", 1e-6), Bar("flow", 1e-6)),
    run, (40.0, 20.0), (40.0,), "joints [m]",
)  # fmt: skip
