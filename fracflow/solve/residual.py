"""How far the balances of a trial are out."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from fracflow._petsc import MPI, PETSc
from fracflow.mesh.data import Floats, Ints
from fracflow.model.flow import Conduction
from fracflow.solve.round_off import ROUND_OFF

TINY = 1e-300  # a network of closed fractures has no terms
CANCELLATION = 1e-4
"""Share of alpha_0 M u, and of alpha_1 B_F' u, that counts as a term of the balance: they cancel against those of the last
state, and with tests at 1e-11 a smaller share would ask for digits that a double does not have. So does that of the last
pressures in a network that comes to rest."""
LEAST_FORCE = 1e-4  # share of the natural force that counts as a term of the balance where nothing is loaded
LEAST_DRIVE = 1e-8
"""Share of the largest pressure so far that drives at least: a network come to rest has only round-off to balance."""


@dataclass(frozen=True)
class Residual:
    """Sizes of what is out of balance: largest entry over the largest of the terms that should balance, and (4.9a).

    solid, flow      largest entry, relative; what is beyond ``round_off``
    out_of_balance   Euclidean norm of the solid balance [force per thickness]
    at_nodes         of the flow, over the terms of the entry's own node: narrow fractures carry little beside wide ones
    carried          of the flow, over what runs, where it is far less than full pressure would drive
    round_off        relative size of what displacements of finite digits leave of either balance, whatever is iterated
    """

    solid: float
    flow: float
    out_of_balance: float
    at_nodes: float = 0.0
    round_off: float = 0.0
    carried: float = 0.0


def largest(vector: PETSc.Vec) -> float:
    """Size of the largest entry on this rank; infinite where one is not a number."""
    return largest_of(vector.getArray(readonly=True))


def largest_of(values: Floats) -> float:
    """Size of the largest value; infinite where one is not a number."""
    size = float(np.abs(values).max(initial=0.0))
    return size if size == size else np.inf


def over_ranks(here: list[float], comm: MPI.Comm) -> list[float]:
    """The largest of each number over all ranks. Collective."""
    sizes = np.array(here)
    comm.Allreduce(MPI.IN_PLACE, sizes, op=MPI.MAX)
    return [float(size) for size in sizes]


def flow_residual(
    balance: Floats, terms: Floats | None, largest: float, closed: Iterable[Ints], comm: MPI.Comm
) -> float:
    """Largest |balance| (n,) over the sum of the ``terms`` (n,) that should balance at its own node. Collective.

    terms    None where there is no flow
    largest  the largest single term of the network, to whose round-off no node is held
    closed   nodes whose row stands for something else, on that scale
    """
    own = np.full(len(balance), largest) if terms is None else np.maximum(terms, ROUND_OFF * largest)
    for rows in closed:
        own[rows] = largest
    return over_ranks([largest_of(balance / np.maximum(own, TINY))], comm)[0]


def flow_sizes(conduction: Conduction, before: Floats | float, drive: float, storing: float) -> tuple[Floats, float]:
    """What elements carry at full pressure at their ends (j, 2), terms whose difference is their flow; the most that runs.

    before  end pressures of the last state; drive  largest pressure that has driven since the start
    storing  b_1, by which a compressible fluid is taken up
    """
    size = np.maximum(np.maximum(np.abs(conduction.pressure), CANCELLATION * before), LEAST_DRIVE * drive)
    drop = np.ptp(conduction.pressure, axis=1, keepdims=True)
    runs = conduction.conductance[:, None] * np.maximum(drop, CANCELLATION * size)
    through: Floats = conduction.conductance[:, None] * size
    if (stored := conduction.compression) is not None:
        known = np.abs(stored.held) + stored.weight * np.abs(conduction.pressure)
        through = np.maximum(through, CANCELLATION * storing * known)
    return through, float(runs.max(initial=0.0))
