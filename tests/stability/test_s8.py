"""S8, small: digits of a known traction."""

import pytest

pytestmark = pytest.mark.serial


def test_bars_hold(tmp_path):
    from figures_stability.s8 import draw

    checks = draw(tmp_path, small=True)
    assert len(checks) == 3 and [check for check in checks if not check.ok] == []
    assert (tmp_path / "s8.png").exists() and "predicted" in (tmp_path / "s8.csv").read_text()
