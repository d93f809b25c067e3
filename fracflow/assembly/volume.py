"""Volume that wells bring into the network in a step."""

from __future__ import annotations

import numpy as np

from fracflow._petsc import MPI
from fracflow.assembly.compression import taken_between
from fracflow.assembly.energy_motion import Scheme
from fracflow.assembly.loads import Loads
from fracflow.assembly.operators import Operators
from fracflow.state import State


def brought(ops: Operators, loads: Loads, old: State, new: State, dt: float, scheme: Scheme, depth: float) -> float:
    """Net volume that wells bring in a step of length ``dt`` into fractures of a ``depth`` [length^3].

    Given rates by their integral. At a pressure that is kept, (3.20) over the step: what walls and compression make room for
    there, and what flows off, which is known at the instants where the balance holds. Collective.
    """
    if ops.flow is None or dt <= 0.0:
        return 0.0
    given = loads.integral(old.time, new.time, new.controls)
    kept = [part for part in loads.pressures if part.well]
    if not kept:
        return given
    instants = (new,) if scheme.balance == "end" else (old, new)
    volume = sum(dt / len(instants) * state.forces.conduction.getArray(readonly=True) for state in instants)
    if scheme.storage:
        room, moved = new.pressure.duplicate(), new.motion.displacement.duplicate()
        after, before = (state.motion.displacement.getArray(readonly=True) for state in (new, old))
        moved.setArray(after - before)
        ops.flow.squeeze.multTranspose(moved, room)
        volume = volume + room.getArray()
        if new.uptake is not None:
            taken = taken_between(ops, old, new)
            volume = volume + taken.getArray()
            taken.destroy()
        room.destroy()
        moved.destroy()
    here = sum(float(np.sum(volume[part.numbers])) for part in kept)
    return given + depth * float(ops.layout.comm.allreduce(here, op=MPI.SUM))
