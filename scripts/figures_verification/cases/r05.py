"""R05: pressure diffuses along one fracture that opens against springs, p_t = D p_xx, D = d0^3 k_n / 12 mu.

With a conductance of its own the film is linear at any pressure (Carslaw and Jaeger, Conduction of Heat in Solids, 2.4,
2.9 and 3.4); with the cubic law D grows with the opening, and the profile is a similarity solution (Wijesinghe 1986).
Of the work of an injection at constant pressure the springs keep 1 - 1/sqrt(2), int erfc^2/2 over int erfc.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import winkler
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.special import erfc

from figures_verification.case import Bar, Case
from figures_verification.runs import Floats, Found, solve

ORDER = {"backward-euler": 1, "bdf2": 2, "trapezoid": 2}
SCENE = winkler.SCENE.replace('[mesh]\nfile = "film.msh"\n', "")
LINEAR = SCENE.format(pressure=0)  # k_n = 1, conductance 1: D = 1
CUBIC = LINEAR.replace("viscosity = 1", f"viscosity = {1 / 12}").replace(
    "aperture = 10\nconductance = 1", "aperture = 1"
)
FAR = 8.0


@cache
def similarity(start: float) -> tuple[Callable[[Floats], Floats], float]:
    """(w, F0) of (w^3 w')' + 2 xi w' = 0, w(0) = start, w(inf) = 1, F0 = -w^3 w'(0), by shooting.

    d_t = (d^3 p_x / 12 mu)_x with d = d0 + (p - p0)/k_n = d0 w(xi), xi = x/sqrt(4 D t). The inflow is F0 d0 sqrt(D/t)/2.
    """

    def slopes(xi: float, y: Floats) -> list[float]:
        slope = -y[1] / y[0] ** 3
        return [slope, 2 * xi * slope]

    def pinched(_: float, y: Floats) -> float:
        return float(y[0] - 1e-3)

    pinched.terminal = True  # type: ignore[attr-defined]

    def shoot(flux: float, dense: bool = False):  # type: ignore[no-untyped-def]
        return solve_ivp(
            slopes, (0, FAR), [start, flux], "DOP853", rtol=1e-12, atol=1e-14, events=pinched, dense_output=dense
        )

    guess = (start - 1) * start**1.5
    flux = float(brentq(lambda f: shoot(f).y[0, -1] - 1, 0.1 * guess, 10 * guess, xtol=1e-14 * guess))
    profile = shoot(flux, dense=True).sol
    return lambda xi: profile(np.minimum(xi, FAR))[0], flux


def injection(given: str, end: float, steps: int) -> str:
    """A well at x = 0 with a pressure or a flow rate, and a quasi-static stage."""
    return f"""
[[well]]
name = "in"
at = {{fracture = "film", end = "start"}}
{given}
[[stage]]
kind = "quasi-static"
time_step = {end / steps}
steps = {steps}
"""


def film(x: Floats, scene: str, rule: str) -> tuple[Found, Floats, Floats]:
    """Run a film with nodes at x: histories, pressure and opening (n,) at the end."""
    found = solve(scene, f"method.flow_integrator={rule}", "method.coupling=whole-lu", mesh=winkler.mesh(x))
    last = found.fractures[-1]
    _, order = np.unique(last.points[:, 0], return_index=True)  # each piece has its own ends
    return found, last.point["pressure"][order], last.point["opening"][order]


def half_line(rule: str) -> Callable[[float], tuple[float, ...]]:
    """Of p = erfc(x/sqrt(4t)) at t = 1, cells of ``size`` and steps of a sixth of that; the energy that the springs keep."""

    def at(size: float) -> tuple[float, ...]:
        x = np.linspace(0, 12, round(12 / size) + 1)
        found, pressure, _ = film(x, LINEAR + injection("pressure = 1", 1.0, round(6 / size)), rule)
        kept = found.history["energy/joint_normal"][-1] / found.history["energy/work_wells"][-1]
        wrong = float(np.abs(pressure - erfc(x / 2)).max())
        return wrong, abs(kept / (1 - 1 / np.sqrt(2)) - 1), found.open_books

    return at


def pumped(size: float) -> tuple[float, ...]:
    """Of p = sqrt(4t) ierfc(x/sqrt(4t)), a rate of 1 at x = 0, over the pressure at x = 0."""
    x = np.linspace(0, 12, round(12 / size) + 1)
    _, pressure, _ = film(x, LINEAR + injection("flow_rate = 1", 1.0, round(6 / size)), "bdf2")
    z = x / 2
    return (float(np.abs(pressure - 2 * (np.exp(-(z**2)) / np.sqrt(np.pi) - z * erfc(z))).max() * np.sqrt(np.pi) / 2),)


def modes_in_time(rule: str) -> Callable[[float], tuple[float, ...]]:
    """On one mesh of length 1: p = 1 - sum c_j sin(k_j x) exp(-s_j t), the modes of the lumped film, without error of h."""
    n, end = 8, 0.4
    x = np.linspace(0, 1, n + 1)
    k = (np.arange(n) + 0.5) * np.pi
    rate = 2 * (1 - np.cos(k / n)) * n**2
    exact = 1 - np.sin(np.outer(x, k)) @ (np.exp(-rate * end) / (n * np.tan(k / 2 / n)))

    def at(step: float) -> tuple[float, ...]:
        _, pressure, _ = film(x, LINEAR + injection("pressure = 1", end, round(end / step)), rule)
        return (float(np.abs(pressure - exact).max()),)

    return at


def modes_in_space(size: float) -> tuple[float, ...]:
    """With a few steps of backward Euler, exact in time: 1 - sum 2/k sin(kx) (1 + k^2 dt)^-m."""
    steps, end = 5, 0.2
    x = np.linspace(0, 1, round(1 / size) + 1)
    k = (np.arange(20000) + 0.5) * np.pi
    exact = 1 - np.sin(np.outer(x, k)) @ (2 / k * (1 + k**2 * end / steps) ** -steps)
    _, pressure, _ = film(x, LINEAR + injection("pressure = 1", end, steps), "backward-euler")
    return (float(np.abs(pressure - exact).max()),)


def cubic(rule: str) -> Callable[[float], tuple[float, ...]]:
    """Of d = w(x/sqrt(4t)), w(0) = 1.5, at t = 1; what has flowed in, all of it in the opening, is F0 sqrt(t)."""
    profile, flux = similarity(1.5)

    def at(size: float) -> tuple[float, ...]:
        x = np.linspace(0, 8, round(8 / size) + 1)
        found, _, opening = film(x, CUBIC + injection("pressure = 0.5", 1.0, round(8 / size)), rule)
        volume = float(np.sum((opening[1:] + opening[:-1]) / 2 * np.diff(x)))
        return float(np.abs(opening - (profile(x / 2) - 1)).max() / 0.5), abs(volume / flux - 1), found.open_books

    return at


BOOKS = Bar("energy balance", 1e-10)


def bar(what: str, rule: str, first: float, second: float, slack: float = 0.1) -> Bar:
    """Of rules of first and of second order."""
    return Bar(what, first if ORDER[rule] == 1 else second, ORDER[rule] - slack)


COARSE = (0.5, 0.25)
FINE = (*COARSE, 0.125)
PARTS = (1 / 8, 1 / 16, 1 / 32)
CASES = (
    *(Case(f"R05 half line, {rule}", (bar("pressure", rule, 3.2e-3, 2.2e-4), Bar("kept of the work", 1e-2), BOOKS),
           half_line(rule), FINE, COARSE, "h and dt") for rule in ORDER),
    Case("R05 constant rate, bdf2", (Bar("pressure", 1.2e-3, 1.9),), pumped, FINE, COARSE, "h and dt"),
    *(Case(f"R05 finite length, {rule}", (bar("pressure", rule, 3e-3, 1e-4),), modes_in_time(rule),
           (0.02, 0.01, 0.005), (0.02, 0.01), "dt") for rule in ORDER),
    Case("R05 finite length in space", (Bar("pressure", 1.3e-4, 1.9),), modes_in_space, PARTS, PARTS[:2]),
    *(Case(f"R05 cubic law, {rule}", (bar("opening", rule, 3e-3, 4e-4, 0.25), Bar("volume", 3e-3), BOOKS), cubic(rule),
           FINE, COARSE, "h and dt") for rule in ORDER),
)  # fmt: skip
