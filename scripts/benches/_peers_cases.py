"""The problems H1, H2 and H3: grids, numbers for the inputs in peers/, and errors against the exact solutions."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache

import numpy as np
from _peers_grids import Grid, grid
from grids import Floats, graded
from numpy.polynomial.legendre import leggauss
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

FRICTION = math.tan(math.radians(30.0))
GAUSS = leggauss(20)


@dataclass(frozen=True)
class Found:
    """The result of a program on a fracture: positions and values at the nodes of its edges, (k, 2), or (k, 3) with middles.

    along   distance from the start of the fracture [m]
    slip, opening, pressure  [m], [m], [Pa]; the sign of the jumps is that of their sums
    """

    along: Floats
    slip: Floats
    opening: Floats
    pressure: Floats


@dataclass(frozen=True)
class Problem:
    """A case on one grid, and what tells how far a program's answer is from the exact one."""

    name: str
    made: Grid
    values: Mapping[str, float | int]
    errors: Callable[[Found], dict[str, float]]
    sides: tuple[str, ...]
    points: Mapping[str, int] = field(default_factory=dict)


def relative_l2(along: Floats, values: Floats, exact: Callable[[Floats], Floats], end: float = math.inf) -> float:
    """Root of int (v - v_exact)^2 over that of int v_exact^2, up to ``end``; of piecewise polynomials on edges."""
    s, weight = (GAUSS[0] + 1.0) / 2.0, GAUSS[1] / 2.0
    shapes = np.stack([1.0 - s, s])
    if values.shape[1] == 3:
        shapes = np.stack([(1.0 - s) * (1.0 - 2.0 * s), s * (2.0 * s - 1.0), 4.0 * s * (1.0 - s)])
    x, found = along[:, :2] @ np.stack([1.0 - s, s]), values @ shapes
    weights = np.abs(along[:, 1] - along[:, 0])[:, None] * weight * (x <= end)
    return float(np.sqrt(np.sum(weights * (found - exact(x)) ** 2) / np.sum(weights * exact(x) ** 2)))


def h1(cells: int, kind: str) -> Problem:
    """A crack |x| < 1 that slides in the middle of |x|, |y| < 20 m; ``cells`` on it, uniform or graded to its tips.

    Slip 4 (1 - nu^2)/E (tau + mu sigma_n) sqrt(a^2 - x^2) of the infinite body.
    """
    youngs, poisson, tension, shear, far = 10e9, 0.25, -10e6, 8e6, 20.0
    crack, growth = np.linspace(-1.0, 1.0, cells + 1), 1.25
    if kind == "graded":
        crack, growth = -np.cos(np.linspace(0.0, np.pi, cells + 1)), 1.0 + 12.0 / cells
    first = crack[1] - crack[0]
    beyond = 1.0 + graded(first, far - 1.0, growth, at_most=False)[1:]
    above = graded(first, far, growth, at_most=False)
    x, y = np.concatenate([-beyond[::-1], crack, beyond]), np.concatenate([-above[:0:-1], above])
    made = grid(x, y, len(above) - 1, slice(len(beyond), len(beyond) + cells + 1))
    largest = 4.0 * (1.0 - poisson**2) / youngs * (shear + FRICTION * tension)
    values = {
        "youngs": youngs, "poisson": poisson, "stiffness": 1e13, "normal": 1e13, "shear": 1e13, "cohesion": 0.0,
        "gamma": shear * 2.0 * (1.0 + poisson) / youngs,
        "epsilon": tension * (1.0 + poisson) * (1.0 - 2.0 * poisson) / (youngs * (1.0 - poisson)),
        "step": 1.0, "steps": 1, "end": 1.0,
    }  # fmt: skip

    def errors(found: Found) -> dict[str, float]:
        def exact(along: Floats) -> Floats:
            return largest * np.sqrt(np.maximum(1.0 - (along - 1.0) ** 2, 0.0))

        return {"slip": relative_l2(found.along, found.slip, exact)}

    return Problem("h1", made, values, errors, ("south", "north", "west", "east"))


@cache
def similarity(first: float) -> Callable[[Floats], Floats]:
    """w(xi) of (w^3 w')' + 2 xi w' = 0, w(0) = ``first``, w(inf) = 1, by shooting; aperture over d0, xi = x/sqrt(4 D0 t)."""

    def profile(flux: float) -> object:
        def slopes(xi: float, y: Floats) -> list[float]:
            slope = -y[1] / y[0] ** 3
            return [slope, 2.0 * xi * slope]

        return solve_ivp(slopes, (0.0, 8.0), [first, flux], "DOP853", rtol=1e-11, atol=1e-13, dense_output=True)

    guess = (first - 1.0) * first**1.5
    flux = brentq(lambda f: profile(f).y[0, -1] - 1.0, 0.8 * guess, 1.3 * guess, xtol=1e-13 * guess)
    shape = profile(flux).sol
    return lambda xi: shape(np.minimum(xi, 8.0))[0]


def h2(cells: int, steps: int, kind: str) -> Problem:
    """A film 25 m long between blocks of 0.05 m, pumped to 0.9 MPa at x = 0 for 100 s in ``steps``; Wijesinghe (1986).

    ``kind`` graded: cells grow from the well on as x^1.5.
    """
    length, height, end, aperture, stiffness, viscosity, pumped = 25.0, 0.1, 100.0, 1e-5, 1e11, 1e-3, 0.9e6
    x = length * np.linspace(0.0, 1.0, cells + 1) ** (1.5 if kind == "graded" else 1.0)
    made = grid(x, np.array([-height / 2.0, 0.0, height / 2.0]), 1)
    shape = similarity(1.0 + pumped / (stiffness * aperture))
    stretch = math.sqrt(4.0 * end * aperture**3 * stiffness / (12.0 * viscosity))
    values = {
        "youngs": 60e9, "viscosity": viscosity, "pumped": pumped, "stiffness": stiffness, "aperture": aperture,
        "step": end / steps, "steps": steps, "end": end,
    }  # fmt: skip

    def opening(along: Floats) -> Floats:
        return aperture * (shape(along.ravel() / stretch).reshape(along.shape) - 1.0)

    def errors(found: Found) -> dict[str, float]:
        return {
            "pressure": relative_l2(found.along[:, :2], found.pressure, lambda s: stiffness * opening(s), 12.0),
            "aperture": relative_l2(found.along, found.opening, opening, 12.0),
        }

    ends = {"inlet": int(made.fracture[0, 0]), "outlet": int(made.fracture[-1, 1])}
    return Problem("h2", made, values, errors, ("south", "west", "east"), ends)


def h3(cells: int) -> Problem:
    """A specimen of 1 m by 2 m, ``cells`` by twice as many, cut at 60 degrees and shortened by 2 mm in ten steps.

    sigma_1 = C/(cos b (sin b - mu cos b)), of a plane of weakness at b without lateral stress (Jaeger, Cook and Zimmerman);
    slip sin b is what the rock and the closure of the joint leave of the shortening.
    """
    youngs, poisson, cohesion, normal, shear, shortening = 10e9, 0.25, 1e6, 20e9, 10e9, 2e-3
    angle = math.radians(60.0)
    sin, cos = math.sin(angle), math.cos(angle)
    x = np.linspace(0.0, 1.0, cells + 1)
    middle, share = 1.0 + (x - 0.5) * math.tan(angle), np.linspace(0.0, 1.0, cells + 1)[:, None]
    heights = np.concatenate([share * middle, middle + (2.0 - middle) * share[1:]])
    made = grid(x, heights[:, 0], cells, heights=heights)
    stress = cohesion / (sin * cos - FRICTION * cos**2)
    stored = stress * (2.0 * (1.0 - poisson**2) / youngs + cos**3 / normal)
    exact = (shortening - stored) / sin
    values = {
        "youngs": youngs, "poisson": poisson, "cohesion": cohesion, "normal": normal, "shear": shear,
        "shortening": shortening, "step": 1.0, "steps": 10, "end": 10.0,
    }  # fmt: skip

    def errors(found: Found) -> dict[str, float]:
        return {"slip": relative_l2(found.along, found.slip, lambda s: np.full_like(s, exact))}

    return Problem("h3", made, values, errors, ("south", "north"), {"pin": 0})
