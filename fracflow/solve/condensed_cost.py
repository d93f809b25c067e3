"""What a step costs with the rock condensed to its joints, and without: from how many steps of one length on it pays.

Costs are counted in LU factorisations of a rock of REFERENCE displacements, on one rank; the shares are what
scripts/bench condensed takes, and grow with the size as nested dissection in the plane has it.
"""

from __future__ import annotations

import math

REFERENCE, JUMPS = 1e5, 800.0  # sizes at which the shares below were measured
BESIDES = 0.3  # what an iteration on all unknowns takes beside LU: matrix, solve, balances
FACTORS = 1.7  # CHOLMOD's factors of the rock, with their ordering
COLUMN = 0.01  # a column of the compliance, solved for with others
SOLVE = 0.06  # a right side alone, with CHOLMOD's factors
SHARED = 0.18  # the same with those of MUMPS: on several ranks, or of all unknowns
BALANCES = 0.1  # of a condensed step
DENSE, ROWS = 0.04, 0.03  # an iteration on the jumps: its dense LU, and what goes by their number squared
LEAST = 0.02  # an iteration on all unknowns, and a step on the joints, however small the rock is
ENTRIES = 10.0  # numbers in both factors, of n log2 n
ITERATIONS = 2  # of Newton's method in a step in which few joints change
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


def condensing(unknowns: int, jumps: int) -> float:
    """Cost of factors and compliance [LU of REFERENCE]."""
    return FACTORS * _factor(unknowns) + jumps * COLUMN * _solve(unknowns)


def solves_per_factor(unknowns: int) -> float:
    """How many right sides LU solves for in the time that it takes itself."""
    return _factor(unknowns) / (SHARED * _solve(unknowns))


def fits(unknowns: int, jumps: int) -> bool:
    """Whether the compliance has no more numbers than both factors of the rock."""
    return jumps**2 <= ENTRIES * unknowns * math.log2(max(unknowns, 2))


def break_even(unknowns: int, jumps: int, iterations: float = ITERATIONS, ranks: int = 1) -> float:
    """Number of steps of one length from which on condensing the rock is cheaper; infinite where it never is."""
    saved = full_step(unknowns, iterations) - condensed_step(unknowns, jumps, iterations, ranks)
    return math.ceil(condensing(unknowns, jumps) / saved) if saved > 0.0 else math.inf
