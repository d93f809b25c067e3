"""S15, small: what absorbing sides send back of a P wave at 60 degrees and an S wave at 30, beside theory."""

import pytest

pytestmark = pytest.mark.serial


def test_bars_hold(tmp_path):
    from figures_stability.s15 import draw

    checks = draw(tmp_path, small=True)
    assert len(checks) == 2 and [check for check in checks if not check.ok] == []
    assert (tmp_path / "s15.png").exists() and "energy_back_by_theory" in (tmp_path / "s15.csv").read_text()
