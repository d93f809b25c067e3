"""Damaged run folders stay as they are, with one line; and what C libraries say at the end of processes of their own."""

from __future__ import annotations

import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from malformed import FLAT, RUBBISH, check_line, contents, environment, lay, msh, placed, spoken
from resealed import changed_notes, resealed
from test_bad_files import CASES

pytestmark = pytest.mark.serial


@pytest.fixture(scope="module")
def stopped(tmp_path_factory):
    """A run that its checkpoint says is not at its end."""
    home = tmp_path_factory.mktemp("stopped")
    lay(home, placed("steps = 1", "steps = 2"))
    words = [sys.executable, "-m", "fracflow", "run", "scene.toml", "-o", "out"]
    subprocess.run(words, cwd=home, env=environment(), check=True, capture_output=True)
    with changed_notes(home / "out" / "checkpoint.h5") as notes:
        notes["finished"] = False
    return home / "out"


def cut(path):
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def without(name):
    def drop(path):
        with resealed(path) as (arrays, _):
            del arrays[name]

    return drop


def without_note(name):
    def drop(path):
        with changed_notes(path) as notes:
            del notes[name]

    return drop


def of_three(path):
    with resealed(path) as (arrays, _):
        arrays["displacement"] = np.array([1.0, 2.0, 3.0])


AGAIN = "start the run again with fracflow run"
DAMAGES = {
    "rubbish as checkpoint": (
        "checkpoint.h5",
        lambda path: path.write_bytes(RUBBISH),
        f"checkpoint.h5: is no checkpoint … {AGAIN}",
    ),
    "an empty checkpoint": (
        "checkpoint.h5",
        lambda path: path.write_bytes(b""),
        f"checkpoint.h5: is no checkpoint … {AGAIN}",
    ),
    "half a checkpoint": ("checkpoint.h5", cut, f"checkpoint.h5: is no checkpoint … {AGAIN}"),
    "a checkpoint without its stage": (
        "checkpoint.h5",
        without_note("stage"),
        f"checkpoint.h5: is no checkpoint … {AGAIN}",
    ),
    "a checkpoint without pressure": ("checkpoint.h5", without("pressure"), f"(pressure has 0 rows, not 3); {AGAIN}"),
    "a checkpoint of another mesh": ("checkpoint.h5", of_three, f"(displacement has 3 rows, not … {AGAIN}"),
    "no mesh": ("mesh.h5", Path.unlink, f"mesh.h5: is no saved mesh … {AGAIN}"),
    "rubbish as mesh": ("mesh.h5", lambda path: path.write_bytes(RUBBISH), f"mesh.h5: is no saved mesh … {AGAIN}"),
    "a mesh without cells": ("mesh.h5", without("cells"), f"mesh.h5: is not of this run … {AGAIN}"),
    "no history": ("history.h5", Path.unlink, "history.h5: no such file"),
    "rubbish as history": (
        "history.h5",
        lambda path: path.write_bytes(RUBBISH),
        f"is no readable history … or {AGAIN}",
    ),
    "half a history": (
        "history.h5",
        cut,
        f"history.h5: is no readable history … put back a copy of the file, or {AGAIN}",
    ),
    "rubbish as scene": (
        "scene.toml",
        lambda path: path.write_bytes(RUBBISH),
        "scene.toml: not UTF-8 text: … save it as UTF-8",
    ),
    "no scene": ("scene.toml", Path.unlink, "holds no run of fracflow that could go on; name the folder of one"),
}


@pytest.mark.parametrize("name", DAMAGES)
def test_a_damaged_run_stays_as_it_is(name, stopped, tmp_path, monkeypatch, capfd):
    file, damage, expected = DAMAGES[name]
    folder = tmp_path / "out"
    shutil.copytree(stopped, folder)
    damage(folder / file)
    before = contents(folder)
    code, said = spoken(["resume", str(folder)], monkeypatch, capfd)
    assert code == 2, said
    check_line(said, expected)
    assert contents(folder) == before


def test_a_bad_scene_leaves_an_earlier_run(stopped, tmp_path, monkeypatch, capfd):
    shutil.copytree(stopped, tmp_path / "out")
    words = lay(tmp_path, msh("1 1 2 5 4\n", "1 1 5 2 4\n"))
    before = contents(tmp_path)
    monkeypatch.chdir(tmp_path)
    code, said = spoken(words, monkeypatch, capfd)
    assert code == 2
    check_line(said, FLAT)
    assert contents(tmp_path) == before


PROCESSES = {
    "command: unknown": CASES["command: unknown"],
    "mesh: an inverted cell": CASES["mesh: an inverted cell"],
    "mesh: a geometry of bad syntax": CASES["mesh: a geometry of bad syntax"],
    "options that a bad scene leaves unused": (
        {**placed("2700", "nan"), "words": ("run", "scene.toml", "-o", "out", "--", "-flow_ksp_rtol", "1e-9")},
        "scene.toml: rock.rock.density = nan: must be finite",
    ),
    "a type that PETSc does not know": (
        {**placed(), "words": ("run", "scene.toml", "-o", "out", "--", "-monolithic_pc_type", "luu")},
        "PETSc option of -monolithic_, in [petsc] or on the command line: … luu; see PETSc's manual",
    ),
}


@pytest.mark.starts_ranks
def test_in_processes_of_their_own(tmp_path):
    """As above, for whatever C libraries say at their end; and two ranks, of which one speaks."""

    def run(name):
        files, _ = PROCESSES[name]
        ranks = 2 if name == "mesh: an inverted cell" else 1
        folder = tmp_path / str(list(PROCESSES).index(name))
        folder.mkdir()
        words = [
            *(["mpirun", "-n", str(ranks)] if ranks > 1 else []),
            sys.executable,
            "-m",
            "fracflow",
            *lay(folder, files),
        ]
        before = contents(folder)
        done = subprocess.run(words, cwd=folder, env=environment(), capture_output=True, text=True, timeout=120)
        assert contents(folder) == before
        return ranks, done

    with ThreadPoolExecutor(2) as pool:
        for (ranks, done), (_, expected) in zip(pool.map(run, PROCESSES), PROCESSES.values(), strict=True):
            assert done.returncode == 2, done.stderr
            lines = done.stderr.splitlines(keepends=True)
            ours = [line for line in lines if line.startswith("fracflow: ")]
            assert len(ours) == 1 and (ranks > 1 or ours == lines), done.stderr  # mpirun adds lines of its own
            assert "Traceback" not in done.stderr and "arning" not in done.stderr, done.stderr
            check_line(ours[0], expected)
