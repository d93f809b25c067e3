"""Two fractures as a T: the upright one under pressure opens, and the one across its upper end slips (Phan et al. 2003).

The scene and the limit that errors are against are those of R17; the print stands beside.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from figures_verification.case import Bar
from figures_verification.cases import r17, r18

from figures_benchmarks.benchmark import Benchmark, Line, Other, Ran, along, rms, table_of, timed

EXACT = 1e-9
NEAR = 3.0  # m from where they meet, or from an end, nothing is compared: all is steep there, and read off a print
QUANTITIES = (
    ("slip", "slip_mm", 1e-3, "slip of the one across [mm]"),
    ("opening", "opening_mm", 1e-3, "opening of the upright one [mm]"),
    ("normal_traction", "compression_MPa", -1e6, "compression of the one across [MPa]"),
)


def run(size: float) -> Ran:
    """On joints of ``size`` metres."""
    found, seconds = timed(lambda: r17.pressed(size))
    state = found.fractures[-1]
    x, y = state.points.T
    crossed = np.isin(np.arange(len(x)), state.pieces[np.ptp(x[state.pieces], axis=1) > 0])
    lines, errors = [], list(r17.errors_of(found)[::-1])
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
        ends = np.abs(where) < (r17.UP if upright else r17.ALONG) - NEAR
        compared = ends if upright else ends & (np.abs(where) > NEAR)
        errors.append(rms((got - right)[compared], right[compared]))
        order = np.argsort(place, kind="stable")
        lines.append(Line(about, "y [m]" if upright else "x [m]", about, (place[order], values[order]), (where, right)))
    return Ran(tuple(errors), seconds, tuple(lines))


def unmeshed(_: Path) -> list[Other]:
    """The same in rock that is not meshed."""
    found = []
    for size in (4.0, 2.0, 1.0):
        ran, seconds = timed(lambda size=size: r18.pressed(size))
        found.append(Other("fracflow, unmeshed", r17.errors_of(ran)[1], seconds, True))
    return found


BENCHMARK = Benchmark(
    "T of two fractures", "T junction",
    "Phan et al. 2003, Int. J. Numer. Meth. Engng 57, 835-851, as digitised in the tests of GEOS; slip and opening against"
    " displacement discontinuities, which run here too",
    "the paper itself was not at hand; the two branches of its slip differ by 1 to 3 %, and no errors are stated",
    (
        Bar("slip", 0.0095, 0.8, 0.01), Bar("opening", 0.0095, 0.8, 0.01),
        Bar("printed slip", 0.017), Bar("printed opening", 0.011, None, 0.01), Bar("printed compression", 0.006),
    ),
    run, (2.0, 1.0, 0.5), (), "joints [m]", unmeshed,
)  # fmt: skip
