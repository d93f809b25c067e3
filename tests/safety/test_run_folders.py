"""Run folders from anybody: no link is followed, no pipe waited for, no file outside written."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest
from malformed import SCENE, contents, said

from fracflow.errors import InputError
from fracflow.mesh.store import load_mesh
from fracflow.output.folder import RunFolder, write_atomic
from fracflow.output.history import HistoryFile, read_history
from fracflow.scene.scene import load
from fracflow.simulation.run import resume, run

pytestmark = pytest.mark.serial
ROOT = Path(__file__).parents[2]


def linked(path, outside):
    path.unlink(missing_ok=True)
    path.symlink_to(outside)


def twice(path, outside):
    path.unlink(missing_ok=True)
    os.link(outside, path)


def piped(path, outside):
    path.unlink(missing_ok=True)
    os.mkfifo(path)


def to_zero(path, outside):
    linked(path, "/dev/zero")


def elsewhere(path, outside):
    if path.exists():
        path.rename(outside.parent / "moved")
    (outside.parent / "moved").mkdir(exist_ok=True)
    path.symlink_to(outside.parent / "moved")


TRAPS = {
    "a log elsewhere": ("log.txt", linked),
    "a log of two names": ("log.txt", twice),
    "a log that is a pipe": ("log.txt", piped),
    "a marker elsewhere": (".fracflow", linked),
    "a marker of two names": (".fracflow", twice),
    "a checkpoint elsewhere": ("checkpoint.h5", linked),
    "a history without end": ("history.h5", to_zero),
    "a half history elsewhere": ("history.h5.part", linked),
    "a half checkpoint elsewhere": ("checkpoint.h5.part", linked),
    "a scene that is a pipe": ("scene.toml", piped),
    "a status elsewhere": ("status.json", linked),
    "a half picture elsewhere": ("pictures/overview.png.part", linked),
    "a field elsewhere": ("fields/rock_000001.h5", linked),
    "fields elsewhere": ("fields", elsewhere),
    "pictures elsewhere": ("pictures", elsewhere),
    "a folder as a log": ("log.txt", lambda path, outside: (path.unlink(), path.mkdir())),
}


@pytest.mark.parametrize("name", TRAPS)
def test_a_run_folder_leads_nowhere_else(name, ended, tmp_path, monkeypatch, capfd):
    where, trap = TRAPS[name]
    folder, outside = tmp_path / "out", tmp_path / "precious"
    shutil.copytree(ended, folder)
    (folder / "pictures").mkdir(exist_ok=True)
    outside.write_text("mine\n" * 1000)
    trap(folder / where, outside)
    before = contents(tmp_path)
    (tmp_path / "again").mkdir()
    (tmp_path / "again" / "scene.toml").write_text(SCENE)
    before = contents(tmp_path)
    commands = [["resume", folder], ["run", tmp_path / "again" / "scene.toml", "-o", folder]]
    for words in [*commands, *([["picture", folder], ["export", "--csv", folder]] if trap is not twice else [])]:
        code, line = said(words, monkeypatch, capfd)
        assert code == 2 and where.partition("/")[0] in line and "remove it" in line
    assert contents(tmp_path) == before


def test_what_is_written_follows_no_link(tmp_path):
    """As the check above might be passed by a link that comes later."""
    outside = tmp_path / "precious"
    outside.write_text("mine")
    folder = RunFolder(tmp_path / "out")
    for name in ("plan.json.part", "history.h5.part"):
        (folder / name).symlink_to(outside)
    folder.write_text("plan.json", "{}")
    with HistoryFile(folder / "history.h5") as history:
        history.append({"time": 0.0})
    (folder / "log.txt").symlink_to(outside)
    folder.log("a line")
    assert folder.unlogged == 1
    with pytest.raises(InputError, match=r"log.txt: is a link"):
        folder.cut_back(0, 0, 0)
    write_atomic(folder / "log.txt", "")  # takes the place of the link
    assert outside.read_text() == "mine" and not (folder / "log.txt").is_symlink()


def external(path):
    with h5py.File(path, "w") as file:
        file["time"] = h5py.ExternalLink("/etc/passwd", "/x")


def stored_elsewhere(path):
    with h5py.File(path, "w") as file:
        file.create_dataset("time", (10,), "f8", external=[("/etc/passwd", 0, 80)])


def made_up(path):
    with h5py.File(path, "w") as file:
        file.create_dataset("time", (10**13,), "f8", chunks=(1000,))


def in_circles(path):
    with h5py.File(path, "w") as file:
        file["a/b"] = h5py.SoftLink("/a")
        file["c/d"] = file["c"] if "c" in file else file.create_group("c")


@pytest.mark.parametrize("make", [external, stored_elsewhere, made_up, in_circles])
@pytest.mark.parametrize("read", [read_history, load_mesh])
def test_an_hdf5_file_holds_its_data_itself(make, read, tmp_path):
    make(tmp_path / "a.h5")
    with pytest.raises(InputError, match=r"a.h5: is no .*; "):
        read(tmp_path / "a.h5")


def test_a_run_that_was_moved_before_its_first_checkpoint_goes_on(tmp_path):
    """Its folder alone is enough: the mesh is kept there."""
    home = tmp_path / "a" / "deep" / "home"
    home.mkdir(parents=True)
    shutil.copy(ROOT / "meshes" / "report_5_2" / "block.geo", home)
    text = (ROOT / "meshes" / "report_5_2" / "scene.toml").read_text()
    (home / "scene.toml").write_text(text)
    scene = load(home / "scene.toml", ["stage.0.end=0.3"])
    run(scene, home / "out")
    whole = read_history(home / "out" / "history.h5")
    shutil.move(home / "out", tmp_path / "moved")
    shutil.rmtree(tmp_path / "a")
    (tmp_path / "moved" / "checkpoint.h5").unlink()
    (tmp_path / "moved" / "history.h5").unlink()
    resume(tmp_path / "moved")
    again = read_history(tmp_path / "moved" / "history.h5")
    assert again.keys() == whole.keys() and all(np.array_equal(again[k], whole[k], equal_nan=True) for k in whole)
