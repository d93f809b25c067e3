"""R01: the strength that the closed form has is Jaeger's; the runs against it are in test_cases."""

import pytest
from figures_verification.cases.r01 import COHESION, CONFINEMENT, COS, PATH, SIN, TAN, exact, strength


@pytest.mark.serial
def test_strength_is_jaegers():
    """sigma_1 - sigma_3 = 2 (C + sigma_3 tan phi) / ((1 - tan phi cot theta) sin 2 theta)."""
    jaeger = 2.0 * (COHESION + CONFINEMENT * TAN) / ((1.0 - TAN * COS / SIN) * 2.0 * SIN * COS)
    assert strength(1.0) == pytest.approx(CONFINEMENT + jaeger, rel=1e-14)
    assert exact(PATH[1][1:], 1.0)[0].max() == pytest.approx(6.346410161513775e6, rel=1e-12)
