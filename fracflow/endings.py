"""How the program ends where it fails: one line and a code, and all ranks together."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fracflow._petsc import MPI

PATIENCE = 20.0  # seconds that a rank waits for the others to end


def abort() -> None:
    """A fault of ours on one rank must not leave the others waiting: show it and end them all."""
    import traceback

    from fracflow._petsc import MPI

    traceback.print_exc()
    if MPI.COMM_WORLD.size > 1:
        MPI.COMM_WORLD.Abort(1)
    sys.exit(1)


def stop(message: str, code: int) -> None:
    """Print one line on rank 0 and exit; a rank that is alone in it says so, and ends the others."""
    from fracflow._petsc import MPI, PETSc

    if code == 2:
        PETSc.Options().delValue("options_left")  # what has not begun has used few of its options
    line = "".join(c if c.isprintable() else "?" for c in " ".join(message.split()))
    if MPI.COMM_WORLD.rank == 0:
        print(f"fracflow: {line}", file=sys.stderr, flush=True)
    if not _all_come(MPI.COMM_WORLD):
        print(f"fracflow: rank {MPI.COMM_WORLD.rank} alone: {line}", file=sys.stderr, flush=True)
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
