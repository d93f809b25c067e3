"""Two fractures as a T: the upright one under pressure opens, and the one across its upper end slips (Phan et al. 2003)."""

from __future__ import annotations

import numpy as np
from figures_verification.case import Bar

from figures_benchmarks.benchmark import Benchmark, Line, Ran, along, clocked, rms, table_of

SCENE = """
rock.rock = {{youngs_modulus = 70e9, poissons_ratio = 0.2, density = 2700}}
initial_stress = {{xx = 0.0, yy = -100e6, zz = 0.0}}
fluid = {{viscosity = 1e-3, initial_pressure = 0}}
support = [{{on = ["south", "north", "east", "west"]}}]
stage = [{{kind = "steady", time_step = 0.1, steps = 10}}]
[geometry]
domain = [-1000, -950, 1000, 1050]
size = 100
size_at_fractures = {size}
size_at_tips = {tip}
growth = 0.15
fracture = [{{name = "vertical", points = [[0, -50], [0, 50]]}}, {{name = "horizontal", points = [[-25, 50], [25, 50]]}}]
[fracture.vertical]
normal_stiffness = 1e9
shear_stiffness = 1e9
aperture = 1e-3
friction_coefficient = 0.0
pressure = [[0, 0], [1, 100e6]]
[fracture.horizontal]
normal_stiffness = 1e13
shear_stiffness = 1e13
aperture = 1e-3
friction_coefficient = 0.577350269
pressure = 0
"""
UPPER, HALF, EXACT = 50.0, 25.0, 1e-9
NEAR = 3.0  # m from where they meet, or from an end, nothing is compared: all is steep there, and read off a print
QUANTITIES = (
    ("slip", "slip_mm", 1e-3, "slip of the one across [mm]"),
    ("opening", "opening_mm", 1e-3, "opening of the upright one [mm]"),
    ("normal_traction", "compression_MPa", -1e6, "compression of the one across [MPa]"),
)


def run(size: float) -> Ran:
    """On joints of ``size`` metres, half of it at the tips."""
    found, seconds = clocked(SCENE.format(size=size, tip=size / 2))
    state = found.fractures[-1]
    x, y = state.points.T
    crossed = np.isin(np.arange(len(x)), state.pieces[np.ptp(x[state.pieces], axis=1) > 0])
    lines, errors = [], []
    for quantity, column, unit, about in QUANTITIES:
        upright = quantity == "opening"
        table = table_of(f"t_{column.partition('_')[0]}.csv")
        where, right = table["y_m" if upright else "x_m"], table[column]
        chosen = ~crossed if upright else crossed
        place, values = (y if upright else x)[chosen], state.point[quantity][chosen] / unit
        if quantity == "slip":
            values = values * np.sign(values[place < 0].sum())
        sides = (along(place[kept], values[kept], where) for kept in (place < -EXACT, place > EXACT))
        got = np.where(where < 0, *sides)  # slip jumps where the two meet
        compared = (np.abs(where) < UPPER - NEAR) if upright else (np.abs(where) > NEAR) & (np.abs(where) < HALF - NEAR)
        errors.append(rms((got - right)[compared], right[compared]))
        order = np.argsort(place, kind="stable")
        lines.append(Line(about, "y [m]" if upright else "x [m]", about, (place[order], values[order]), (where, right)))
    return Ran(tuple(errors), seconds, tuple(lines))


BENCHMARK = Benchmark(
    "T of two fractures", "T junction",
    "Phan et al. 2003, Int. J. Numer. Meth. Engng 57, 835-851, as digitised in the tests of GEOS",
    "the paper itself was not at hand; the two branches of its slip differ by 1 %, and no errors are stated",
    (Bar("slip", 0.017, 0.9, 0.01), Bar("opening", 0.014, None, 0.01), Bar("compression", 0.006)),
    run, (4.0, 2.0, 1.0, 0.5), (), "joints [m]",
)  # fmt: skip
