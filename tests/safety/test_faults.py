"""A run whose disk, folder or other rank fails: one line, exit code 3, and what was saved last can be gone on with."""

from __future__ import annotations

import errno
import fcntl
import os
import resource
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from _launch import without_ranks
from rich.console import Console

from fracflow._petsc import MPI
from fracflow.cli import run as cli_runs
from fracflow.cli.app import main
from fracflow.errors import DiskError, InputError
from fracflow.mesh.files import gmsh
from fracflow.output import list_steps, read_events, read_history, read_step
from fracflow.output.checkpoint import read_notes
from fracflow.output.folder import RunFolder
from fracflow.output.status import read_status
from fracflow.scene.scene import load
from fracflow.simulation import files as files_of
from fracflow.simulation import recorder as recorder_of
from fracflow.simulation.run import resume, run

ROOT = Path(__file__).parents[2]
SCENE = str(ROOT / "meshes/report_5_2/scene.toml")
SETTINGS = ["output.pictures=false", "stage.0.end=0.9", "output.checkpoint_every=2", "output.fields_every=4"]
COMM = MPI.COMM_WORLD


@pytest.fixture(scope="module")
def scene():
    """A scene whose mesh Gmsh makes once."""
    given, real = load(SCENE, SETTINGS), gmsh.run_worker
    found = real({"file": str(Path(SCENE).with_name("block.geo"))}, "block.geo") if COMM.rank == 0 else None
    gmsh.run_worker = lambda *given: found
    yield given
    gmsh.run_worker = real


@pytest.fixture(scope="module")
def whole(scene, tmp_path_factory):
    """The history of the undisturbed run; only on rank 0."""
    folder = Path(COMM.bcast(str(tmp_path_factory.mktemp("whole") / "run"), root=0))
    run(scene, folder)
    COMM.barrier()
    return read_history(folder / "history.h5") if COMM.rank == 0 else None


def same(folder, whole):
    if COMM.rank:
        return
    found = read_history(folder / "history.h5")
    assert [
        k for k in whole if k != "step/factorisations" and not np.array_equal(found[k], whole[k], equal_nan=True)
    ] == []
    assert read_status(folder).word == "ended" and not [*folder.rglob("*.part"), *folder.rglob("*.redo")]
    for _, path in list_steps(folder, "fractures"):
        read_step(path)
    read_events(folder / "events.csv")


class AfterSteps:
    """Does something on rank 0 after so many steps."""

    def __init__(self, steps, work):
        self.left, self.work, self.told = steps, work, []

    def __call__(self, step):
        self.left -= 1
        if self.left == 0 and COMM.rank == 0:
            self.work()

    def saved(self, steps):
        self.told.append(steps)


class FullDisk:
    """No file grows beyond a size, as on a full disk, on rank 0."""

    def __init__(self, size):
        self.size = size if COMM.rank == 0 else None

    def __enter__(self):
        self.before = resource.getrlimit(resource.RLIMIT_FSIZE)
        if self.size is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (self.size, self.before[1]))

    def __exit__(self, *_):
        resource.setrlimit(resource.RLIMIT_FSIZE, self.before)


@pytest.mark.parametrize("size", [3_000, 30_000, 120_000])
def test_a_full_disk_is_an_error_on_every_rank_and_the_run_goes_on_from_its_last_state(size, scene, whole, shared_tmp):
    folder = shared_tmp / "run"
    with FullDisk(size), pytest.raises(DiskError, match=r"h5: File too large; .*make room"):
        run(scene, folder)
    assert MPI.COMM_WORLD.allreduce(1) == COMM.size  # no rank waits for another
    (resume if COMM.bcast((folder / "scene.toml").exists(), root=0) else lambda where: run(scene, where))(folder)
    same(folder, whole)


@pytest.mark.parametrize("how", ["moved", "removed", "replaced"])
def test_a_folder_that_goes_ends_the_run_and_goes_on_where_it_is(how, scene, whole, shared_tmp):
    folder, there = shared_tmp / "run", shared_tmp / "elsewhere"

    def away():
        shutil.move(folder, there)
        if how == "removed":
            shutil.rmtree(there)
        if how == "replaced":
            shutil.copytree(there, folder)

    told = "another folder was put in its place" if how == "replaced" else "resume it where it is"
    with pytest.raises(DiskError, match=told):
        run(scene, folder, progress=AfterSteps(5, away))
    if how == "removed":
        with pytest.raises(InputError, match="holds no run"):
            resume(folder)
    else:
        COMM.barrier()
        if how == "replaced" and COMM.rank == 0:
            assert read_notes(folder / "checkpoint.h5")["totals"]["steps"] == 4  # nothing of ours was written there
        resume(there)
        same(there, whole)


def test_another_run_in_the_folder_ends_this_one_where_there_are_no_locks(scene, shared_tmp, monkeypatch):
    def no_locks(*_):
        raise OSError(errno.ENOLCK, "no locks")

    monkeypatch.setattr(fcntl, "flock", no_locks)
    with pytest.raises(DiskError, match="another run has taken the folder"):
        run(scene, shared_tmp / "run", progress=AfterSteps(3, lambda: RunFolder(shared_tmp / "run")))
    if COMM.rank == 0:
        assert not (shared_tmp / "run" / "status.json").exists()  # which is the other's


def test_the_end_counts_when_all_is_on_disk(scene, whole, shared_tmp, monkeypatch):
    """Events and status of a run whose last writes fail are not those of a run that has ended."""
    real = recorder_of.write_status

    def full(folder, status):
        if status.word == "ended":
            raise OSError(errno.EIO, "Input/output error", str(folder / "status.json"))
        real(folder, status)

    monkeypatch.setattr(recorder_of, "write_status", full)
    with pytest.raises(DiskError, match=r"status\.json: Input/output error"):
        run(scene, shared_tmp / "run")
    monkeypatch.undo()
    if COMM.rank == 0:
        assert not read_notes(shared_tmp / "run" / "checkpoint.h5")["finished"]
        assert read_status(shared_tmp / "run").word == "failed"
    resume(shared_tmp / "run")
    same(shared_tmp / "run", whole)


def test_a_run_whose_last_state_cannot_be_written_has_failed(scene, shared_tmp, monkeypatch):
    real = files_of.write_checkpoint

    def full(path, arrays, notes):
        if notes["finished"]:
            raise OSError(errno.ENOSPC, "No space left on device", str(path))
        real(path, arrays, notes)

    monkeypatch.setattr(files_of, "write_checkpoint", full)
    with pytest.raises(DiskError, match=r"checkpoint\.h5: No space left on device"):
        run(scene, shared_tmp / "run")
    if COMM.rank == 0:
        found = read_status(shared_tmp / "run")
        assert found.word == "failed" and "No space left" in found.line


def test_a_log_that_cannot_be_written_is_told_at_the_end(scene, whole, shared_tmp):
    def no_log():
        (shared_tmp / "run" / "log.txt").unlink()
        (shared_tmp / "run" / "log.txt").mkdir()

    totals = run(scene, shared_tmp / "run", progress=AfterSteps(3, no_log))
    if COMM.rank == 0:
        assert any("log.txt" in line and "could not be written" in line for line in totals.doubts)
    same(shared_tmp / "run", whole)


@pytest.mark.serial
def test_a_picture_that_cannot_be_drawn_is_a_line(scene, tmp_path, monkeypatch):
    run(scene, tmp_path / "run")

    def full(folder):
        raise OSError(errno.ENOSPC, "No space left on device", "overview.png")

    monkeypatch.setattr("fracflow.output.pictures.draw", full)
    with Console(record=True, width=200, file=open(os.devnull, "w")) as console:
        cli_runs.show(tmp_path / "run", console, True, False, True)
    assert "overview.png: No space left on device; again with: fracflow picture" in console.export_text()


@pytest.mark.serial
def test_pictures_without_room_name_their_folder(tmp_path, monkeypatch, capfd):
    def full(folder):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("fracflow.output.pictures.draw", full)
    monkeypatch.setattr(sys, "argv", ["fracflow", "picture", str(tmp_path)])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 3
    assert capfd.readouterr().err == f"fracflow: {tmp_path}: No space left on device; make room, or look at the disk\n"


@pytest.mark.serial
def test_a_run_that_begins_again_keeps_what_to_begin_with(scene, whole, tmp_path):
    """Killed before its first state and again while it clears its folder: its own scene and mesh are still there."""
    folder = RunFolder(tmp_path / "run", scene="one")
    for name in ("mesh.h5", "history.h5", "history.h5.redo", "checkpoint.h5"):
        (folder / name).write_text("")
    folder.write_text("scene.toml", "one")
    folder.close()
    RunFolder(tmp_path / "run", scene="one").close()
    assert {path.name for path in folder.path.iterdir()} == {".fracflow", "scene.toml", "mesh.h5"}
    RunFolder(tmp_path / "run", scene="another").close()
    assert {path.name for path in folder.path.iterdir()} == {".fracflow"}


@pytest.mark.serial
def test_a_clock_that_is_set_back_changes_nothing(scene, whole, tmp_path, monkeypatch):
    now = [2e9]

    def earlier():
        now[0] -= 3600.0
        return now[0]

    monkeypatch.setattr(time, "time", earlier)
    run(scene, tmp_path / "run")
    monkeypatch.undo()
    same(tmp_path / "run", whole)
    assert (
        " s\n" in (tmp_path / "run" / "log.txt").read_text()
        and " in -" not in (tmp_path / "run" / "log.txt").read_text()
    )


PROGRAM = """
import os, resource, sys
from fracflow.cli import app as cli
from fracflow._petsc import MPI
from fracflow.simulation.signals import SignalWatch
agreed, steps = SignalWatch.request, 0
def request(self, *given, **named):
    global steps
    steps += 1
    if steps == 6 and MPI.COMM_WORLD.rank == MPI.COMM_WORLD.size - 1:
        {fault}
    return agreed(self, *given, **named)
SignalWatch.request = request
sys.argv = ["fracflow", "run", {scene!r}, "-o", {folder!r}, *{sets!r}]
cli.main()
"""


def program(fault, folder, ranks):
    sets = [word for each in SETTINGS for word in ("--set", each)]
    kept = without_ranks()
    text = PROGRAM.format(fault=fault, scene=SCENE, folder=str(folder), sets=sets)
    launcher = ["mpirun", "-n", str(ranks)] if ranks > 1 else []
    words, clean = [*launcher, sys.executable, "-c", text], {**kept, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(words, capture_output=True, text=True, timeout=120, env=clean)
    return done.returncode, [line for line in done.stderr.splitlines() if line.startswith("fracflow:")], done.stderr


@pytest.mark.serial
@pytest.mark.starts_ranks
def test_a_rank_that_is_killed_ends_all_with_a_line(tmp_path):
    code, lines, said = program("os.kill(os.getpid(), 9)", tmp_path / "run", 2)
    assert code == 137, said
    steps = read_notes(tmp_path / "run" / "checkpoint.h5")["totals"]["steps"]
    assert len(lines) == 1 and f"after {steps} steps: go on with: fracflow resume {tmp_path / 'run'}" in lines[0], said


@pytest.mark.serial
@pytest.mark.starts_ranks
def test_a_rank_without_memory_ends_all_with_its_line(tmp_path):
    code, lines, said = program("raise MemoryError", tmp_path / "run", 2)
    assert code == 3 and "Traceback" not in said, said
    assert "fracflow: rank 1: out of memory" in said and len(lines) <= 2


@pytest.mark.serial
def test_a_full_disk_ends_the_program_with_exit_code_3_and_one_line(tmp_path):
    fault = "resource.setrlimit(resource.RLIMIT_FSIZE, (20000, resource.getrlimit(resource.RLIMIT_FSIZE)[1]))"
    code, lines, said = program(fault, tmp_path / "run", 1)
    assert code == 3, said
    assert len(lines) == 1 and "File too large" in lines[0] and "fracflow resume" in lines[0], said
    assert "Traceback" not in said and "Exception ignored" not in said and "HDF5" not in said
