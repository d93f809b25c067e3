"""SEAS BP6-QD-A with constant friction: a fault that slips as fluid spreads in it for 100 days and drains for 630.

Lambert et al. 2025 have rate-and-state friction; here it is f = 0.6 and there is no damping. Plane strain with nu = 0 and
E = 2 mu is their antiplane problem. Slip is also found here by boundary elements: constant slip on intervals h gives the stress
-mu h/(2 pi)/(h^2/4 - (z_i - z_j)^2) s_j, and f (sigma - p) is nowhere exceeded; slip never goes back.
"""

from __future__ import annotations

import sys
import tempfile
import time
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
from figures_verification.case import Bar
from figures_verification.cases.r18 import unbounded
from scipy.special import erfc

from figures_benchmarks.benchmark import Benchmark, Floats, Line, Other, Ran, clocked, measured, table_of

SHEAR, FRICTION, STRESS, TRACTION = 32.04e9, 0.6, 50e6, 29.2e6
DIFFUSIVITY, RATE, COMPRESSIBILITY, POROSITY = 0.1, 1.25e-6, 1e-8, 0.1
DAY = 86400.0
OFF, END, HALF, FAR = 100 * DAY, 730 * DAY, 8000.0, 120e3
GROWTH = 1.2e-3  # by which a cell is longer than the one nearer to the fault, over the joint [1/m]
SPANS = tuple(
    days * DAY for days in (100, 15, 45, 150, 420)
)  # until OFF, when pressure at the middle is largest, and after
STEPS, FINE = (1, 5, 5, 5, 5), (100, 15, 45, 150, 420)  # of these
"""While all pressures rise slip depends on the last ones alone: one step leaves what fifty do, to 1e-11. Behind OFF slip
spreads ever more slowly: 20 steps that grow leave .11 % of the potency, 63 of 10 days .26 %. Slip at z = 0 has none."""
SCENE = """
rock.rock = {{youngs_modulus = {young}, poissons_ratio = 0, density = 2670}}
initial_stress = {{xx = -{stress}, yy = -{stress}, zz = -{stress}, xy = {traction}}}
fluid = {{viscosity = 1e-3, initial_pressure = 0}}
support = [{{on = ["south", "north", "east", "west"]}}]
stage = [{stages}]
[geometry]
domain = [-{far}, -{far}, {far}, {far}]
size = 8000
size_at_fractures = {size}
growth = {growth}
fracture = [{{name = "fault", points = [[-{half}, 0], [{half}, 0]]}}]
[fracture.fault]
normal_stiffness = 1e13
shear_stiffness = 1e13
aperture = 1e-3
friction_coefficient = {friction}
pressure = {{along = {along}, time = {times}, value = {values}}}
"""


def pressure(z: Floats, at: float) -> Floats:
    """On the fault: a line source at z = 0 until OFF."""

    def since(begin: float) -> Floats:
        if at <= begin:
            return np.zeros_like(z)
        root = np.sqrt(at - begin)
        x = np.abs(z) / np.sqrt(4 * DIFFUSIVITY) / root
        return root * (np.exp(-(x**2)) / np.sqrt(np.pi) - x * erfc(x))

    return RATE / (COMPRESSIBILITY * POROSITY * np.sqrt(DIFFUSIVITY)) * (since(0.0) - since(OFF))


def instants(steps: tuple[int, ...] = STEPS) -> Floats:
    """Times of all states, the first one included."""
    ends = np.concatenate([[0.0], np.cumsum(SPANS)])
    parts = [np.linspace(*span, count + 1)[1:] for span, count in zip(pairwise(ends), steps, strict=True)]
    return np.concatenate([[0.0], *parts])


def boundary_elements(size: float, steps: tuple[int, ...] = STEPS) -> tuple[Floats, Floats, Floats]:
    """Middles of the intervals, slip at the end, and the potency after each step."""
    z = (np.arange(round(2 * HALF / size)) + 0.5) * size - HALF
    apart = z - z[0]
    row = -SHEAR * size / (2 * np.pi) / (size**2 / 4 - apart**2)
    stiffness = row[np.abs(np.subtract.outer(np.arange(len(z)), np.arange(len(z))))]
    slip, potency = np.zeros_like(z), [0.0]
    for at in instants(steps)[1:]:
        over = TRACTION - FRICTION * (STRESS - pressure(z, at)) + stiffness @ slip  # stress beyond the strength
        slides = over > 0
        while slides.any():
            more = np.zeros_like(z)
            more[slides] = np.linalg.solve(stiffness[np.ix_(slides, slides)], -over[slides])
            # slides on where it went forward, begins where the others' slip takes it past its strength
            now = np.where(slides, more > 0, over + stiffness @ more > 1e-9 * STRESS)
            if np.array_equal(now, slides):
                slip = slip + more
                break
            slides = now
        potency.append(slip.sum() * size)
    return z, slip, np.array(potency)


@cache
def limit() -> tuple[float, float]:
    """Slip at z = 0 and potency at the end: the boundary elements of 25 and 50 m, whose errors are of first order."""
    coarse, fine = (boundary_elements(size, FINE) for size in (50.0, 25.0))
    (one, other), (low, high) = (
        (float(np.interp(0.0, z, slip)), float(potency[-1])) for z, slip, potency in (coarse, fine)
    )
    return 2 * low - one, 2 * high - other


def run(size: float, far: float = FAR, growth: float = GROWTH, meshed: bool = True) -> Ran:
    """On joints of ``size`` metres, in a box of ``far`` to each side; cells away from the fault shrink with them.

    If not ``meshed``, without a box and cells.
    """
    nodes, times = np.linspace(-HALF, HALF, round(2 * HALF / size) + 1), instants()
    values = [[float(f"{p:.7g}") for p in pressure(nodes, at)] for at in times]
    stages = ", ".join(
        f'{{kind = "steady", time_step = {span / count}, steps = {count}}}'
        for span, count in zip(SPANS, STEPS, strict=True)
    )
    scene = SCENE.format(
        young=2 * SHEAR, stress=STRESS, traction=TRACTION, stages=stages,
        far=far, size=size, half=HALF, growth=growth * size,
        friction=FRICTION, along=(nodes + HALF).tolist(), times=times.tolist(), values=values,
    )  # fmt: skip
    found, seconds = clocked(scene if meshed else unbounded(scene))
    state, table = found.fractures[-1], table_of("bp6_constant_friction.csv")
    order = np.argsort(state.points[:, 0], kind="stable")
    z, slip = state.points[order, 0], np.abs(state.point["plastic_slip"][order])
    potency = float(np.sum((slip[1:] + slip[:-1]) / 2 * np.diff(z)))
    right = limit()
    places = np.array([float(key.split("_")[1]) for key in table if key.startswith("slip_")])
    profile = np.array([table[f"slip_{place:g}_m"][-1] for place in places])
    line = Line("slip after 730 days", "along the fault [m]", "slip [m]", (z, slip), (places, profile))
    return Ran((abs(np.interp(0.0, z, slip) / right[0] - 1), abs(potency / right[1] - 1)), seconds, (line,))


def elements(_: Path) -> list[Other]:
    """The same in rock that is not meshed, and by boundary elements with the CPU of a start of Python and SciPy."""
    ran = [run(2 * HALF / joints, meshed=False) for joints in (80, 160, 330)]
    found = [Other("fracflow, unmeshed", each.errors[0], each.seconds, True) for each in ran]
    with tempfile.TemporaryDirectory() as name:
        begin = measured([sys.executable, "-c", "import numpy, scipy.special"], Path(name)).seconds
    for size in (200.0, 100.0, 50.0):
        began = time.process_time()
        z, slip, _potency = boundary_elements(size)
        seconds = begin + time.process_time() - began
        found.append(Other("boundary elements", abs(float(np.interp(0.0, z, slip)) / limit()[0] - 1), seconds, True))
    return found


BENCHMARK = Benchmark(
    "BP6 with constant friction", "BP6, constant friction",
    "SEAS BP6-QD-A (Lambert et al. 2025), parameters as in five public decks, with f = 0.6 in place of rate and state; slip by"
    " boundary elements, which run here too",
    "no one has published this variant: the boundary elements are our own",
    (Bar("slip at z = 0", 0.006, 1.0, 0.01), Bar("potency", 0.006, 0.5, 0.01)),
    run, (200.0, 100.0, 50.0), (400.0, 200.0), "joints [m]", elements,
)  # fmt: skip
