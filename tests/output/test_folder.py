from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest

from fracflow.errors import InputError
from fracflow.output.fields import list_steps
from fracflow.output.folder import RunFolder

pytestmark = pytest.mark.serial


def test_a_run_folder_holds_texts_and_a_log(tmp_path):
    folder = RunFolder(tmp_path / "deep" / "run")
    folder.write_text("scene.toml", 'title = "ä"\n')
    folder.write_plan([{"limit": np.float64(0.5), "error": float("inf"), "sizes": np.arange(2), "on": True}])
    folder.log("one")
    folder.log("two\n")
    assert (folder / "log.txt").read_text() == "one\ntwo\n"
    assert json.loads((folder / "plan.json").read_text()) == [
        {"limit": 0.5, "error": "inf", "sizes": [0, 1], "on": True}
    ]


def test_an_earlier_run_is_replaced_but_other_files_stay(tmp_path):
    folder = RunFolder(tmp_path / "run")
    (folder / "fields").mkdir()
    for name in ("history.h5", "fields/rock_000001.h5", "fields/notes.txt", "rock.xdmf", "mine.csv"):
        (folder / name).write_text("")
    folder.close()
    RunFolder(tmp_path / "run", resume=True).close()
    assert (folder / "history.h5").exists()
    RunFolder(tmp_path / "run").close()
    left = {path.name for path in folder.path.rglob("*") if path.is_file()}
    assert left == {".fracflow", "notes.txt", "mine.csv"}


@pytest.mark.parametrize("resume", [False, True])
def test_what_a_kill_left_half_written_is_taken_away(tmp_path, resume):
    folder = RunFolder(tmp_path / "run")
    (folder / "fields").mkdir()
    for name in ("history.h5.part", "fields/rock_000001.h5.part", "checkpoint.h5", "notes.txt"):
        (folder / name).write_text("")
    folder.close()
    RunFolder(tmp_path / "run", resume=resume).close()
    left = {path.name for path in folder.path.rglob("*") if path.is_file()}
    assert left == {".fracflow", "notes.txt", *(["checkpoint.h5"] if resume else [])}


def test_a_folder_has_one_run_at_a_time(tmp_path):
    """A second process would write over the first one's files; a killed one leaves no lock behind."""
    hold = "import sys; from fracflow.output.folder import RunFolder; f = RunFolder(sys.argv[1]); print(1, flush=True); input()"
    command = [sys.executable, "-c", hold, str(tmp_path / "run")]
    other = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert other.stdout.readline() == b"1\n"
    for resume in (False, True):
        with pytest.raises(InputError, match=rf"run: a run is under way there .process {other.pid}."):
            RunFolder(tmp_path / "run", resume=resume)
    other.kill()
    other.wait()
    RunFolder(tmp_path / "run").close()


def test_foreign_folders_are_left_alone(tmp_path):
    (tmp_path / "letter.txt").write_text("dear")
    (tmp_path / "empty").mkdir()
    RunFolder(tmp_path / "empty")
    with pytest.raises(InputError, match="no run's"):
        RunFolder(tmp_path)
    with pytest.raises(InputError, match="is a file"):
        RunFolder(tmp_path / "letter.txt")
    with pytest.raises(InputError, match="holds no run"):
        RunFolder(tmp_path / "new", resume=True)
    assert not (tmp_path / "new").exists()


def test_a_copy_of_a_field_file_is_left_alone(tmp_path):
    folder = RunFolder(tmp_path / "run")
    (folder / "fields").mkdir()
    for name in ("rock_000002", "rock_000004", "rock_000004 (copy)", "rock_1\u00b2", "rock_mesh", "old_rock_000004"):
        (folder / "fields" / f"{name}.h5").write_text("")
    assert [number for number, _ in list_steps(tmp_path / "run", "rock")] == [2, 4]
    folder.cut_back(3, 0, 2)
    left = {path.stem for path in (folder / "fields").iterdir()}
    assert left == {"rock_000002", "rock_000004 (copy)", "rock_1\u00b2", "rock_mesh"}
