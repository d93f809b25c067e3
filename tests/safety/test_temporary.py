"""Temporary folders: none is left by a process that was killed, and none in use is taken away."""

import os
import subprocess
import sys
import tempfile

import pytest

from fracflow.storage import child
from fracflow.storage.child import IN_USE, temporary_folder

pytestmark = pytest.mark.serial
HOLDS = """
import sys
from fracflow.storage.child import temporary_folder
with temporary_folder("mesh") as folder:
    print(folder, flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def of_tests(monkeypatch, tmp_path):
    """The folder for temporary files; none in it is too young to go."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", None)
    monkeypatch.setattr(child, "YOUNG", -1.0)
    return tmp_path


def test_those_of_a_killed_process_go_with_the_next(of_tests):
    with subprocess.Popen(
        [sys.executable, "-c", HOLDS], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as one:
        left = one.stdout.readline().strip()
        with temporary_folder("mesh") as mine:
            assert {each.name for each in of_tests.iterdir()} == {mine.name, os.path.basename(left)}
        one.kill()
    assert os.path.isdir(left)
    with temporary_folder("gmsh"):
        assert os.path.isdir(left)
    with temporary_folder("mesh") as mine:
        assert list(of_tests.iterdir()) == [mine]
    assert not list(of_tests.iterdir())


@pytest.mark.parametrize("text", [None, "another-machine", "\xff"])
def test_others_are_left_alone(of_tests, text):
    other = of_tests / "fracflow-mesh-other"
    other.mkdir()
    if text is not None:
        (other / IN_USE).write_text(text, encoding="latin-1")
    (of_tests / "fracflow-mesh-link").symlink_to(of_tests / "kept")
    with temporary_folder("mesh"):
        assert other.is_dir()


def test_a_young_one_may_not_have_its_lock_yet(of_tests, monkeypatch):
    monkeypatch.setattr(child, "YOUNG", 60.0)
    other = of_tests / "fracflow-mesh-other"
    other.mkdir()
    (other / IN_USE).write_text(os.uname().nodename)
    with temporary_folder("mesh"):
        assert other.is_dir()
