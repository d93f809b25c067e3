"""S1 in small: every bar of the map, and that its files are there."""

import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.serial
def test_small_map_meets_its_bars(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "scripts"))
    from figures_stability import s1

    checks = s1.draw(tmp_path, small=True)
    assert len(checks) == 4 and all(check.ok for check in checks), checks
    assert (tmp_path / "s1.png").stat().st_size > 10_000
    lines = [line for line in (tmp_path / "s1.csv").read_text(encoding="utf-8").splitlines() if line[0] != "#"]
    columns = np.array([[float(value) for value in line.split(",")] for line in lines[1:]]).T
    table = dict(zip(lines[0].split(","), columns, strict=True))
    rho = 2.0 / table["dt_over_tau_d"] + 3.0 * table["p_over_kd"]
    assert np.allclose(rho, table["closed_form"])
    failed = np.isnan(table["plain"])
    assert failed.any() and not failed.all()  # the map has both sides of the boundary
    assert table["plain"][rho < 0.5].max() < table["plain"][rho < 0.9].max()  # slower towards it
    sys.modules.pop("figures_stability.s1")
