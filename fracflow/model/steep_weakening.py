"""Strength that falls with slip faster than the shear stiffness of its joints lets slip follow: such a scene is refused."""

from __future__ import annotations

import numpy as np

from fracflow._petsc import MPI
from fracflow.errors import InputError, SolveError
from fracflow.mesh.blocks import Blocks
from fracflow.mesh.data import Floats
from fracflow.model.joints import Joints
from fracflow.model.state import SectionHistory, Sections

REMEDY = "make shear_stiffness times {1} at least {0:.3g} times what it is"


def steepest(
    blocks: Blocks,
    joints: Joints,
    traction: Floats,
    past: SectionHistory,
    chosen: Floats | None = None,
    least: float = 0.0,
) -> tuple[float, str, str]:
    """Largest fall of strength with slip over shear stiffness, of the chosen sections, its fracture and key. Collective.

    traction (s, dim) [stress], chosen (s,) or all; the key is that of the slip over which strength falls. Where the largest is
    below ``least`` it may be 0, and none is named.
    """
    worst = (0.0, "", "")
    compression = -float(traction[:, -1].min(initial=0.0))
    for group, history in zip(joints.laws, past, strict=True):
        if group.law.most_steepness(compression) < least:  # mostly: it spares a step a pass over its sections
            continue
        falls = group.law.steepness(traction[group.sections], history)
        if chosen is not None:
            falls = np.where(chosen[group.sections], falls, 0.0)
        most = float(falls.max(initial=0.0))
        if most > worst[0]:
            fracture = blocks.joints.fracture[group.sections[falls.argmax()] // joints.points]
            worst = (most, blocks.joints.fractures[fracture], group.law.weakens_over)
    if blocks.comm.size == 1:
        return worst
    largest = np.array([worst[0]])
    blocks.comm.Allreduce(MPI.IN_PLACE, largest, op=MPI.MAX)
    return (float(largest[0]), "", "") if largest[0] < least else max(blocks.comm.allgather(worst))


def refuse_steep_start(blocks: Blocks, joints: Joints) -> None:
    """Raise InputError, on every rank, for a fracture that would jump under its initial normal traction. Collective."""
    worst, name, key = steepest(blocks, joints, joints.initial, joints.initial_history())
    if worst >= 1.0:
        raise InputError(
            f"fracture.{name}: under its initial normal traction its strength falls with slip {worst:.4g} times as fast as"
            f" its shear_stiffness unloads, so that it would jump: {REMEDY.format(worst, key)}"
        )


def refuse_jumps(blocks: Blocks, joints: Joints, old: Sections, new: Sections, time: float) -> None:
    """Raise SolveError, on every rank, for a fracture that slid in a step where its strength fell too fast. Collective."""
    if steepest(blocks, joints, new.traction, old.history, least=1.0)[0] < 1.0:
        return
    slid = (new.inelastic != old.inelastic).any(axis=1)
    worst, name, key = steepest(blocks, joints, new.traction, old.history, slid, least=1.0)
    if worst >= 1.0:
        raise SolveError(
            f"time {time:.6g}: fracture {name}: under its present normal traction its strength fell with slip"
            f" {worst:.4g} times as fast as its shear_stiffness unloads: it jumped, which no smaller step resolves;"
            f" {REMEDY.format(worst, key)}"
        )
