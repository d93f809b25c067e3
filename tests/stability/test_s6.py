"""The small map of rupture along a bar, with its bars, and the published thresholds."""

import numpy as np
import pytest
from figures_stability import s6

pytestmark = pytest.mark.serial


def test_small_map(tmp_path):
    checks = s6.draw(tmp_path, small=True)
    assert len(checks) == 5 and all(check.ok for check in checks), checks
    assert (tmp_path / "s6.png").stat().st_size > 30_000
    lines = [line for line in (tmp_path / "s6.csv").read_text().splitlines() if not line.startswith("#")]
    table = dict(zip(lines[0].split(","), np.loadtxt(lines[1:], delimiter=",").T, strict=True))
    # where-methods-fail 5, found there to 2 %
    assert table["S l=1"] == pytest.approx([4.44, 5.31, 5.57], rel=0.02)
    assert table["S l=0.05"] == pytest.approx([6.88, 14.98, 30.05], rel=0.02)
    assert table["S weakening"] == pytest.approx([4.30, 4.90, 5.14], rel=0.02)
