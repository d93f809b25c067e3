"""The small map of what grows of itself, with its bars."""

import numpy as np
import pytest
from figures_stability import s7

pytestmark = pytest.mark.serial


def test_small_map(tmp_path):
    checks = s7.draw(tmp_path, small=True)
    assert len(checks) == 4 and all(check.ok for check in checks), checks
    assert (tmp_path / "s7.png").stat().st_size > 30_000
    lines = [line for line in (tmp_path / "s7.csv").read_text().splitlines() if not line.startswith("#")]
    table = dict(zip(lines[0].split(","), zip(*[line.split(",") for line in lines[1:]], strict=True), strict=True))
    contrast, friction, growth = (
        np.array([float(value) for value in table[name] if value])
        for name in ("contrast", "friction", "growth_resolved")
    )
    assert np.all((growth[: len(contrast)] > 1e-3) == (contrast > 1.0))
    at = {(c, f): g for c, f, g in zip(contrast, friction, growth, strict=False)}
    assert at[1.2, 0.84] / at[1.2, 0.3] == pytest.approx(0.84 / 0.3, rel=0.05)  # as good as linear in the friction
