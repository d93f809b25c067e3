"""Work of one rank, or of a few, whose errors are raised on all."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from fracflow._petsc import MPI
from fracflow.errors import DiskError, InputError

Result = TypeVar("Result")


def on_root(comm: MPI.Comm, work: Callable[[], Result]) -> Result | None:
    """Do ``work`` on rank 0; its InputError is raised on every rank, an OSError as a DiskError. Collective."""
    return on_first(comm, 1, work)


def on_each(comm: MPI.Comm, work: Callable[[], Result]) -> Result:
    """Do ``work`` on every rank; the first of their errors is raised on all as above. Collective."""
    found: list[Result] = []
    on_first(comm, comm.size, lambda: found.append(work()))
    return found[0]


def on_first(comm: MPI.Comm, ranks: int, work: Callable[[], Result]) -> Result | None:
    """Do ``work`` on the first ranks, so many; the first of their errors is raised on every rank as above. Collective."""
    result: Result | None = None
    failure: InputError | DiskError | None = None
    if comm.rank < ranks:
        try:
            result = work()
        except InputError as error:
            failure = InputError(str(error))
        except DiskError as error:
            failure = DiskError(str(error))
        except OSError as error:
            failure = DiskError.of(error, "the run folder")
    if ranks == 1:
        failure = comm.bcast(failure, root=0)
    else:
        failure = next((each for each in comm.allgather(failure) if each is not None), None)
    if failure is not None:
        raise failure
    return result
