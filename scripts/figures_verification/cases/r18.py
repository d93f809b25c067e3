"""R18: cracks, injection and a T in unbounded rock that is not meshed; exact solutions as in R07, R08 and R17, without a box.

Sneddon's crack opens by w = 4 p sqrt(a^2 - x^2)/E', of volume 2 pi p a^2/E'; the slip of a sheared crack that loses the
traction p is the same. Joints are equal.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.special import erfc

from figures_verification.case import Bar, Case
from figures_verification.cases import r07, r08, r17
from figures_verification.cases.r07 import FRICTION, HALF, MODULUS, POISSON, PRESSURE, SHEAR, STRESS, YOUNG
from figures_verification.runs import Found, solve

CRACK = f"""
rock.rock = {{youngs_modulus = {YOUNG}, poissons_ratio = {POISSON}}}
stage = [{{kind = "steady", time_step = 1, steps = 1}}]
geometry = {{domain = "unbounded", fracture = [{{name = "crack", points = [[-{HALF}, 0], [{HALF}, 0]]}}]}}
"""
BLOWN = f"""
fluid.viscosity = 1e-3
[fracture.crack]
aperture = 1e-3
normal_stiffness = {MODULUS / (4 * HALF)}
shear_stiffness = 1e10
pressure = [[0, 0], [1, {PRESSURE}]]
"""
SHEARED = f"""
initial_stress.yy = -{STRESS}
load = [{{stress.xy = [[0, 0], [1, {SHEAR}]]}}]
fracture.crack = {{aperture = 1e-3, normal_stiffness = 1e15, shear_stiffness = 1e15, friction_coefficient = {FRICTION}}}
"""


def loaded(kind: str, size: float) -> Found:
    """Run a crack that is "sheared", "blown" or on "springs", with joints of ``size`` a."""
    law = 'fracture.crack.law="linear"' if kind == "springs" else "fracture.crack.friction_coefficient=0.5"
    return solve(CRACK + (SHEARED if kind == "sheared" else BLOWN), f"geometry.size_at_fractures={size * HALF}", law)


def errors_of(found: Found, kind: str) -> tuple[float, ...]:
    """Of the jump in the middle, over x < 0.9 a, and of its sum."""
    load = SHEAR - FRICTION * STRESS if kind == "sheared" else PRESSURE
    state = found.fractures[-1]
    x, jump = np.abs(state.points[:, 0]), np.abs(state.point["slip" if kind == "sheared" else "opening"])
    right, whole = 4 * load / MODULUS * np.sqrt(np.maximum(HALF**2 - x**2, 0.0)), 2 * np.pi * load * HALF**2 / MODULUS
    if kind == "springs":
        right, whole = r07.on_springs(x, MODULUS / (4 * HALF))
    middle, inner = int(np.argmin(x)), x < 0.9 * HALF
    sizes = np.abs(np.diff(state.points[state.pieces, 0], axis=1))[:, 0]
    total = float(np.sum(jump[state.pieces].mean(axis=1) * sizes))
    return (
        abs(jump[middle] / right[middle] - 1),
        float(np.abs(jump - right)[inner].max() / right[middle]),
        abs(total / whole - 1),
    )


def errors(kind: str) -> Callable[[float], tuple[float, ...]]:
    """By the size of the joints over a."""
    return lambda size: errors_of(loaded(kind, size), kind)


INJECTED = """
rock.rock = {{youngs_modulus = {young}, poissons_ratio = {poisson}}}
initial_stress = {{xx = -{total}, yy = -{total}, zz = -{total}, xy = {shear}}}
fluid = {{viscosity = 1e-3, initial_pressure = 0}}
stage = [{{kind = "steady", time_step = 1, steps = 1}}]
[fracture.fault]
normal_stiffness = {normal}
shear_stiffness = {normal}
aperture = 1
friction_coefficient = {friction}
pressure = {{along = {along}, time = [0, 1], value = {value}}}
[geometry]
domain = "unbounded"
size_at_fractures = {size}
fracture = [{{name = "fault", points = [[-{half}, 0], [{half}, 0]]}}]
"""


def pushed(stress: float, size: float, ramp: int = 1, by_means: bool = False) -> Found:
    """Viesca's rupture to a = LENGTH on joints ``size`` a, in a fault of 1.5 a to each side, in ``ramp`` even steps.

    Pressures are those of the nodes. The nodal rule takes each for the joints around. At its kink, in the middle, that pushes
    too much by the slope times a third of a joint, and the slip there is off by h^2 log h. With ``by_means`` they are the means
    of the pressure along these joints, weighted with the node's share of the slip.
    """
    x = np.linspace(-1.5, 1.5, 2 * round(1.5 / size) + 1) * r08.LENGTH
    decay, joint = r08.extent(stress) / r08.LENGTH, x[1] - x[0]
    pressure = r08.PUMPED * erfc(np.abs(x) * decay)
    if by_means:
        away, weight = (1.0 + r08.NODES) / 2, r08.WEIGHTS / 2 * (1.0 - r08.NODES) / 2
        around = x[:, None, None] + joint * np.array([-1.0, 1.0])[:, None] * away
        pressure = r08.PUMPED * (erfc(np.abs(around) * decay) @ weight).sum(axis=1)
    text = INJECTED.format(
        young=2 * r08.SHEAR * (1 + r08.POISSON), poisson=r08.POISSON, total=r08.STRESS,
        shear=r08.FRICTION * (r08.STRESS - stress * r08.PUMPED), normal=1e6 * r08.OUTER / r08.LENGTH,
        friction=r08.FRICTION, along=(x - x[0]).tolist(), value=[[0.0] * len(x), pressure.tolist()],
        size=x[1] - x[0], half=-x[0],
    )  # fmt: skip
    return solve(text, f"stage=[{{kind = 'steady', time_step = {1 / ramp}, steps = {ramp}}}]")


def pressed(size: float) -> Found:
    """The T of R17 on joints of ``size``, a sixteenth of that at ends and where they meet."""
    return solve(unbounded(r17.SCENE.format(size=size, tip=size / 16, growth=0.2)))


def unbounded(text: str) -> str:
    """The text of a scene with a rectangle, without it."""
    kept = [line for line in text.splitlines() if not line.startswith(("support = ", "cells = ", "size = "))]
    return "\n".join('domain = "unbounded"' if line.startswith("domain = ") else line for line in kept)


SIZES, QUICK = (0.1, 0.04, 0.02), (0.1, 0.04)
BARS = (Bar("w(0)", 6e-5, 1.9, 1e-3), Bar("w on x < 0.9 a", 1e-3, 1.7), Bar("volume", 1e-4, 1.9))
SPRINGS = (BARS[0]._replace(most=1.5e-4, order=1.7), BARS[1], BARS[2]._replace(most=6e-4, order=1.7))
VIESCA = (Bar("lambda", 8e-4, 1.7, 1e-3), Bar("slip", 7e-4, 1.5, 1e-3))
T = tuple(bar._replace(most=0.004, order=0.5, asked=0.005) for bar in r17.BARS)
CASES = (
    Case("R18 Sneddon, unmeshed", BARS, errors("blown"), SIZES, QUICK),
    Case("R18 friction crack, unmeshed", BARS, errors("sheared"), SIZES, ()),
    Case("R18 crack on springs, unmeshed", SPRINGS, errors("springs"), SIZES, QUICK),
    *(
        Case(
            f"R18 Viesca, T = {stress}, unmeshed", VIESCA,
            lambda size, t=stress: r08.errors_of(pushed(t, size, by_means=True), t),
            (0.08, 0.04, 0.02), (0.04,) if stress == 0.5 else (),
        )
        for stress in r08.LOADS
    ),
    Case("R18 T of two fractures, unmeshed", T, lambda size: r17.errors_of(pressed(size)), (4.0, 2.0), ()),
)  # fmt: skip
