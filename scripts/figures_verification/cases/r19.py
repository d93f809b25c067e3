"""R19: a slider with rate-and-state friction, with inertia and without: stick-slip against a stiff ODE solver.

Two squares of rock, one above the other, move along the joint between them; their far sides are driven apart, and ties keep
them upright. Each wall has the lumped mass of half a square and, where inertia counts, half an infinite bar beside it, into
which it radiates exactly: an absorbing side. Without one a slider that has stuck rings on the joint for ever.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from grids import edges_of, msh, quads_of
from scipy.integrate import solve_ivp

from figures_verification.case import Bar, Case, Floats
from figures_verification.runs import Found, solve

SHEAR, DENSITY = 3e8, 2700.0
A, B, D_C, SIGMA, V0, F0, START = 0.010, 0.015, 2.5e-4, 1e7, 1e-6, 0.6, 6e6
JOINT, RATE = 2e10, 1e-5
"""Shear stiffness of the joint; rate at which the sides are driven apart."""
SPRING, MASS, BAR = SHEAR / 2, DENSITY / 4, DENSITY * np.sqrt(2 * SHEAR / DENSITY) / 4
"""Of the slip between two walls in series, each of a square of 1 m."""
IMPEDANCE = 0.5 * np.sqrt(DENSITY * SHEAR)
FAST = 1e-3
"""Rate at whose onset a cycle begins and ends."""
SCENE = f"""
rock.rock = {{{{youngs_modulus = {2 * SHEAR}, poissons_ratio = 0, density = {DENSITY}}}}}
initial_stress = {{{{xx = -{SIGMA}, yy = -{SIGMA}, xy = {START}}}}}
support = [
  {{{{on = "south", displacement = {{{{x = [[0, 0], [1e4, -{0.5e4 * RATE}]], y = 0}}}}}}}},
  {{{{on = "north", displacement = {{{{x = [[0, 0], [1e4, {0.5e4 * RATE}]], y = 0}}}}}}}},
]
tie = [{{{{on = ["west", "east"]}}}}]
absorbing = [{{{{on = ["west"], without_inertia = "free"}}}}]
probe = [{{{{name = "seam", at = [0, 1], on = "seam", quantities = ["sliding_rate", "plastic_slip"]}}}}]
accuracy.slip_share = {{share}}
stage = [{{stage}}]
[fracture.seam]
law = "rate-and-state"
normal_stiffness = 1e12
shear_stiffness = {JOINT}
aperture = 1e-3
friction_coefficient = {F0}
reference_slip_rate = {V0}
direct_effect = {A}
evolution_effect = {B}
characteristic_slip = {D_C}
initial_slip_rate = {{first}}
"""


def squares() -> str:
    """The mesh."""
    node = np.arange(6).reshape(3, 2)
    points = np.array([[x, y] for y in (0.0, 1.0, 2.0) for x in (0.0, 1.0)])
    groups = [("rock", quads_of(node)), ("seam", edges_of(node[1])), ("south", edges_of(node[0]))]
    sides = [("north", edges_of(node[2])), ("west", edges_of(node[:, 0])), ("east", edges_of(node[:, 1]))]
    return msh(points, [*groups, *sides])


def psi(first: float) -> float:
    """f0 + b ln(V0 theta/D_c) at which friction carries the initial traction at a rate."""
    return float(A * (np.log(2.0 * V0 / first) + START / (A * SIGMA) - np.log(2.0)))


@cache
def moved(first: float, until: float) -> tuple[Floats, Floats, Floats]:
    """With inertia: times of onsets, and times and slips from the start at an initial rate on."""

    def rate(jump: Floats, log_theta: Floats) -> Floats:
        x, y = (START + JOINT * jump) / (A * SIGMA), (F0 + B * (log_theta + np.log(V0 / D_C))) / A
        return V0 * (np.exp(x - y) - np.exp(-x - y))

    def moves(time: float, state: Floats) -> list[Floats]:
        walls, speed, jump, log_theta = state
        slip = rate(jump, log_theta)
        pull = SPRING * (RATE * time - walls) - BAR * speed - JOINT * jump
        return [speed, pull / MASS, speed - slip, np.exp(-log_theta) - np.abs(slip) / D_C]

    def rises(_: float, state: Floats) -> float:
        return float(rate(state[2], state[3]) - FAST)

    rises.direction = 1.0  # type: ignore[attr-defined]
    theta = D_C / V0 * np.exp((psi(first) - F0) / B)
    limits = dict(rtol=1e-9, atol=[1e-13, 1e-13, 1e-15, 1e-10], max_step=until / 50)
    start = [0.0, 0.0, 0.0, np.log(theta)]
    found = solve_ivp(moves, (0.0, until), start, "Radau", events=rises, **limits)
    return found.t_events[0], found.t, found.y[0] - found.y[2]


@cache
def slid(first: float, until: float) -> Floats:
    """Without inertia, radiating: times of onsets."""
    soft = SPRING * JOINT / (SPRING + JOINT)

    def slides(_: float, state: Floats) -> list[float]:
        v, theta = np.exp(state)
        z = state[0] - np.log(2.0 * V0) + (F0 + B * np.log(theta * V0 / D_C)) / A
        direct, grows = SIGMA * A / np.sqrt(1.0 + np.exp(-2.0 * z)), 1.0 / theta - v / D_C
        return [(soft * (RATE - v) - direct * B / A * grows) / (direct + IMPEDANCE * v), grows]

    def rises(_: float, state: Floats) -> float:
        return float(state[0] - np.log(FAST))

    rises.direction = 1.0  # type: ignore[attr-defined]
    start = [np.log(first), np.log(D_C / V0) + (psi(first) - F0) / B]
    return solve_ivp(slides, (0.0, until), start, "LSODA", rtol=1e-10, atol=1e-12, events=rises).t_events[0]


def ran(stage: str, share: float, first: float, *settings: str) -> Found:
    """A run of one stage."""
    return solve(SCENE.format(stage=stage, share=share, first=first), *settings, mesh=squares())


def onsets(found: Found) -> Floats:
    """Times at which the rate of slip rises through ``FAST``, of lines of its logarithm between the middles of steps."""
    steps = np.diff(found.history["time"])
    times, rates = found.history["time"][1:] - 0.5 * steps, found.probe("seam", "sliding_rate")[1:]
    times, size = times[steps > 0.0], np.log(rates[steps > 0.0] / FAST)
    n = np.flatnonzero((size[:-1] < 0.0) & (size[1:] >= 0.0))
    return np.asarray(times[n] - size[n] / (size[n + 1] - size[n]) * (times[n + 1] - times[n]))


def period_errors(found: Found, exact: Floats) -> tuple[float]:
    """Of the time between two onsets."""
    return (abs(float(np.diff(onsets(found))[0] / np.diff(exact)[0] - 1.0)),)


def in_auto(size: float) -> tuple[float]:
    """Cycle with inertia in its events, in steps of slip ``size`` D_c, with inertia at most 1 ms long."""
    stage = '{kind = "auto", time_step = 8, dynamic_time_step = 1e-3, rest_periods = 3, end = 803}'
    return period_errors(ran(stage, size, 1e-6, f"accuracy.dynamic_slip_share={size}"), moved(1e-6, 803.0)[0])


def quasi_dynamic(size: float) -> tuple[float]:
    """Cycle without inertia, in steps of slip ``size`` D_c."""
    exact = slid(1e-6, 1000.0)
    stage = f'{{kind = "quasi-static", time_step = 8, end = {exact[1] + 0.1:.6g}}}'
    return period_errors(ran(stage, size, 1e-6), exact)


def event(size: float) -> tuple[float, float]:
    """Slip of an event on its way, at 20 ms, and after it, at 60 ms; steps of ``size`` ms."""
    _, times, slips = moved(0.02, 0.06)
    found = ran(f'{{kind = "dynamic", time_step = {1e-3 * size}, end = 0.06}}', 0.1, 0.02)
    at, slip = found.history["time"], np.abs(found.probe("seam", "plastic_slip"))
    return tuple(abs(float(np.interp(t, at, slip) / np.interp(t, times, slips) - 1.0)) for t in (0.02, 0.06))


EVENT = (Bar("slip at 20 ms", 5e-4, 1.9), Bar("slip", 1e-4, 1.9, 1e-4))
CASES = (
    Case("R19 slider, event with inertia", EVENT, event, (0.4, 0.2, 0.1), (0.2, 0.1), "dt"),
    Case("R19 slider, cycle with inertia", (Bar("period", 1e-4, None, 1e-4),), in_auto, (0.1, 0.05), (), "dt"),
    Case("R19 slider, quasi-dynamic cycle", (Bar("period", 5e-5, 1.9, 1e-4),), quasi_dynamic, (0.1, 0.05), (), "dt"),
)
