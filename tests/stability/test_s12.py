"""S12, small: the critical step of explicit steps, measured against that of the program; a longer one is taken in parts."""

import pytest

pytestmark = pytest.mark.serial


def test_bars_hold(tmp_path):
    from figures_stability.s12 import draw

    checks = draw(tmp_path, small=True)
    assert len(checks) == 6 and [check for check in checks if not check.ok] == []
    assert (tmp_path / "s12.png").exists() and "measured" in (tmp_path / "s12.csv").read_text()
