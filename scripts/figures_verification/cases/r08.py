"""R08: slip driven by injection into a fault of constant friction, self-similar (Viesca, J. Fluid Mech. 928, A29, 2021).

Mode II, mu* = G/(1 - nu), pressure p0 + dp erfc(|x|/l), l = sqrt(4 alpha t), on the fault; |x| < a = lambda l slips, and
nothing is singular at its ends. The loss of friction, averaged over the crack by Abel's equation,
    Tau(z) = 2/pi int_0^{pi/2} erfc(z sin theta) d theta,
gives lambda: Tau(lambda) = T = (1 - tau/(f sigma')) sigma'/dp, and the slip
    delta = f dp a/mu* 2 int_0^{sqrt(1 - X^2)} (Tau(lambda sqrt(X^2 + v^2)) - T) dv, X = x/a.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from grids import Floats, graded, mirrored, onwards, tensor
from numpy.polynomial.legendre import leggauss
from scipy.optimize import brentq
from scipy.special import erfc

from figures_verification.case import Bar, Case
from figures_verification.runs import Found, solve

SHEAR, POISSON, FRICTION, STRESS, PUMPED, DIFFUSIVITY = 30e9, 0.25, 0.6, 50e6, 10e6, 0.1
LENGTH = 50.0  # half length of the rupture at the end
FAR = 40.0 * LENGTH
OUTER = SHEAR / (1 - POISSON)  # mu*
NODES, WEIGHTS = leggauss(200)


def loss(z: Floats) -> Floats:
    """Tau(z), z >= 0, of any shape."""
    angle = np.arcsin(np.minimum(1.0, 6.0 / np.maximum(z, 6.0)))[..., None]  # erfc(6) = 2e-17
    values = erfc(np.asarray(z)[..., None] * np.sin(angle * (NODES + 1) / 2))
    return (values @ WEIGHTS) * angle[..., 0] / np.pi


def extent(stress: float) -> float:
    """lambda(T)."""
    return float(brentq(lambda z: float(loss(np.array(z))) - stress, 1e-8, 4 / stress, xtol=1e-14))


def slip(x: Floats, stress: float) -> Floats:
    """The slip delta mu*/(f dp a) at X = x/a."""
    top = np.sqrt(np.maximum(1 - x**2, 0.0))[:, None]
    v = top * (NODES + 1) / 2
    values = loss(extent(stress) * np.hypot(x[:, None], v)) - stress
    return top[:, 0] * (values @ WEIGHTS)


SCENE = """
rock.rock = {{youngs_modulus = {young}, poissons_ratio = {poisson}}}
initial_stress = {{xx = -{total}, yy = -{total}, zz = -{total}, xy = {shear}}}
fluid = {{viscosity = {viscosity}, initial_pressure = 0}}
support = [{{on = ["south", "north", "east", "west"]}}]
[fracture.fault]
normal_stiffness = {normal}
shear_stiffness = {tangential}
aperture = {aperture}
friction_coefficient = {friction}
"""


def points(size: float) -> tuple[Floats, Floats]:
    """Points x with equal intervals ``size`` a to 1.2 a, then growing to the far sides; y growing from the fault.

    All of it: half of it would be on rollers at x = 0, where the pressure opens the fault.
    """
    first = size * LENGTH
    near = np.linspace(0.0, 1.2 * LENGTH, round(1.2 / size) + 1)
    growth = 1.0 + 0.8 * np.sqrt(size)  # its square is in the error
    away = graded(first, FAR - 1.2 * LENGTH, growth)
    return mirrored(onwards(near, away)), mirrored(graded(first, FAR, growth))


def pushed(
    stress: float, size: float, coupled: bool, triangles: bool = False, stiff: float = 1e4, steps: int = 10,
    coupling: str = "whole-lu", ramp: int = 1,
) -> Found:  # fmt: skip
    """Run it to a = LENGTH on cells ``size`` a; a prescribed pressure rises evenly in ``ramp`` steps."""
    x, y = points(size)
    reach = LENGTH / extent(stress)
    end = reach**2 / (4 * DIFFUSIVITY)
    normal = stiff * OUTER / LENGTH
    aperture = 500 * PUMPED / normal
    text = SCENE.format(
        young=2 * SHEAR * (1 + POISSON), poisson=POISSON, total=STRESS, normal=normal,
        shear=FRICTION * (STRESS - stress * PUMPED), tangential=normal, aperture=aperture,
        viscosity=aperture**3 * normal / (12 * DIFFUSIVITY), friction=FRICTION,
    )  # fmt: skip
    if coupled:
        text += f'[[well]]\nname = "in"\nat = [0, 0]\npressure = {PUMPED}\n'
        stage = f"stage=[{{kind = 'quasi-static', time_step = {end / steps}, steps = {steps}}}]"
    else:
        value = [[0.0] * len(x), (PUMPED * erfc(np.abs(x) / reach)).tolist()]
        text += f"pressure = {{along = {(x + FAR).tolist()}, time = [0, 1], value = {value}}}\n"
        stage = f"stage=[{{kind = 'steady', time_step = {1 / ramp}, steps = {ramp}}}]"
    mesh = tensor(x, y, {"fault": (0.0, -FAR, FAR)}, triangles)
    return solve(text, stage, "method.flow_integrator=bdf2", f"method.coupling={coupling}", mesh=mesh)


def errors(stress: float, coupled: bool, triangles: bool = False) -> Callable[[float], tuple[float, ...]]:
    """By the size of the cells."""
    return lambda size: errors_of(pushed(stress, size, coupled, triangles), stress)


def errors_of(found: Found, stress: float) -> tuple[float, ...]:
    """Of lambda and of the slip, over its largest."""
    state = found.fractures[-1]
    tip = front(np.abs(state.points[:, 0]) / LENGTH, state.point["plastic_slip"])
    return abs(tip - 1), error_of_slip(found, stress)


def front(x: Floats, slid: Floats) -> float:
    """Where slip^(2/3) would vanish, by a cubic, whose front of the exact slip is off by 2e-4; a parabola's is by 1e-3."""
    last = (slid > 0) & (x > 0.6 * x[slid > 0].max())
    return float(np.polyfit(slid[last] ** (2 / 3), x[last], min(3, len(np.unique(x[last])) - 1))[-1])


def error_of_slip(found: Found, stress: float) -> float:
    """The largest along the fault, over the largest slip."""
    state = found.fractures[-1]
    x = np.minimum(np.abs(state.points[:, 0]) / LENGTH, 1.0)
    right = FRICTION * PUMPED * LENGTH / OUTER * slip(x, stress)
    return float(np.abs(state.point["plastic_slip"] - right).max() / right.max())


BARS = (Bar("lambda", 0.01, asked=0.02), Bar("slip", 0.01))
LOADS = (0.2, 0.5, 0.8)
SIZES = (0.1, 0.05, 0.025)
CASES = (
    *(Case(f"R08 Viesca, T = {stress}, prescribed p, Q4", BARS, errors(stress, False), SIZES, (0.1,)) for stress in LOADS),
    Case("R08 Viesca, T = 0.5, prescribed p, T3", BARS, errors(0.5, False, triangles=True), SIZES, (0.025,)),
    *(Case(f"R08 Viesca, T = {stress}, coupled p, Q4", BARS, errors(stress, True), SIZES[:2], (0.1,)) for stress in LOADS),
)  # fmt: skip
