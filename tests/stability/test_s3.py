"""The small map of pressure overshoot, with its bars."""

import numpy as np
import pytest
from figures_stability import s3

pytestmark = pytest.mark.serial


def test_small_map(tmp_path):
    checks = s3.draw(tmp_path, small=True)
    assert len(checks) == 6 and all(check.ok for check in checks), checks
    assert (tmp_path / "s3_pressure.png").stat().st_size > 30_000
    lines = [line for line in (tmp_path / "s3_pressure.csv").read_text().splitlines() if not line.startswith("#")]
    table = {
        name: column for name, column in zip(lines[0].split(","), np.loadtxt(lines[1:], delimiter=",").T, strict=True)
    }
    assert table["c_f dt/h^2"] == pytest.approx(np.logspace(-6, 1, 8))
    assert table["report backward-euler first"][0] == pytest.approx(1.0, abs=0.005)  # where-methods-fail 3
    assert table["consistent backward-euler first"][0] == pytest.approx(0.5, abs=0.005)
