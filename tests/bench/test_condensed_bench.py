"""`scripts/bench condensed` on a small mesh: its bar on displacements, its iterations, and that a missed bar is told."""

import csv
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.serial
@pytest.mark.starts_ranks
@pytest.mark.parametrize(("faster", "code"), [("0", 0), ("1e9", 1)])
def test_small_bench_keeps_its_bars_and_a_missed_one_is_exit_code_1(faster, code, tmp_path):
    clean = {k: v for k, v in os.environ.items() if not k.startswith(("OMPI_COMM", "PMIX", "OMPI_UNIVERSE"))}
    done = subprocess.run(
        [sys.executable, ROOT / "scripts/benches/condensed.py", "24", "16", "5", "--faster", faster, "--out", tmp_path],
        capture_output=True, text=True, timeout=200, stdin=subprocess.DEVNULL,
        env=clean | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.returncode == code, done.stdout + done.stderr
    assert ("missed" in done.stdout) == (code == 1)
    with (tmp_path / "condensed.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    assert [row["condensed_newton"] for row in rows] == [row["newton_newton"] for row in rows] and len(rows) == 5
    assert [row["condensed_sliding"] for row in rows] == [row["modified_sliding"] for row in rows]
    assert any(float(row["newton_sliding"]) > 0 for row in rows), "the scene slips"
