"""R15: the onset of slip that grows by itself on a fault that weakens with slip, under fluid injection at its middle.

Strength (f_p - w d)(sigma - p), p = p_w erfc(|x|/sqrt(4 alpha t)) of a well of constant pressure. The onset is that of an
eigenvalue program of its own, scripts/nucleation.py (Uenishi and Rice 2003; Garagash and Germanovich 2012).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
from nucleation import Fault, of_a_well

from figures_verification.case import Bar, Case
from figures_verification.runs import solve

SHEAR, POISSON, STRESS, TRACTION, PUMPED, DIFFUSIVITY = 24e9, 0.25, 50e6, 24.6e6, 24e6, 0.15
PEAK, LOW, DISTANCE, HALF = 0.6, 0.35, 4.6875e-3, 30.0
STIFFNESS = 2e13

SCENE = f"""
rock.rock = {{youngs_modulus = {2 * SHEAR * (1 + POISSON)}, poissons_ratio = {POISSON}}}
initial_stress = {{xx = -{STRESS}, yy = -{STRESS}, zz = -{STRESS}, xy = {TRACTION}}}
fluid = {{viscosity = 1e-3, specific_weight = 9810, initial_pressure = 0}}
support = [{{on = ["west", "east", "south", "north"]}}]
[geometry]
domain = [-240, -240, 240, 240]
size = 24
size_at_fractures = SIZE
growth = 0.1
fracture = [{{name = "fault", points = [[-{HALF}, 0], [0, 0], [{HALF}, 0]]}}]
[fracture.fault]
law = "slip-weakening"
friction_coefficient = {PEAK}
dynamic_friction_coefficient = {LOW}
slip_weakening_distance = {DISTANCE}
normal_stiffness = {STIFFNESS}
shear_stiffness = {STIFFNESS}
aperture = 1
conductance = {DIFFUSIVITY / STIFFNESS}
"""
WELL = f"[[well]]\nname = 'injection'\nat = [0, 0]\npressure = {PUMPED}\n"
PRESSURE = of_a_well(PUMPED, DIFFUSIVITY)


@cache
def onset() -> float:
    """Its time in closed form but for an eigenvalue."""
    fault = Fault(SHEAR / (1 - POISSON), TRACTION, STRESS, PEAK, (PEAK - LOW) / DISTANCE, PRESSURE)
    return fault.onset((1.0, 100.0), (6.0, 14.0))[0]


def prescribed(size: float) -> str:
    """The same pressure, given along the fault and in time."""
    x, times = np.linspace(-HALF, HALF, 2 * round(HALF / size) * 2 + 1), np.arange(61.0)
    values = [[0.0] * len(x), *(PRESSURE(x, time).tolist() for time in times[1:])]
    return f"pressure = {{along = {(x + HALF).tolist()}, time = {times.tolist()}, value = {values}}}\n"


def errors(coupled: bool, time_step: float) -> Callable[[float], tuple[float, ...]]:
    """Of the time of the last state at rest, at a size [m] of joints."""

    def at(size: float) -> tuple[float, ...]:
        text = SCENE.replace("SIZE", repr(size))
        text += WELL if coupled else prescribed(size)
        stage = f"stage=[{{kind = 'quasi-static', end = 60, time_step = {time_step}}}]"
        found = solve(text, stage, "method.flow_integrator=bdf2", may_stop=True)
        return (abs(found.history["time"][-1] / onset() - 1.0),)

    return at


CASES = (
    Case("R15 nucleation, prescribed p", (Bar("onset", 0.02, asked=0.02),), errors(False, 4.0), (2.4, 1.2), (2.4,)),
    Case("R15 nucleation, coupled p", (Bar("onset", 0.02, asked=0.02),), errors(True, 1.0), (2.4, 1.2), ()),
)
