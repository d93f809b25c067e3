"""Folders of a run that was stopped half way."""

from __future__ import annotations

import shutil

import pytest
from malformed import SCENE
from stopped_run import stop_half_way

from fracflow.scene.scene import load
from fracflow.simulation.run import run


@pytest.fixture(scope="session")
def stopped(tmp_path_factory):
    """The folder of a run that was stopped half way; it stays as it is."""
    return stop_half_way(tmp_path_factory.mktemp("stopped"))


@pytest.fixture
def folder(stopped, tmp_path):
    """A copy of the folder, to be damaged."""
    shutil.copytree(stopped, tmp_path / "out")
    return tmp_path / "out"


@pytest.fixture(scope="session")
def ended(tmp_path_factory):
    """A run that has ended, with fields and a log."""
    home = tmp_path_factory.mktemp("ended")
    (home / "scene.toml").write_text(SCENE)
    run(load(home / "scene.toml"), home / "out")
    return home / "out"
