"""The one door to PETSc and MPI: finds Debian's petsc4py, starts it without reading sys.argv."""

from __future__ import annotations

import atexit
import ctypes
import glob
import os
import re
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import wraps
from importlib.util import find_spec
from typing import Any, ParamSpec, TypeVar
from weakref import WeakValueDictionary

from fracflow.errors import InputError

# Debian's petsc4py.pth adds $PETSC_DIR/lib/python3/dist-packages, but no plain package sets PETSC_DIR.
_PATTERN = "/usr/lib/petscdir/petsc*/*-real"
_PACKAGES = "lib/python3/dist-packages"
_OF_LAUNCHERS = ("OMPI_COMM_", "OMPI_UNIVERSE", "PMIX_", "PMI_", "SLURM_", "FLUX_", "PALS_")
_ALONE = {"OMPI_MCA_ess_singleton_isolated": "1", "OMPI_MCA_pml": "ob1", "OMPI_MCA_btl": "self"}


def find_petsc_dir(pattern: str = _PATTERN) -> str | None:
    """Return the newest directory under ``pattern`` that holds a petsc4py with real numbers, or None."""
    held = [path for path in glob.glob(pattern) if os.path.isdir(os.path.join(path, _PACKAGES, "petsc4py"))]
    return max(held, key=_version, default=None)


def _version(path: str) -> tuple[int, ...]:
    digits = os.path.basename(os.path.dirname(path)).removeprefix("petsc")
    return tuple(int(part) for part in digits.split(".") if part.isdigit())


def _use_petsc_dir() -> None:
    if "PETSC_DIR" in os.environ or find_spec("petsc4py") is not None:  # conda's, say, on a Debian that has its own
        return
    if (found := find_petsc_dir()) is not None:
        os.environ["PETSC_DIR"] = found
        # The .pth file was read when Python started, before PETSC_DIR was known.
        sys.path.append(os.path.join(found, _PACKAGES))


@contextmanager
def _options_of_the_user() -> Iterator[None]:
    """Let PETSc start with ~/.petscrc and PETSC_OPTIONS alone.

    It would read .petscrc and petscrc of the working folder too, where a scene and all beside it may come from anybody.
    """
    given, home = os.environ.get("PETSC_OPTIONS"), os.path.expanduser("~/.petscrc")
    if os.path.isfile(home) and not re.search(r"\s", home):  # PETSc divides its options at spaces
        os.environ["PETSC_OPTIONS"] = f"-options_file {home} {given or ''}"  # the later ones count
    try:
        yield
    finally:
        os.environ.pop("PETSC_OPTIONS", None)
        if given is not None:
            os.environ["PETSC_OPTIONS"] = given


@contextmanager
def _without_network() -> Iterator[None]:
    """Let Open MPI start without network and daemon where no launcher has started this process: 25 ms of CPU, .25 s.

    Settings of the user count. Those made here are gone before any other process starts.
    """
    is_alone = not any(name.startswith(_OF_LAUNCHERS) or name in _ALONE for name in os.environ)
    given = _ALONE if is_alone else {}
    os.environ.update(given)
    try:
        yield
    finally:
        for name in given:
            del os.environ[name]


def _return_memory() -> None:
    """Let the C library return large arrays to the system, which SuperLU_DIST forbids it as PETSc loads it.

    The holes that they leave took a ninth of the memory of a run. Other C libraries than GNU's have no such option.
    """
    _choose(_MMAP_MAX, 65_536)
    _choose(_MMAP_THRESHOLD, 2**21)


def _choose(option: int, value: int) -> None:
    with suppress(AttributeError, OSError):
        ctypes.CDLL(None).mallopt(option, value)


@contextmanager
def memory_kept() -> Iterator[None]:
    """Let the C library keep arrays of up to 32 MiB once they are freed, for work that makes the same ones again and again.

    A new vector of 2.2 MB then takes 0.03 ms in place of 1.1, in which the system clears its pages.
    """
    _choose(_MMAP_THRESHOLD, 2**25)  # the most that it takes
    try:
        yield
    finally:
        _choose(_MMAP_THRESHOLD, 2**21)


_MMAP_THRESHOLD, _MMAP_MAX = -3, -4  # of malloc.h
_use_petsc_dir()
try:
    import petsc4py

    with _without_network():
        from mpi4py import MPI

    _on_broken_pipe = signal.getsignal(signal.SIGPIPE)
    with _options_of_the_user():
        petsc4py.init(["fracflow", "-skip_petscrc"])
    from petsc4py import PETSc

    PETSc.Options().delValue("skip_petscrc")
    _return_memory()
    # PETSc frees its own communicator with the last object on it. Kept, ranks never disagree on whether it is there.
    _WORLD = PETSc.COMM_WORLD.duplicate()

    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGPIPE, _on_broken_pipe)  # PETSc takes `| head` for a crash
except ImportError as error:
    _reason = " ".join(str(error).split())
    raise InputError(
        f"PETSc cannot be imported ({_reason}); PETSC_DIR={os.environ.get('PETSC_DIR', 'unset')}: "
        "install python3-petsc4py and python3-mpi4py, or source scripts/setup.sh"
    ) from error


Given = ParamSpec("Given")
Result = TypeVar("Result")


_stages = {0}  # of the log: the main one, and those that are named here


def logged(event: str, kind: str) -> float:
    """The "count" or "time" [s] of an event in all stages of PETSc's log."""
    return float(sum(PETSc.Log.Event(event).getPerfInfo(stage)[kind] for stage in sorted(_stages)))


def timed(event: str, stage: str = "") -> Callable[[Callable[Given, Result]], Callable[Given, Result]]:
    """Decorate a function whose time PETSc's ``-log_view`` shows as an event, and in a stage of the log if one is named."""
    on, within = PETSc.Log.Event(event), PETSc.Log.Stage(stage) if stage else None
    if within is not None:
        _stages.add(within.id)

    def decorate(work: Callable[Given, Result]) -> Callable[Given, Result]:
        @wraps(work)
        def done(*given: Given.args, **named: Given.kwargs) -> Result:
            if within is None:
                with on:
                    return work(*given, **named)
            with within, on:
                return work(*given, **named)

        return done

    return decorate


_by_python: WeakValueDictionary[int, Any] = WeakValueDictionary()


def precondition_by(solver: PETSc.KSP, context: Any) -> None:
    """Let an object of ours be the preconditioner of a solver."""
    solver.getPC().setType("python")
    solver.getPC().setPythonContext(context)
    _by_python[id(solver)] = solver


@atexit.register
def _end_contexts() -> None:
    """End those that an unforeseen error has left on one rank: PETSc ends after Python, and could not call them any more."""
    for solver in list(_by_python.values()):
        if solver and solver.getComm().getSize() == 1:
            solver.getPC().setType("none")


def sum_over_ranks(here: Any, comm: MPI.Comm) -> Any:
    """The sum of an array over all ranks; on one rank itself, since MPI would pack and unpack it. Collective."""
    return here if comm.size == 1 else comm.allreduce(here, op=MPI.SUM)


def gathered(here: Result, comm: MPI.Comm, root: int = 0) -> list[Result] | None:
    """The things of all ranks, on rank ``root``; None elsewhere. On one rank itself, which MPI would pack. Collective."""
    found: list[Result] | None = [here] if comm.size == 1 else comm.gather(here, root=root)
    return found


def destroy(*things: Any) -> None:
    """Free PETSc objects, and others that own some; None is passed over. Collective."""
    for thing in things:
        if thing is not None:
            thing.destroy()


__all__ = ["MPI", "PETSc", "destroy", "find_petsc_dir", "gathered", "precondition_by", "sum_over_ranks", "timed"]
