"""A run that is stopped goes on as if nothing had happened: on the same ranks bit by bit, on others to round-off."""

from __future__ import annotations

import random
import signal
import subprocess
import sys
import time
import xml.etree.ElementTree as ElementTree
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from _launch import without_ranks
from rich.console import Console

from fracflow._petsc import MPI
from fracflow.cli.run import run_with_progress
from fracflow.errors import InputError, Interrupted
from fracflow.model.state import COUNTS as COUNTS_OF_STEPS
from fracflow.model.state import StepReport
from fracflow.output import list_steps, read_events, read_history, read_step
from fracflow.output.status import STOPPED, read_status
from fracflow.scene.scene import load
from fracflow.simulation.run import resume, run
from fracflow.simulation.signals import RunRequest, SignalWatch
from fracflow.simulation.totals import Totals

pytestmark = [pytest.mark.serial, pytest.mark.starts_ranks]
ROOT = Path(__file__).parents[2]
SCENE = str(ROOT / "meshes/report_5_5/scene.toml")
# the first 60 dynamic steps hold the strength drops of nodes 4, 3 and 5
SHORT = ["output.pictures=false", "stage.failure.steps=60", "output.checkpoint_every=7", "output.fields_every=20"]
PATIENCE = 300.0  # s: a machine that others use takes minutes for what takes seconds alone
COUNTS = {"step/factorisations"}  # the first step after a resume has no old factorisation to use


def environment():
    kept = without_ranks()
    return {**kept, "PYTHONPATH": str(ROOT)}


def command(*words, ranks=1):
    launcher = ["mpirun", "-n", str(ranks)] if ranks > 1 else []
    return [*launcher, sys.executable, "-m", "fracflow", *map(str, words)]


def start(folder, *overrides, ranks=1):
    sets = [word for setting in (*SHORT, *overrides) for word in ("--set", setting)]
    words = command("run", SCENE, "-o", folder, *sets, ranks=ranks)
    return subprocess.Popen(words, env=environment(), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def go_on(folder, ranks=1):
    done = subprocess.run(
        command("resume", folder, ranks=ranks), env=environment(), capture_output=True, text=True, timeout=PATIENCE
    )
    assert done.returncode == 0, done.stderr
    return done


def wait_for_rows(folder, rows, process, patience=PATIENCE):
    """Wait until the history has so many steps, or the process has ended; fail where neither comes in time."""
    end, found = time.monotonic() + patience, 0
    while process.poll() is None:
        try:
            found = len(read_history(folder / "history.h5").get("time", ()))
        except InputError:
            pass
        if found >= rows:
            return
        if time.monotonic() > end:
            process.kill()
            pytest.fail(f"{folder}: only {found} of {rows} rows after {patience:g} s")
        time.sleep(0.02)  # reading takes a core from those that run


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The undisturbed run."""
    folder = tmp_path_factory.mktemp("whole") / "out"
    run(load(SCENE, SHORT), folder)
    return folder


def same(folder, whole):
    one, other = read_history(folder / "history.h5"), read_history(whole / "history.h5")
    assert one.keys() == other.keys()
    differ = [k for k in one.keys() - COUNTS if not np.array_equal(one[k], other[k], equal_nan=True)]
    assert not differ
    assert (folder / "events.csv").read_text() == (whole / "events.csv").read_text()
    assert {p.name for p in (folder / "fields").iterdir()} == {p.name for p in (whole / "fields").iterdir()}
    for _, path in list_steps(whole, "fractures"):
        mine, theirs = read_step(folder / "fields" / path.name)[1], read_step(path)[1]
        assert [k for k in theirs if not np.array_equal(mine[k], theirs[k], equal_nan=True)] == []


def readable(folder):
    """Every file that is there can be read."""
    if (folder / "history.h5").exists():
        history = read_history(folder / "history.h5")
        assert len({len(values) for values in history.values()}) <= 1
    if (folder / "events.csv").exists():
        read_events(folder / "events.csv")
    for name in folder.glob("*.xdmf"):
        ElementTree.parse(name)


def killed(folder, rows, delay):
    process = start(folder)
    wait_for_rows(folder, rows, process)
    time.sleep(delay)
    process.kill()
    process.communicate()
    readable(folder)
    return folder


def test_twenty_kills(tmp_path, whole):
    """kill -9 at seeded moments, from the first file of the folder to the last step."""
    dice = random.Random(76)
    moments = [(dice.randrange(0, 62), dice.uniform(0.0, 0.03)) for _ in range(20)]
    with ThreadPoolExecutor(2) as pool:
        jobs = [pool.submit(killed, tmp_path / f"kill{i}", *moment) for i, moment in enumerate(moments)]
        resumed = 0
        for folder in (job.result() for job in jobs):
            if (folder / "scene.toml").exists():
                resume(folder)  # in this process, whose start is behind it; the next ones are being killed meanwhile
                readable(folder)
                same(folder, whole)
                resumed += 1
    assert resumed >= 15  # the others were killed before they wrote a thing


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGUSR2])
def test_signals_save_and_stop(tmp_path, whole, number):
    folder = tmp_path / "out"
    process = start(folder, "output.checkpoint_every=0")
    wait_for_rows(folder, 12, process)
    process.send_signal(number)
    _, complaint = process.communicate(timeout=PATIENCE)
    assert process.returncode == 130, complaint
    lines = [line for line in complaint.splitlines() if line.startswith("fracflow: ")]
    assert len(lines) == 1 and f"fracflow resume {folder}" in lines[0]
    stopped = len(read_history(folder / "history.h5")["time"])
    assert 12 <= stopped < len(read_history(whole / "history.h5")["time"])
    go_on(folder)
    same(folder, whole)


def test_a_signal_that_comes_while_ranks_agree_on_a_save_is_met_after_the_next_step():
    class Ranks:
        rank, sent = 0, [signal.SIGTERM]

        def allreduce(self, value, op):
            if self.sent:
                signal.raise_signal(self.sent.pop())
            return value

    with SignalWatch(Ranks(), 1, 1e9) as watch:
        assert [watch.request(steps) for steps in (1, 2, 3)] == [RunRequest.SAVE, RunRequest.STOP, RunRequest.SAVE]


@pytest.mark.parametrize("steps", [0, 3])
def test_a_second_interrupt_tells_how_to_go_on(tmp_path, steps):
    def job(observer):
        if steps:
            observer.saved(steps)
        raise KeyboardInterrupt

    with pytest.raises(Interrupted if steps else KeyboardInterrupt) as caught:
        run_with_progress(load(SCENE), tmp_path, Console(quiet=True), MPI.COMM_SELF, job)
    if steps:
        assert str(caught.value).endswith(f"after 3 steps is on disk; go on with: fracflow resume {tmp_path}")


@pytest.mark.parametrize(
    ("before", "after", "number"), [(1, 2, signal.SIGTERM), (3, 1, signal.SIGTERM), (2, 2, signal.SIGUSR2)]
)
def test_on_another_number_of_ranks(tmp_path, whole, before, after, number):
    """The same events; histories to 1e-12 of each field's size; on the same number bit by bit.

    mpirun passes USR2 on and waits. After TERM it waits a second or two, which is enough for these steps.
    """
    folder, undisturbed = tmp_path / "out", whole
    process = start(folder, ranks=before)
    wait_for_rows(folder, 25, process)
    process.send_signal(number)
    _, complaint = process.communicate(timeout=PATIENCE)
    if number == signal.SIGUSR2:
        assert (process.returncode, read_status(folder).word) == (130, STOPPED), complaint
    assert 25 <= len(read_history(folder / "history.h5")["time"])
    go_on(folder, ranks=after)
    one, other = read_history(folder / "history.h5"), read_history(undisturbed / "history.h5")
    assert len(one["time"]) == len(other["time"]) > 60
    logs = [read_events(f / "events.csv") for f in (folder, undisturbed)]
    slips, starts = (
        [[(e["kind"], e["node"]) for e in log] for log in logs],
        [[e["start"] for e in log] for log in logs],
    )
    assert slips[0] == slips[1] and starts[0] == pytest.approx(starts[1], rel=1e-10)
    energy = max(np.abs(v).max() for k, v in other.items() if k.startswith("energy/"))
    natural = {"traction": 1.7e5, "pressure": 3e4, "opening": 1.7e-3, "slip": 1.7e-3, "displacement": 1.7e-3}
    for key in one:
        if key.startswith("energy/"):
            size = energy
        elif key.startswith("probe/") and not key.endswith(("rate", "velocity", "acceleration", "bottom")):
            size = max([v for k, v in natural.items() if k in key] + [np.abs(other[key]).max()])
        else:
            continue
        assert np.abs(one[key] - other[key]).max() <= 1e-10 * size, key  # as tests/parallel has it


def test_a_failed_solve_leaves_its_last_good_state(tmp_path):
    """The tolerance is out of reach from the second stage on: exit 3, and the state before it is in the checkpoint."""
    folder = tmp_path / "out"
    process = start(folder, "method.coupling=fixed-point", "fracture.fault.aperture=0.05 ft")
    _, complaint = process.communicate(timeout=PATIENCE)
    assert process.returncode == 3, complaint
    words = command("resume", folder)
    done = subprocess.run(words, env=environment(), capture_output=True, text=True, timeout=PATIENCE)
    assert done.returncode == 3 and "fixed-point" in done.stderr  # it goes on to where it failed, and says so again


def test_a_finished_run_stays_as_it_is(whole):
    before = (whole / "history.h5").stat().st_mtime_ns
    assert resume(whole).steps == len(read_history(whole / "history.h5")["time"])
    assert (whole / "history.h5").stat().st_mtime_ns == before


def test_what_is_no_run_is_refused(tmp_path):
    with pytest.raises(InputError, match="holds no run"):
        resume(tmp_path)
    (tmp_path / "scene.toml").write_text((ROOT / "meshes/report_5_5/scene.toml").read_text())
    (tmp_path / "checkpoint.h5").write_bytes(b"rubbish")
    with pytest.raises(InputError, match="is no checkpoint"):
        resume(tmp_path)


def test_totals_of_earlier_checkpoints_and_of_every_count():
    earlier = {"steps": 2, "newton": 5, "rejected": 1, "told_factor": 0.5}
    totals = Totals.of(earlier)
    totals.add(StepReport(newton=2, **{name: 1 for name in COUNTS_OF_STEPS if name != "newton"}))
    assert totals.steps == 3 and totals.reported_factor == 0.5
    assert totals.counts == dict.fromkeys(COUNTS_OF_STEPS, 1) | {"newton": 7, "rejected": 2}
    assert Totals.of(asdict(totals)).counts == totals.counts
    twice = StepReport(krylov=3).after(StepReport(krylov=4, refused=1))
    assert (twice.krylov, twice.refused) == (7, 1)
