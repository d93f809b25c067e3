"""Runs with a fault in them: on one rank in forks of one process, on two under mpirun; and how what they leave is judged.

``LD_PRELOAD=shim.so python _kills_runs.py one`` reads jobs from standard input, a JSON each line, and answers likewise.
``mpirun -n 2 python _kills_runs.py two FOLDER ...`` resumes each, and leaves FOLDER.code and FOLDER.said.RANK.
"""

from __future__ import annotations

import ctypes
import gc
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from _launch import without_ranks

from fracflow.output import list_steps, read_events, read_history, read_step
from fracflow.output.fields import read_mesh
from fracflow.output.status import read_status

PATIENCE = 30.0  # wall clock in seconds, after which a run hangs; longer where the cores are shared by more
COUNTS = {"step/factorisations"}  # the first step after a resume has no old factorisation to use
WAIT = 0.004  # [s]
HUNG = 1000


def patience() -> float:
    """Seconds to wait now for a run that takes a few alone."""
    return PATIENCE * max(1.0, 2.0 * os.getloadavg()[0] / (os.cpu_count() or 1))


def readable(folder: Path) -> str:
    """Why a file that is there cannot be read; empty where all can be."""
    if (folder / "history.h5").exists():
        history = read_history(folder / "history.h5")
        if len({len(values) for values in history.values()}) > 1:
            return "history: rows differ"
    if (folder / "events.csv").exists():
        read_events(folder / "events.csv")
    for path in folder.glob("*.xdmf"):
        ElementTree.parse(path)
        read_mesh(folder, path.stem)
        for _, step in list_steps(folder, path.stem):
            read_step(step)
    for path in folder.glob("*.json"):
        json.loads(path.read_text(encoding="utf-8"))
    return ""


def difference(folder: Path, other: Path) -> str:
    """In what a run differs from the undisturbed one, and what should have been taken away; empty where in nothing."""
    one, two = read_history(folder / "history.h5"), read_history(other / "history.h5")
    if one.keys() != two.keys():
        return f"history: keys {sorted(one.keys() ^ two.keys())[:3]}"
    rows = len(one["time"]), len(two["time"])
    if rows[0] != rows[1]:
        return f"history: {rows[0]} rows, not {rows[1]}"
    for key in sorted(one.keys() - COUNTS):
        if not np.array_equal(one[key], two[key], equal_nan=one[key].dtype.kind == "f"):
            first = int(np.flatnonzero((one[key] != two[key]).reshape(rows[0], -1).any(axis=1))[0])
            return f"history: {key} from row {first} of {rows[0]}"
    if (folder / "events.csv").read_text() != (other / "events.csv").read_text():
        return "events.csv"
    names = [{path.name for path in (each / "fields").iterdir()} for each in (folder, other)]
    if names[0] != names[1]:
        return f"fields: {sorted(names[0] ^ names[1])[:4]}"
    for name in ("fractures", "rock"):
        for _, path in list_steps(other, name):
            mine, theirs = read_step(folder / "fields" / path.name), read_step(path)
            for place in (1, 2):
                for key, values in theirs[place].items():
                    if not np.array_equal(mine[place][key], values, equal_nan=values.dtype.kind == "f"):
                        return f"{path.name}: {key}"
    if left := [path.name for path in folder.rglob("*") if path.suffix in (".part", ".redo")]:
        return f"left: {left[:3]}"
    return "" if read_status(folder).word == "ended" else f"status.json: {read_status(folder).word}"


def complaints(said: str, most: int = 1) -> str:
    """Faults of the terminal output of a run."""
    for mark in ("Traceback", "HDF5-DIAG", "Exception ignored", "Segmentation", "PETSC ERROR", "AssertionError"):
        if mark in said:
            lines = [line for line in said.splitlines() if line.strip()]
            return f"{mark}: {lines[-1][:200]}"
    lines = [line for line in said.splitlines() if line.startswith("fracflow:")]
    return f"{len(lines)} lines: {lines}" if len(lines) > most else ""


def environment(**more: object) -> dict[str, str]:
    """The environment without what a rank has in it, and with the way to these modules."""
    kept = without_ranks("KILLS_")
    here = Path(__file__).resolve().parent
    ways = [str(here), str(here.parents[1]), *filter(None, [os.environ.get("PYTHONPATH")])]
    return {**kept, "PYTHONPATH": os.pathsep.join(ways), **{key: str(value) for key, value in more.items()}}


def command(words: Sequence[str]) -> int:
    """The exit code of fracflow with these words, in this process; its lines go where standard error goes."""
    from fracflow.cli import app as cli

    sys.argv = ["fracflow", *words]
    try:
        cli.main()
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else 0
    return 0


def forked(work: Callable[[], int], said: Path) -> tuple[int, str, float]:
    """Exit code, lines and CPU seconds of work in a fork; HUNG where it did not end."""
    sys.stdout.flush()
    child = os.fork()
    if child == 0:
        code = 99
        try:
            file = os.open(said, os.O_CREAT | os.O_WRONLY | os.O_TRUNC)
            os.dup2(file, 1)
            os.dup2(file, 2)
            resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
            code = work()
            gc.collect()
            close_hdf5()
        except BaseException:
            import traceback

            traceback.print_exc()
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    began, longest = time.monotonic(), patience()
    while True:
        done, status, used = os.wait4(child, os.WNOHANG)
        if done:
            text = said.read_text(encoding="utf-8", errors="replace")
            return os.waitstatus_to_exitcode(status), text, used.ru_utime + used.ru_stime
        if time.monotonic() - began > longest:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            return HUNG, f"did not end in {longest:g} s", longest
        time.sleep(WAIT)


def close_hdf5() -> None:
    """End HDF5 as the end of a process does: it crashes there with what it could not write."""
    for line in Path("/proc/self/maps").read_text().splitlines():
        if "libhdf5_serial.so" in line or "libhdf5.so" in line:
            ctypes.CDLL(line.split()[-1]).H5close()
            return


def aside(work: Callable[[], str], said: Path) -> str:
    """The text of work in a fork; a crash, a hang or an error in it is text too."""

    def told() -> int:
        try:
            print(work(), flush=True)
        except Exception as error:
            print(f"{type(error).__name__}: {error}", flush=True)
        return 0

    code, text, _ = forked(told, said)
    return text.strip() if code == 0 else f"reading ended with {code}"


def on_ranks(words: Sequence[str], said: Path, runs: int = 1, **more: object) -> tuple[int, str]:
    """Exit code and lines of a command on two ranks, which does so many runs; HUNG where it did not end."""
    with said.open("wb") as file:
        child = subprocess.Popen(
            ["mpirun", "-n", "2", sys.executable, *words],
            stdin=subprocess.DEVNULL,
            stdout=file,
            stderr=file,
            env=environment(**more),
            start_new_session=True,
        )
        try:
            code = child.wait(runs * patience())
        except subprocess.TimeoutExpired:
            os.killpg(child.pid, signal.SIGKILL)
            child.wait()
            code = HUNG
    return code, said.read_text(encoding="utf-8", errors="replace")


class One:
    """Does jobs on one rank; all is imported once, and Gmsh meshes a scene once."""

    def __init__(self) -> None:
        """Import, and take up the shim that is preloaded."""
        import fracflow.cli.app
        import fracflow.cli.report
        import fracflow.mesh.files.gmsh as gmsh
        import fracflow.simulation.run  # noqa: F401

        self.shim = ctypes.CDLL(None)
        known: dict[str, Any] = {}
        real = gmsh.run_worker

        def remembered(*given: Any) -> Any:
            key = json.dumps(given, sort_keys=True, default=str)
            if key not in known:
                known[key] = real(*given)
            return known[key]

        gmsh.run_worker = remembered

    def mesh(self, scene: str) -> None:
        """Let forks find the mesh of a scene."""
        from fracflow.reduction.prepare import read_split
        from fracflow.scene.scene import load

        read_split(load(Path(scene)))

    def fracflow(self, words: list[str], folder: str, mode: int, at: int) -> dict[str, Any]:
        """A command with a fault; ``seen`` is how many operations there were."""
        seen = Path(f"{folder}.seen")
        seen.unlink(missing_ok=True)

        def work() -> int:
            self.shim.shim_arm(str(folder).encode(), mode, ctypes.c_long(at))
            code = command(words)
            count = self.shim.shim_seen()
            self.shim.shim_arm(b"/nowhere", 0, ctypes.c_long(0))
            seen.write_text(str(count))
            return code

        code, said, seconds = forked(work, Path(f"{folder}.said"))
        return {"code": code, "said": said, "seconds": seconds, "seen": int(seen.read_text()) if seen.exists() else 0}

    def judge(self, folder: str, other: str) -> dict[str, Any]:
        """Whether all can be read and, with an ``other`` folder, is the same."""
        path, said = Path(folder), Path(f"{folder}.judged")
        found = aside(lambda: readable(path) or (difference(path, Path(other)) if other else ""), said)
        return {"found": found}

    def serve(self) -> None:
        """Answer each line of standard input."""
        answers = os.fdopen(os.dup(1), "w", buffering=1)
        os.dup2(2, 1)
        for line in sys.stdin:
            name, *arguments = json.loads(line)
            answers.write(json.dumps(getattr(self, name)(*arguments)) + "\n")


def _two(folders: Sequence[str]) -> None:
    """Resume each folder as one of several ranks."""
    from fracflow._petsc import MPI

    comm = MPI.COMM_WORLD
    for folder in folders:
        file = os.open(f"{folder}.said.{comm.rank}", os.O_CREAT | os.O_WRONLY | os.O_TRUNC)
        os.dup2(file, 1)
        os.dup2(file, 2)
        os.close(file)
        code = command(["resume", folder])
        sys.stdout.flush()
        if comm.rank == 0:
            Path(f"{folder}.code").write_text(str(code))
        comm.barrier()


def resumed_on_ranks(folders: Sequence[Path], said: Path) -> dict[Path, tuple[int, str]]:
    """Exit code and lines of each folder's resume on two ranks, all in one job."""
    for folder in folders:
        for path in folder.parent.glob(f"{folder.name}.*"):
            if path.name.startswith((f"{folder.name}.code", f"{folder.name}.said")):
                path.unlink()
    left = list(folders)
    found: dict[Path, tuple[int, str]] = {}
    while left:
        words = [str(Path(__file__).resolve()), "two", *map(str, left)]
        code, all_said = on_ranks(words, said, 1 + len(left))
        for folder in list(left):
            text = "".join(
                each.read_text(errors="replace") for each in sorted(folder.parent.glob(f"{folder.name}.said.*"))
            )
            done = Path(f"{folder}.code")
            if done.exists():
                found[folder] = int(done.read_text()), text
                left.remove(folder)
        if left:  # the first of them ended the ranks
            found[left[0]] = code, text + all_said
            left.pop(0)
    return found


def copied(folder: Path, to: Path) -> None:
    """Keep what a fault left."""
    shutil.rmtree(to, ignore_errors=True)
    if folder.exists():
        shutil.copytree(folder, to, symlinks=True)


if __name__ == "__main__":
    if sys.argv[1] == "two":
        _two(sys.argv[2:])
    else:
        One().serve()
