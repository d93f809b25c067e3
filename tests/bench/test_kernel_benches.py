"""`scripts/bench sliding` and `explicit_kernels` in small: they reach into the program, and must move with it."""

from __future__ import annotations

import shutil

import explicit_kernels
import pytest
import sliding

pytestmark = pytest.mark.serial
BOTH = ("lu", "multigrid")


def test_one_step_with_soft_joints_by_all_ways():
    found = {row["way"]: row for row in sliding.one_step(sliding.Row(1500, normal=1e15, shear=1e4), BOTH)}
    assert found.keys() == set(BOTH)
    assert all(not row["failure"] and row["newton"] > 0 for row in found.values())
    assert found["lu"]["krylov"] == 1 < found["multigrid"]["krylov"] < sliding.MOST / 2


@pytest.mark.starts_ranks
def test_sliding_network(tmp_path):
    """Hundreds of sections slide; multigrid takes the steps and statuses of LU, in few iterations."""
    found = sliding.run_network(1200, 3, BOTH, tmp_path, patience=200.0)
    assert not sliding.missed(found, []) and all(row["reached"] == 1.0 for row in found)
    direct, multigrid = found
    assert max(multigrid["slipping"]) > 50 and len(multigrid["krylov"]) == 4
    worse = multigrid | {"krylov": [31 * each for each in multigrid["newton"]], "slipping": [0] * 4}
    assert len(sliding.missed([direct, worse], [])) == 2


def test_explicit_steps_and_kernels(tmp_path):
    """The kernels of C are held against each other where there is a compiler."""
    found = explicit_kernels.kernels(2500.0)
    in_c = [name for name in found["ms"] if name.startswith("C, ")]
    assert len(in_c) == (3 if shutil.which("cc") or shutil.which("gcc") else 0)
    assert len(found["ms"]) == 6 + len(in_c) and all(each >= 0.0 for each in found["ms"].values())
    steps = explicit_kernels.run_steps(2500.0, 6, tmp_path / "run")
    assert steps["steps"] == 3 and steps["parts_ms"].keys() == {"K u and joint forces", "joints", "coupling"}
    assert sum(steps["parts_ms"].values()) < 2.0 * steps["parts_ms"]["coupling"] < 2.0 * steps["step_ms"]
