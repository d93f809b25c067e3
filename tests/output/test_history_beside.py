"""history.h5 is read by plain h5py, in a process of its own, at any moment of a run."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys

import h5py
import numpy as np
import pytest
from stopped_run import SCENE

from fracflow._petsc import MPI
from fracflow.errors import InputError
from fracflow.output.history import HistoryFile, read_history, read_rows
from fracflow.scene.scene import load
from fracflow.simulation.run import run
from fracflow.storage.hdf5 import redo_of

COMM = MPI.COMM_WORLD
OPENED = 200
AT_EACH_STEP = 7  # of 30
READER = """
import json, sys, h5py
rows, whole = [], True
for _ in sys.stdin:
    for _ in range({times}):
        with h5py.File({path!r}, "r") as file:
            found = {{name: file[name][()] for name in ("time", "step/dt", "step/newton", "probe/middle/slip", "seal")}}
        rows.append(len(found["time"]))
        whole &= len({{len(each) for each in found.values()}}) == 1 and (found["time"][1:] > found["time"][:-1]).all()
        whole &= (found["step/dt"][1:] > 0.0).all() and found["seal"].any(axis=1).all()  # no row is filled later
    print("opened", flush=True)
print(json.dumps([rows, bool(whole)]))
"""


class Reader:
    """Has another process open the history of a run some times during each of its steps but the first."""

    def __init__(self, path):
        self.path, self.process = path, None

    def __call__(self, _):
        if COMM.rank:
            return
        if self.process is None:
            kept = {k: v for k, v in os.environ.items() if not k.startswith(("OMPI_", "PMIX", "PMI_", "HDF5_"))}
            code = READER.format(times=AT_EACH_STEP, path=str(self.path))
            pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
            self.process = subprocess.Popen([sys.executable, "-c", code], env=kept, text=True, **pipes)
        else:
            assert self.process.stdout.readline() == "opened\n"
        self.process.stdin.write("open\n")
        self.process.stdin.flush()

    def saved(self, steps):
        pass


def test_another_process_opens_it_200_times_while_a_run_goes_on(shared_tmp, monkeypatch):
    monkeypatch.setattr("fracflow.storage.hdf5.SHARE", 1.0)  # whatever else the machine does, it is often replaced
    (shared_tmp / "scene.toml").write_text(SCENE) if COMM.rank == 0 else None
    COMM.barrier()
    scene = load(shared_tmp / "scene.toml", ['stage.0.time_step="2 h"', "output.fields_every=0"])
    beside = Reader(shared_tmp / "run/history.h5")
    run(scene, shared_tmp / "run", progress=beside)
    if COMM.rank == 0:
        rows, is_whole = json.loads(beside.process.communicate(timeout=60)[0].splitlines()[-1])
        assert len(rows) >= OPENED and is_whole and beside.process.returncode == 0
        last = len(read_history(shared_tmp / "run/history.h5")["time"])
        assert rows == sorted(rows) and rows[0] < last and len(set(rows)) > 5  # it grew meanwhile


@pytest.mark.serial
def test_a_file_that_is_behind_is_completed_by_ours(tmp_path, monkeypatch):
    """Records that are not in the file yet are beside it; what a reader has open stays as it was."""
    monkeypatch.setattr("fracflow.storage.hdf5.SHARE", 1e9)
    path = tmp_path / "h.h5"
    with HistoryFile(path) as history:
        for i in range(600):
            history.append({"time": float(i), "a": np.full(2, i)})
            assert i % 100 or len(read_history(path)["time"]) == i + 1
        assert redo_of(path).stat().st_size > 0
        with h5py.File(path, "r") as file:
            assert len(file["time"]) == len(file["a"]) == 1
            history.close()
            assert len(file["time"]) == 1
    with h5py.File(path, "r") as file:
        assert (file["a"][:, 1] == np.arange(600)).all()


@pytest.mark.serial
def test_records_beside_it_are_of_its_chain(tmp_path, monkeypatch):
    """A record that another program put there is named; one of another size is none, and those after it neither."""
    monkeypatch.setattr("fracflow.storage.hdf5.SHARE", 1e9)
    path = tmp_path / "h.h5"
    with HistoryFile(path) as history:
        for i in range(3):
            history.append({"time": float(i)})
        history._disk.put_down(3, np.full(3, 3.0).tobytes())
        with pytest.raises(InputError, match=r"h\.h5: step 3 is not as it was written"):
            read_history(path)
        with pytest.raises(InputError, match="has 1 steps, not 2"):
            read_rows(shutil.copy(path, tmp_path / "alone.h5"), 2)
        assert len(read_rows(path, 3)[0]["time"]) == 3  # the records before it are whole
        history._disk.put_down(4, b"short")
        assert len(read_rows(path, 3)[0]["time"]) == 3


@pytest.mark.serial
def test_a_record_damaged_beside_it_is_none(tmp_path, monkeypatch):
    """The records before it are read."""
    monkeypatch.setattr("fracflow.storage.hdf5.SHARE", 1e9)
    path = tmp_path / "h.h5"
    with HistoryFile(path) as history:
        for i in range(9):
            history.append({"time": float(i)})
        whole = redo_of(path).read_bytes()
        each = len(whole) // 8
        for place in (
            5 * each,
            5 * each + 10,
            5 * each + 14,
            6 * each - 40,
            6 * each - 1,
        ):  # head, checksum, length, row
            damaged = bytearray(whole)
            damaged[place] ^= 1
            redo_of(path).write_bytes(damaged)
            assert len(read_history(path)["time"]) == 6
        redo_of(path).write_bytes(whole[: 6 * each - 1])
        assert len(read_history(path)["time"]) == 6


@pytest.mark.serial
def test_what_is_put_down_beside_it_stays_short(tmp_path, monkeypatch):
    monkeypatch.setattr("fracflow.storage.hdf5.SHARE", 1e9)
    monkeypatch.setattr("fracflow.storage.hdf5.LONGEST_REDO", 10_000)
    with HistoryFile(tmp_path / "h.h5") as history:
        for i in range(500):
            history.append({"time": float(i)})
            assert redo_of(tmp_path / "h.h5").stat().st_size < 12_000
        with h5py.File(tmp_path / "h.h5", "r") as file:
            assert len(file["time"]) > 250
