from __future__ import annotations

import os
import signal
import subprocess
import sys

import numpy as np
import pytest

from fracflow.errors import InputError
from fracflow.output.history import HistoryFile, read_attributes, read_history

pytestmark = pytest.mark.serial


def record(i: int) -> dict[str, object]:
    displacement = np.array([i, -i])
    return {"time": 0.5 * i, "step/newton": i, "energy/kinetic": i**2, "probe/a/displacement": displacement}


def check(history, rows):
    i = np.arange(rows)
    np.testing.assert_array_equal(history["time"], 0.5 * i)
    np.testing.assert_array_equal(history["probe/a/displacement"], np.stack([i, -i], axis=1))
    assert history["step/newton"].dtype == np.int64
    assert {len(values) for values in history.values()} == {rows}


def test_records_come_back_and_attributes_too(tmp_path):
    units = {"length": "m", "force": "N"}
    with HistoryFile(tmp_path / "h.h5", {"units": units, "title": "a run"}) as history:
        for i in range(700):  # more than two chunks
            history.append(record(i))
    check(read_history(tmp_path / "h.h5"), 700)
    assert read_attributes(tmp_path / "h.h5") == {"units": '{"length": "m", "force": "N"}', "title": "a run"}


def test_a_reader_beside_a_live_writer_sees_every_step(tmp_path):
    with HistoryFile(tmp_path / "h.h5") as history:
        for i in range(5):
            history.append(record(i))
            check(read_history(tmp_path / "h.h5"), i + 1)


def test_a_history_is_there_once_it_can_be_read(tmp_path):
    """Until its first record HDF5 could not read the file after a kill; so an earlier one stays until then."""
    path = tmp_path / "h.h5"
    for rows in (3, 5):
        history = HistoryFile(path)
        assert path.exists() == (rows == 5)
        if path.exists():
            check(read_history(path), 3)
        for i in range(rows):
            history.append(record(i))
            check(read_history(path), i + 1)
        history.close()
    HistoryFile(tmp_path / "empty.h5").close()
    assert read_history(tmp_path / "empty.h5") == {}
    with HistoryFile.resume(tmp_path / "empty.h5", 0) as history:
        history.append(record(0))
    check(read_history(tmp_path / "empty.h5"), 1)


WRITER = """
import sys
sys.path[:0] = {paths!r}
from fracflow.output.history import HistoryFile
from test_history import record
history = HistoryFile({path!r})
for i in range(10**9):
    history.append(record(i))
    print(i, flush=True)
"""


@pytest.mark.serial
def test_a_killed_writer_leaves_every_finished_step(tmp_path):
    here = os.path.dirname(__file__)
    paths = [os.path.dirname(os.path.dirname(here)), here]
    code = WRITER.format(paths=paths, path=str(tmp_path / "h.h5"))
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as writer:
        seen = -1
        while seen < 400:
            seen = int(writer.stdout.readline())
        writer.send_signal(signal.SIGKILL)
        rest = [int(line) for line in writer.stdout.read().splitlines() if line]
    assert writer.returncode == -signal.SIGKILL
    history = read_history(tmp_path / "h.h5")
    rows = len(history["time"])
    assert rows in (max([seen, *rest]) + 1, max([seen, *rest]) + 2)  # a step may be done but not printed
    check(history, rows)

    with HistoryFile.resume(tmp_path / "h.h5", 300) as again:
        again.append(record(300))
    check(read_history(tmp_path / "h.h5"), 301)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"extra": 1.0}, "extra"),
        ({"probe/a/displacement": np.zeros(3)}, "probe/a/displacement"),
    ],
)
def test_a_record_unlike_the_first_is_refused_whole(tmp_path, change, message):
    with HistoryFile(tmp_path / "h.h5") as history:
        history.append(record(0))
        with pytest.raises(ValueError, match=message):
            history.append({**record(1), **change})
        history.append(record(1))
    check(read_history(tmp_path / "h.h5"), 2)


def test_what_is_no_history_is_an_input_error(tmp_path):
    (tmp_path / "h.h5").write_text("not HDF5")
    for name in ("h.h5", "none.h5"):
        with pytest.raises(InputError, match=name):
            read_history(tmp_path / name)
    with HistoryFile(tmp_path / "k.h5") as history:
        history.append(record(0))
    with pytest.raises(InputError, match="has 1 steps, not 2"):
        HistoryFile.resume(tmp_path / "k.h5", 2)
