"""S9, small: the normal traction of explicit ruptures, damped and not, on mirror images and not."""

import pytest

pytestmark = pytest.mark.serial


def test_bars_hold(tmp_path):
    from figures_stability.s9 import draw

    checks = draw(tmp_path, small=True)
    assert len(checks) == 6 and [check for check in checks if not check.ok] == []
    assert (tmp_path / "s9.png").exists() and "asymmetry" in (tmp_path / "s9.csv").read_text()
