"""The small map of the energy that contact makes, with its bars."""

import numpy as np
import pytest
from figures_stability import s2

pytestmark = pytest.mark.serial


def test_small_map(tmp_path):
    checks = s2.draw(tmp_path, small=True)
    assert len(checks) == 4 and all(check.ok for check in checks), checks
    assert (tmp_path / "s2.png").stat().st_size > 30_000
    lines = [line for line in (tmp_path / "s2.csv").read_text().splitlines() if not line.startswith("#")]
    table = dict(zip(lines[0].split(","), np.loadtxt(lines[1:], delimiter=",").T, strict=True))
    # where-methods-fail 4 has 11.2 until t = 3
    worst = table["energy lumped without events"][(table["kn_h_over_E"] == 30) & (table["c_dt_over_h"] == 1)]
    assert worst == pytest.approx(11.205, abs=0.001)
