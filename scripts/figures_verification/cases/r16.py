"""R16: a fracture in plane strain driven by a viscous fluid, self-similar (KGD, M vertex; Adachi and Detournay, 2002).

Zero toughness, no leak-off, no lag; Q0 feeds both wings, m = 12 mu. With l = gamma (E' Q0^3 t^4/m)^(1/6), X = x/l,
    w = gamma (m Q0^3 t^2/E')^(1/6) W(X),  p = E' (m/(E' t))^(1/3) P(X):
elasticity W = (4/pi) int_0^1 P ln|(sqrt(1-X^2) + sqrt(1-S^2))/(sqrt(1-X^2) - sqrt(1-S^2))| dS, the flow
W^3 dP/dX = -int_X^1 W dS - (2/3) X W, and gamma = (2 int_0^1 W)^(-1/2).

W is a sum of (1-X^2)^(2/3) times Jacobi's polynomials, the tip's power, and of 4 sqrt(1-X^2) - 4 X^2 arccosh(1/X), whose
pressure 2 - pi |X| has the inlet's kink (their equations 40 to 50, in another basis); Newton, least squares at points.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from grids import Floats, graded, mirrored, onwards, tensor
from scipy.special import eval_jacobi, gamma, hyp2f1, roots_jacobi

from figures_verification.case import Bar, Case
from figures_verification.runs import Found, solve

TIP = 2 / 3  # the power of W at the tip


class Terms(NamedTuple):
    """Columns (n, terms) at places (n,): opening, pressure, its slope, and the volume from there to the tip."""

    opening: Floats
    pressure: Floats
    slope: Floats
    volume: Floats


def polynomial(n: int, x: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Of the opening (1-x^2)^(2/3) P_n^(2/3,2/3), n even, 0 < x < 1: its pressure is a finite Hilbert transform.

    The opening's slope is -2 m (1-x^2)^a P_m^(a,a), m = n + 1, a = -1/3; of that Erdogan's formula gives the transform.
    """
    m, a = n + 1, TIP - 1
    weight, values = (1 - x**2) ** a, eval_jacobi(m, a, a, x)
    slope = (m + 2 * a + 1) / 2 * eval_jacobi(n, a + 1, a + 1, x)
    factor = 2 ** (2 * a) * gamma(a) * gamma(m + a + 1) / (np.pi * gamma(m + 2 * a + 1))
    b, z = -m - 2 * a, (1 - x) / 2
    series = factor * hyp2f1(m + 1, b, 1 - a, z)
    by_x = -factor / 2 * (m + 1) * b / (1 - a) * hyp2f1(m + 2, b + 1, 2 - a, z)
    cot = 1 / np.tan(np.pi * a)
    transform = cot * weight * values - series
    change = cot * weight * (slope - 2 * a * x * values / (1 - x**2)) - by_x
    points, weights = roots_jacobi(30 + n, TIP, 0.0)
    s = 1 - (1 - x)[:, None] / 2 * (1 - points)
    volume = ((1 - x) / 2) ** (1 + TIP) * ((1 + s) ** TIP * eval_jacobi(n, TIP, TIP, s) @ weights)
    return (1 - x**2) ** TIP * eval_jacobi(n, TIP, TIP, x), m / 2 * transform, m / 2 * change, volume


def kinked(x: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Of the pressure 2 - pi x, 0 < x < 1."""
    root = np.sqrt(1 - x**2)
    steep = np.log((1 + root) / x)
    to_x = 2 * (x * root + np.arcsin(x)) - 4 * (x**3 * steep / 3 + (np.arcsin(x) - x * root) / 6)
    return 4 * root - 4 * x**2 * steep, 2 - np.pi * x, np.full(len(x), -np.pi), 2 * np.pi / 3 - to_x


def terms(count: int, x: Floats) -> Terms:
    """All of them at places 0 < x < 1."""
    columns = [*(polynomial(2 * i, x) for i in range(count - 1)), kinked(x)]
    return Terms(*(np.stack(part, axis=1) for part in zip(*columns, strict=True)))


class Similarity(NamedTuple):
    """The solution: gamma, and the coefficients of the terms."""

    extent: float
    coefficients: Floats

    def profiles(self, x: Floats) -> tuple[Floats, Floats]:
        """W and P at places 0 <= X < 1."""
        here = terms(len(self.coefficients), np.maximum(x, 1e-12))
        return here.opening @ self.coefficients, here.pressure @ self.coefficients


@cache
def similarity(count: int = 24) -> Similarity:
    """The solution by so many terms; 24 give gamma and W(0) to six digits, P(0) to 5e-6 of it."""
    x = np.cos(np.pi * (np.arange(3 * count) + 0.5) / (6 * count))
    parts, scale = terms(count, x), (1 - x) ** -TIP
    rest = parts.volume + TIP * x[:, None] * parts.opening
    c = np.r_[1.8, np.zeros(count - 2), 0.2]

    def residual(c: Floats) -> Floats:
        return scale * ((parts.opening @ c) ** 3 * (parts.slope @ c) + rest @ c)

    for _ in range(100):
        w, slope = parts.opening @ c, parts.slope @ c
        tangent = scale[:, None] * ((3 * w**2 * slope)[:, None] * parts.opening + (w**3)[:, None] * parts.slope + rest)
        size = np.linalg.norm(tangent, axis=0)
        change, length = -np.linalg.lstsq(tangent / size, residual(c), rcond=1e-14)[0] / size, 1.0
        while length > 1e-4 and np.linalg.norm(residual(c + length * change)) > np.linalg.norm(residual(c)):
            length /= 2
        c = c + length * change
        if np.abs(change).max() < 1e-11:
            break
    else:
        raise ArithmeticError(f"R16: Newton did not converge with {count} terms")
    whole = float((terms(count, np.array([1e-12])).volume @ c)[0])
    return Similarity((2 * whole) ** -0.5, c)


def inlet(modulus: float, viscosity: float, rate: float, time: float) -> tuple[float, float, float]:
    """Half length, opening and net pressure at the inlet; E', mu, Q0 of both wings, t."""
    found, m = similarity(), 12 * viscosity
    w, p = (float(profile[0]) for profile in found.profiles(np.zeros(1)))
    return (
        found.extent * (modulus * rate**3 * time**4 / m) ** (1 / 6),
        found.extent * (m * rate**3 * time**2 / modulus) ** (1 / 6) * w,
        modulus * (m / (modulus * time)) ** (1 / 3) * p,
    )


YOUNG, POISSON, VISCOSITY, RATE, STRESS = 30e9, 0.25, 1e-3, 1e-4, 1e4
END, STAGES = 40.0, 1  # the time; each stage is as long as all before it, from END/2: what was before is forgotten
LENGTH, OPENING, NET = inlet(YOUNG / (1 - POISSON**2), VISCOSITY, RATE, END)
FAR = 50 * LENGTH
# one wing, since the other is its mirror image
SCENE = f"""
rock.rock = {{{{youngs_modulus = {YOUNG}, poissons_ratio = {POISSON}}}}}
initial_stress = {{{{xx = -{STRESS}, yy = -{STRESS}, zz = -{STRESS}}}}}
fluid = {{{{viscosity = {VISCOSITY}, initial_pressure = 0, compressibility = 5e-10}}}}
support = [{{{{on = ["south", "north", "east"]}}}}, {{{{on = "west", components = ["x"]}}}}]
well = [{{{{name = "in", at = [0, 0], flow_rate = {RATE / 2}}}}}]
[method]
conductance = "{{mean}}"
flow_integrator = "{{rule}}"
coupling = "whole-lu"
[fracture.f]
normal_stiffness = 1e11
shear_stiffness = 1e11
aperture = {{aperture}}
friction_coefficient = 0.6
"""


def driven(joint: float, steps: int, aperture: float = 1e-7, rule: str = "bdf2", mean: str = "front") -> Found:
    """Run it to END on joints of ``joint`` LENGTH, in so many steps a stage."""
    size = joint * LENGTH
    growth = 1.0 + 0.8 * np.sqrt(joint)
    near = size * np.arange(round(1.3 / joint) + 1)
    x = onwards(near, graded(size, FAR - near[-1], growth))
    stages = []
    for k in range(STAGES, -1, -1):
        lasts = END / 2 ** min(k + 1, STAGES)
        stages.append(f'{{kind = "quasi-static", time_step = {lasts / steps!r}, steps = {steps}}}')
    mesh = tensor(x, mirrored(graded(size, FAR, growth)), {"f": (0.0, 0.0, near[-1])})
    text = SCENE.format(mean=mean, rule=rule, aperture=aperture)
    return solve(text, f"stage=[{', '.join(stages)}]", mesh=mesh)


def errors_of(found: Found) -> tuple[float, float, float]:
    """Of opening and net pressure at the inlet, and of the length, with their signs.

    The length is that which brings places of a quarter to seven tenths of the inlet's opening closest to the exact profile.
    """
    state = found.fractures[-1]
    x, w, p = state.points[:, 0], state.point["opening"], state.point["pressure"]
    middle = int(np.argmin(np.abs(x)))
    some = (x > 0) & (w > 0.25 * w[middle]) & (w < 0.7 * w[middle])
    places = np.linspace(0.0, 1.0, 2001)[1:-1]
    right = similarity().profiles(places)[0]
    right = right / similarity().profiles(np.zeros(1))[0]
    share = w[some] / w[middle]
    scaled = np.interp(-share, -right, places)
    length = float(scaled @ x[some] / (scaled @ scaled))
    return w[middle] / OPENING - 1, (p[middle] - STRESS) / NET - 1, length / LENGTH - 1


def errors(size: float) -> tuple[float, ...]:
    """Of opening, net pressure and length, at joints of ``size`` LENGTH and 2/size steps a stage."""
    return tuple(abs(each) for each in errors_of(driven(size, round(2 / size))))


BARS = (Bar("opening", 0.006, 0.3, 0.01), Bar("net pressure", 0.006, 0.4, 0.01), Bar("length", 0.005, 0.45, 0.01))
CASES = (Case("R16 KGD, viscosity, d0 0.1 um", BARS, errors, (1 / 10, 1 / 20, 1 / 40), (1 / 10, 1 / 14), "h and dt"),)
