"""Problems with a closed form, of figures_verification: Sneddon's crack, Viesca's rupture, the KGD fracture."""

from __future__ import annotations

import numpy as np
from figures_verification.case import Bar
from figures_verification.cases import r07, r08, r16
from figures_verification.runs import Found

from figures_benchmarks.benchmark import Benchmark, Floats, Line, Ran, table_of, timed

MICRO = 1e6


def sorted_along(found: Found, quantity: str, scale: float = 1.0) -> tuple[Floats, Floats]:
    """Places in order and values on the fracture at the end."""
    state = found.fractures[-1]
    order = np.argsort(state.points[:, 0], kind="stable")
    return state.points[order, 0], state.point[quantity][order] * scale


def sneddon(size: float) -> Ran:
    """Under pressure in a row of cracks, on cells size^2 at the tips."""
    period = 10.0
    found, seconds = timed(lambda: r07.loaded("blown", period, size))
    x = np.linspace(0, r07.HALF, 13)
    right = r07.opening(x, period, r07.PRESSURE) * MICRO
    line = Line("opening", "x [m]", "opening [µm]", sorted_along(found, "opening", MICRO), (x, right))
    return Ran(r07.errors_of(found, "blown", period), seconds, (line,))


def viesca(size: float) -> Ran:
    """Slip by a well of constant pressure, T = 0.5, on cells ``size`` of the rupture at the end, in 1/size steps."""
    stress = 0.5
    found, seconds = timed(lambda: r08.pushed(stress, size, coupled=True, steps=round(1 / size)))
    x = np.linspace(-1, 1, 25)
    right = r08.FRICTION * r08.PUMPED * r08.LENGTH / r08.OUTER * r08.slip(np.abs(x), stress)
    places, slid = sorted_along(found, "plastic_slip", 1e3)
    near = np.abs(places) < 1.3 * r08.LENGTH
    line = Line("slip", "x [m]", "slip [mm]", (places[near], np.abs(slid[near])), (x * r08.LENGTH, right * 1e3))
    return Ran(r08.errors_of(found, stress), seconds, (line,))


def kgd(size: float) -> Ran:
    """A fracture driven by a viscous fluid, 40 s, on joints ``size`` of its half length, in 2/size steps a stage."""
    found, seconds = timed(lambda: r16.driven(size, round(2 / size)))
    x = np.linspace(0, 0.96, 15)
    openings, pressures = r16.similarity().profiles(x)
    place, opening = sorted_along(found, "opening", 1e3)
    _, pressure = sorted_along(found, "pressure", 1e-6)
    near = (place >= 0) & (place < r16.LENGTH)
    printed = table_of("kgd.csv")
    at = printed["t_s"] == r16.END
    right = r16.OPENING * 1e3 * openings / openings[0], r16.NET / 1e6 * pressures / pressures[0]
    lines = (
        Line("opening", "x [m]", "opening [mm]", (place[near], opening[near]),
             (np.append(x * r16.LENGTH, 0.0), np.append(right[0], printed["w0_m"][at] * 1e3))),
        Line("net pressure", "x [m]", "net pressure [MPa]", (place[near], pressure[near] - r16.STRESS / 1e6),
             (np.append(x * r16.LENGTH, 0.0), np.append(right[1], printed["p0_Pa"][at] / 1e6))),
    )  # fmt: skip
    return Ran(tuple(abs(error) for error in r16.errors_of(found)), seconds, lines)


BENCHMARKS = (
    Benchmark(
        "Crack under pressure (Sneddon)", "Sneddon",
        "Sneddon 1946; a row of cracks: Tada, Paris, Irwin, The Stress Analysis of Cracks Handbook, 7.1",
        "nothing",
        (Bar("opening in the middle", 1.4e-3, 1.7, 0.01), Bar("opening, x < 0.9 a", 2e-3, 1.6), Bar("volume", 2.6e-3, 1.7)),
        sneddon, (0.2, 0.1, 0.05), (0.2, 0.1), "cells",
    ),
    Benchmark(
        "Slip by injection (Viesca)", "Viesca",
        "Viesca 2021, J. Fluid Mech. 928, A29: lambda(T) and slip at T = 0.5, by quadrature",
        "nothing", (Bar("slip", 3e-3, None, 0.02), Bar("lambda", 3.2e-3, None, 0.02)),
        lambda size: (ran := viesca(size))._replace(errors=ran.errors[::-1]), (0.15, 0.1, 0.05), (), "cells and steps",
    ),
    Benchmark(
        "KGD, viscosity-dominated", "KGD",
        "Adachi and Detournay 2002, Int. J. Numer. Anal. Meth. Geomech. 26, 579-604; the similarity solution to six digits",
        "the printed coefficients have two digits (2.1, 0.62): as printed the opening is 1 % wider",
        (Bar("opening", 0.008, 0.3, 0.01), Bar("net pressure", 0.009, 0.4, 0.01), Bar("length", 0.008, 0.45, 0.01)),
        kgd, (1 / 10, 1 / 14, 1 / 20), (), "joints and steps",
    ),
)  # fmt: skip
