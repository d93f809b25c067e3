"""A run whose disk, folder or other rank fails: one line, exit code 3, and what was saved last can be gone on with."""

from __future__ import annotations

import errno
import fcntl
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
import zlib
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
from fracflow.output.history import HistoryFile
from fracflow.output.status import read_status
from fracflow.scene.scene import load
from fracflow.simulation import files as files_of
from fracflow.simulation import recorder as recorder_of
from fracflow.simulation.run import resume, run
from fracflow.storage import hdf5 as files_hdf
from fracflow.storage.hdf5 import Growing, redo_of, whole_file
from fracflow.storage.sealed import write_sealed

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


def fail(number, action, half=False):
    """os.pwrite that fails at its n-th call and ever after, half of it written or nothing."""
    real, calls = os.pwrite, [0]

    def pwrite(file, data, offset):
        calls[0] += 1
        if calls[0] < number:
            return real(file, data, offset)
        if half and calls[0] == number:
            real(file, bytes(data)[: len(data) // 2], offset)
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    os.pwrite = pwrite
    try:
        action()
    finally:
        os.pwrite = real
    return calls[0]


def history(path, steps=4):
    found = HistoryFile(path)
    try:
        for i in range(steps):
            found.append({"time": float(i), **{f"k{j}": np.full(3, i + j) for j in range(4)}})
        found.close()
    except OSError as error:
        assert error.errno == errno.ENOSPC
        try:
            found.close()  # tells it again, unless it was the close that failed
        except OSError as again:
            assert again.errno == errno.ENOSPC
        found.close()  # and HDF5 has nothing more to write


@pytest.mark.serial
@pytest.mark.parametrize("half", [False, True])
def test_a_history_is_whole_whichever_write_fails(tmp_path, half):
    """Also where half of it is written: the next reader has the step whole or not at all."""
    path = tmp_path / "h.h5"
    total, seen = fail(10**9, lambda: history(tmp_path / "all.h5")), set()
    for number in range(1, total):
        for old in tmp_path.glob("h.h5*"):
            old.unlink()
        fail(number, lambda: history(path), half)
        if not path.exists():
            continue
        found = read_history(path)
        rows = len(found["time"])
        seen.add(rows)
        assert all((found[f"k{j}"] == np.arange(rows)[:, None] + j).all() for j in range(4))
        HistoryFile.resume(path, rows).close()
        assert len(read_history(path)["time"]) == rows and not redo_of(path).exists()
    assert seen >= {1, 2, 3, 4}


@pytest.mark.serial
def test_a_reader_beside_a_writer_needs_no_program_of_ours(tmp_path):
    """The file is as HDF5 closes one: readers of every kind open it."""
    import h5py

    with HistoryFile(tmp_path / "h.h5", lag=False) as found:
        for i in range(3):
            found.append({"time": float(i)})
            for how in ({}, {"libver": "latest", "swmr": True}):
                with h5py.File(tmp_path / "h.h5", "r", **how) as file:
                    assert len(file["time"]) == i + 1
    with h5py.File(tmp_path / "h.h5", "r") as file:
        assert len(file["time"]) == 3


@pytest.mark.serial
def test_a_file_that_cannot_be_written_leaves_the_last_one(tmp_path):
    def write():
        with pytest.raises(OSError, match="No space"), whole_file(tmp_path / "c.h5", is_synced=True) as file:
            for name in "ab":
                file[name] = np.ones(10_000)

    with whole_file(tmp_path / "c.h5") as file:
        file["a"] = 1
    before = (tmp_path / "c.h5").read_bytes()
    for number in (1, 2, 3, 4):
        fail(number, write)
    assert (tmp_path / "c.h5").read_bytes() == before and [*tmp_path.iterdir()] == [tmp_path / "c.h5"]


@pytest.mark.serial
def test_half_a_change_is_completed_by_whoever_reads(tmp_path):
    """A change of an earlier version at a place in the file, that it was killed over: put down whole, or half."""
    path = tmp_path / "f"
    path.write_bytes(b"one two")
    body = files_hdf._WRITE.pack(4, 9) + b"TWO three"
    whole = files_hdf._HEAD.pack(files_hdf._MAGIC, zlib.crc32(body), len(body)) + body
    redo_of(path).write_bytes(whole)
    assert files_hdf.Completed(path).read() == b"one TWO three"
    for size in (0, 10, len(whole) - 1):
        redo_of(path).write_bytes(whole[:size])
        assert files_hdf.Completed(path).read() == b"one two"
    redo_of(path).write_bytes(whole)
    files_hdf.complete(path)
    assert path.read_bytes() == b"one TWO three" and not redo_of(path).exists()


@pytest.mark.serial
def test_half_a_row_is_none(tmp_path):
    """Killed after rows were put down, before they were in the file; and killed, or the disk full, while one was put down."""
    path = tmp_path / "f"
    disk = Growing(path)
    disk.write(memoryview(b"two rows"))
    disk.publish(lambda: None)
    disk.put_down(2, b"third")
    disk.put_down(3, b"forth")
    assert path.read_bytes() == b"two rows"
    rows = [(2, b"third"), (3, b"forth")]
    with pytest.raises(OSError, match="No space"):
        fail(1, lambda: disk.put_down(4, b"fifth"), half=True)
    assert files_hdf.rows_in(files_hdf.beside(path), 5) == rows
    whole = redo_of(path).read_bytes()[: 2 * 41]
    for size, left in ((0, 0), (10, 0), (41, 1), (2 * 41 - 1, 1), (2 * 41, 2)):
        redo_of(path).write_bytes(whole[:size])
        assert files_hdf.rows_in(files_hdf.beside(path), 5) == rows[:left]
    redo_of(path).write_bytes(whole[:60] + b"!" + whole[61:])
    assert files_hdf.rows_in(files_hdf.beside(path), 5) == rows[:1] and not files_hdf.rows_in(whole, 4)
    disk.close()
    assert redo_of(path).exists()  # after an error it is needed


@pytest.mark.serial
@pytest.mark.parametrize("at", [1, 4, 9, 14])
def test_an_interrupt_while_hdf5_writes_comes_after_it(at, tmp_path, monkeypatch):
    """Out of a write that HDF5 has asked for, it would be an error of HDF5, with a traceback."""
    real, count = os.pwrite, [0]

    def interrupted(*given):
        count[0] += 1
        if count[0] == at:
            signal.raise_signal(signal.SIGINT)
        return real(*given)

    monkeypatch.setattr(os, "pwrite", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_sealed(tmp_path / "a.h5", {"a": np.zeros(20_000)}, {"note": "x"})
        count[0] = 0 if count[0] < at else at  # it has fewer writes
        with HistoryFile(tmp_path / "b.h5") as history:
            for row in range(3):
                history.append({"time": row, "a": np.zeros(1000)})
    assert count[0] >= at and signal.getsignal(signal.SIGINT) is signal.default_int_handler


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
