"""W3: a bar hits a stiff joint (meshes/failures/bar_impact, k_n = 30 E/h of its mesh); mass at the contact, steppers.

d'Alembert, E = rho = L = v = 1: with a(t) the velocity that comes in, half of the bar's until the wave is back at t = 2, the
wall moves by w' = 2a - k w and the force is k w: F = 1 - exp(-kt), and from then on, s = t - 2, F = 2 (1 + ks) exp(-ks) - 1
until it comes to nothing and the bar leaves.
"""

from __future__ import annotations

import numpy as np
from figures_verification.runs import solve
from grids import Floats, tensor
from scipy.integrate import trapezoid

from figures_work_precision.problem import Answer, Method, Problem

STIFFNESS = 1200.0
CELLS, FEW = (5, 10, 20, 40), (5, 8, 10, 14)
SCENE = f"""
units = "none"
rock.rock = {{youngs_modulus = 1, poissons_ratio = 0, density = 1}}
rock.wall = {{rigid = true, density = 1}}
initial.rock.rock = {{velocity = [0, -1]}}
support = [{{on = "wall", components = ["x", "y", "rotation"]}}, {{on = "rock", components = ["x"]}}]
probe = [{{name = "face", at = [0, 0], on = "face", quantities = ["normal_traction"]}}]
[fracture.face]
normal_stiffness = {STIFFNESS}
shear_stiffness = 1
aperture = 1e3
friction_coefficient = 0
initial_normal_traction = 0
initial_shear_traction = 0
"""


def force(time: Floats) -> Floats:
    """Of the bar on the joint."""
    ks = STIFFNESS * np.maximum(time - 2, 0)
    held = -np.expm1(-STIFFNESS * time)
    return np.where(time < 2, held, np.maximum(2 * (1 + ks) * np.exp(-ks) - 1, 0))


def run(*settings: str, cells: float) -> Answer:
    """Mean of the absolute error of the force, over that of the force; a step is the time across a cell."""
    h = 1.0 / cells
    grid = tensor(np.array([0.0, h]), np.linspace(-h, 1, int(cells) + 2), {"face": (0.0, 0.0, h)}, below="wall")
    stage = f"stage=[{{kind = 'dynamic', time_step = {h}, end = 3}}]"
    found = solve(SCENE, stage, *settings, mesh=grid)
    wrong = np.abs(-found.probe("face", "normal_traction") - force(found.history["time"]))
    return Answer(float(trapezoid(wrong, found.history["time"]) / 2), found.seconds)


def method(name: str, *settings: str, most: float | None = None) -> Method:
    """Settings under [method]."""
    given = tuple(f"method.{setting}" for setting in settings)
    cells = FEW if settings == (LUMPED,) else CELLS  # it chatters, and each of its events ends a part of a step
    return Method(name, lambda each: run(*given, cells=each), cells, default=not settings, most=most)


ENDS, LUMPED = "events=at-step-ends", "contact=lumped"
PROBLEM = Problem(
    "W3", "A bar hits a joint: mass at the contact and steppers", "cells along the bar", "force",
    (
        method("newmark"),
        method("newmark, at step ends", ENDS),
        method("newmark, lumped contact", LUMPED, most=1.6),
        method("newmark, lumped contact, at step ends", LUMPED, ENDS, most=1.6),
        method("newmark, LU, at step ends", "coupling=whole-lu", ENDS),
        method("newmark, consistent mass", "mass=consistent"),
        method("hht", "stepper=hht"),
        method("generalised-alpha", "stepper=generalised-alpha"),
        method("generalised-alpha, 0", "stepper=generalised-alpha", "rho_infinity=0"),
        method("implicit-euler", "stepper=implicit-euler", most=0.2),
        method("explicit", "stepper=explicit", most=0.75),
    ),
    0.16,
)  # fmt: skip
