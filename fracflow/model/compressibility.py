"""Changes in the fractures from state to state: fluid taken up by compression or leaving by terms, and apertures."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fracflow._petsc import MPI, PETSc, destroy
from fracflow.integrators import Alphas, first_rate
from fracflow.mesh.data import Floats
from fracflow.mesh.places import extent_of, place_text
from fracflow.model.energy_motion import Scheme
from fracflow.model.flow import Compression, Conduction
from fracflow.model.loads import Loads
from fracflow.model.operators import Operators
from fracflow.model.state import State
from fracflow.model.terms.term import Term, TermStep
from fracflow.model.undrained import Closure


def compression_of(operators: Operators, state: State) -> Compression | None:
    """Fluid beyond the room between the walls at a state; None of an incompressible fluid. Collective."""
    network = operators.flow
    if network is None or network.compressibility == 0.0:
        return None
    return network.compress(_apertures(operators, state), network.driving(state.pressure))


def _apertures(operators: Operators, state: State) -> Floats:
    """Apertures (j, 2) of the joint ends at a state [length]. Collective."""
    opening = operators.joints.openings(state.sections.strain)
    return operators.network.apertures(state.motion.displacement, opening)


def rate_by(operators: Operators, term: Term, state: State) -> PETSc.Vec:
    """Rates at which fluid leaves by a term at the flow nodes, in a new vector [volume rate per thickness]. Collective."""
    network, result = operators.network, operators.layout.flow_vector()
    leaving = term.leaving(network.at_ends(state.pressure), _apertures(operators, state), TermStep(state.memory))
    network.taken_up(leaving.rate, result)
    return result


def taken_up(operators: Operators, before: Compression, after: Compression) -> PETSc.Vec:
    """Volumes taken up by compression between two instants at the flow nodes, new [volume per thickness]. Collective."""
    result = operators.layout.flow_vector()
    operators.network.taken_up(after.held - before.held, result)
    return result


def taken_between(operators: Operators, old: State, new: State) -> PETSc.Vec:
    """The same between two states. Collective."""
    before, after = compression_of(operators, old), compression_of(operators, new)
    assert before is not None and after is not None
    return taken_up(operators, before, after)


def narrowing(operators: Operators, old: State, new: State) -> float:
    """Least ratio of new to old aperture of conducting elements; 1 or more where none narrows. Collective."""
    if operators.flow is None:
        return 1.0
    return float(operators.layout.comm.allreduce(float(_left(operators, old, new).min(initial=1.0)), op=MPI.MIN))


class Growth(NamedTuple):
    """How apertures of conducting elements grew in a step, as its report has it."""

    grown: float = 1.0
    widening: float = 1.0
    widest: str = ""


def widening(operators: Operators, loads: Loads, old: State, new: State) -> Growth:
    """Largest factor by which an aperture has grown, at least 1; where no pressure is prescribed, and the place. Collective.

    A prescribed pressure gives the aperture of its place at once, whatever flows in. No shorter step makes it grow less.
    """
    if operators.flow is None:
        return Growth()
    joints, given = operators.blocks.joints, operators.layout.flow_vector()
    given.getArray()[loads.given_pressures] = 1.0
    left = _left(operators, old, new)
    follows = np.where(operators.network.at_ends(given) > 0.0, 1.0, left)
    given.destroy()
    grown, found = float(left.max(initial=1.0)), (1.0, "")
    if follows.size and follows.max() > 1.0:
        joint, end = np.unravel_index(follows.argmax(), follows.shape)
        points = operators.blocks.solid.points
        at = place_text(points[joints.bottom[joint, end]], extent_of(points))
        found = float(follows[joint, end]), f"{joints.fractures[joints.fracture[joint]]} at {at}"
    every = operators.layout.comm.allgather((grown, found))
    return Growth(max(grown for grown, _ in every), *max(found for _, found in every))


def _left(operators: Operators, old: State, new: State) -> NDArray[np.float64]:
    """Ratio of new to old aperture (j, 2) of conducting elements; 1 where conductances are given. Collective."""
    network = operators.network
    before, after = (np.maximum(_apertures(operators, state), network.least) for state in (old, new))
    wide = (before > 0.0) & np.isnan(network.given)[:, None]
    return np.divide(after, before, out=np.ones_like(before), where=wide)


DENSEST = 100.0  # exponent of a density: beyond it a trial overflows somewhere


def uptake_rate(state: State, alphas: Alphas, taken: Floats) -> Floats | None:
    """Rates (n,) of what was ``taken`` (n,) since ``state``, by the rule of the walls; None in a step without storage."""
    if alphas.b1 == alphas.b4 == 0.0:
        return None
    rates = (state.uptake, state.previous_step.uptake)
    old, mean = (0.0 if rate is None else rate.getArray(readonly=True) for rate in rates)
    return first_rate(alphas, taken, 0.0, old, mean)


def uptake_at(
    operators: Operators,
    state: State,
    alphas: Alphas,
    before: Compression | None,
    after: Compression | None,
    opened: Floats | float = 0.0,
) -> Floats | None:
    """The same (n,) of the fluid that compression has taken up since ``state``; None if incompressible. Collective.

    opened  (n,) volumes that walls open beside their rates
    """
    if before is None or after is None:
        return None
    taken = taken_up(operators, before, after)
    rate = uptake_rate(state, alphas, taken.getArray() + opened)
    taken.destroy()
    return rate


def taken_by(operators: Operators, closure: Closure, before: Compression | None, after: Compression | None) -> float:
    """Fluid that compression has taken up in a component that must keep it [volume per thickness]. Collective."""
    if closure.by != "fluid" or before is None or after is None:
        return 0.0
    return float(operators.layout.comm.allreduce(float((after.held - before.held)[closure.ends].sum())))


def lost(
    operators: Operators,
    closure: Closure,
    moved: PETSc.Vec,
    pressure_change: Floats,
    before: Compression | None,
    after: Compression | None,
) -> float:
    """Fluid or level that a closed component has lost, over its natural size; pressure_change (n,). Collective."""
    if closure.by != "level":
        taken = taken_by(operators, closure, before, after)
        return float((closure.weights.dot(moved) + taken) / closure.size)
    here = float(closure.weights.values @ pressure_change[closure.weights.at])
    return float(operators.layout.comm.allreduce(here)) / operators.scales.pressure


def why_not_finite(operators: Operators, conduction: Conduction | None) -> str:
    """The term without a finite value at a trial: density of the fluid in a fracture, named, or tractions. Collective."""
    comm, block, network = operators.layout.comm, operators.blocks.joints, operators.flow
    pressed = ("", 0.0)
    if network is not None and conduction is not None and len(conduction.pressure):
        size = np.where(np.isfinite(conduction.pressure), conduction.pressure, np.inf).max(axis=1)
        pressed = (block.fractures[block.fracture[int(size.argmax())]], float(size.max()))
    name, pressure = max(comm.allgather(pressed), key=lambda found: found[1])
    compressibility, unit = (0.0, "") if network is None else (network.compressibility, network.unit)
    if compressibility * pressure <= DENSEST:
        return "the joint laws gave no finite traction (a joint closed beyond its aperture)"
    return (
        f"fluid in {name} would come under {pressure:.3g}{unit}, {compressibility * pressure:.3g}/compressibility, which must"
        f" be at most {DENSEST:g}: give it a way out, such as a wider minimum_hydraulic_aperture, or pump and close it less"
    )


def brought(
    ops: Operators, loads: Loads, old: State, new: State, room: Floats, dt: float, scheme: Scheme, depth: float
) -> float:
    """Net volume that wells bring in a step of length ``dt`` into fractures of a ``depth`` [length^3]. Collective.

    room  (n,) ``room_between`` both states

    Fractures end closed, so that it is what the network stores, and what leaves by terms; a steady stage stores nothing.
    Where fractures have prescribed pressures, wells are counted one by one. Given rates count by their integral. At a kept
    pressure (3.20) is integrated over the step, with outflow at the instants where the balance holds.
    """
    if ops.flow is None or dt <= 0.0:
        return 0.0
    if all(part.well for part in loads.pressures):
        lost = sum(leaked(ops, old, new, dt, scheme, depth).values())
        return (stored(ops, room, depth) if scheme.storage else 0.0) + lost
    given = loads.integral(old.time, new.time, new.controls)
    kept = [part for part in loads.pressures if part.well]
    instants = (new,) if scheme.balance == "end" else (old, new)
    volume = sum(dt / len(instants) * state.forces.conduction.getArray(readonly=True) for state in instants)
    if scheme.storage:
        volume = volume + room
    here = sum(float(np.sum(volume[part.numbers])) for part in kept)
    return given + depth * float(ops.layout.comm.allreduce(here, op=MPI.SUM))


def leaked(ops: Operators, old: State, new: State, dt: float, scheme: Scheme, depth: float) -> dict[str, float]:
    """Volume that leaves fractures of a ``depth`` by each term in a step of length ``dt`` [length^3]. Collective."""
    found = {}
    instants = (new,) if scheme.balance == "end" else (old, new)
    for term in ops.flow.terms if ops.flow is not None else ():
        if term.name in new.memory:
            found[term.name] = depth * ops.layout.comm.allreduce(term.lost(new.memory[term.name], dt))
            continue
        rates = [rate_by(ops, term, state) for state in instants]
        found[term.name] = depth * dt / len(instants) * sum(float(rate.sum()) for rate in rates)
        destroy(*rates)
    return found


def stored(ops: Operators, room: Floats, depth: float) -> float:
    """Volume of fluid that fractures of a ``depth`` take up [length^3]; room (n,) ``room_between`` states. Collective."""
    return depth * float(ops.layout.comm.allreduce(float(np.sum(room)), op=MPI.SUM))


def room_between(ops: Operators, old: State, new: State) -> Floats:
    """Volumes taken up by walls and compression between states, at flow nodes (n,) of a rank [volume per thickness].

    Collective.
    """
    room, moved = new.pressure.duplicate(), new.motion.displacement.duplicate()
    after, before = (state.motion.displacement.getArray(readonly=True) for state in (new, old))
    moved.setArray(after - before)
    ops.network.storage_coupling.multTranspose(moved, room)
    if new.uptake is not None:
        taken = taken_between(ops, old, new)
        room.axpy(1.0, taken)
        taken.destroy()
    result: Floats = room.getArray().copy()
    destroy(room, moved)
    return result
