"""S14, small: slip that weakens over a joint whose fluid is shut in, held by dilation, beside the boundary predicted."""

import pytest

pytestmark = pytest.mark.serial


def test_bars_hold(tmp_path):
    from figures_stability.s14 import draw

    checks = draw(tmp_path, small=True)
    assert len(checks) == 3 and [check for check in checks if not check.ok] == []
    assert (tmp_path / "s14.png").exists() and "hardening_over_k" in (tmp_path / "s14.csv").read_text()
