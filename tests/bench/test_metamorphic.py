"""`scripts/bench metamorphic` on few scenes: they agree in other ways of writing them, and one wrong sign is found."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from _launch import without_ranks

BENCHES = Path(__file__).parents[2] / "scripts" / "benches"
FEW = ["--scenes", "2", "--seed", "12"]  # of them some slip, and none takes long
WAYS = ["mirrored", "other units", "stage split", "condensed", "resumed"]
WRONG_SIGN = """
import sys
import metamorphic
from _meta_turns import Back, Turn, _mirrored, always


def mirrored(case, random):
    other, back = _mirrored(case, random)
    return other, Back(back.turn, faces=-1)  # slip and shear traction keep their signs


metamorphic.TURNS = (Turn("mirrored", always, mirrored),)
raise SystemExit(metamorphic.main())
"""


def bench(*arguments):
    clean = without_ranks()
    way = os.pathsep.join(map(str, (BENCHES.parents[1], BENCHES.parent, BENCHES)))
    return subprocess.run(
        [sys.executable, *map(str, arguments)], capture_output=True, text=True, timeout=300, stdin=subprocess.DEVNULL,
        env=clean | {"PYTHONPATH": way, "COLUMNS": "150"},
    )  # fmt: skip


@pytest.mark.serial
def test_few_scenes_agree_in_other_ways():
    done = bench(BENCHES / "metamorphic.py", *FEW, "--ranks-every", "0", "--only", *WAYS)
    assert done.returncode == 0, done.stdout + done.stderr
    rows = {
        line.split("│")[1].strip(): line.split("│")[2:] for line in done.stdout.splitlines() if line.startswith("│")
    }
    assert set(rows) <= set(WAYS) and {"mirrored", "other units", "resumed"} <= set(rows)
    assert all(int(rows[name][0]) == int(rows[name][1]) == 2 for name in ("mirrored", "other units", "resumed"))
    assert "0 open energies, 0 with NaN, 0 findings" in done.stdout
    assert "0 s left" in done.stderr


@pytest.mark.serial
def test_a_wrong_sign_is_exit_code_1():
    done = bench("-c", WRONG_SIGN, *FEW[2:], "--scenes", "1", "--ranks-every", "0", "--only", "mirrored")
    assert done.returncode == 1, done.stdout + done.stderr
    assert "above: seed 12" in done.stdout and "shear_traction" in done.stdout and "1 findings" in done.stdout
