"""The suite on one rank or many: ranks meet every test together, fail together, and never hang for long."""

from __future__ import annotations

import gc
import os
import shutil
import signal
import tempfile
import time
from pathlib import Path

import kept_meshes
import pytest
from hypothesis import settings

if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:  # as in what a shell runs in the background; tests send it
    signal.signal(signal.SIGINT, signal.default_int_handler)
os.environ.setdefault("MPLBACKEND", "Agg")
from fracflow._petsc import MPI

WORLD = MPI.COMM_WORLD.Dup()  # the suite's own messages never meet those of the code under test
SIZE, RANK = WORLD.size, WORLD.rank
PATIENCE = float(os.environ.get("FRACFLOW_TEST_PATIENCE", "300"))  # seconds a rank waits for the others
PATIENCE_AFTER_FAILURE = 30.0
APPLICATIONS = {"bench", "failures", "reference", "report", "resume", "stability", "stepping"}
"""Folders of whole runs: on one and two ranks; tests/parallel and tests/resume compare some of them on three."""
EVERY_CASE = {"resume"}  # of them, each of whose cases is another kind of state to take apart and put together

TWO_SAY_ALL = {
    "test_inertia_left_out", "test_kept_factors", "test_mesh_sizes",  # decisions on loads in time, and on the work
    "test_agreement", "test_fixed_point", "test_newton_methods", "test_true_residual",  # norms are sums over all ranks
    "test_bar_impact", "test_oblique_wave", "test_two_modes",  # waves and events: other tests have them on three ranks
    "test_history_beside", "test_quantities", "test_suction", "test_faults", "test_api", "test_memory",  # rank 0 writes
}  # fmt: skip
"""Files on one and two ranks only: a third is one more of the other ranks to them, and no neighbour on two sides."""

MESHES_ANEW = {"mesh", "safety"}
"""Folders of tests of Gmsh itself, its process and its limits: there each mesh is made anew."""

# Ranks must draw the same examples, and a failure must come back on the next run.
settings.register_profile("fracflow", derandomize=True, deadline=None, database=None)
settings.load_profile("fracflow")


def meet(patience: float, reason: str) -> None:
    """Wait for all ranks; a rank that waits in vain says why and ends them all."""
    request, end = WORLD.Ibarrier(), time.monotonic() + patience
    while not request.Test():
        if time.monotonic() > end:
            os.write(2, f"\nrank {RANK}: other ranks did not come within {patience:g} s\n{reason}\n".encode())
            WORLD.Abort(1)
        time.sleep(0.0005)


@pytest.hookimpl(tryfirst=True)  # pytest's own tmp_path reads basetemp when it is configured
def pytest_configure(config):
    kept_meshes.prepare()
    if SIZE == 1:
        return
    root = WORLD.bcast(tempfile.mkdtemp(prefix="fracflow-tests-") if RANK == 0 else None)
    config.shared_root = Path(root)
    config.option.basetemp = str(config.shared_root / f"rank{RANK}")


@pytest.hookimpl(tryfirst=True)
def pytest_sessionstart(session):
    reporter = session.config.pluginmanager.getplugin("terminalreporter")
    if RANK > 0 and reporter is not None:
        # A failure on this rank is printed by rank 0, see pytest_runtest_makereport.
        reporter._tw._file = open(os.devnull, "w")


def pytest_collection_modifyitems(config, items):
    """Serial tests run on one rank; whole applications on one and two, and parts of the program on any number.

    Serial is what needs one process or knows of no ranks, and orders in time, of steps that other tests take on ranks.
    Of one test with many cases ranks run the first and the last, but of those that take a state apart and put it together.
    """
    tests = Path(__file__).parent
    cases: dict[str, list[str]] = {}
    for item in items:
        if item.get_closest_marker("serial") is None:
            cases.setdefault(item.nodeid.partition("[")[0], []).append(item.nodeid)
    inner = {case for found in cases.values() for case in found[1:-1]}

    def runs_elsewhere(number, item):
        group = item.path.relative_to(tests).parts[0]
        # three ranks on two cores are slow
        is_spared = group in APPLICATIONS or item.path.stem in TWO_SAY_ALL or (group == "physics" and number % 4 != 0)
        is_inner = item.nodeid in inner and group not in EVERY_CASE
        return item.get_closest_marker("serial") is not None or is_inner or (SIZE > 2 and is_spared)

    if SIZE == 1:
        return
    elsewhere = [item for number, item in enumerate(items) if runs_elsewhere(number, item)]
    if elsewhere:
        config.hook.pytest_deselected(items=elsewhere)
        items[:] = [item for item in items if item not in elsewhere]


def pytest_collection_finish(session):
    gc.freeze()  # what is imported stays: collecting after a test need not look through it
    found = ([item.nodeid for item in session.items], session.testsfailed)
    meet(PATIENCE, "while the tests were collected")
    if any(other != found for other in WORLD.allgather(found)):
        os.write(2, f"\nrank {RANK}: ranks have collected different tests\n".encode())
        WORLD.Abort(1)


@pytest.hookimpl(hookwrapper=True, tryfirst=True)
def pytest_runtest_makereport(item, call):
    report = (yield).get_result()
    if SIZE == 1:
        return
    failed = report.outcome == "failed"
    reason = f"{item.nodeid} ({report.when}) {report.outcome}\n{report.longreprtext if failed else ''}"
    meet(PATIENCE_AFTER_FAILURE if failed else PATIENCE, reason)
    crash = getattr(getattr(report.longrepr, "reprcrash", None), "message", "")
    text = f"{crash.partition(chr(10))[0]}\n{report.longreprtext}" if failed else ""
    all_outcomes = WORLD.allgather((report.outcome, text))
    outcomes = [outcome for outcome, _ in all_outcomes]
    if "failed" in outcomes:
        texts = [f"rank {rank}: {text}" for rank, (_, text) in enumerate(all_outcomes) if text]
        report.outcome, report.longrepr = "failed", "\n".join(texts)
    elif len(set(outcomes)) > 1:
        report.outcome, report.longrepr = "failed", f"outcomes differ between ranks: {outcomes}"


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item):
    kept_meshes.use(item.path.relative_to(Path(__file__).parent).parts[0] not in MESHES_ANEW)


@pytest.hookimpl(trylast=True)
def pytest_runtest_teardown(item):
    if SIZE > 1:  # ranks free what is left of their common objects together
        gc.collect()


def pytest_sessionfinish(session, exitstatus):
    session.config.all_passed = exitstatus == 0
    if SIZE > 1:
        meet(PATIENCE, "at the end of the suite")


def pytest_unconfigure(config):
    if SIZE > 1:
        meet(PATIENCE, "after the suite")  # mpirun ends all when one exits, and rank 0 has yet to print
        # only now: at the end of its session each rank's pytest tidies its own folders in there
        if RANK == 0 and getattr(config, "all_passed", False):
            shutil.rmtree(config.shared_root, ignore_errors=True)


@pytest.fixture
def shared_tmp(tmp_path, request):
    """One new folder for all ranks."""
    if SIZE == 1:
        return tmp_path
    root = request.config.shared_root
    path = WORLD.bcast(tempfile.mkdtemp(dir=root, prefix="shared-") if RANK == 0 else None)
    return Path(path)


@pytest.fixture
def comm():
    """All ranks of the run."""
    return MPI.COMM_WORLD
