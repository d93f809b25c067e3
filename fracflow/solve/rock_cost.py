"""Cost of the rock's solve by a factorisation and by multigrid, CPU and memory: by which of the two a scene is solved.

Factors by nested dissection take N^(3/2) operations and N log N numbers in the plane, N^2 and N^(4/3) in space (George 1973;
Lipton, Rose and Tarjan 1979). Multigrid takes N of both, with iterations that grow a little. Shares are those of scripts/bench
rock_solver, for one iteration of Newton's method while hundreds of sections slide.
"""

from __future__ import annotations

import math
import os
import resource
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from fracflow._petsc import MPI
from fracflow.errors import InputError
from fracflow.scene.method import MULTIPOLES_FROM, Method
from fracflow.scene.scene import Scene
from fracflow.storage.files import read_text

NUMBER = 8.0  # bytes
SWIFT_FROM, SWIFT_TO = 1_000, 400_000
"""Displacements between which UMFPACK takes the place of MUMPS on one rank. From 1.3e3 to 3.2e5 it factors in the same time,
and solves in a fifth to a third of it (scripts/bench iteration)."""
UNPIVOTED_TO = 2_000
"""Unknowns up to which PETSc's own LU without pivots takes 0.6 of UMFPACK's time, and its solves half."""
WORTH_GRIDS = 1.5  # times less time than by factors, from which on multigrid is taken


@dataclass(frozen=True)
class CostShares:
    """Measured shares of a problem in the plane, or in space.

    operations   CPU s of the power ``grows`` of a million unknowns, in a factorisation
    more_costly  times as long that takes by MUMPS, of more than ``SWIFT_TO`` unknowns; it also factors more often
    solves       CPU s of N log2 N of a million unknowns, in solves with the factors
    numbers      in both factors, of N log2 N or N^(4/3); besides, LU works with ``works`` numbers an unknown
    sets_up      CPU s of a million unknowns: small systems of multigrid, made anew in each iteration of Newton's method
    iterates     CPU s of a million unknowns in an iteration of FGMRES
    holds        numbers an unknown in its grids, small systems and vectors
    iterations   of FGMRES with a million unknowns, and ``more`` the power of N by which they grow
    """

    grows: float
    operations: float
    more_costly: float
    solves: float
    numbers: float
    works: float
    sets_up: float
    iterates: float
    holds: float
    iterations: float
    more: float


SHARES = {
    2: CostShares(
        grows=1.5, operations=3.3, more_costly=2.4, solves=0.11, numbers=10.0, works=90.0,
        sets_up=1.6, iterates=0.15, holds=88.0, iterations=9.0, more=0.05,
    ),
    3: CostShares(
        grows=2.0, operations=1160.0, more_costly=1.0, solves=0.25, numbers=40.0, works=90.0,
        sets_up=16.0, iterates=1.7, holds=600.0, iterations=18.0, more=0.15,
    ),
}  # fmt: skip
"""By dimension. Times were measured from 7e3 to 3.3e5 unknowns in the plane, with MUMPS at 6.3e4 and 1.5e6. In space they
were from 1.1e4 to 3e4, by MUMPS alone. Memory was measured in the plane, at 8.9e4 and 1.5e6. ``works`` and ``holds`` in space
are guesses."""
PROGRAM, MATRICES = 1.37e8, 120.0
"""Bytes of the program with its libraries; numbers an unknown in matrices and vectors, however the rock is solved for."""


BY_ENTRIES, BY_SERIES = 0.14, 0.16
"""CPU s of an iteration in unmeshed rock of 1000 joints. Entries were measured from 97 to 436 joints (scripts/figures plan
--only wide): their factors are kept, and the power of the number is 1.5. Series: scripts/bench multipoles, to 5e4 joints."""


@dataclass(frozen=True)
class Cost:
    """CPU time of an iteration of Newton's method [s], on the machine of the benchmark; memory of the run [bytes]."""

    seconds: float
    bytes: float


def without_solves(unknowns: float) -> float:
    """Memory of a run that solves for no rock, as in explicit steps [bytes]."""
    return PROGRAM + NUMBER * MATRICES * unknowns


def factor_numbers(unknowns: float, dim: int = 2) -> float:
    """Numbers in both factors of so many unknowns."""
    grows = unknowns * math.log2(max(unknowns, 2.0)) if dim == 2 else unknowns ** (4.0 / 3.0)
    return SHARES[dim].numbers * grows


def direct(unknowns: int, dim: int = 2) -> Cost:
    """Cost by LU."""
    shares, size = SHARES[dim], unknowns / 1e6
    operations = shares.operations * (shares.more_costly if unknowns > SWIFT_TO else 1.0)
    seconds = operations * size**shares.grows + shares.solves * size * math.log2(max(unknowns, 2))
    numbers = factor_numbers(unknowns, dim) + shares.works * unknowns
    return Cost(seconds, without_solves(unknowns) + NUMBER * numbers)


def unmeshed(joints: float) -> float:
    """CPU s of an iteration of Newton's method in rock that is not meshed, by all entries or by multipoles."""
    thousands = joints / 1e3
    return BY_SERIES * thousands if joints > MULTIPOLES_FROM else BY_ENTRIES * thousands**1.5


def iterations(unknowns: int, dim: int = 2) -> float:
    """Iterations of FGMRES that multigrid is expected to take."""
    return SHARES[dim].iterations * (unknowns / 1e6) ** SHARES[dim].more


def multigrid(unknowns: int, dim: int = 2, krylov: float | None = None) -> Cost:
    """Cost by multigrid, of so many iterations of FGMRES or of those expected."""
    shares, made = SHARES[dim], iterations(unknowns, dim) if krylov is None else krylov
    seconds = (shares.sets_up + shares.iterates * made) * unknowns / 1e6
    return Cost(seconds, without_solves(unknowns) + NUMBER * shares.holds * unknowns)


@dataclass(frozen=True)
class RockChoice:
    """How the rock of a run is solved for: by multigrid in the place of a factorisation, or not, and why.

    unknowns  displacements on all ranks
    memory    at hand [bytes]
    why       in words
    is_dense  the rock's matrix has an entry for each two unknowns, as without a mesh and multipoles
    """

    by_multigrid: bool = False
    unknowns: int = 0
    memory: float = math.inf
    why: str = "no cost was asked for"
    is_dense: bool = False

    @property
    def cost(self) -> Cost:
        """By the solver that is taken, in the plane."""
        return (multigrid if self.by_multigrid else direct)(self.unknowns)

    @property
    def lacks_room(self) -> bool:
        """Whether the factors of LU do not fit into the memory at hand."""
        return direct(self.unknowns).bytes > self.memory

    @classmethod
    def of(cls, method: Method, unknowns: int, memory: float = math.inf, dim: int = 2) -> RockChoice:
        """As the scene says, or by the cost.

        ``auto`` takes multigrid where it is expected to take clearly less time: LU needs no estimate of its iterations. It
        does so too where the factors of LU do not fit into the ``memory`` at hand [bytes]. So does ``multipoles``, which says
        nothing on the mesh of an event.
        """
        if method.rock_solver not in ("auto", "multipoles"):
            is_asked = method.rock_solver == "multigrid"
            return cls(is_asked, unknowns, memory, f'method.rock_solver = "{method.rock_solver}"')
        if method.coupling == "whole-lu":
            return cls(False, unknowns, memory, 'method.coupling = "whole-lu"')
        if not unknowns:
            return cls(memory=memory, why="no displacements")
        by_factors, by_grids = direct(unknowns, dim), multigrid(unknowns, dim)
        time, held = by_grids.seconds / by_factors.seconds, by_grids.bytes / by_factors.bytes
        expected = f"{unknowns} displacements, {time:.2g} times the time and {held:.2g} times the memory of LU expected"
        takes = by_factors.seconds > WORTH_GRIDS * by_grids.seconds or by_factors.bytes > memory
        return cls(takes, unknowns, memory, f"{expected}, {memory / 1e9:.3g} GB at hand")


def rock_choice(scene: Scene, comm: MPI.Comm, unknowns: int, has_far: bool = False) -> RockChoice:
    """The choice for so many displacements on these ranks, by the memory that they have. Collective.

    has_far  far walls of rock without a mesh act by multipoles
    """
    memory = memory_at_hand(comm)
    if scene.is_unbounded:  # it has no grids
        return RockChoice(False, unknowns, memory, "rock that is not meshed", is_dense=not has_far)
    if scene.method.rock_solver == "auto" and all(rock.rigid for rock in scene.rock.values()):  # nor has this
        return RockChoice(False, unknowns, memory, "rigid rock")
    return RockChoice.of(scene.method, unknowns, memory)


def memory_at_hand(comm: MPI.Comm) -> float:
    """Bytes that a run on these ranks may take, spread evenly, for the smallest machine to hold its share. Collective."""
    machine = comm.Split_type(MPI.COMM_TYPE_SHARED)
    found = (_of_machine() - PROGRAM * (machine.size - 1)) * comm.size / machine.size
    machine.Free()
    return float(comm.allreduce(found, op=MPI.MIN))


def _of_machine() -> float:
    """Bytes of this machine's memory, or what a container, a batch system or the shell leaves of it."""
    pages, size = os.sysconf("SC_PHYS_PAGES"), os.sysconf("SC_PAGE_SIZE")
    limits = [float(pages * size)]
    limits += [float(most) for most in resource.getrlimit(resource.RLIMIT_AS) if most != resource.RLIM_INFINITY]
    group = Path("/sys/fs/cgroup")
    with suppress(InputError):
        own = next(
            (line[3:] for line in read_text(Path("/proc/self/cgroup"), "").splitlines() if line[:3] == "0::"), "/"
        )
        group /= own.lstrip("/")
    for folder in (group, *group.parents[:-3]):
        with suppress(InputError, ValueError):
            limits.append(float(read_text(folder / "memory.max", "")))
    return min(limits)
