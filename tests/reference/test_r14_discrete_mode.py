"""R14: every mode of the discrete film, the shortest too, by every rule; more of it in test_cases."""

from functools import cache

import numpy as np
import pytest
from figures_verification.cases import r14
from figures_verification.cases.r14 import CUT, LAST, LEADING, PAIRS, RULES, STEP, rates

amplitudes = cache(r14.amplitudes)


@pytest.mark.parametrize("film", RULES)
@pytest.mark.parametrize("storage", PAIRS)
def test_decay_rate_of_every_mode(storage, film):
    """To round-off: the digits that the largest pressure leaves to the smallest amplitude, through the rule's formula."""
    found, exact = amplitudes(storage, film)[LAST], rates(storage)
    x = exact * STEP
    wrong = np.abs(RULES[film](*found) / x - 1)
    digits = np.finfo(float).eps * np.abs(found).max() / np.abs(found).min(axis=0)
    assert np.all(wrong <= 4 * digits * (1 + x) ** 2 / x), wrong
    assert wrong[:8].max() <= 1e-12


def test_error_of_the_longest_mode():
    """Leading error (qh)^2 times -1/12 lumped, 1/12, 1/4, 1/3 the report's, 5/12; (qh)^4 is left over."""
    for storage, coefficient in LEADING.items():
        rate = RULES["backward-euler"](*amplitudes(storage, "backward-euler")[LAST])[0] / STEP
        assert (rate / CUT[0] ** 2 - 1) / CUT[0] ** 2 == pytest.approx(coefficient, abs=0.15 * CUT[0] ** 2)
