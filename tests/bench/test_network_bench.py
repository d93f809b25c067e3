"""`scripts/bench network`: a network of pressures alone, with parts that nothing drains, at steps of all lengths."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from _launch import without_ranks

ROOT = Path(__file__).parents[2]


@pytest.mark.serial
@pytest.mark.starts_ranks
def test_steps_of_all_lengths_by_one_factorisation(tmp_path):
    done = subprocess.run(
        [sys.executable, ROOT / "scripts/benches/network.py", "2500", "--kinds", "random", "--out", tmp_path],
        capture_output=True, text=True, timeout=200, stdin=subprocess.DEVNULL, env=without_ranks() | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    (found,) = json.loads((tmp_path / "network.json").read_text(encoding="utf-8"))["network"]
    assert found["parts"] > 10 and 2000 < found["pressures"] < 3000
    assert [step["dt"] for step in found["step"]] == [1e-3, 1.0, 1e3, 1e6, 1e9]
    assert all(0 < each["numbers_a_pressure"] < 20 for each in found["alone"] if each["package"] != "umfpack")
