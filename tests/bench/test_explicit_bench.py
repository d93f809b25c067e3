"""`scripts/bench explicit` on two ranks, whose rows differ in number: each step of the sweep sends, so both make as many."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from _launch import without_ranks

ROOT = Path(__file__).parents[2]


@pytest.mark.serial
@pytest.mark.starts_ranks
def test_small_bench_ends_on_two_ranks(tmp_path):
    words = ["2000", "--cells", "triangles", "--parts", "2", "--states", "3", "--ranks", "2", "--out", tmp_path]
    done = subprocess.run(
        [sys.executable, ROOT / "scripts/benches/explicit.py", *words],
        capture_output=True, text=True, timeout=60, stdin=subprocess.DEVNULL,
        env=without_ranks() | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    (row,) = (json.loads(line) for line in done.stdout.splitlines() if line.startswith("{"))
    assert row["ranks"] == 2 and row["step_ms"] > 0.0 < row["sweep_ms"]
