"""Volume that wells bring into the network in a step, what the network stores, and what leaves by terms."""

from __future__ import annotations

import numpy as np

from fracflow._petsc import MPI
from fracflow.mesh.data import Floats
from fracflow.model.compressibility import rate_by, taken_between
from fracflow.model.energy_motion import Scheme
from fracflow.model.loads import Loads
from fracflow.model.operators import Operators
from fracflow.model.state import State


def brought(ops: Operators, loads: Loads, old: State, new: State, dt: float, scheme: Scheme, depth: float) -> float:
    """Net volume that wells bring in a step of length ``dt`` into fractures of a ``depth`` [length^3]. Collective.

    Fractures end closed, so that it is what the network stores, and what leaves by terms; a steady stage stores nothing.
    Where fractures have prescribed pressures, wells are counted one by one. Given rates count by their integral. At a kept
    pressure (3.20) is integrated over the step, with outflow at the instants where the balance holds.
    """
    if ops.flow is None or dt <= 0.0:
        return 0.0
    if all(part.well for part in loads.pressures):
        lost = sum(leaked(ops, old, new, dt, scheme, depth).values())
        return (stored(ops, old, new, depth) if scheme.storage else 0.0) + lost
    given = loads.integral(old.time, new.time, new.controls)
    kept = [part for part in loads.pressures if part.well]
    instants = (new,) if scheme.balance == "end" else (old, new)
    volume = sum(dt / len(instants) * state.forces.conduction.getArray(readonly=True) for state in instants)
    if scheme.storage:
        volume = volume + _room(ops, old, new)
    here = sum(float(np.sum(volume[part.numbers])) for part in kept)
    return given + depth * float(ops.layout.comm.allreduce(here, op=MPI.SUM))


def leaked(ops: Operators, old: State, new: State, dt: float, scheme: Scheme, depth: float) -> dict[str, float]:
    """Volume that leaves fractures of a ``depth`` by each term in a step of length ``dt`` [length^3]. Collective."""
    found = {}
    instants = (new,) if scheme.balance == "end" else (old, new)
    for term in ops.flow.terms if ops.flow is not None else ():
        rates = [rate_by(ops, term, state) for state in instants]
        found[term.name] = depth * dt / len(instants) * sum(float(rate.sum()) for rate in rates)
        for rate in rates:
            rate.destroy()
    return found


def stored(ops: Operators, old: State, new: State, depth: float) -> float:
    """Volume of fluid that fractures of a ``depth`` take up between two states [length^3]. Collective."""
    return depth * float(ops.layout.comm.allreduce(float(np.sum(_room(ops, old, new))), op=MPI.SUM))


def _room(ops: Operators, old: State, new: State) -> Floats:
    """Volumes that walls and compression take up between two states, at this rank's flow nodes (n,) [volume per thickness]."""
    assert ops.flow is not None
    room, moved = new.pressure.duplicate(), new.motion.displacement.duplicate()
    after, before = (state.motion.displacement.getArray(readonly=True) for state in (new, old))
    moved.setArray(after - before)
    ops.flow.storage_coupling.multTranspose(moved, room)
    if new.uptake is not None:
        taken = taken_between(ops, old, new)
        room.axpy(1.0, taken)
        taken.destroy()
    result: Floats = room.getArray().copy()
    room.destroy()
    moved.destroy()
    return result
