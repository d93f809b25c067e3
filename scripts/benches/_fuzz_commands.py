"""Commands of fracflow in processes of their own: forked from one that has imported everything, or started afresh."""

from __future__ import annotations

import io
import json
import os
import re
import resource
import signal
import subprocess
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np
from _fuzz_cases import FRESH, GMSH, Bases, Case
from _fuzz_judge import HANGS, MEMORY, Box, Found, of_command, snapshot

import fracflow
import fracflow.mesh.files.gmsh as gmsh_side
from fracflow.cli.app import main
from fracflow.mesh.files import gmsh_worker
from fracflow.output.checkpoint import read_notes
from fracflow.scene.scene import load

SLEEPS = 3.0 * HANGS  # seconds of wall clock: beyond it a process waits for what never comes
WAIT = 0.002  # [s]
CRASHES = (signal.SIGABRT, signal.SIGSEGV, signal.SIGBUS, signal.SIGFPE, signal.SIGILL)
MOST_STEPS, MOST_CELLS = 12, 2000.0
UNKNOWN = re.compile(
    r"step/(predicted|measured)|well/.*/injectivity$"
)  # nan where nothing was foretold, or no pressure rose
BOUNDLESS = ("strength", "slip_margin")  # inf where a law knows no slip


def forked(action: Callable[[], object], out: Path | None = None, err: Path | None = None) -> tuple[int, int]:
    """Exit code and peak memory [bytes] of an action in a child; a negative code is a signal, SIGXCPU a hang."""
    sys.stdout.flush()
    sys.stderr.flush()
    child = os.fork()
    if child == 0:
        code = 1
        try:
            os.setsid()
            for path, number in ((out, 1), (err, 2)):
                file = os.open(path or os.devnull, os.O_CREAT | os.O_WRONLY | os.O_TRUNC)
                os.dup2(file, number)
            os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
            resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
            resource.setrlimit(resource.RLIMIT_CPU, (int(HANGS), int(HANGS) + 5))
            signal.signal(signal.SIGALRM, signal.SIG_DFL)
            code = _code(action)
        except BaseException:
            traceback.print_exc()
        finally:
            try:
                sys.stdout.flush()
                sys.stderr.flush()
            finally:
                os._exit(code)
    return _awaited(child)


def _code(action: Callable[[], object]) -> int:
    """The exit code of a process that does an action and nothing else."""
    try:
        action()
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else 0 if end.code is None else 1
    except BaseException:
        traceback.print_exc()
        return 1
    return 0


def _awaited(child: int) -> tuple[int, int]:
    began = time.monotonic()
    while True:
        done, status, used = os.wait4(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status), used.ru_maxrss * 1024
        if time.monotonic() - began > SLEEPS:
            os.killpg(child, signal.SIGKILL)
            os.waitpid(child, 0)
            return -signal.SIGXCPU, 0
        time.sleep(WAIT)


def _fork_of_gmsh(folder: Path, allowed: gmsh_side.Limits) -> tuple[int | None, str]:
    """The outcome of the process that runs Gmsh in its folder, without starting Python again; meshio runs in this one."""
    if b'"msh2"' in (folder / "job.json").read_bytes():
        return _read_here(folder), ""
    said = folder / "said.txt"

    def work() -> None:
        for number in CRASHES:  # Open MPI's handlers, which that process has not, would wait for a broken heap
            signal.signal(number, signal.SIG_DFL)
        os.chdir(folder)
        job = json.loads((folder / "job.json").read_text())
        (folder / "job.json").write_text(json.dumps({**job, "parent": os.getppid()}))
        sys.exit(gmsh_worker.main(folder))

    code, _ = forked(work, None, said)
    return None if code == -signal.SIGXCPU else code, said.read_text(errors="replace")[-1000:]


def _read_here(folder: Path) -> int:
    """Read a mesh of version 2 as Gmsh's process does, but for the limits that would be those of this process."""
    before, here = gmsh_worker.keep_within, os.getcwd()
    gmsh_worker.keep_within = lambda *_: None
    try:
        os.chdir(folder)
        with warnings.catch_warnings(), redirect_stderr(io.StringIO()), redirect_stdout(io.StringIO()):
            warnings.simplefilter("ignore")
            return gmsh_worker.main(folder)
    finally:
        gmsh_worker.keep_within = before
        os.chdir(here)


@contextmanager
def forking_gmsh(is_on: bool = True) -> Iterator[None]:
    """Inside, Gmsh's process is forked from this one, which has imported it."""
    before = gmsh_side._run
    if is_on:
        gmsh_side._run = _fork_of_gmsh
    try:
        yield
    finally:
        gmsh_side._run = before


def is_small(case: Case, folder: Path) -> bool:
    """Whether a scene that can be loaded asks for no more steps and cells than a case may take."""
    try:
        scene = load(folder / "scene.toml")
        start, steps = 0.0, 0
        for stage in scene.stage:
            count = stage.step_count(start)
            if count is None and stage.kind == "auto":
                return False
            steps, start = steps + (count or 0), stage.finish(start)
    except Exception:
        return True  # which the command is to refuse, or to fail at before the first step
    geometry = scene.geometry
    if scene.refine > 2 or steps > MOST_STEPS:
        return False
    if geometry is None:
        return True
    corners = np.array(geometry.domain)
    area = float(np.prod(np.ptp(corners, axis=0)))
    length = sum(float(np.linalg.norm(np.diff(np.array(f.points), axis=0), axis=1).sum()) for f in geometry.fracture)
    finest = min(s for s in (geometry.size, geometry.size_at_fractures, geometry.size_at_tips, np.inf) if s is not None)
    return geometry.size is not None and area / geometry.size**2 + 30.0 * length / finest < MOST_CELLS


def at_command(case: Case, box: Box, bases: Bases) -> list[tuple[str, Found]]:
    """Run the command of a case, which lies in its box: what is wrong with what it did."""
    out, err, words = box.root / "out.txt", box.root / "err.txt", list(case.words)
    if not case.is_run and not is_small(case, box.case):
        words = ["mesh", "scene.toml"] if case.kind != "scene" and case.kind != "traces.csv" else ["schema", "--json"]
    before, floor = snapshot(box.case), 300 << 20
    if case.way == FRESH:
        code, taken = _afresh(words, box.case, out, err)
    else:
        floor = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024

        def work() -> None:
            os.chdir(box.case)
            sys.argv = ["fracflow", *words]
            with forking_gmsh(case.way != GMSH):
                main()

        code, taken = forked(work, out, err)
    texts = [path.read_text(encoding="utf-8", errors="surrogateescape") for path in (out, err)]
    if code == -signal.SIGXCPU:
        return [("command", Found(f"hang of {words[0]}", texts[1][-3000:]))]
    found = of_command(code, *texts)
    if taken > floor + MEMORY:
        found.append(Found(f"{words[0]} took {taken >> 20} MiB"))
    found += _left(case, words, code, box, bases, before)
    return [(f"{words[0]} exit code {code}", fault) for fault in found]


def _afresh(words: Sequence[str], folder: Path, out: Path, err: Path) -> tuple[int, int]:
    """A command in a Python of its own."""
    package = str(Path(fracflow.__file__).parents[1])
    with out.open("wb") as one, err.open("wb") as other:
        child = subprocess.Popen(
            [sys.executable, "-m", "fracflow", *words], cwd=folder, stdin=subprocess.DEVNULL, stdout=one, stderr=other,
            start_new_session=True, env={**os.environ, "PYTHONPATH": package},
        )  # fmt: skip
        code, taken = _awaited(child.pid)
        child.returncode = code
    return code, taken


def _left(case: Case, words: list[str], code: int, box: Box, bases: Bases, before: dict[str, str]) -> Iterator[Found]:
    """Faults of the folder after a command."""
    if words[0] == "run":
        folder = box.case / "o"
        if code == 2 and folder.exists():
            yield Found("refused, and left a run folder", " ".join(sorted(path.name for path in folder.iterdir())))
        elif code in (0, 3):
            yield from _unreadable(folder)
    if words[0] == "resume" and code == 2:
        after = snapshot(box.case)
        for name in sorted(name for name in before.keys() | after.keys() if before.get(name) != after.get(name)):
            what = "took away" if name not in after else "made" if name not in before else "changed"
            yield Found(f"a refused resume {what} {Path(name).name}", name)
    if words[0] == "resume" and code == 0 and case.target not in ("run/scene.toml",):
        try:
            now = fracflow.open(box.case / "run").history
        except Exception as error:
            yield Found(f"a resume left a folder that cannot be read: {type(error).__name__}", str(error))
            return
        odd = [key for key, values in bases.whole.items() if not _same(values, now.get(key))]
        if odd:
            yield Found(f"a resume with a damaged {Path(case.target).name} ends elsewhere", ", ".join(sorted(odd)[:9]))


def _same(one: Any, other: Any) -> bool:
    return other is not None and one.shape == other.shape and one.tobytes() == other.tobytes()


def _unreadable(folder: Path) -> Iterator[Found]:
    """Unreadable files of a run that ended or failed."""
    try:
        run = fracflow.open(folder)
        history = run.history
        run.events, run.plan, run.card, run.scene, run.status, run.units  # noqa: B018
        read_notes(folder / "checkpoint.h5")
    except Exception as error:
        yield Found(f"left a run folder that cannot be read: {type(error).__name__}", str(error))
        return
    odd = [key for key, values in history.items() if values.dtype.kind == "f" and not np.isfinite(values).all()]
    odd = [
        key for key in odd if not (UNKNOWN.match(key) or (key.endswith(BOUNDLESS) and not np.isnan(history[key]).any()))
    ]
    if odd:
        yield Found(f"history holds what is no number: {odd[0]}", ", ".join(odd))
    if parts := list(folder.rglob("*.part")):
        yield Found(f"left {parts[0].name}")
