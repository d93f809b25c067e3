"""R07: cracks in elastic rock, pressurised, sheared and on springs; periodic rows are strips with smooth sides.

Sneddon's crack in a row of period W (Tada, Paris, Irwin, The Stress Analysis of Cracks Handbook, 7.1):
w = 4 p W/(pi E') arccosh(cos(pi x/W)/cos(pi a/W)), V = -4 p W^2/(pi E') ln cos(pi a/W); the slip of a sheared crack that
loses the traction p is the same. Springs k in an infinite body: w = sum b_n sin(n theta), x = a cos theta, with
E'/(4a) n pi/2 b_n + k sum_m M_nm b_m = p pi/2 delta_n1, M_nm = int_0^pi sin(n theta) sin(m theta) sin(theta) d theta.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from grids import Floats, graded, mirrored, onwards, tensor

from figures_verification.case import Bar, Case
from figures_verification.runs import Found, solve

HALF, YOUNG, POISSON = 1.0, 50e9, 0.25
MODULUS = YOUNG / (1 - POISSON**2)
PRESSURE, STRESS, FRICTION, SHEAR = 1e6, 10e6, 0.5, 8e6


def opening(x: Floats, period: float, pressure: float, modulus: float = MODULUS) -> Floats:
    """Of a crack |x| < HALF in a row."""
    ratio = np.maximum(np.cos(np.pi * x / period) / np.cos(np.pi * HALF / period), 1.0)
    return 4 * pressure * period / (np.pi * modulus) * np.arccosh(ratio)


def volume(period: float, pressure: float, modulus: float = MODULUS) -> float:
    """Of the same crack."""
    return float(-4 * pressure * period**2 / (np.pi * modulus) * np.log(np.cos(np.pi * HALF / period)))


def on_springs(x: Floats, stiffness: float, terms: int = 80) -> tuple[Floats, float]:
    """Opening under PRESSURE of a crack whose walls springs hold together, and its volume."""
    n = np.arange(1, terms + 1)
    even = lambda k: np.where(k % 2 == 0, 2 / (1.0 - np.where(k % 2 == 0, k, 0) ** 2), 0.0)  # noqa: E731
    mass = (even(np.subtract.outer(n, n)) - even(np.add.outer(n, n))) / 2
    matrix = np.diag(MODULUS / (4 * HALF) * n * np.pi / 2) + stiffness * mass
    b = np.linalg.solve(matrix, np.where(n == 1, PRESSURE * np.pi / 2, 0.0))
    return np.sin(np.outer(np.arccos(np.clip(x / HALF, -1, 1)), n)) @ b, np.pi / 2 * HALF * float(b[0])


SCENE = f"""
rock.rock = {{youngs_modulus = {YOUNG}, poissons_ratio = {POISSON}}}
stage = [{{kind = "steady", time_step = 1, steps = 1}}]
"""
BLOWN = """
fluid = {{viscosity = 1e-3}}
support = [{{on = ["west", "east"], components = ["x"]}}, {{on = "south", components = ["y"]}}]
[fracture.crack]
{law}
normal_stiffness = {stiffness}
shear_stiffness = 1e10
aperture = 1e-3
pressure = [[0, 0], [1, {pressure}]]
"""
SHEARED = f"""
initial_stress.yy = -{STRESS}
support = [{{on = ["west", "east"], components = ["y"]}}, {{on = "south", components = ["x"]}}]
load = [
  {{on = ["north", "south"], traction = "initial-stress"}},
  {{on = "north", traction = [[[0, 0], [1, {SHEAR}]], 0]}},
]
[fracture.crack]
normal_stiffness = 1e15
shear_stiffness = 1e15
aperture = 1e-3
friction_coefficient = {FRICTION}
"""

GEOMETRY = """
[geometry]
domain = [-5, -15, 5, 15]
size = 2
size_at_tips = {tip}
growth = {growth}
fracture = [{{name = "crack", points = [[-1, 0], [1, 0]]}}]
"""


def cells(size: float, period: float, triangles: bool = False) -> str:
    """The half 0 < x < W/2 of a cell of the row: from the tip, ``size``^2, all cells grow."""
    tip, growth = size**2, 1 + 2 * size
    inner = graded(tip, HALF, growth)
    x = onwards(HALF - inner[::-1], graded(tip, period / 2 - HALF, growth))
    return tensor(x, mirrored(graded(tip, 1.5 * period, growth)), {"crack": (0.0, 0.0, HALF)}, triangles)


def loaded(kind: str, period: float, size: float, mesh: str = "quads") -> Found:
    """Run a crack that is "sheared", "blown" or on "springs"."""
    law = 'law = "linear"' if kind == "springs" else "friction_coefficient = 0.5"  # walls that touch open at once
    blown = BLOWN.format(law=law, stiffness=MODULUS / (4 * HALF), pressure=PRESSURE)
    scene, grid = SCENE + (SHEARED if kind == "sheared" else blown), ""
    if mesh == "unstructured":
        scene += GEOMETRY.format(tip=size**2, growth=2 * size)
    else:
        grid = cells(size, period, mesh == "triangles")
    return solve(scene, mesh=grid)


def errors_of(found: Found, kind: str, period: float, mesh: str = "quads") -> tuple[float, ...]:
    """Of the jump in the middle, over x < 0.9 a, and of its sum."""
    load = SHEAR - FRICTION * STRESS if kind == "sheared" else PRESSURE
    state = found.fractures[-1]
    x, jump = np.abs(state.points[:, 0]), state.point["slip" if kind == "sheared" else "opening"]
    right, whole = opening(x, period, load), volume(period, load)
    if kind == "springs":
        right, whole = on_springs(x, MODULUS / (4 * HALF))
    middle, inner = int(np.argmin(x)), x < 0.9 * HALF
    sizes = np.abs(np.diff(state.points[state.pieces, 0], axis=1))[:, 0]
    total = float(np.sum(jump[state.pieces].mean(axis=1) * sizes)) * (1 if mesh == "unstructured" else 2)
    return (
        abs(jump[middle] / right[middle] - 1),
        float(np.abs(jump - right)[inner].max() / right[middle]),
        abs(total / whole - 1),
    )


def errors(kind: str, period: float, mesh: str = "quads") -> Callable[[float], tuple[float, ...]]:
    """By the size of the cells."""
    return lambda size: errors_of(loaded(kind, period, size, mesh), kind, period, mesh)


SIZES, QUICK = (0.2, 0.1, 0.05), (0.2, 0.1)
BARS = (Bar("w(0)", 4e-3, 1.7), Bar("w on x < 0.9 a", 4e-3, 1.7), Bar("volume", 6e-3, 1.7))
LOOSE = tuple(bar._replace(most=2 * bar.most, order=1.6) for bar in BARS)
ASKED = 0.01  # of w(0) under pressure, on a graded mesh


def sneddon(bars: tuple[Bar, ...]) -> tuple[Bar, ...]:
    """The same where the opening in the middle is asked for."""
    return bars[0]._replace(asked=ASKED), *bars[1:]


CASES = (
    Case("R07 Sneddon, row, Q4", sneddon(BARS), errors("blown", 10.0), SIZES, QUICK),
    Case("R07 Sneddon, row, T3", sneddon(BARS), errors("blown", 10.0, "triangles"), SIZES, QUICK),
    Case("R07 Sneddon, row, unstructured", sneddon(LOOSE), errors("blown", 10.0, "unstructured"), SIZES, QUICK),
    Case("R07 friction crack, row, Q4", BARS, errors("sheared", 10.0), SIZES, QUICK),
    Case("R07 friction crack, row, unstructured", LOOSE, errors("sheared", 10.0, "unstructured"), SIZES, QUICK),
    Case("R07 crack on springs, Q4", BARS, errors("springs", 200.0), SIZES, QUICK),
)
