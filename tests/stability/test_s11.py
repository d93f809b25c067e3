"""S11, small: iterations of multigrid for rock that slides, beside those predicted and of BoomerAMG alone."""

import pytest

pytestmark = pytest.mark.serial


def test_bars_hold(tmp_path):
    from figures_stability.s11 import draw

    checks = draw(tmp_path, small=True)
    assert len(checks) == 3 and [check for check in checks if not check.ok] == []
    assert (tmp_path / "s11.png").exists() and "predicted by size" in (tmp_path / "s11.csv").read_text()
