"""Run folders that a stranger has made, with seals that fit: one line, in bounded time, by a process that may be lost."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
import zlib
from itertools import pairwise
from pathlib import Path

import h5py
import numpy as np
import pytest
from _launch import without_ranks
from hypothesis import given
from hypothesis import strategies as st
from resealed import changed_notes, resealed
from rich.console import Console
from stopped_run import flat, flip, refused, spoken

from fracflow.cli.report import report
from fracflow.errors import InputError
from fracflow.mesh.store import load_mesh
from fracflow.output.checkpoint import read_arrays, read_notes
from fracflow.output.history import HistoryFile, read_attributes, read_history
from fracflow.output.reader import load_run_data
from fracflow.scene.scene import load
from fracflow.simulation import refinement
from fracflow.storage import hdf5
from fracflow.storage import reader as h5_reader

pytestmark = pytest.mark.serial
ROOT = Path(__file__).parents[2]

# what a stranger may put there, with a seal that fits


def rows_of(name, change):
    def forge(folder):
        with resealed(folder / "fields/fractures_000006.h5") as (arrays, _):
            arrays[name] = change(arrays[name])

    return forge


def names_of_fractures(text):
    def forge(folder):
        with resealed(folder / "fields/fractures_mesh.h5") as (_, notes):
            notes["fractures"] = text

    return forge


def probe_without_numbers(folder):
    old, attrs = read_history(folder / "history.h5"), read_attributes(folder / "history.h5")
    old["probe/middle/slip"] = np.zeros((len(old["time"]), 0))
    (folder / "history.h5").unlink()
    with h5py.File(folder / "history.h5", "w") as file:
        for name, values in old.items():
            file[name] = values
        file.attrs.update(attrs)


def probe_as_large_as_numbers_are(folder):
    old, attrs = read_history(folder / "history.h5"), read_attributes(folder / "history.h5")
    old["probe/middle/slip"][-1] = 1e308
    HistoryFile.after(folder / "history.h5", old, attrs).close()


def points_as_far_as_numbers_go(folder):
    with resealed(folder / "fields/rock_mesh.h5") as (arrays, _):
        arrays["points"] = arrays["points"] + [1e308, -1e308, 0.0]


UNFIT = {
    "a slip of 1e308": (probe_as_large_as_numbers_are, "history.h5: probe/middle/slip has values above 1e[+]300"),
    "rock at 1e308": (points_as_far_as_numbers_go, "rock_mesh.h5: points has values above"),
    "a field of 1e308": (rows_of("point/plastic_slip", lambda v: v - 1e308), "plastic_slip has values above"),
    "a word for a list": (names_of_fractures("{"), "are no names"),
    "a number for a list": (names_of_fractures("5"), "are no names"),
    "numbers for names": (names_of_fractures("[1, 2]"), "are no names"),
    "a name that steers": (names_of_fractures('["\\u001b[2J"]'), "are no names"),
    "points too few": (rows_of("point/plastic_slip", lambda v: v[:1]), "plastic_slip has the shape"),
    "cells too few": (rows_of("cell/fracture", lambda v: v[:1]), "fracture has the shape"),
    "rows of nothing": (rows_of("point/pressure", lambda v: np.zeros((len(v), 0))), "pressure has the shape"),
    "steps of nothing": (probe_without_numbers, "has steps without a number"),
}


@pytest.mark.parametrize("name", UNFIT)
def test_pictures_need_fields_that_fit(name, folder):
    forge, why = UNFIT[name]
    forge(folder)
    with pytest.raises(InputError, match=why):
        load_run_data(folder)


def test_a_level_with_a_scene_that_is_no_text_is_run_anew(folder):
    scene = load(folder / "scene.toml")
    assert refinement._found(scene, folder) == "a part"
    (folder / "scene.toml").write_bytes(b"\xff\xfe")
    assert refinement._found(scene, folder) == "nothing"


def test_books_need_numbers(folder):
    old, attrs = read_history(folder / "history.h5"), read_attributes(folder / "history.h5")
    HistoryFile.after(folder / "history.h5", old, attrs | {"energy_noise": "x"}).close()
    with pytest.raises(InputError, match="energy_noise is no number"):
        report(folder, Console(quiet=True))


def group_in_itself(file):
    file["loop"] = file["/"]


def group_with_many_names(file):
    inner = file.create_group("inner")
    for number in range(100):  # in each other to any depth: names without end
        inner[f"{number}"] = inner


def gzipped(file):
    file.create_dataset("bomb", shape=(1 << 28,), dtype="f8", chunks=(1 << 20,), compression="gzip", fillvalue=0.0)


def stored_outside(file):
    file.create_dataset("outside", shape=(4,), dtype="u1", external=[("/etc/passwd", 0, 4)])


def virtual(file):
    layout = h5py.VirtualLayout(shape=(4,), dtype="f8")
    layout[:] = h5py.VirtualSource("/etc/hostname", "data", shape=(4,))
    file.create_virtual_dataset("virtual", layout)


HOSTILE = {
    "a soft link": lambda file: file.__setitem__("other", h5py.SoftLink("/displacement")),
    "a link to a file": lambda file: file.__setitem__("other", h5py.ExternalLink("/etc/passwd", "/")),
    "stored in another file": stored_outside,
    "virtual": virtual,
    "a shape without end": lambda file: file.create_dataset("huge", shape=(10**12,), dtype="f8"),
    "chunks without end": lambda file: file.create_dataset("huge", shape=(10**12,), dtype="f8", chunks=(10**6,)),
    "compressed": gzipped,
    "a group in itself": group_in_itself,
    "a group in itself by many names": group_with_many_names,
    "texts": lambda file: file.create_dataset("texts", data=["a", "b"], dtype=h5py.string_dtype()),
    "references": lambda file: file.create_dataset("to", data=[file.ref], dtype=h5py.ref_dtype),
    "records": lambda file: file.create_dataset("rows", data=np.zeros(3, dtype=[("a", "f8"), ("b", "i4")])),
    "arrays as attributes": lambda file: file.attrs.__setitem__("many", np.zeros(1000)),
    "a type by a name": lambda file: file.__setitem__("kind", np.dtype("f8")),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_what_no_run_writes_is_not_read(name, folder, monkeypatch, capfd):
    for file, read in (("checkpoint.h5", read_notes), ("history.h5", read_history), ("mesh.h5", load_mesh)):
        with h5py.File(folder / file, "r+") as opened:
            HOSTILE[name](opened)
        began = time.monotonic()
        with pytest.raises(InputError, match=file):
            read(folder / file)
        assert time.monotonic() - began < h5_reader.PATIENCE
    refused(folder, monkeypatch, capfd)


def outgrown(arrays, _):
    arrays["sections/traction"] = np.zeros((*arrays["sections/traction"].shape[:2], 7))


def of_integers(arrays, _):
    arrays["displacement"] = arrays["displacement"].astype(int)


NONSENSE = {
    "tractions of seven components": outgrown,
    "displacements of integers": of_integers,
    "without friction": lambda arrays, _: arrays.pop("friction"),
}
NOTES = {
    "a time that is a text": ("time", "noon"),
    "a stage that is not there": ("stage", 3),
    "a stage below none": ("stage", -1),
    "progress in a list": ("progress", [1, 2]),
    "progress past the end of a step": ("progress", {"n": 6, "place_base": 5.0}),
    "progress to no place in a step": ("progress", {"n": 6, "place_part": float("nan")}),
    "parts of steps without length": ("progress", {"n": 6, "place_level": 1e6}),
    "totals of another kind": ("totals", {"steps": 7, "undone": {}, "colour": 3}),
    "events of another kind": ("events", {"rows": 3}),
    "no numbers in the books": ("energy", {"kinetic": None}),
    "a time without a value": ("time", float("nan")),
    "a control without end": ("controls", {"": float("inf")}),
}


@pytest.mark.parametrize("name", [*NONSENSE, *NOTES])
def test_a_checkpoint_that_fits_its_seal_alone(name, folder, monkeypatch, capfd):
    path = folder / "checkpoint.h5"
    if name in NONSENSE:
        with resealed(path) as (arrays, notes):
            NONSENSE[name](arrays, notes)
    else:
        with changed_notes(path) as notes:
            notes[NOTES[name][0]] = NOTES[name][1]
    code, said = spoken(["resume", folder], monkeypatch, capfd)
    assert code == 2 and len(said.splitlines()) == 1 and "checkpoint.h5: is no checkpoint" in said


@pytest.mark.parametrize(
    ("part", "value"),
    [
        ("displacement", np.nan),
        ("velocity", -np.inf),
        ("pressure", np.nan),
        ("sections/strain", np.inf),
        ("sections/strength", np.nan),
        ("past/0/plastic_slip", np.nan),
    ],
)
def test_a_state_with_a_value_that_is_no_number_is_not_gone_on_from(part, value, folder, monkeypatch, capfd):
    with resealed(folder / "checkpoint.h5") as (arrays, _):
        arrays[part] = arrays[part].copy()
        arrays[part].flat[0] = value
    assert f"checkpoint.h5: is no checkpoint ({part} has values that are" in refused(folder, monkeypatch, capfd)


@pytest.mark.parametrize(
    ("part", "value"),
    [
        ("cells", 10**9),
        ("joint_top", -5),
        ("flow_origin", 10**6),
        ("side_cell", 99_999),
        ("points", np.nan),
        ("joint_fracture", 4),
    ],
)
def test_a_mesh_that_fits_its_seal_alone(part, value, folder):
    with resealed(folder / "mesh.h5") as (arrays, _):
        arrays[part] = arrays[part].copy()
        arrays[part].flat[0] = value
    with pytest.raises(InputError, match=f"mesh.h5: is no saved mesh .{part} has"):
        load_mesh(folder / "mesh.h5")


# the process that reads


def test_a_process_that_hangs_or_dies_is_replaced(folder, monkeypatch):
    path = folder / "checkpoint.h5"
    right = flat(read_arrays(path))
    monkeypatch.setattr(h5_reader, "PATIENCE", 0.3)
    os.kill(h5_reader._reader._process.pid, signal.SIGSTOP)
    with pytest.raises(InputError, match="takes longer to read"):
        read_arrays(path)
    monkeypatch.setattr(h5_reader, "PATIENCE", 10.0)
    assert flat(read_arrays(path)) == right
    monkeypatch.setattr(h5_reader.Reader, "_started", lambda self: self._process)
    os.kill(h5_reader._reader._process.pid, signal.SIGSEGV)
    with pytest.raises(InputError, match="ended"):
        read_arrays(path)
    monkeypatch.undo()
    assert flat(read_arrays(path)) == right


def test_a_process_that_starts_late_is_no_fault_of_the_file(folder, tmp_path, monkeypatch):
    (tmp_path / "slow").mkdir()
    (tmp_path / "slow" / "sitecustomize.py").write_text(
        "import sys, time\nif 'storage/worker.py' in ' '.join(sys.orig_argv):\n    time.sleep(1.0)\n"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "slow"), prepend=os.pathsep)
    monkeypatch.setattr(h5_reader, "_reader", h5_reader.Reader())
    monkeypatch.setattr(h5_reader, "PATIENCE", 0.5)
    assert len(read_arrays(folder / "checkpoint.h5")) > 10
    h5_reader._reader.close()
    monkeypatch.setattr(h5_reader, "START", 0.3)
    with pytest.raises(InputError, match=r"cannot be read: .* was not ready within 0\.3 s.*; try again later"):
        read_arrays(folder / "checkpoint.h5")


def test_files_that_were_read_are_closed(folder):
    read_history(folder / "history.h5")
    there = Path(f"/proc/{h5_reader._reader._process.pid}/fd")
    before = len(list(there.iterdir()))
    for _ in range(3):
        read_history(folder / "history.h5")
    assert len(list(there.iterdir())) == before


def test_what_a_history_has_of_many_probes_is_read(tmp_path, monkeypatch):
    """Memory goes with the size of the file, not with how many datasets it has."""
    monkeypatch.setattr(h5_reader, "_reader", h5_reader.Reader())
    most = []
    for count in (10, 1500):
        with HistoryFile(tmp_path / f"{count}.h5") as found:
            found.append({"time": 0.0, **{f"probe/{i // 10}/{i % 10}": 1.0 for i in range(count)}})
        assert len(read_history(tmp_path / f"{count}.h5")) == count + 1
        status = Path(f"/proc/{h5_reader._reader._process.pid}/status").read_text()
        most.append(1024 * int(status.partition("VmHWM:")[2].split()[0]))
    assert most[1] - most[0] < 4 * (tmp_path / "1500.h5").stat().st_size
    h5_reader._reader.close()


def test_as_many_names_are_read_as_the_file_has_room_for(tmp_path):
    """The datasets of 4000 probes on fractures are read; the limit grows with the file."""
    with h5py.File(tmp_path / "many.h5", "w") as file:
        file["time"] = 1.0
        for probe in range(4000):
            group = file.create_group(f"probe/{probe}")
            for quantity in range(11):
                group[f"{quantity}"] = file["time"]
    found = h5_reader.read_h5(tmp_path / "many.h5", "is no file of a run", "", ["probe/3999/10"])
    assert len(found.layout) == 44_001 and found.arrays["probe/3999/10"] == 1.0


def forge_redo(path, writes):
    body = b"".join(hdf5._WRITE.pack(offset, len(data)) + data for offset, data in writes)
    hdf5.redo_of(path).write_bytes(hdf5._HEAD.pack(hdf5._MAGIC, zlib.crc32(body), len(body)) + body)


def test_a_last_change_of_any_number_of_writes_is_read_at_once(folder):
    path = folder / "history.h5"
    right, size = read_history(path), path.stat().st_size
    forge_redo(path, [(size, b"")] * 500_000)
    assert not hdf5.writes_of(path)
    forge_redo(path, [(size + 3 * number, b"x") for number in range(100_000)])
    assert len(hdf5.writes_of(path)) == 100_000
    began = time.monotonic()
    assert flat(read_history(path)) == flat(right)
    assert time.monotonic() - began < h5_reader.PATIENCE
    disk = hdf5.Completed(path)
    assert len(disk._written(size, size + 300)) == 100
    disk.close()


@given(st.lists(st.tuples(st.integers(0, 40), st.binary(min_size=1, max_size=12)), max_size=8))
def test_writes_leave_what_the_last_of_them_wrote(writes):
    once, apart = bytearray(60), bytearray(60)
    hdf5.lay_over(memoryview(once), 0, writes)
    found = hdf5.without_overlap(writes)
    hdf5.lay_over(memoryview(apart), 0, found)
    assert apart == once and all(at + len(data) <= after for (at, data), (after, _) in pairwise(found))


def test_no_other_part_of_the_program_reads_such_files():
    """Only the process that may crash opens one that is not new."""
    calls = [
        (path.name, line.strip())
        for path in (ROOT / "fracflow").rglob("*.py")
        for line in path.read_text(encoding="utf-8").splitlines()
        if "h5py.File(" in line and path.name != "worker.py"
    ]
    assert calls and all('"w"' in line for _, line in calls), calls


@pytest.mark.starts_ranks
def test_ranks_refuse_it_together(folder):
    flip(folder / "checkpoint.h5", "displacement")
    kept = without_ranks()
    words = ["mpirun", "-n", "2", sys.executable, "-m", "fracflow", "resume", str(folder)]
    done = subprocess.run(words, env={**kept, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True, timeout=120)
    assert done.returncode == 2, done.stderr
    lines = [line for line in done.stderr.splitlines() if line.startswith("fracflow: ")]
    assert len(lines) == 1 and "checkpoint.h5: displacement, rows 0 to" in lines[0]
