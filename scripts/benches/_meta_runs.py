"""Runs that may crash or hang without harm: each in a process of its own, with a limit in time; on ranks, in batches."""

from __future__ import annotations

import math
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path

from _launch import without_ranks
from _meta_compare import Record
from _meta_scenes import Case

from fracflow.advance.step import Step
from fracflow.errors import InputError, Interrupted, SolveError
from fracflow.output import read_history
from fracflow.output.events import read_events
from fracflow.scene.scene import load
from fracflow.scene.toml import write_toml
from fracflow.simulation.run import resume, run

HUNG, CRASHED = -9, 1
SLEEPS = 20.0  # wall clock over the limit in CPU seconds: beyond it a run waits for what never comes
WAIT = 0.004  # [s]


def write(case: Case, folder: Path) -> Path:
    """Leave scene and mesh in an empty folder; gives the path of the scene."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    (folder / "mesh.msh").write_text(case.mesh_text(), encoding="ascii")
    path = folder / "scene.toml"
    path.write_text(write_toml({**case.data, "mesh": {"file": "mesh.msh"}}), encoding="utf-8")
    return path


def code_of(action: Callable[[], object]) -> int:
    """Exit code of an action; its message goes to standard error."""
    try:
        action()
    except (InputError, SolveError, Interrupted) as error:
        print(error, file=sys.stderr)
        return 2 if isinstance(error, InputError) else 3 if isinstance(error, SolveError) else 130
    except BaseException:
        traceback.print_exc()
        return CRASHED
    return 0


def forked(action: Callable[[], object], log: Path, limit: float) -> tuple[int, str, float]:
    """Exit code, message and CPU seconds of an action in a process of its own; HUNG if it took more than ``limit`` of them."""
    sys.stdout.flush()
    sys.stderr.flush()
    child = os.fork()
    if child == 0:
        file = os.open(log, os.O_CREAT | os.O_WRONLY | os.O_TRUNC)
        os.dup2(file, 1)
        os.dup2(file, 2)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_CPU, (math.ceil(limit), math.ceil(limit) + 1))
        code = code_of(action)
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    began = time.monotonic()
    while True:
        done, status, used = os.wait4(child, os.WNOHANG)
        if done:
            code, seconds = os.waitstatus_to_exitcode(status), used.ru_utime + used.ru_stime
            if code == -signal.SIGXCPU:
                return HUNG, f"took more than {limit:g} CPU s", seconds
            return code, log.read_text(encoding="utf-8", errors="replace"), seconds
        if time.monotonic() - began > SLEEPS * limit:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            return HUNG, f"did not end in {SLEEPS * limit:g} s", SLEEPS * limit
        time.sleep(WAIT)


def record_of(code: int, message: str, seconds: float, folder: Path) -> Record:
    """The results of a run in its folder; nothing is read where it crashed."""
    if code in (HUNG, CRASHED, 2) or code < 0 or not (folder / "history.h5").exists():
        return Record(code, message, seconds=seconds)
    return Record(code, message, read_history(folder / "history.h5"), read_events(folder / "events.csv"), seconds)


def at_once(case: Case, folder: Path, limit: float) -> Record:
    """A run from beginning to end."""
    scene = write(case, folder)
    return record_of(*forked(lambda: run(load(scene), folder / "run"), folder / "said", limit), folder / "run")


def resumed(case: Case, folder: Path, limit: float, after: int) -> Record:
    """A run that is stopped after some steps, and goes on in another process."""
    scene, seen = write(case, folder), 0

    def stop(step: Step) -> None:
        nonlocal seen
        seen += 1
        if seen == after:
            os.kill(os.getpid(), signal.SIGUSR2)

    found = forked(lambda: run(load(scene), folder / "run", progress=stop), folder / "said", limit)
    if found[0] == 130:
        found = forked(lambda: resume(folder / "run"), folder / "said", limit)
    return record_of(*found, folder / "run")


def on_ranks(folders: Sequence[Path], ranks: int, limit: float) -> None:
    """Run the scenes that ``write`` left, one after another, on ranks; each leaves ``code`` and ``said`` in its folder.

    Where one hangs or ends the ranks, it has the code HUNG or CRASHED, and new ranks go on with the next.
    """
    left = list(folders)
    while left:
        command = ["mpirun", "-n", str(ranks), sys.executable, str(Path(__file__)), *map(str, left)]
        child = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=_without_ranks(),
            start_new_session=True,
        )  # fmt: skip
        last = time.monotonic() + 20.0  # ranks take a moment to start
        while left and child.poll() is None:
            if (left[0] / "code").exists():
                left.pop(0)
                last = time.monotonic()
            elif time.monotonic() - last > limit:
                break
            else:
                time.sleep(10 * WAIT)
        is_hung = child.poll() is None and bool(left)
        if is_hung:
            os.killpg(child.pid, signal.SIGKILL)
        child.wait()
        left = [folder for folder in left if not (folder / "code").exists()]
        if left:
            blamed = left.pop(0)
            (blamed / "said").write_text(
                f"took more than {limit:g} s" if is_hung else "the ranks ended", encoding="utf-8"
            )
            (blamed / "code").write_text(str(HUNG if is_hung else CRASHED), encoding="utf-8")


def _without_ranks() -> dict[str, str]:
    """The environment without what a rank has in it, and with the way to these modules."""
    kept = without_ranks()
    here = Path(__file__).parent
    ways = [str(here), str(here.parent), *filter(None, [os.environ.get("PYTHONPATH")])]
    return {**kept, "PYTHONPATH": os.pathsep.join(ways)}


def left_by_ranks(folder: Path) -> Record:
    """The results of a scene on several ranks."""
    code, message = (
        int((folder / "code").read_text()),
        (folder / "said").read_text(encoding="utf-8", errors="replace"),
    )
    return record_of(code, message, 0.0, folder / "run")


def _as_rank(folders: Sequence[str]) -> None:
    """One of the ranks that run the scenes."""
    from fracflow._petsc import MPI

    for folder in map(Path, folders):
        said: list[str] = []

        def action(folder: Path = folder, said: list[str] = said) -> None:
            try:
                run(load(folder / "scene.toml"), folder / "run")
            except (InputError, SolveError) as error:
                said.append(str(error))
                raise

        code = code_of(action)
        if code == CRASHED:
            MPI.COMM_WORLD.Abort(CRASHED)
        if MPI.COMM_WORLD.rank == 0:
            (folder / "said").write_text("\n".join(said), encoding="utf-8")
            part = folder / "code.part"
            part.write_text(str(code), encoding="utf-8")
            part.replace(folder / "code")


if __name__ == "__main__":
    _as_rank(sys.argv[1:])
