"""`scripts/bench kills` on few faults: every one is survived; and a run whose checkpoint lies is found out."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from _launch import without_ranks

BENCHES = Path(__file__).parents[2] / "scripts" / "benches"
COMPILER = shutil.which("cc")
pytestmark = [pytest.mark.serial, pytest.mark.starts_ranks]


def bench(*arguments):
    clean = without_ranks()
    way = os.pathsep.join(map(str, (BENCHES.parents[1], BENCHES)))
    done = subprocess.run(
        [sys.executable, BENCHES / "kills.py", "--only", "block", *map(str, arguments)],
        capture_output=True, text=True, timeout=600, stdin=subprocess.DEVNULL, env=clean | {"PYTHONPATH": way},
    )  # fmt: skip
    if COMPILER is None:
        assert done.returncode == 2 and done.stderr.startswith("kills: no C compiler cc"), done.stderr
    return done


@pytest.mark.parametrize(("ranks_share", "cases"), [(0, 12), (1, 4)])
def test_few_faults_are_survived(ranks_share, cases):
    done = bench("--seed", 3, "--ranks-share", ranks_share, "--cases", cases)
    assert COMPILER is None or done.returncode == 0, done.stdout + done.stderr
    assert COMPILER is None or f"{cases} faults, {cases * ranks_share} of them on 2 ranks, 0 failures" in done.stdout
