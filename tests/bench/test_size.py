"""`scripts/bench size` on a small mesh: its parts, sums and files; no times are asserted."""

import csv
import json
import subprocess
import sys
from pathlib import Path

import meshio
import numpy as np
import pytest
from _launch import without_ranks

ROOT = Path(__file__).parents[2]
PARTS = {
    "read", "interpret", "split",
    "mesh by a process of its own", "place", "partition", "distribute", "assemble G K M B", "start", "Jacobian", "balances",
    "PETSc's solve", "energy balance", "output", "checkpoint", "all else",
}  # fmt: skip
SUMS = {"all outside the solve", "whole"}


@pytest.mark.serial
@pytest.mark.starts_ranks
def test_small_size(tmp_path):
    clean = without_ranks()
    command = [sys.executable, ROOT / "scripts/benches/size.py", "1000", "--ranks", "2", "--out", tmp_path]
    done = subprocess.run(
        command,
        capture_output=True,
        text=True,
        timeout=200,
        env=clean | {"PYTHONPATH": str(ROOT)},
        stdin=subprocess.DEVNULL,
    )
    assert done.returncode == 0, done.stderr
    with (tmp_path / "size.csv").open(encoding="utf-8", newline="") as file:
        rows = {row["part"]: row for row in csv.DictReader(file)}
    assert rows.keys() == PARTS | SUMS
    assert all(part in done.stdout for part in rows)

    mesh = meshio.read(tmp_path / "network-1000.msh")
    triangles = sum(len(block.data) for block in mesh.cells if block.type == "triangle")
    assert 800 <= triangles <= 2500 and int(rows["whole"]["cells"]) == triangles
    assert (tmp_path / "network-1000.msh").read_bytes().startswith(b"$MeshFormat\n4.1 1 8")

    cpu = {part: float(row["cpu_s"]) for part, row in rows.items()}
    rounding = 1e-3 * len(rows)
    assert all(cpu[part] > 0.0 for part in ("read", "PETSc's solve", "output"))  # what cannot be too short to be seen
    assert abs(sum(cpu[part] for part in PARTS) - cpu["whole"]) <= rounding
    assert abs(cpu["whole"] - cpu["PETSc's solve"] - cpu["all outside the solve"]) <= rounding
    assert abs(sum(float(rows[part]["share"]) for part in PARTS) - 1.0) <= rounding
    assert float(rows["whole"]["rank0_GB"]) >= float(rows["read"]["rank0_GB"]) > 0.0
    for key, said in {
        "machine": "GB",
        "versions": "PETSc 3.",
        "command": "scripts/bench size 1000",
        "ranks": "2",
    }.items():
        assert said in rows["whole"][key]

    facts = json.loads((tmp_path / "network-1000.json").read_text(encoding="utf-8"))["facts"]
    assert (
        facts["newton"] >= 2 and facts["krylov"] >= facts["newton"]
    )  # the network is not linear, and solved for directly
    assert np.max([facts["solid_residual"], facts["flow_residual"]]) <= 1e-11
    with (tmp_path / "run-1000" / "rock.xdmf").open(encoding="utf-8") as file:
        assert f'NumberOfElements="{triangles}"' in file.read()


@pytest.mark.serial
def test_unknown_benchmark_is_refused():
    done = subprocess.run([ROOT / "scripts/bench", "sise"], capture_output=True, text=True, stdin=subprocess.DEVNULL)
    assert done.returncode == 2 and "size" in done.stderr
