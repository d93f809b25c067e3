"""`scripts/bench condensed` on a small mesh: its bars on displacements, its iterations, and that a missed bar is told."""

import csv
import subprocess
import sys
from pathlib import Path

import pytest
from _launch import without_ranks

ROOT = Path(__file__).parents[2]


@pytest.mark.serial
def test_small_bench_keeps_its_bars_and_tells_a_missed_one(tmp_path):
    clean = without_ranks()
    done = subprocess.run(
        [sys.executable, ROOT / "scripts/benches/condensed.py", "24", "16", "5", "--faster", "1e9", "--out", tmp_path],
        capture_output=True, text=True, timeout=200, stdin=subprocess.DEVNULL,
        env=clean | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.returncode == 1, done.stdout + done.stderr
    bars = {line.split("│")[1].strip(): line for line in done.stdout.splitlines() if line.startswith("│")}
    assert "missed" in bars["CPU of the better rival over condensed"]
    assert all("ok" in bars[f"displacements, {name} against Newton"] for name in ("condensed", "modified"))
    with (tmp_path / "condensed.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    assert [row["condensed_newton"] for row in rows] == [row["newton_newton"] for row in rows] and len(rows) == 5
    assert [row["condensed_sliding"] for row in rows] == [row["modified_sliding"] for row in rows]
    assert any(float(row["newton_sliding"]) > 0 for row in rows), "the scene slips"


@pytest.mark.serial
@pytest.mark.starts_ranks
def test_rank_0_and_all_ranks_solve_for_the_same_sections():
    words = [sys.executable, ROOT / "scripts/benches/condensed_ranks.py", "16", "--steps", "2", "--fluid"]
    clean = without_ranks() | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(words, capture_output=True, text=True, timeout=200, stdin=subprocess.DEVNULL, env=clean)
    assert done.returncode == 0, done.stdout + done.stderr
    first, other, apart = done.stdout.splitlines()
    assert "rank 0" in first and "all ranks" in other and float(apart.split("by ")[1].split()[0]) > 0.0, (
        "no other way was taken"
    )
