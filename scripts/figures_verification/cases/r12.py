"""R12: steppers of the vibrating block: what a step makes of (u, dt v, dt^2 a) is a matrix of the papers, here its powers.

Newmark (1959); Hilber, Hughes and Taylor (1977); Chung and Hulbert (1993). The trapezoidal rule has the period of
2 atan(w dt/2)/dt and no damping; central differences that of 2 asin(w dt/2)/dt.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from sheets import ROOT

from figures_verification.case import Bar, Case
from figures_verification.runs import Floats, solve

Matrix = Callable[[float, float], Floats]


def newmark(beta: float, gamma: float, m: float = 0.0, f: float = 0.0) -> Matrix:
    """(u, dt v, dt^2 a) -> the next, of u'' + 2 xi w u' + w^2 u = 0: (4.1a) with (1-m) a_new + m a + (1-f) S_new + f S = 0."""

    def matrix(x: float, xi: float) -> Floats:
        new = [[1, 0, -beta], [0, 1, -gamma], [(1 - f) * x**2, (1 - f) * 2 * xi * x, 1 - m]]
        old = [[1, 1, 0.5 - beta], [0, 1, 1 - gamma], [-f * x**2, -f * 2 * xi * x, -m]]
        return np.linalg.solve(np.array(new, dtype=float), np.array(old, dtype=float))

    return matrix


def hht(alpha: float) -> Matrix:
    """Hilber, Hughes and Taylor (1977): a_new + (1 + alpha) S_new - alpha S = 0."""
    return newmark((1 - alpha) ** 2 / 4, 0.5 - alpha, f=-alpha)


def chung_hulbert(rho: float) -> Matrix:
    """Chung and Hulbert (1993)."""
    m, f = (2 * rho - 1) / (1 + rho), rho / (1 + rho)
    return newmark((1 - m + f) ** 2 / 4, 0.5 - m + f, m, f)


def euler(x: float, xi: float) -> Floats:
    """u_new = u + v_new, v_new = v + a_new, a_new + 2 xi x v_new + x^2 u_new = 0."""
    new = np.array([[1, -1, 0], [0, 1, -1], [x**2, 2 * xi * x, 1]], dtype=float)
    return np.linalg.solve(new, np.array([[1, 0, 0], [0, 1, 0], [0, 0, 0]], dtype=float))


SCENE = ROOT / "meshes" / "report_5_2" / "scene.toml"  # mass 1 on springs that add up to 1
LET_GO = (
    "fracture.default.law=linear", "load.0.traction=[0, 0]", "initial={rock = {block = {velocity = [1, 0]}}}",
)  # fmt: skip
STEPPERS: dict[str, tuple[Matrix, tuple[str, ...]]] = {
    "trapezoid": (newmark(0.25, 0.5), ()),
    "newmark 0.36, 0.7": (newmark(0.36, 0.7), ("method.newmark_beta=0.36", "method.newmark_gamma=0.7")),
    "hht -0.1": (hht(-0.1), ("method.stepper=hht",)),
    "hht -0.3": (hht(-0.3), ("method.stepper=hht", "method.hht_alpha=-0.3")),
    "generalised-alpha 0.8": (chung_hulbert(0.8), ("method.stepper=generalised-alpha",)),
    "implicit-euler": (euler, ("method.stepper=implicit-euler",)),
}


def errors(matrix: Matrix, settings: tuple[str, ...]) -> Callable[[float], tuple[float, ...]]:
    """Of the displacement at all of 40 steps, over the largest, by the time step."""

    def at(step: float) -> tuple[float, ...]:
        found = solve(SCENE, *LET_GO, *settings, f"stage.0.time_step={step}", f"stage.0.end={40 * step}")
        state, rows = np.array([0.0, step, 0.0]), []
        for _ in range(41):
            rows.append(state[0])
            state = matrix(step, 0.0) @ state
        got = found.probe("block", "displacement")[:, 0]
        return (float(np.abs(got - rows).max() / np.abs(rows).max()),)

    return at


CASES = tuple(
    Case(f"R12 stepper, {name}", (Bar("displacement", 1e-10),), errors(*given), (2.0, 0.5), (0.5,), "dt")
    for name, given in STEPPERS.items()
)
