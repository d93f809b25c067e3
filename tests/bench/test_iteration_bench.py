"""`scripts/bench iteration` on a small scene: its parts add up, and a bar that is missed ends it with 1."""

import csv
import subprocess
import sys
from pathlib import Path

import pytest
from _launch import without_ranks

ROOT = Path(__file__).parents[2]


@pytest.mark.serial
@pytest.mark.starts_ranks
def test_parts_of_an_iteration_add_up(tmp_path):
    clean = without_ranks()
    scene = ROOT / "meshes/pressurised_crack/scene.toml"
    command = [sys.executable, ROOT / "scripts/benches/iteration.py", scene, "--repeats", "1", "--most", "1e-9"]
    done = subprocess.run(
        [*command, "--out", tmp_path],
        capture_output=True,
        text=True,
        timeout=100,
        env=clean | {"PYTHONPATH": str(ROOT)},
        stdin=subprocess.DEVNULL,
    )
    assert done.returncode == 1 and not done.stderr, done.stderr  # no iteration takes a nanosecond
    with (tmp_path / "iteration.csv").open(encoding="utf-8", newline="") as file:
        found = {row["part"]: float(row["cpu_ms"]) for row in csv.DictReader(file)}
    assert found["joint laws"] > 0.0 and found["PETSc: factorisation"] > 0.0 and found["iterations"] >= 1.0
    names = list(found)
    last = names.index("an iteration of Newton's method")
    iteration = sum(found[name] for name in names[:last])
    assert iteration == pytest.approx(found[names[last]], abs=1e-3)
    step = iteration + found["beginning and end of steps"] + found["ways to advance"]
    assert step == pytest.approx(found["all of a step but its record"], abs=1e-3)
    petsc = sum(value for name, value in found.items() if name.startswith("PETSc"))
    assert step - petsc == pytest.approx(found["of it outside PETSc"], abs=1e-3)
