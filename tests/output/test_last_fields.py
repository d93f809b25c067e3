"""A run that stops or fails leaves the fields of its last state, and its pictures say which times they show."""

from __future__ import annotations

import os
import signal
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
from stopped_run import SCENE as COARSE

import fracflow
from fracflow.errors import Interrupted, SolveError
from fracflow.output import list_steps, read_history, read_step
from fracflow.output.pictures import draw
from fracflow.output.reader import load_run_data
from fracflow.scene.scene import load
from fracflow.simulation.run import resume, run

pytestmark = pytest.mark.serial
SCENE = COARSE.replace("size = 400, size_at_fractures = 200", "size = 200, size_at_fractures = 130")
SCENE = SCENE.replace("output = {fields_every = 2, checkpoint_every = 3, pictures = false}\n", "")
LAST, SLIPS = 10, 4  # the last state, and the first in which the fracture slips


@pytest.fixture
def scene(tmp_path):
    (tmp_path / "scene.toml").write_text(SCENE)

    def of(*settings):
        return load(tmp_path / "scene.toml", ["accuracy.max_halvings=0", *settings])

    return of


def signalled(scene, folder, number, at):
    """Run until a signal after so many steps, or go on to the end; how the run ended."""
    count = [0]

    def progress(_):
        count[0] += 1
        if count[0] == at:
            os.kill(os.getpid(), number)

    try:
        run(scene, folder, progress=progress)
    except (Interrupted, SolveError) as error:
        return error
    return None


def steps_of(folder, name="fractures"):
    """Steps that have a file, after a look whether the index lists the same, at the times of the history."""
    steps = list_steps(folder, name)
    times = [float(each.get("Value")) for each in ElementTree.parse(folder / f"{name}.xdmf").iter("Time")]
    assert times == [read_step(path)[0] for _, path in steps]
    assert times == [read_history(folder / "history.h5")["time"][step] for step, _ in steps]
    return [step for step, _ in steps]


def slip(folder):
    return float(np.abs(read_step(list_steps(folder, "fractures")[-1][1])[1]["plastic_slip"]).max())


@pytest.mark.parametrize("every", [0, 3])
def test_a_stop_leaves_its_last_state_and_going_on_takes_it_away(tmp_path, scene, every):
    scene = scene(f"output.fields_every={every}")
    at = 6  # in turn where every third is
    assert isinstance(signalled(scene, tmp_path / "out", signal.SIGTERM, at), Interrupted)
    for name in ("rock", "fractures"):
        assert steps_of(tmp_path / "out", name) == ([0, 3, 6] if every else [0, 6])
    data = load_run_data(tmp_path / "out")
    assert not data.is_behind and slip(tmp_path / "out") > 1e-4
    assert slip(tmp_path / "out") >= np.abs(data.probe("middle", "plastic_slip")[-1]) > 0.0
    assert data.account == "Stopped at 36 h; fracflow resume goes on"
    assert fracflow.open(tmp_path / "out").status == "stopped"
    assert every or all(path.stat().st_size for path in draw(tmp_path / "out"))
    resume(tmp_path / "out")
    assert signalled(scene, tmp_path / "whole", signal.SIGTERM, -1) is None
    for name in ("rock", "fractures"):
        assert steps_of(tmp_path / "out", name) == ([0, 3, 6, 9, 10] if every else [0, 10])
        for (_, mine), (_, other) in zip(
            *(list_steps(tmp_path / folder, name) for folder in ("out", "whole")), strict=True
        ):
            assert mine.name == other.name and mine.read_bytes() == other.read_bytes()
    assert fracflow.open(tmp_path / "out").status == "ended"
    assert load_run_data(tmp_path / "out").account == "Ended at 60 h"


def test_a_checkpoint_leaves_fields_of_the_fractures_until_the_next(tmp_path, scene):
    """A kill then has a picture of the last checkpoint, which says so, and that the histories go on."""
    folder, seen = tmp_path / "out", []

    def progress(step):
        seen.append((steps_of(folder), load_run_data(folder)))
        if len(seen) in (2, SLIPS + 1):
            os.kill(os.getpid(), signal.SIGUSR1)

    run(scene(), folder, progress=progress)
    steps = [each for each, _ in seen]
    assert steps[1] == [0] and steps[2] == steps[4] == [0, 2] and steps[-1] == [0, 5]
    assert steps_of(folder) == [0, LAST] == steps_of(folder, "rock")
    data = seen[SLIPS - 1][1]  # slip began after the checkpoint
    assert data.is_behind and data.slipped_since() == ["Bruno"]
    assert data.account == "Under way: histories to 24 h. Map and profiles are older: of 12 h, step 2"
    (folder / "status.json").write_text('{"status": "running", "line": ""}')
    assert fracflow.open(folder).status == "cut off"


def test_a_failed_solve_leaves_its_last_state_and_says_so(tmp_path):
    """A block that the pressure lifts off: nothing holds it any more."""
    text = SCENE.replace('["west", "east", "south", "north"]', '"south"').replace('"12 MPa"', '"45 MPa"')
    text = text.replace("[400, 600], [600, 200]", "[0, 400], [1000, 400]")
    free = '[[load]]\non = ["north", "west", "east"]\ntraction = "initial-stress"\n'
    (tmp_path / "scene.toml").write_text(text.replace("[fracture.default]", free + "[fracture.default]"))
    scene, folder = load(tmp_path / "scene.toml", ["accuracy.max_halvings=0"]), tmp_path / "out"
    assert isinstance(signalled(scene, folder, signal.SIGTERM, -1), SolveError)
    last = len(read_history(folder / "history.h5")["time"]) - 1
    assert 1 < last < LAST and steps_of(folder) == [0, last]
    data = load_run_data(folder)
    assert data.status.word == "failed" and "no support" in data.status.line
    assert data.status.line.endswith(
        f"; what was reached is in {folder}: change its scene.toml, then: fracflow resume {folder}"
    )
    assert data.account == f"Failed after {data.at(21600.0 * last)}: no state beyond it was found"


def test_a_stop_after_the_first_state_has_its_fields(tmp_path, scene):
    """With no step made there is the initial state, once."""
    assert isinstance(signalled(scene(), tmp_path / "out", signal.SIGTERM, 1), Interrupted)
    assert steps_of(tmp_path / "out") == [0, 1]


def test_an_event_starts_as_the_step_begins_in_which_it_slips(tmp_path, scene):
    run(scene(), tmp_path / "out")
    found = fracflow.open(tmp_path / "out")
    first = int(np.flatnonzero(found.steps["slipping"])[0])
    assert first == SLIPS and found.events["start"].min() == found.times[first - 1]
    assert found.status == "ended"


def test_a_folder_of_an_earlier_version_tells_its_times(tmp_path, scene):
    run(scene(), tmp_path / "out")
    (tmp_path / "out/status.json").unlink()
    assert load_run_data(tmp_path / "out").account == "Histories to 60 h"
