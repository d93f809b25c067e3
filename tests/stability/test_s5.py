"""S5, small: tractions along the closed half of a joint by quadrature."""

import pytest

pytestmark = pytest.mark.serial


def test_bars_hold(tmp_path):
    from figures_stability.s5 import draw

    checks = draw(tmp_path, small=True)
    assert len(checks) == 4 and [check for check in checks if not check.ok] == []
    assert (tmp_path / "s5.png").exists() and "kn_h_over_E_prime" in (tmp_path / "s5.csv").read_text()
