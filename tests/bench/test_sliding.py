"""`scripts/bench sliding`: rows of one step, of all kinds, on a small mesh take few iterations."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from _launch import without_ranks

ROOT = Path(__file__).parents[2]
FEW = 18  # Krylov iterations of the worst linear solve; they are 6 to 16, most in steps of 1e9 s, and 30 are asked


@pytest.mark.serial
@pytest.mark.starts_ranks
def test_rows_of_all_kinds_take_few_iterations(tmp_path):
    clean = without_ranks()
    rows = "1 7 9 13 16 17 21 31".split()  # soft, stiff, wide, tight, unlike, brief, long, many fractures
    options = ["--unknowns", "2000", "--ways", "multigrid", "--rows", *rows, "--out", tmp_path]
    done = subprocess.run(
        [sys.executable, ROOT / "scripts/benches/sliding.py", "0", *options],
        capture_output=True, text=True, timeout=200, stdin=subprocess.DEVNULL, env=clean | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    found = json.loads((tmp_path / "sliding.json").read_text(encoding="utf-8"))["step"]
    assert len(found) == len(rows) and {row["fractures"] for row in found} == {1, 10, 100}
    assert {row["time_step"] for row in found} == {1e-3, 1.0, 1e9}
    assert all(0 < row["krylov"] <= FEW and row["newton"] > 0 and not row["failure"] for row in found), done.stdout
