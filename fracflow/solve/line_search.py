"""How far to go along a step of Newton, once whole steps lead in circles: by the residual, or by the energy.

Both see the balances only through a function of the fraction, so that they stand apart from what is solved.
"""

from __future__ import annotations

from collections.abc import Callable

DECREASE = 1e-4  # share of the residual that a fraction of 1 must take away
SHORTEST = 1e-4
POWER_LEFT = 0.5  # a whole step that leaves at most this share of the power, backwards, is not shortened
POWER_SOUGHT = 0.1
NARROW = 1e-6  # of a fraction: two that near have a change of status between them
MOST_TRIALS = 60


def by_residual(size: Callable[[float], float], before: float, change: float) -> float:
    """The first fraction of 1, just past the first ``change`` of a status, 1/2, 1/4 ... that lowers the residual.

    size    fraction -> residual there, inf where the laws have no answer
    before  residual at fraction 0
    change  fraction at which the first joint opens or closes, inf if none does
    """
    trials = [1.0, *([change] if change < 1.0 else []), *(0.5**n for n in range(1, 14))]
    best, lowest = 1.0, float("inf")
    for fraction in trials:
        found = size(fraction)
        if found <= (1.0 - DECREASE * fraction) * before:
            return fraction
        if found < lowest:
            best, lowest = fraction, found
    return max(best, SHORTEST)


def by_energy(power: Callable[[float], float], before: float, change: float) -> float:
    """The first fraction of 1, just past the first ``change`` of a status, that does not overshoot the lowest energy.

    Where all of them do, the fraction before at which the unbalanced forces do little work along the step.

    power   fraction -> out-of-balance force times step, positive while the energy falls
    before  power at fraction 0; not positive where the step does not lower the energy: then all of it is taken
    change  fraction at which the first joint opens or closes, inf if none does
    """
    after = power(1.0)
    if before <= 0.0 or after >= -POWER_LEFT * before:
        return 1.0
    end = 1.0
    if change < 1.0:
        end, after = change, power(change)
        if after >= -POWER_SOUGHT * before:
            return change
    low, high, at_low, at_high = 0.0, end, before, after
    for trial in range(MOST_TRIALS):
        chord = (low * at_high - high * at_low) / (at_high - at_low)
        fraction = chord if trial % 2 == 0 and low < chord < high else 0.5 * (low + high)
        here = power(fraction)
        if abs(here) <= POWER_SOUGHT * before:
            return fraction
        if here > 0.0:
            low, at_low = fraction, here
        else:
            high, at_high = fraction, here
        if high - low <= NARROW * high:
            break
    return high
