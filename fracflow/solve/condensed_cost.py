"""Cost of a step with the rock condensed to its joints, and without: from how many steps of one length on it pays.

Costs are counted in LU factorisations of a rock of REFERENCE displacements, on one rank. The shares are those of scripts/bench
condensed, and grow with the size as for nested dissection in the plane. The scene alone decides which steps are condensed, so
a restarted run does the same.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from fracflow.integrators import EXPLICIT, Alphas, stepper_from
from fracflow.scene.boundary import Stage
from fracflow.scene.checks import against_condensing
from fracflow.scene.scene import Scene
from fracflow.solve.options import is_meant
from fracflow.solve.rock_cost import RockChoice, direct, factor_numbers

REFERENCE, JUMPS = 1e5, 800.0  # sizes at which the shares below were measured
BESIDES = 0.3  # cost of an iteration on all unknowns beside LU: matrix, solve, balances
FACTORS = 1.7  # CHOLMOD's factors of the rock, with their ordering
COLUMN = 0.01  # a column of the compliance, solved for with others
SOLVE = 0.06  # a right side alone, with CHOLMOD's factors
SHARED = 0.18  # the same with those of MUMPS: on several ranks, or of all unknowns
BALANCES = 0.1  # of a condensed step
# An iteration on the jumps: its dense LU, and what goes by their number squared. The LU has jumps that move alike once: at a
# node two joints have the same.
DENSE, ROWS = 0.005, 0.04
LEAST = 0.02  # an iteration on all unknowns, and a step on the joints, however small the rock is
OWN = 6e-3  # CPU s of an iteration besides: joint laws, balances, and what they are called by
ITERATIONS = 2  # of Newton's method in a step in which few joints change
SWIFT = 12.0  # solves in the time of a factorisation by UMFPACK, of 1e3 to 3e5 unknowns
USUAL = 3  # iterations of FGMRES with factors made before joints changed


def _factor(unknowns: int) -> float:
    return float((unknowns / REFERENCE) ** 1.5)


def _solve(unknowns: int) -> float:
    size = max(unknowns, 2)
    return size * math.log(size) / (REFERENCE * math.log(REFERENCE))


def full_step(unknowns: int, iterations: float = ITERATIONS) -> float:
    """Cost of a step on all unknowns, whose factors are new in every iteration or kept [LU of REFERENCE]."""
    besides = iterations * (BESIDES * _solve(unknowns) + LEAST)
    served = (iterations - 1.0) * (USUAL + 1.0) * SHARED * _solve(unknowns)
    return besides + min(iterations * _factor(unknowns), _factor(unknowns) + served)


def condensed_step(unknowns: int, jumps: int, iterations: float = ITERATIONS, ranks: int = 1) -> float:
    """Cost of a step on the joints, with two solves for the rock [LU of REFERENCE]."""
    rock = 2.0 * (SOLVE if ranks == 1 else SHARED) * _solve(unknowns) + BALANCES * unknowns / REFERENCE + LEAST
    return float(rock + iterations * (DENSE * (jumps / JUMPS) ** 3 + ROWS * (jumps / JUMPS) ** 2))


def seconds_condensed(unknowns: int, jumps: int) -> float:
    """CPU s of an iteration on the joints."""
    return condensed_step(unknowns, jumps) * direct(int(REFERENCE)).seconds / ITERATIONS + OWN


def seconds_by_factors(lasts: float) -> float:
    """CPU s of an iteration on all unknowns whose factorisation ``lasts`` so many."""
    return lasts * (1.0 + BESIDES) + OWN


def condensing_cost(unknowns: int, jumps: int) -> float:
    """Cost of factors and compliance [LU of REFERENCE]."""
    return FACTORS * _factor(unknowns) + jumps * COLUMN * _solve(unknowns)


def solves_per_factor(unknowns: int, swift: bool = False) -> float:
    """Number of right sides that LU solves for in the time of a factorisation, by MUMPS or, if ``swift``, by UMFPACK."""
    return SWIFT if swift else _factor(unknowns) / (SHARED * _solve(unknowns))


def fits(unknowns: int, jumps: int) -> bool:
    """Whether the compliance has no more numbers than both factors of the rock."""
    return jumps**2 <= factor_numbers(unknowns)


def break_even(unknowns: int, jumps: int, iterations: float = ITERATIONS, ranks: int = 1) -> float:
    """Number of steps of one length from which on condensing the rock is cheaper; infinite where it never is."""
    saved = full_step(unknowns, iterations) - condensed_step(unknowns, jumps, iterations, ranks)
    return math.ceil(condensing_cost(unknowns, jumps) / saved) if saved > 0.0 else math.inf


Key = tuple[float, float]
"""Shares of mass and damping, by which a time integrator enters the rock's matrix."""
SMALLEST = 500  # displacements: of fewer a factorisation is the least of a step (report_5_5: 3.4 against 4.1 CPU s)
WORTH_CONDENSING = 1.5  # times less work in a step: a step that is solved again for all unknowns outweighs a small gain
AT_LEAST = 2.0  # times the number of steps at which condensing the rock breaks even


@dataclass(frozen=True)
class Condensing:
    """Number of steps planned of each kind, infinite where events make them; from how many on condensing pays.

    has_events  stages may make steps of a kind that is known when they begin
    """

    steps: Mapping[Key, float]
    pays: float
    has_events: bool = False

    def is_worth(self, key: Key) -> bool:
        """Whether there are enough steps of a kind to trust the estimate."""
        return self.pays < math.inf and self.steps.get(key, 0.0) >= AT_LEAST * self.pays

    @property
    def any_worth(self) -> bool:
        """Whether steps of any kind are, or may be."""
        return (self.has_events and self.pays < math.inf) or any(self.is_worth(key) for key in self.steps)


def key_of(alphas: Alphas, damps: bool) -> Key:
    """Of a rule; ``damps``: rates of displacement meet dashpots."""
    return float(f"{alphas.mass:.12g}"), float(f"{alphas.a1 * damps:.12g}")


def condensing(scene: Scene, unknowns: int, jumps: int, ranks: int, damps: bool) -> Condensing:
    """The plan for so many displacements and jumps of joints."""
    clearly = full_step(unknowns) >= WORTH_CONDENSING * condensed_step(unknowns, jumps, ranks=ranks)
    pays = break_even(unknowns, jumps, ranks=ranks) if jumps and clearly and fits(unknowns, jumps) else math.inf
    steps: dict[Key, float] = {}
    for _, alphas, count in planned(scene):
        key = key_of(alphas, damps)
        steps[key] = steps.get(key, 0.0) + count
    return Condensing(steps, pays, any(stage.kind == "auto" for stage in scene.stage))


def is_chosen(scene: Scene, plan: Condensing, rock: RockChoice) -> bool:
    """Whether the program chooses to condense the rock: the scene allows it, its methods permit it, and it pays."""
    allowed = scene.model == "default" and scene.method.coupling == "auto" and scene.method.newton == "newton"
    suits = allowed and SMALLEST <= rock.unknowns and not rock.by_multigrid and not any(against_condensing(scene))
    return suits and plan.any_worth and not (is_meant("monolithic") or is_meant("solid"))


def planned(scene: Scene) -> Iterator[tuple[Stage, Alphas, float]]:
    """Stages, the rule of their steps and the number of these, infinite where it is not known; no explicit ones."""
    time, name = 0.0, scene.method.stepper
    for stage in scene.stage:
        count = stage.step_count(time)
        time, number = stage.finish(time), math.inf if count is None else float(count)
        if stage.kind != "dynamic":
            yield stage, Alphas(), number
        elif stage.time_step is not None and name not in EXPLICIT:
            yield stage, stepper_from(name, scene.method).alphas(stage.time_step), number
