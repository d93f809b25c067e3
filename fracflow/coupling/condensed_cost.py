"""What a step costs with the rock condensed to its joints, and without: from how many steps on it pays.

Operations of nested dissection in the plane, weighed by how fast each kind goes; ratios as scripts/bench condensed finds them.
"""

from __future__ import annotations

import math

FACTORS = 126.0  # operations, of n^1.5: LU of n displacements
ENTRIES = 10.0  # numbers that both factors hold, of n log2 n
SINGLE = 17.0  # time of an operation of a single solve, which waits for memory; of one in the factorisation
MANY = 1.2  # the same with many right sides
DENSE = 0.25  # the same of a dense matrix
HALF = 0.75  # of LU: factors of a symmetric matrix
ITERATIONS = 4  # of Newton's method in a step in which joints slip


def factorisation(unknowns: int) -> float:
    """Cost of LU of the rock [operations]."""
    return FACTORS * unknowns**1.5


def solve(unknowns: int) -> float:
    """Cost of a right side [operations of a factorisation]."""
    return SINGLE * 2.0 * ENTRIES * unknowns * math.log2(max(unknowns, 2))


def compliance(unknowns: int, jumps: int) -> float:
    """Cost of factors and compliance [operations of a factorisation]."""
    return HALF * factorisation(unknowns) + jumps * solve(unknowns) * MANY / SINGLE


def full_step(unknowns: int, iterations: int = ITERATIONS) -> float:
    """Cost of a step with a factorisation in every iteration [operations of a factorisation]."""
    return iterations * (factorisation(unknowns) + solve(unknowns))


def condensed_step(unknowns: int, jumps: int, iterations: int = ITERATIONS) -> float:
    """Cost of a step on the joints, with two solves for the rock [operations of a factorisation]."""
    return 2.0 * solve(unknowns) + iterations * DENSE * 2.0 / 3.0 * jumps**3


def break_even(unknowns: int, jumps: int, iterations: int = ITERATIONS) -> float:
    """Number of steps of one length from which on it is cheaper to condense the rock; infinite where it never is."""
    saved = full_step(unknowns, iterations) - condensed_step(unknowns, jumps, iterations)
    return math.ceil(compliance(unknowns, jumps) / saved) if saved > 0.0 else math.inf
