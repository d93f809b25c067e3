"""Progress of a run in words: steps and substeps, sections, trials, events, and a time left only where it is known."""

import os
import pty
import re
import sys
import threading
import time
from functools import partial
from types import SimpleNamespace

import pytest
from malformed import SCENE
from rich.console import Console

from fracflow.cli.progress import Pace, RunProgress, Screen, inside, spoken
from fracflow.cli.run import run_with_progress
from fracflow.model.state import TrialProgress
from fracflow.scene.boundary import Stage
from fracflow.scene.scene import Scene, load
from fracflow.simulation.observer import Observer
from fracflow.simulation.run import run
from fracflow.solve.problem import StepProblem

DYNAMIC = Stage(name="shock", kind="dynamic", time_step=0.01, steps=10)
AUTO = Stage(name="weeks", kind="auto", time_step=3600.0, end=864000.0)
SEARCH = Stage(name="pumping", kind="steady", until="incipient", control="pumping")


class Story:
    """The lines of a run with these stages, whose steps take so many seconds each."""

    def __init__(self, *stages):
        self.now, self.told, self.time, self.n = 100.0, [], 0.0, 0
        scene = SimpleNamespace(stage=stages, unit_names={"length": "m", "force": "N", "time": "s"})
        self.bar = RunProgress(scene, lambda line, share: self.told.append((line, share)), lambda: self.now)

    def step(self, stage=0, takes=1.0, length=0.01, regime="", rejected=0, **progress):
        self.now, self.time, self.n = self.now + takes, self.time + length, self.n + 1
        state = SimpleNamespace(time=self.time, controls={"pumping": 1.2345678})
        report = SimpleNamespace(rejected=rejected)
        given = {"n": self.n, "start": 0.0, **progress}
        self.bar(SimpleNamespace(state=state, stage=stage, dt=length, regime=regime, report=report, progress=given))
        return self.told[-1][0]

    def auto(self, regime="quasi-static", length=3600.0, takes=1.0, **progress):
        self.n = 0
        return self.step(takes=takes, length=length, regime=regime, **progress)


@pytest.mark.serial
def test_steps_sections_and_the_time_left():
    story = Story(DYNAMIC)
    assert story.told == [("setting up: mesh, model, what is left out", None)]
    for _ in range(3):
        assert "left" not in story.step()  # too few to know a pace by
    story.bar.sections(3, 1)
    assert story.step() == (
        "stage 1 of 1 (shock): dynamic, step 4 of 10, at 40 ms, 3 sections slip, 1 open; about 6 s left"
    )
    assert story.told[-1][1] == 0.4
    assert "quasi-static, at 3.33 h of 10 days" in Story(AUTO).auto(length=12000.0)


@pytest.mark.serial
def test_substeps_are_parts_of_a_step():
    story = Story(DYNAMIC)
    story.n = 5
    line = story.step(n=6, place_base=0.0, place_part=0.25)
    assert "step 7 of 10, 25% of it done in substeps" in line and story.told[-1][1] == 0.625


@pytest.mark.serial
def test_a_pace_that_changes_gives_two_times():
    story = Story(DYNAMIC)
    for takes in (1.0, 1.0, 1.0, 1.0, 60.0):
        line = story.step(takes=takes)
    assert line.endswith("; 79 s to 5 min left")


@pytest.mark.serial
def test_with_stages_after_it_the_time_left_is_that_of_the_stage():
    story = Story(DYNAMIC, SEARCH)
    for _ in range(5):
        line = story.step()
    assert line.endswith("; about 5 s left in this stage, with 1 more after it")
    line = story.step(stage=1, length=0.0, increment=0.5)
    assert line.startswith("stage 2 of 2 (pumping): control.pumping at 1.235")
    assert line.endswith("; its end is not known before the first section is about to slip")
    assert story.told[-1][1] is None


@pytest.mark.serial
def test_an_event_has_no_time_left_and_does_not_count_afterwards():
    story = Story(AUTO)
    for _ in range(60):
        line = story.auto()
    assert line == ("stage 1 of 1 (weeks): quasi-static, at 2.5 days of 10 days; 3 min left + events")
    begun = story.time
    for _ in range(500):  # ten minutes at a standing clock
        line = story.auto("dynamic", length=1e-3, takes=1.2, begun=begun)
    assert "dynamic, in an event for 500 ms, at 2.5" in line
    assert line.endswith("; the time left is not known during an event")
    for _ in range(20):
        line = story.auto()
    assert line.endswith("; 2.7 min left + events")


@pytest.mark.serial
def test_an_event_gives_its_least_time_and_then_its_share_of_the_run():
    """A period of 0.2 s in steps of a millisecond: 200 steps at least, of half a second each."""
    story, stage = Story(AUTO), AUTO.model_copy(update={"rest_periods": 1.0})
    story.bar.scene.stage = (stage,)
    for _ in range(5):
        story.auto(takes=10.0)
    begun = story.time
    for count in range(1, 251):
        line = story.auto("dynamic", length=1e-3, takes=0.5, begun=begun, period=0.2, least=1e-3, count=float(count))
        if count in (3, 100, 250):
            left = {3: "is not known during an event", 100: "the event takes at least 50 s more", 250: "is not known"}
            assert left[count] in line
    line = story.auto(takes=10.0)
    assert ", 1 event so far in 2.1 min; " in line and line.endswith(" left + events")


@pytest.mark.serial
def test_a_run_that_begins_anew_has_a_new_pace():
    story = Story(DYNAMIC)
    for _ in range(8):
        story.step(takes=100.0)
    story.n = 0
    assert "left" not in story.step()


@pytest.mark.serial
def test_trials_are_shown_as_they_are_rejected():
    story = Story(AUTO)
    story.auto(length=43200.0)
    for rejected in range(3):
        story.bar.trial(43200.0, 0.5**rejected, "why")
    there = "stage 1 of 1 (weeks): quasi-static, at 12 h of 10 days"
    assert story.told[-1][0] == f"{there}, 3 trials rejected, the last of 250 ms at 12 h"
    assert ", 3 trials rejected" in story.auto(rejected=3)


@pytest.mark.serial
def test_few_samples_are_kept_of_a_long_run():
    pace = Pace(0.0)
    for n in range(1, 100_001):
        pace.add(float(n), n / 200_000, False)
    assert len(pace.samples) < 300 and pace.left() == pytest.approx((1e5, 1e5), rel=1e-3)


@pytest.mark.serial
def test_times_as_they_are_said():
    assert [spoken(s) for s in (4.2, 89.0, 91.0, 3600.0, 9000.0, 4e5)] == [
        "4 s",
        "89 s",
        "1.5 min",
        "60 min",
        "2.5 h",
        "4.6 days",
    ]


def small(folder, comm) -> Scene:
    """A scene of a few steps, in a file that all ranks have."""
    if comm.rank == 0:
        (folder / "scene.toml").write_text(SCENE)
    comm.barrier()
    return load(folder / "scene.toml", ["stage.0.steps=12"])


def go(scene, folder, comm):
    """A run each of whose steps takes 20 ms at least."""

    def job(tick):
        class Slow(Observer):
            sections, saved = staticmethod(tick.sections), staticmethod(tick.saved)

            def __call__(self, step):
                time.sleep(0.02)
                tick(step)

        return run(scene, folder, comm, Slow())

    run_with_progress(scene, folder, Console(quiet=True), comm, job, is_shown=False)


def test_a_pipe_gets_lines_of_rank_0(shared_tmp, comm, capfd, monkeypatch):
    monkeypatch.setattr("fracflow.cli.progress.INTERVAL", 0.03)
    go(small(shared_tmp, comm), shared_tmp / "out", comm)
    said = capfd.readouterr().err
    if comm.rank > 0:
        assert said == ""
        return
    assert "\r" not in said and "\x1b" not in said
    line = r"A square with a fault: after \d s: stage 1 of 1 \(quasi-static\): quasi-static, step \d+ of 12, at \d+ s"
    assert re.search(line + r", \d+ sections slip, \d+ open", said)
    assert all(each.startswith("A square with a fault: after ") for each in said.splitlines())


def test_a_short_run_says_nothing_into_a_pipe(shared_tmp, comm, capfd):
    go(small(shared_tmp, comm), shared_tmp / "out", comm)
    assert capfd.readouterr().err == ""


def read_terminal(end):
    """Bytes from a terminal; none once its other end is closed."""
    try:
        return os.read(end, 1 << 16)
    except OSError:
        return b""


@pytest.mark.serial
def test_a_terminal_has_a_bar(tmp_path, comm, monkeypatch):
    there, here = pty.openpty()
    parts = []
    reader = threading.Thread(target=lambda: parts.extend(iter(partial(read_terminal, there), b"")))
    reader.start()  # a terminal that nobody reads takes 4 kB, then holds the run up
    with os.fdopen(here, "w") as terminal:
        monkeypatch.setattr(sys, "stderr", terminal)
        monkeypatch.setenv("TERM", "xterm")
        monkeypatch.setenv("COLUMNS", "100")
        go(small(tmp_path, comm), tmp_path / "out", comm)
    reader.join()
    os.close(there)
    said = b"".join(parts).decode()
    plain = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", said)
    assert "━" in plain and re.search(r"A square with a fault .* \d+%", plain)
    assert re.search(
        r"stage 1 of 1 \(quasi-static\): quasi-static, step \d+ of 12, at \d+ s, 0 sections slip, 0 open", plain
    )


@pytest.mark.serial
def test_a_long_step_is_seen_to_go_on(capfd, monkeypatch):
    monkeypatch.setattr("fracflow.cli.progress.INTERVAL", 0.02)
    with Screen(Console(stderr=True), "a run") as screen:
        screen.show("stage 1 of 1 (shock): dynamic, step 4 of 10", 0.4)
        screen.follow(TrialProgress(iteration=7, unbalanced=3.14e-5))
        time.sleep(0.1)
    said = capfd.readouterr().err.splitlines()[-1]
    assert said.endswith("step 4 of 10, and this for 0 s at Newton iteration 7, 3.1e-05 out of balance")
    assert inside(TrialProgress(), 9.0, 5.0) == ", and this for 9 s"  # nothing is known of a first iteration under way


@pytest.mark.serial
def test_a_run_is_followed_into_its_steps(tmp_path, comm, monkeypatch):
    """While a step is solved; afterwards, as in explicit steps, there is no iteration."""
    found, seen, destroy = [], [], StepProblem.destroy

    def ended(problem):
        seen.append((problem.work.trial, problem.work.trial.iteration, problem.work.trial.unbalanced))
        destroy(problem)

    monkeypatch.setattr(StepProblem, "destroy", ended)
    run(
        small(tmp_path, comm),
        tmp_path / "out",
        progress=RunProgress(small(tmp_path, comm), lambda *_: None, on_trial=found.append),
    )
    assert seen and all(trial is found[0] and count > 0 and left < 1e-6 for trial, count, left in seen)
    assert inside(found[0], 7.0, 5.0) == ", and this for 7 s"
