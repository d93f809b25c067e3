"""`scripts/bench explicit` on two ranks, where each makes as many steps of the sweep, which send; and the cost of a section."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
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


@pytest.mark.serial
def test_cost_of_a_section(tmp_path):
    """Of two small rocks, whose faults are equally long; noise may hide the cost itself."""
    sys.path.insert(0, str(ROOT / "scripts" / "benches"))
    from explicit import Way, section

    row = section(2000, "triangles", [1, 2], Way(2, 4, 1, tmp_path / "run"))
    assert (
        row["sections"][1] == 2 * row["sections"][0] > 0 < row["ns_of_unknown"]["sweep"] < row["ns_of_unknown"]["step"]
    )
    (nanoseconds,) = row["ns_of_section"]
    for (count,), each in zip(row["section_in_unknowns"].values(), row["ns_of_unknown"].values(), strict=True):
        assert abs(count * each - nanoseconds) < 0.06 * each + 1e-3 * abs(nanoseconds) + 0.1  # counts have one decimal


def test_local_steps_of_powers_of_two():
    """A cell goes at the pace of its quickest node: of steps 1, 3, 8 and 8 in a row these have 1, 1, 2 and 8."""
    sys.path.insert(0, str(ROOT / "scripts" / "benches"))
    from local_steps import gain

    critical, cells = np.array([1.0, 3.0, 8.0, 8.0]), np.array([[0, 1, -1], [1, 2, -1], [2, 3, -1], [3, 4, -1]])
    assert gain(critical, cells, 5, 1.0) == pytest.approx(4.0 / (1.0 + 1.0 + 0.5 + 0.125))
