"""R14: the discrete decay rate of a pressure mode cos(qx) on a uniform mesh, for every pair of matrices and every rule.

A film on springs k_n, closed at both ends, conductance c: K_F p + E_F v = 0 with k_n w = J^-1 E p, J lumped. On a uniform
mesh cos(qx) is a mode of all of them; with e = (2 + cos qh)/3, e_F = (1 + cos qh)/2 and 1 for lumped matrices
    s_h = c k_n 2 (1 - cos qh)/h^2 / (w_force w_storage).
In space-time a rule multiplies the mode by what its formula says of s_h dt, from which s_h is had back without error.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import winkler

from figures_verification.case import Bar, Case
from figures_verification.cases.r05 import LINEAR
from figures_verification.runs import Floats, solve

PAIRS = {
    "lumped": ("lumped", "lumped"),
    "consistent": ("e", "e"),
    "averaging": ("e_F", "e_F"),
    "report": ("e", "e_F"),
    "consistent-lumped": ("e", "lumped"),
}
WEIGHT = {"e": lambda c: (2 + c) / 3, "e_F": lambda c: (1 + c) / 2, "lumped": lambda c: 1 + 0 * c}
LEADING = {"lumped": -1 / 12, "consistent": 1 / 4, "averaging": 5 / 12, "report": 1 / 3, "consistent-lumped": 1 / 12}
RULES = {  # s dt from three successive amplitudes after the pulse, where rules begin anew with a step of backward Euler
    "backward-euler": lambda a0, a1, a2: a0 / a1 - 1,
    "trapezoid": lambda a0, a1, a2: 2 * (a0 - a1) / (a0 + a1),
    "bdf2": lambda a0, a1, a2: (2 * a1 - a0 / 2) / a2 - 3 / 2,
}
N = 16
MODES = np.arange(1, N)
CUT = np.pi * MODES / N  # q h, with h = 1
STEP = 1.0
LAST = slice(2, 5)  # of the amplitudes
PULSE = f"""
[[well]]
name = "pulse"
at = {{fracture = "film", end = "start"}}
flow_rate = {{time = [0, {STEP}], value = [1, 0], interpolation = "step"}}
[[stage]]
kind = "quasi-static"
time_step = {STEP}
steps = 4
""" + "".join(f'[[probe]]\nname = "{i}"\nat = [{i}, 0]\non = "film"\nquantities = ["pressure"]\n' for i in range(N + 1))


def amplitudes(storage: str, film: str) -> Floats:
    """Amplitudes (n, k) of the modes in the pressures of a run: at the start, with a pulse at one end, and after it."""
    x = np.arange(N + 1)
    settings = (f"method.storage={storage}", f"method.flow_integrator={film}", "method.coupling=whole-lu")
    found = solve(LINEAR + PULSE, *settings, mesh=winkler.mesh(x.astype(float)))
    pressure = np.array([found.probe(str(i), "pressure") for i in x])
    ends = np.where((x == 0) | (x == N), 0.5, 1.0)
    return (np.cos(np.outer(CUT, x)) * ends @ pressure).T * 2 / N


def rates(storage: str) -> Floats:
    """s_h of all modes, c = k_n = h = 1."""
    force, volume = (WEIGHT[name](np.cos(CUT)) for name in PAIRS[storage])
    return 2 * (1 - np.cos(CUT)) / (force * volume)


def errors(storage: str) -> Callable[[float], tuple[float, ...]]:
    """Of the rates of the longer half of the modes, by every rule."""

    def at(size: float) -> tuple[float, ...]:
        x = rates(storage)[: N // 2] * STEP
        found = [rule(*amplitudes(storage, film)[LAST, : N // 2]) for film, rule in RULES.items()]
        return (float(np.abs(np.array(found) / x - 1).max()),)

    return at


CASES = tuple(
    Case(f"R14 modes, {storage}", (Bar("decay rates", 1e-12),), errors(storage), (STEP,), (), "dt") for storage in PAIRS
)
