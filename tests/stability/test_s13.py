"""S13, small: slow slip by rate-and-state friction on joints of half L_b in long steps, beside the error predicted."""

import pytest

pytestmark = pytest.mark.serial


def test_bars_hold(tmp_path):
    from figures_stability.s13 import draw

    checks = draw(tmp_path, small=True)
    assert len(checks) == 3 and [check for check in checks if not check.ok] == []
    assert (tmp_path / "s13.png").exists() and "joint_over_l_b" in (tmp_path / "s13.csv").read_text()
