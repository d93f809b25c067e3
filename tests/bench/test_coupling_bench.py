"""`scripts/bench coupling` on a small mesh: every kind of case, its bars, and that a missed one is told."""

import csv
import subprocess
import sys
from pathlib import Path

import pytest
from _launch import without_ranks

ROOT = Path(__file__).parents[2]


def bench(folder, *arguments, **environment):
    clean = without_ranks()
    done = subprocess.run(
        [sys.executable, ROOT / "scripts/benches/coupling.py", *arguments, "--out", folder],
        capture_output=True, text=True, timeout=200, stdin=subprocess.DEVNULL,
        env=clean | {"PYTHONPATH": str(ROOT), **environment},
    )  # fmt: skip
    assert (folder / "coupling.csv").exists(), done.stdout + done.stderr
    with (folder / "coupling.csv").open(encoding="utf-8", newline="") as file:
        return done, list(csv.DictReader(file))


@pytest.mark.serial
@pytest.mark.starts_ranks
def test_small_bench_keeps_its_bars(tmp_path):
    done, rows = bench(tmp_path, "1000", "--ranks", "1", "--apertures", "1e-1", "1e-3", "1e-6")
    assert done.returncode == 0, done.stdout + done.stderr
    cases = {(row["blocks"], row["kind"], row["fault"], row["drained"]) for row in rows}
    assert len(cases) == 2 * (3 + 2) * 2 and len(rows) == 3 * len(cases)  # steady flow has a fixed pressure
    assert all(not row["failure"] and int(row["newton"]) > 0 and int(row["ranks"]) == 1 for row in rows)
    for row in rows:
        assert 0 < int(row["krylov"]) <= (20 if row["blocks"] == "exact" else 30)
        assert 0.0 < float(row["true_residual"]) <= 1e-7  # FGMRES is asked for 1e-9
        assert max(float(row["solid_residual"]), float(row["flow_residual"])) <= 1e-11
    assert "0 over a bar" in done.stdout and "PETSc" in rows[0]["versions"]


@pytest.mark.serial
@pytest.mark.starts_ranks
def test_missed_bar_is_exit_code_1(tmp_path):
    """The rock's block by Jacobi in place of a factorisation."""
    spoilt = "-monolithic_fieldsplit_solid_pc_type jacobi"
    done, rows = bench(
        tmp_path, "1000", "--ranks", "1", "--apertures", "1e-4", "--blocks", "exact", PETSC_OPTIONS=spoilt
    )
    assert done.returncode == 1 and max(int(row["krylov"]) for row in rows) > 20, done.stdout
