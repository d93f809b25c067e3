"""How the program ends where it fails: one line and a code, and all ranks together."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from fracflow.storage.files import shown_plain

if TYPE_CHECKING:
    from fracflow._petsc import MPI

PATIENCE = 20.0  # seconds that a rank waits for the others to end


NO_MEMORY = 55  # PETSc's code of that error
_WATCHER = """
import os, select, sys
poll, last = select.poll(), b""
poll.register(0, select.POLLIN)
for rank in sys.argv[1:]:
    try:
        poll.register(os.pidfd_open(int(rank)), select.POLLIN)
    except (OSError, AttributeError):
        pass
while True:
    found = [file for file, _ in poll.poll()]
    said = os.read(0, 1 << 16) if 0 in found else b""
    last = said.splitlines()[-1] if said else last
    if found != [0] or not said or not last:
        break
if last:
    os.write(2, last + b"\\n")
"""
"""It keeps the last line of its input, and prints it when a rank or its input ends; an empty line ends it."""


class ExitReport:
    """The line on the terminal where ranks are killed: MPI then ends the others before they could say a thing.

    Another process prints it, in a session of its own that mpirun does not end. The launcher leaves ranks a second, and
    a rank that waits for another cannot print. Only of several ranks; one alone is seen to be killed by whoever started
    it.
    """

    def __init__(self, comm: MPI.Comm, folder: Path) -> None:
        """Of the run in a folder. Collective."""
        self._folder = folder
        self._watcher: subprocess.Popen[bytes] | None = None
        ranks = comm.gather((os.uname().nodename, os.getpid()), root=0) if comm.size > 1 else None
        if ranks is not None:
            near = [str(number) for host, number in ranks if host == ranks[0][0]]
            with suppress(OSError):
                self._watcher = subprocess.Popen(
                    [sys.executable, "-I", "-S", "-c", _WATCHER, *near],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.DEVNULL,
                    start_new_session=True,
                )
        self._tell(
            f"fracflow: ranks were killed, or ended alone, before a state was on disk in {folder}: start the run again"
        )

    def saved(self, steps: int) -> None:
        """The state after so many steps is on disk."""
        self._tell(
            f"fracflow: ranks were killed, or ended alone; the last state on disk is that after {steps} steps:"
            f" go on with: fracflow resume {self._folder}"
        )

    def __enter__(self) -> ExitReport:
        return self

    def __exit__(self, *_: object) -> None:
        """The run has ended in a way that is reported otherwise."""
        self._tell("")
        if self._watcher is not None and self._watcher.stdin is not None:
            with suppress(OSError):
                self._watcher.stdin.close()
            self._watcher.wait()

    def _tell(self, line: str) -> None:
        if self._watcher is not None and self._watcher.stdin is not None:
            with suppress(OSError):
                self._watcher.stdin.write(f"{line}\n".encode())
                self._watcher.stdin.flush()


def abort() -> None:
    """A fault of ours on one rank must not leave the others waiting: show it and end them all."""
    import traceback

    from fracflow._petsc import MPI

    error, code = sys.exc_info()[1], 1
    if isinstance(error, MemoryError) or getattr(error, "ierr", 0) == NO_MEMORY:
        code = 3
        remedy = "use a coarser mesh, or more machines, then go on with fracflow resume"
        print(f"fracflow: rank {MPI.COMM_WORLD.rank}: out of memory; {remedy}", file=sys.stderr, flush=True)
    else:
        traceback.print_exc()
        last = traceback.extract_tb(error.__traceback__)[-1] if error is not None else None
        if (
            last is not None and Path(last.filename).resolve() == Path(sys.argv[0]).resolve()
        ):  # a law of the script that runs
            line = f"a fault in line {last.lineno} of {sys.argv[0]}; mend it by the lines above, then run it again"
        else:
            line = "a fault of the program, not of your input; report it with the lines above and the scene"
        print(f"fracflow: {line}", file=sys.stderr, flush=True)
    if MPI.COMM_WORLD.size > 1:
        MPI.COMM_WORLD.Abort(code)
    sys.exit(code)


def stop(message: str, code: int) -> None:
    """Print one line on rank 0 and exit; a rank that is alone in it says so, and ends the others."""
    from fracflow._petsc import MPI, PETSc

    if code == 2:
        PETSc.Options().delValue("options_left")  # what has not begun has used few of its options
    line = shown_plain(" ".join(message.split()))
    rank, come = MPI.COMM_WORLD.rank, _all_come(MPI.COMM_WORLD)
    if rank == 0 or not come:
        print(f"fracflow: {line if come else f'rank {rank} alone: {line}'}", file=sys.stderr, flush=True)
    if not come:
        MPI.COMM_WORLD.Abort(code)
    sys.exit(code)


def _all_come(comm: MPI.Comm) -> bool:
    """Whether every rank ends as this one does: MPI would wait for the others at its end, for ever."""
    request, end = comm.Ibarrier(), time.monotonic() + PATIENCE
    while not request.Test():
        if time.monotonic() > end:
            return False
        time.sleep(1e-3)
    return True
