"""Run folders that were damaged or forged: one line and exit code 2, soon; what is whole is the same to the bit."""

from __future__ import annotations

import os
import random
import shutil
import time
import zlib
from pathlib import Path

import h5py
import numpy as np
import pytest
from resealed import changed_notes, resealed
from stopped_run import flat, flip, refused, spoken

import fracflow
from fracflow.errors import InputError
from fracflow.mesh.store import load_mesh
from fracflow.output.checkpoint import read_arrays, read_notes
from fracflow.output.fields import read_step
from fracflow.output.history import HistoryFile, read_attributes, read_history
from fracflow.simulation.run import resume
from fracflow.storage import hdf5 as files_hdf
from fracflow.storage import reader as h5_reader
from fracflow.storage.sealed import PIECE, SEAL, layout_of, pieces, root_of

pytestmark = pytest.mark.serial
ROOT = Path(__file__).parents[2]
AGAIN = "start the run again with fracflow run"


@pytest.fixture(scope="module")
def whole(stopped, tmp_path_factory):
    """The history of the run when it goes on."""
    folder = tmp_path_factory.mktemp("whole") / "out"
    shutil.copytree(stopped, folder)
    resume(folder)
    return read_history(folder / "history.h5")


def same(one, other):
    """Whether two histories are the same; the first step after a resume makes a factorisation more."""
    keys = one.keys() - {"step/factorisations"}
    return one.keys() == other.keys() and all(np.array_equal(one[k], other[k], equal_nan=True) for k in keys)


def names_of(path):
    found = []
    with h5py.File(path, "r") as file:
        file.visititems(lambda name, item: found.append(name) if isinstance(item, h5py.Dataset) and item.size else None)
    return [name for name in found if name != SEAL]


# what is sealed


@pytest.mark.parametrize(("file", "read"), [("checkpoint.h5", read_arrays), ("mesh.h5", load_mesh)])
def test_a_bit_of_any_array_is_named(folder, file, read):
    names = names_of(folder / file)
    assert len(names) > 10
    for name in names:
        flip(folder / file, name, at=-1)
        with pytest.raises(InputError, match=f"{file}: {name}, rows 0 to .*{AGAIN}"):
            read(folder / file)
        flip(folder / file, name, at=-1)
    read(folder / file)


def test_a_flipped_bit_ends_a_resume_before_it_begins(folder, monkeypatch, capfd):
    flip(folder / "checkpoint.h5", "velocity", at=6)
    assert "checkpoint.h5: velocity, rows 0 to" in refused(folder, monkeypatch, capfd)


def test_a_damaged_file_of_fields_stops_no_resume(folder):
    """No run goes on from fields: what cannot be read is told, and left out of the index."""
    first = folder / "fields" / "rock_000000.h5"
    first.write_bytes(first.read_bytes()[:-40])
    with pytest.warns(UserWarning, match=r"rock_000000.h5: .*: left out of rock.xdmf"):
        resume(folder)
    index = (folder / "rock.xdmf").read_text()
    assert "rock_000000" not in index and "rock_000002" in index


def test_notes_are_sealed(folder, monkeypatch, capfd):
    with h5py.File(folder / "checkpoint.h5", "r+") as file:
        file.attrs["notes"] = file.attrs["notes"].replace('"stage": 0', '"stage": 1', 1)
    assert "its notes, names or shapes are not as they were sealed" in refused(folder, monkeypatch, capfd)


def test_pieces_are_the_same_whoever_holds_them():
    """Slabs that end where pieces do have the digests of the whole; the root is of names, types, shapes and notes too."""
    values = np.random.default_rng(1).random((PIECE // 16 + 40_000, 3))
    rows = PIECE // 24
    whole = pieces(values)
    assert len(whole) == -(-len(values) // rows) > 2
    assert np.array_equal(whole, np.concatenate([pieces(values[: 2 * rows]), pieces(values[2 * rows :])]))
    roots = {
        root_of(layout, notes, whole)
        for layout in (layout_of({"a": values}), layout_of({"b": values}), layout_of({"a": values.T}))
        for notes in ({}, {"time": 1.0}, {"time": 1})
    }
    assert len(roots) == 9


def test_a_step_of_a_history_is_named(folder, monkeypatch, capfd):
    path = folder / "history.h5"
    for name in ("energy/friction", "probe/middle/displacement", SEAL, "time"):
        with h5py.File(path, "r+") as file:
            kept = file[name][...]
            changed = kept.copy()
            changed.reshape(-1).view(np.uint8)[3 * changed.nbytes // len(changed)] ^= 1
            file[name][...] = changed
        with pytest.raises(InputError, match=r"history.h5: step 3 is not as it was written, those before it are"):
            read_history(path)
        assert "history.h5: step 3 " in refused(folder, monkeypatch, capfd)
        with h5py.File(path, "r+") as file:
            file[name][...] = kept
    with h5py.File(path, "r+") as file:
        file.attrs["units"] = file.attrs["units"].replace("m", "n")
    for read in (read_history, read_attributes):
        with pytest.raises(InputError, match="its attributes or names are not as they were written"):
            read(path)


def test_what_follows_the_checkpoint_may_be_damaged(folder, whole, tmp_path):
    """A run that was killed goes on from its checkpoint, whatever became of the rows after it."""
    path = folder / "history.h5"
    rows, attrs = read_history(path), read_attributes(path)
    with HistoryFile.resume(path, len(rows["time"])) as longer:
        for _ in range(2):
            longer.append({name: values[-1] for name, values in rows.items()})
    flip(path, "energy/friction", at=8 * (len(rows["time"]) + 1))
    with pytest.raises(InputError, match=f"step {len(rows['time']) + 1} "):
        read_history(path)
    resume(folder)
    assert same(read_history(path), whole) and read_attributes(path) == attrs


def test_a_history_of_another_run_is_refused(folder, monkeypatch, capfd):
    path = folder / "history.h5"
    rows, attrs = read_history(path), read_attributes(path)
    rows["energy/friction"] = rows["energy/friction"] + 1.0
    HistoryFile.after(path, rows, attrs).close()
    read_history(path)
    assert "history.h5: step 6 is not that of checkpoint.h5" in refused(folder, monkeypatch, capfd)
    HistoryFile.after(path, {name: values[:3] for name, values in rows.items()}, attrs).close()
    assert "history.h5: has 3 steps, not 7 as checkpoint.h5 says" in refused(folder, monkeypatch, capfd)


def test_a_mesh_of_another_run_is_refused(folder, monkeypatch, capfd):
    with resealed(folder / "mesh.h5") as (arrays, _):
        arrays["points"] = arrays["points"] + 1.0
    assert "mesh.h5: is not of this run" in refused(folder, monkeypatch, capfd)


def test_a_history_of_two_names_is_not_completed(folder, tmp_path, monkeypatch, capfd):
    """A file beside a history may be all of it; put in its place, it would be written to the file of the other name."""
    history, other = folder / "history.h5", tmp_path / "precious"
    body = files_hdf._WRITE.pack(0, history.stat().st_size) + history.read_bytes()
    head = files_hdf._HEAD.pack(files_hdf._MAGIC, zlib.crc32(body), len(body))
    (folder / "history.h5.redo").write_bytes(head + body)
    other.write_text("mine\n" * 1000)
    history.unlink()
    os.link(other, history)
    assert "history.h5: is a link" in refused(folder, monkeypatch, capfd)
    with pytest.raises(InputError, match=r"history.h5: is a link"):  # nor where the name comes later
        files_hdf.complete(history)
    assert other.read_text() == "mine\n" * 1000


def test_a_checkpoint_that_was_taken_away_costs_no_history(folder, monkeypatch, capfd):
    (folder / "checkpoint.h5").unlink()
    assert "checkpoint.h5: no such file, although history.h5 has steps" in refused(folder, monkeypatch, capfd)


def test_a_changed_scene_is_told_and_goes_on(folder, recwarn):
    text = (folder / "scene.toml").read_text()
    (folder / "scene.toml").write_text(text + "# a note of mine\n")
    resume(folder)
    assert [str(each.message) for each in recwarn if "scene.toml is not as it was" in str(each.message)]
    assert "note: " in (folder / "log.txt").read_text()


def test_a_scene_with_other_probes_cannot_go_on(folder, monkeypatch, capfd):
    text = (folder / "scene.toml").read_text()
    (folder / "scene.toml").write_text(text + '[[probe]]\nname = "new"\nat = [450.0, 500.0]\non = "Bruno"\n')
    code, said = spoken(["resume", folder], monkeypatch, capfd)
    assert code == 2 and len(said.splitlines()) == 1 and "history.h5: probe/new/" in said
    assert "probes or controls of the scene were changed" in said


def test_a_stage_that_was_begun_keeps_its_kind(folder, monkeypatch, capfd):
    text = (folder / "scene.toml").read_text()
    (folder / "scene.toml").write_text(text.replace('kind = "quasi-static"', 'kind = "auto"'))
    said = refused(folder, monkeypatch, capfd)
    assert 'stage.0.kind = "auto": the run was stopped amid this stage' in said and "let a stage follow it" in said


def test_a_stage_auto_may_follow_in_a_run_that_had_none(folder):
    text = (folder / "scene.toml").read_text()
    more = '[[stage]]\nkind = "auto"\ntime_step = 21600.0\nend = 237600.0\n'
    (folder / "scene.toml").write_text(text + more)
    resume(folder)
    assert read_history(folder / "history.h5")["time"][-1] == 66 * 3600.0


def test_a_folder_without_seals_goes_on_with_a_line(folder, whole, recwarn):
    """As earlier versions left them: the same to the bit, and sealed from then on."""
    with changed_notes(folder / "checkpoint.h5") as notes:
        del notes["seals"]
    for name in ("checkpoint.h5", "mesh.h5", "history.h5", "fields/rock_mesh.h5"):
        with h5py.File(folder / name, "r+") as file:
            del file[SEAL], file.attrs[SEAL]
    resume(folder)
    assert len([each for each in recwarn if "left no seals here" in str(each.message)]) == 1
    assert same(read_history(folder / "history.h5"), whole)
    assert read_notes(folder / "checkpoint.h5")["seals"].keys() == {"mesh", "history", "scene"}
    for name in ("checkpoint.h5", "mesh.h5", "history.h5"):
        with h5py.File(folder / name, "r") as file:
            assert SEAL in file and SEAL in file.attrs


# damage of any kind


def read_fields(path):
    return read_step(path)


READERS = {
    "checkpoint.h5": lambda path: (read_notes(path), read_arrays(path)),
    "mesh.h5": lambda path: vars(load_mesh(path)),
    "history.h5": lambda path: (read_history(path), read_attributes(path)),
    "fields/fractures_000002.h5": read_step,
    "fields/rock_mesh.h5": lambda path: fracflow.output.read_mesh(path.parents[1], "rock"),
}


@pytest.mark.parametrize("name", READERS)
def test_any_damage_is_seen_or_changes_nothing(name, stopped, tmp_path, monkeypatch):
    """Bits, bytes and pages. HDF5 by itself may crash, go round, or wait for ever where it reads a live file."""
    monkeypatch.setattr(h5_reader, "PATIENCE", 4.0)
    dice, path = random.Random(name), tmp_path / "fields" / Path(name).name
    path.parent.mkdir()
    if name == "history.h5":  # as a kill leaves it
        old = (read_history(stopped / name), read_attributes(stopped / name))
        with HistoryFile.after(tmp_path / "live.h5", *old):
            good = (tmp_path / "live.h5").read_bytes()
    else:
        good = (stopped / name).read_bytes()
    path.write_bytes(good)
    right, seen, longest = flat(READERS[name](path)), 0, 0.0
    for _ in range(80):
        bad = bytearray(good)
        # structure is in the first pages and between the arrays; most of a small file is that
        at = dice.randrange(len(bad)) if dice.random() < 0.5 else dice.randrange(min(4096, len(bad)))
        how = dice.choice(("bit", "bit", "bytes", "zeros", "cut"))
        if how == "bit":
            bad[at] ^= 1 << dice.randrange(8)
        elif how == "bytes":
            bad[at : at + 8] = dice.randbytes(8)
        elif how == "zeros":
            bad[at : at + dice.choice((8, 64, 512))] = bytes(dice.choice((8, 64, 512)))
        else:
            del bad[at:]
        path.write_bytes(bad)
        began = time.monotonic()
        try:
            assert flat(READERS[name](path)) == right, (how, at)
        except InputError as error:
            assert str(path) in str(error)
            seen += 1
        longest = max(longest, time.monotonic() - began)
    assert seen > 20 and longest < 20.0


REPLACED = {
    "empty": lambda path: path.write_bytes(b""),
    "a text": lambda path: path.write_text("time,slip\n0,1\n"),
    "half": lambda path: path.write_bytes(path.read_bytes()[: path.stat().st_size // 2]),
    "a pipe": lambda path: (path.unlink(), os.mkfifo(path)),
    "a folder": lambda path: (path.unlink(), path.mkdir()),
}


@pytest.mark.parametrize("how", REPLACED)
@pytest.mark.parametrize("name", ["checkpoint.h5", "mesh.h5", "history.h5"])
def test_a_file_that_is_another_is_refused(name, how, folder, monkeypatch, capfd):
    REPLACED[how](folder / name)
    assert name in refused(folder, monkeypatch, capfd)


@pytest.mark.parametrize("command", ["picture", "export"])
def test_commands_that_only_read_refuse_it_too(command, folder, monkeypatch, capfd):
    flip(folder / "history.h5", "energy/friction", at=8)
    said = refused(folder, monkeypatch, capfd, command=command)
    assert "history.h5: step 1 is not as it was written" in said


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("events.csv", "kind,fracture\nslip,Bruno\n"),
        ("events.csv", None),
        ("fields/rock_mesh.h5", "no mesh"),
        ("fields/fractures_000006.h5", "no fields"),
    ],
)
def test_pictures_need_whole_files(name, text, folder, monkeypatch, capfd):
    path = folder / name
    path.write_text(path.read_text().replace("slip,", "slip,,", 1) if text is None else text)
    assert path.name in refused(folder, monkeypatch, capfd, command="picture")
