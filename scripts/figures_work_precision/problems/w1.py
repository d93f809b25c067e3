"""W1: a film between a wall and springs is filled from one end; rules of quasi-static stages and ways to couple.

Exact in time are the modes of the lumped film on the same mesh, p = 1 - sum c_j sin(k_j x) exp(-s_j t) (R05), so that all
of the error is of the rule. The plain fixed point (4.5) diverges at every step: walls answer the pressure by all they open.
"""

from __future__ import annotations

import numpy as np
from figures_verification.cases.r05 import LINEAR, injection
from figures_verification.runs import solve
from winkler import mesh

from figures_work_precision.problem import Answer, Method, Problem

CELLS, END = 32, 0.4
RULES = ("backward-euler", "bdf2", "trapezoid")
TURNS = ("aitken", "anderson", "added-storage", "plain")
STEPS, FEW = (4, 8, 16, 24, 32, 64), (4, 8, 16, 32)
TOLERANCES = (0.3, 0.1, 0.03, 0.01)


def exact() -> np.ndarray:
    """Pressures (CELLS + 1,) at the end."""
    x = np.linspace(0, 1, CELLS + 1)
    k = (np.arange(CELLS) + 0.5) * np.pi
    rate = 2 * (1 - np.cos(k / CELLS)) * CELLS**2
    return 1 - np.sin(np.outer(x, k)) @ (np.exp(-rate * END) / (CELLS * np.tan(k / 2 / CELLS)))


def run(*settings: str, steps: float) -> Answer:
    """Largest error of the pressure at the end, over the pressure pumped in."""
    x = np.linspace(0, 1, CELLS + 1)
    found = solve(LINEAR + injection("pressure = 1", END, int(steps)), *settings, mesh=mesh(x))
    _, order = np.unique(found.fractures[-1].points[:, 0], return_index=True)  # each piece has its own ends
    wrong = np.abs(found.fractures[-1].point["pressure"][order] - exact()).max()
    return Answer(float(wrong), found.seconds)


def method(rule: str, coupling: str) -> Method:
    """A rule with a coupling, or with a way to relax the fixed point."""
    turns = coupling in TURNS
    ways = ("coupling=fixed-point", f"fixed_point={coupling}") if turns else (f"coupling={coupling}",)
    settings = ("accuracy.max_cycles=200", *(f"method.{way}" for way in (f"film={rule}", *ways)))
    return Method(
        f"{rule}, {coupling}", lambda steps: run(*settings, steps=steps), FEW if turns else STEPS,
        fails=coupling == "plain",
    )  # fmt: skip


def by_tolerance(rule: str = "") -> Method:
    """A rule whose steps the program chooses, and the rule too if none is given."""
    given = (f"method.flow_integrator={rule}",) if rule else ()
    run_to = lambda tolerance: run(*given, f"accuracy.tolerance={tolerance}", steps=2)  # noqa: E731
    return Method(f"{rule or 'default'}, by tolerance", run_to, TOLERANCES, default=not rule)


PROBLEM = Problem(
    "W1", "A film that fills: rules without inertia and couplings", "steps, or tolerance", "pressure at the end",
    (
        *(method(rule, coupling) for rule in RULES for coupling in ("monolithic", "whole-lu", "added-storage")),
        *(method("backward-euler", turns) for turns in TURNS if turns != "added-storage"),
        by_tolerance("backward-euler"),
        by_tolerance(),
    ),
    0.03,
)  # fmt: skip
