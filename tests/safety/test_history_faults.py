"""A history whose writes fail or are interrupted, wherever: whole rows, and files that other programs read."""

from __future__ import annotations

import errno
import os
import signal
import zlib

import numpy as np
import pytest

from fracflow.output import read_history
from fracflow.output.history import HistoryFile
from fracflow.storage import hdf5 as files_hdf
from fracflow.storage.hdf5 import Growing, redo_of, whole_file
from fracflow.storage.sealed import write_sealed

pytestmark = pytest.mark.serial


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
