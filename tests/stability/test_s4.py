"""The small map of Newton on one joint, with its bars; and the closed forms it is judged by."""

import numpy as np
import pytest
from figures_stability import s4

pytestmark = pytest.mark.serial


def test_small_map(tmp_path):
    checks = s4.draw(tmp_path, small=True)
    assert len(checks) == 7 and all(check.ok for check in checks), checks
    assert (tmp_path / "s4_newton.png").stat().st_size > 30_000
    assert "# kind: 0 the root" in (tmp_path / "s4_newton.csv").read_text()


@pytest.mark.parametrize("spring", s4.SPRINGS)
@pytest.mark.parametrize("force", [-1e3, -5.0, -1e-2, 0.0, 0.5, 1.05, 40.0])
def test_the_root_balances(force, spring):
    """f_n - f_n0 = min(e/(1 + e/d_0), e, 1), rising, so that there is one root, or none."""
    e = s4.root(force, spring)
    if spring == 0.0 and force > 1.0:
        assert np.isnan(e)
        return
    assert e > -s4.D0
    joint = min(e / (1.0 + e / s4.D0) if e < 0.0 else e, 1.0)
    assert joint + spring * e == pytest.approx(force, rel=1e-9, abs=1e-15)
