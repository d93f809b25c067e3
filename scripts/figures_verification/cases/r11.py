"""R11: the energy balance to round-off.

With the work of the joints by (2.33b) they close to round-off whatever happens; with the closed form of the energy stored in
a joint they close to second order of the time step, the error of the trapezoid. A pulse V sin^2(pi t/T) brings 3/8 Z V^2 T,
and once it has left all of it was radiated. Of the work of an injection see R05.
"""

from __future__ import annotations

import numpy as np
from sheets import ROOT

from figures_verification.case import Bar, Case
from figures_verification.cases import r02, r03
from figures_verification.runs import solve

FAULT = ROOT / "meshes" / "report_5_3" / "scene.toml"


def closed_form(step: float) -> tuple[float, ...]:
    """Of the books of the block of 5.2 free across the joints, pushed by a smooth sin^2, over the work: nothing slips."""
    times = np.linspace(0.0, 4.0, 161)
    table = [[float(t), float(0.4 * np.sin(np.pi * t / 4.0) ** 2)] for t in times]
    given = (f"load.0.traction=[0, {table}]", "stage.0.end=6", f"stage.0.time_step={step}")
    found = solve(r02.SCENE, 'support.1.components=["x", "rotation"]', *given)
    work = np.abs(found.history["energy/work_boundaries"]).max()
    return float(np.abs(found.history["energy/residual_closed"]).max() / work), found.open_books


def sliding(step: float) -> tuple[float, ...]:
    """Of the books of application 5.3, fluid and walls coupled, faults that slip with a drop."""
    found = solve(FAULT, f"stage.failure.time_step={step}", "stage.failure.steps=20")
    assert found.history["energy/friction"][-1] > 0.0
    return (found.open_books,)


def radiated(size: float) -> tuple[float, ...]:
    """Of what a pulse brings and of what leaves, long after it has."""
    each = round(5.0 / size)
    found = r03.passed("p", each, 1.35e10, 10 * each)
    brought = 3 / 8 * r03.RHO * r03.CP * r03.SPEED**2 * r03.PULSE * size
    energy = {name: float(found.history[f"energy/{name}"][-1]) for name in ("work_incident", "radiated")}
    return *(abs(value / brought - 1) for value in energy.values()), found.open_books


BOOKS = Bar("energy balance", 1e-10)
CASES = (
    Case(
        "R11 block, closed form", (Bar("energy", 5e-5, 1.8), BOOKS), closed_form, (0.1, 0.05, 0.025), (0.2, 0.1), "dt"
    ),
    Case("R11 faults slip, coupled", (BOOKS,), sliding, (0.02, 0.01), (0.02,), "dt"),
    Case("R11 pulse in and out", (Bar("brought", 1e-10), Bar("radiated", 1e-6), BOOKS), radiated, (0.2, 0.1), ()),
)
