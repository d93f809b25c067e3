"""Residuals of both balances at a trial, and how many digits of the joint tractions a double leaves.

A wall that moved by u has a round-off of eps |u|/2, the jump between two walls eps |u|, and the traction eps k_n |u|. The
jumps are summed up from the motion of each step, so u is the motion of a wall in one step, not since the start.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fracflow._petsc import MPI, PETSc
from fracflow.errors import SolveError
from fracflow.mesh.data import Floats, Ints
from fracflow.model.flow import Compression, Conduction, Flow
from fracflow.model.operators import Operators
from fracflow.model.state import Sections, State

UNIT_ROUND_OFF = 0.5 * float(np.finfo(float).eps)
NOISE = 2.0  # round-offs of single displacements that meet in the balance of a node
MOST_DIGITS = 15.65  # -log10 of the spacing of doubles
LEAST_SHARE = 1e-6
"""Least traction from which digits are counted, as a share of the largest in the scene, or of loads, reactions and inertia.
Smaller ones may be zero, as those of a joint that no wave has reached."""
PRESSURE_SHARE = 1e-3
"""The same share of the largest pressure above that at rest: effective tractions of a crack that it opens are zero."""


@dataclass(frozen=True)
class SignificantDigits:
    """Fewest digits of the tractions of a fracture: its name, the largest it has carried [stress], and the cause.

    stiffness  of the joints there, or of the rock beside them, E/h, if that takes more; 0 where nothing has moved
    by_rock    whether it is that of the rock
    """

    digits: float
    fracture: str
    traction: float
    stiffness: float
    by_rock: bool


def round_off_of_jumps(before: Floats, moved: Floats) -> Floats:
    """Round-off of the strains (s, dim) after a step [length]; ``moved`` is the sum of sizes of its displacements.

    Steps round off independently of each other.
    """
    return np.hypot(before, UNIT_ROUND_OFF * moved)


def round_off_here(operators: Operators, sections: Sections, moved: Floats) -> float:
    """Round-off bound of a balance of forces, by this rank's jumps; no iteration can reduce it.

    ``moved`` (s, dim) as for ``round_off_of_jumps``, of this step. [force per thickness]
    """
    traction = np.einsum("sij,sj->si", np.abs(sections.tangent), UNIT_ROUND_OFF * moved)
    force = traction * operators.joints.weights[:, None]
    return NOISE * float(force[np.isfinite(force)].max(initial=0.0))


def round_off_of_pressure(network: Flow, conduction: Conduction) -> Floats:
    """Round-off of the flow at the joint ends (j, 2) by that of the pressures [volume rate per thickness]."""
    sizes = np.abs(conduction.pressure) + np.abs(network.resting_end)
    rounded: Floats = (NOISE * UNIT_ROUND_OFF * conduction.conductance)[:, None] * (sizes + sizes[:, ::-1])
    return rounded


def round_off_of_flow(network: Flow, conduction: Conduction, moved: Floats | None, rate: float) -> Floats:
    """The same of the flow at the joint ends (j, 2), by that of openings [volume rate per thickness].

    Pressures in a wide fracture in series with a narrow one differ by hardly more than their round-off. The aperture of a
    nearly closed fracture has few digits and its cube fewer. The flow displaced by its walls has those of their common motion.
    ``rate`` is alpha_1.
    """
    driven = round_off_of_pressure(network, conduction)
    if moved is None:
        return driven
    known = NOISE * UNIT_ROUND_OFF * np.abs(moved)
    drop = np.abs(conduction.pressure[:, 0] - conduction.pressure[:, 1])
    through = (np.abs(conduction.slope) * known).sum(axis=1) * drop
    squeezed: Floats = round_off_of_volumes(network, moved, rate) + through[:, None]
    return driven + squeezed


def round_off_of_volumes(network: Flow, moved: Floats, rate: float) -> Floats:
    """The same of the volume rates that walls open at the joint ends (j, 2), by that of openings; ``moved`` as above."""
    known = NOISE * UNIT_ROUND_OFF * np.abs(moved)
    return np.asarray(0.5 * rate * network.length[:, None] * known)


def round_off_of_uptake(network: Flow, before: Compression | None, conduction: Conduction, rate: float) -> Floats:
    """The same of what compression takes up in a step, at flow nodes (n,): a difference of volumes held. Collective.

    ``rate`` is beta_1. In a step of milliseconds it is 1e-9 of a wide fracture's fluid or less. Volumes have the digits of
    the pressures that they follow, whose changes may be far less than those at rest.
    """
    after = conduction.compression
    if before is None or after is None:
        return network.at_nodes(np.zeros_like(network.aperture))
    known = np.abs(before.held) + np.abs(after.held)
    known = known + after.weight * (np.abs(conduction.pressure) + np.abs(network.resting_end))
    return network.at_nodes(NOISE * UNIT_ROUND_OFF * rate * known)


def round_off_of_rock(operators: Operators, displacement: float) -> float:
    """The same of the rock [force per thickness], from the largest displacement: at the end of a step, or by it."""
    return NOISE * UNIT_ROUND_OFF * operators.scales.stiffness * displacement


class Largest(NamedTuple):
    """Sizes of the largest displacement and force of inertia, of this rank or more [length, force per thickness]."""

    displacement: float
    inertia: float


def significant_digits(operators: Operators, state: State, known: Largest | None = None) -> SignificantDigits:
    """Digits of the tractions of each fracture, the worst of all ranks; the rock's balance has all its motion. Collective.

    Counted from the largest traction that a fracture has carried: after unloading only round-off remains. ``known`` spares
    two passes over all unknowns.
    """
    sections = state.sections
    blocks, comm, joints = operators.blocks, operators.blocks.comm, operators.joints
    count = len(blocks.joints.fractures)
    error = np.einsum("sij,sj->si", np.abs(sections.tangent), sections.blur).max(axis=1, initial=0.0)
    beside = operators.scales.stiffness / (joints.points * joints.weights)
    stiff = np.abs(sections.tangent).max(axis=(1, 2), initial=0.0)
    is_closed = stiff > 0.0
    table = np.zeros(5 * count + 2)
    largest, table[-2:] = table[:-2].reshape(5, count), _largest(operators, state) if known is None else known
    order, present, starts = operators.sections_by_fracture
    values = np.array([error, UNIT_ROUND_OFF * beside * is_closed, sections.record, stiff, beside])[:, order]
    if len(present):
        largest[:, present] = np.maximum.reduceat(np.where(np.isfinite(values), values, 0.0), starts, axis=1)
    comm.Allreduce(MPI.IN_PLACE, table, op=MPI.MAX)
    error, closed, size, stiff, beside = largest
    displacement, inertia = table[-2:].tolist()
    rock = closed * (displacement if np.isfinite(displacement) else 0.0)
    outer = [vector.norm(PETSc.NormType.INFINITY) for vector in (state.forces.load, state.forces.support)]
    forces = max(*outer, inertia)
    least = LEAST_SHARE * max(size.max(initial=0.0), forces / operators.scales.length)
    held = np.maximum(size, max(least, PRESSURE_SHARE * state.max_overpressure))
    lost = np.divide(np.maximum(error, rock), held, out=np.zeros(count), where=held > 0.0)
    if not lost.any():
        return SignificantDigits(MOST_DIGITS, "", 0.0, 0.0, False)
    worst = int(lost.argmax())
    left, by_rock = min(MOST_DIGITS, float(-np.log10(lost[worst]))), bool(rock[worst] > error[worst])
    stiffness = float(beside[worst] if by_rock else stiff[worst])
    return SignificantDigits(left, blocks.joints.fractures[worst], float(held[worst]), stiffness, by_rock)


def _largest(operators: Operators, state: State) -> Largest:
    force = state.forces.load.duplicate()
    operators.mass.mult(state.motion.acceleration, force)
    found = Largest(*(each.norm(PETSc.NormType.INFINITY) for each in (state.motion.displacement, force)))
    force.destroy()
    return found


def refuse_few(found: SignificantDigits, limit: int, time: float) -> None:
    """Raise SolveError, on every rank, where fewer digits are left than asked for; names what would do."""
    if limit == 0 or found.digits >= limit:
        return
    enough = 0.5 * found.stiffness * 10.0 ** (found.digits - limit)
    left = min(max(round(found.digits, 1), 0.0), limit - 0.1)  # rounded down, so that it is less than required
    what, remedy = "the larger of normal_stiffness and shear_stiffness,", "or the same motion in more steps"
    if found.by_rock:
        what = "the rock's stiffness E/h ="
        remedy = "in the rock, cells as much larger, or displacements counted from where it is now"
    raise SolveError(
        f"time {time:.6g}: tractions of {found.fracture} (largest {found.traction:.3g}) keep {left:.1f}"
        f" digits, accuracy.digits asks for {limit}: {what} {found.stiffness:.3g} times the motion that both walls share"
        f" is rounded off; a stiffness of {enough:.2g} would do, {remedy}"
    )


TINY = 1e-300  # a network of closed fractures has no terms
CANCELLATION = 1e-4
"""Share of alpha_0 M u, and of alpha_1 B_F' u, that counts as a term of the balance. They cancel against those of the last
state, and with tests at 1e-11 a smaller share would need more digits than a double has. So do the last pressures in a network
that comes to rest."""
LEAST_FORCE = 1e-4  # share of the natural force that counts as a term of the balance where nothing is loaded
LEAST_DRIVE = 1e-8
"""Share of the largest pressure so far that drives at least: a network come to rest has only round-off to balance."""


@dataclass(frozen=True)
class Residual:
    """Sizes of the imbalance: largest entry over the largest of the terms that should balance, and (4.9a).

    solid, flow      largest entry, relative; what is beyond ``round_off``
    out_of_balance   Euclidean norm of the solid balance [force per thickness]
    at_nodes         of the flow, over the terms of the entry's own node: narrow fractures carry little beside wide ones
    carried          of the flow, over the actual flow, where it is far less than that at full pressure
    round_off        relative round-off bound of either balance, which no iteration can reduce
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
    """Size of the largest of values (...); infinite where one is not a number."""
    size = float(np.abs(values).max(initial=0.0))
    return size if size == size else np.inf


def over_ranks(here: list[float], comm: MPI.Comm) -> list[float]:
    """The largest of each number over all ranks. Collective."""
    if comm.size == 1:
        return [float(size) for size in here]
    sizes = np.array(here)
    comm.Allreduce(MPI.IN_PLACE, sizes, op=MPI.MAX)
    return [float(size) for size in sizes]


def flow_residual(
    balance: Floats, terms: Floats | None, largest: float, closed: Iterable[Ints], comm: MPI.Comm
) -> float:
    """Largest |balance| (n,) over the sum of the ``terms`` (n,) that should balance at its own node. Collective.

    terms    None where there is no flow
    largest  the largest single term of the network, to whose round-off no node is held
    closed   nodes whose row is a closure, on that scale
    """
    own = np.full(len(balance), largest) if terms is None else np.maximum(terms, UNIT_ROUND_OFF * largest)
    for rows in closed:
        own[rows] = largest
    with np.errstate(invalid="ignore"):  # a trial that is not finite is refused by its size
        shares = balance / np.maximum(own, TINY)
    return over_ranks([largest_of(shares)], comm)[0]


def flow_sizes(conduction: Conduction, before: Floats | float, drive: float, storing: float) -> tuple[Floats, float]:
    """Flow of elements at full pressure at their ends (j, 2), whose difference is their flow; and the largest flow.

    before  end pressures of the last state; drive  largest pressure that has driven since the start
    storing  b_1, by which a compressible fluid is taken up
    """
    size = np.maximum(np.maximum(np.abs(conduction.pressure), CANCELLATION * before), LEAST_DRIVE * drive)
    drop = np.abs(conduction.pressure[:, :1] - conduction.pressure[:, 1:])
    runs = conduction.conductance[:, None] * np.maximum(drop, CANCELLATION * size)
    through: Floats = conduction.conductance[:, None] * size
    if (stored := conduction.compression) is not None:
        known = np.abs(stored.held) + stored.weight * np.abs(conduction.pressure)
        through = np.maximum(through, CANCELLATION * storing * known)
    return through, float(runs.max(initial=0.0))
