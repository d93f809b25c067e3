"""`scripts/bench sliding` and `explicit` in small: they reach into the program, and must move with it."""

from __future__ import annotations

import shutil

import explicit
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
    found = sliding.run_network(sliding.network_scene(1200, 3, tmp_path), 1200, BOTH, tmp_path, patience=200.0)
    assert not sliding.missed(found, []) and all(row["reached"] == 1.0 for row in found)
    direct, multigrid = found
    assert max(multigrid["slipping"]) > 50 and len(multigrid["krylov"]) == 4
    worse = multigrid | {"krylov": [31 * each for each in multigrid["newton"]], "slipping": [0] * 4}
    assert len(sliding.missed([direct, worse], [])) == 2


def test_explicit_steps(tmp_path):
    """Sweeps are loops of C where there is a compiler; a step has a sweep in it."""
    found = explicit.measure(1000.0, "triangles", True, explicit.Way(2, 4, 1, tmp_path / "run"))
    assert bool(found["bound_by_memory"] < float("inf")) == bool(shutil.which("cc") or shutil.which("gcc"))
    assert found["unknowns"] > 500 and found["sections"] > 0 and 0.0 < found["sweep_ms"] < found["step_ms"]
