"""(2.24)-(2.27) The energy balance: every term of (2.33b) summed over each step, and the residual.

Running totals, per unit thickness. The balance that must close:
kinetic + rock_strain + joint_normal + joint_shear + fluid_storage + friction + viscous + radiated + damping + scheme
    + spurious + dropped = work_boundaries + work_wells + work_pressure + work_incident + work_initial
Terms may add entries: on the left, or on the right where their names begin with "work_". Where joints dilate, ``dilation``
is the work of walls that ride up against what presses them. It is no summand: the dissipation ``friction`` is less it.
Where rock may be meshed in the course of a run, ``change_of_rock`` is on the left. It is the strain energy of the rock before
a change less that after it, summed over all changes.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from fracflow._petsc import PETSc, destroy, sum_over_ranks
from fracflow.errors import SolveError
from fracflow.laws import LawStep
from fracflow.mesh.data import Floats
from fracflow.model.compressibility import rate_by, taken_between
from fracflow.model.energy_motion import Scheme, kinetic_energy, motion_parts, term_parts
from fracflow.model.operators import Operators
from fracflow.model.state import Sections, State
from fracflow.model.terms.term import Term

STORED = (
    "kinetic", "rock_strain", "joint_normal", "joint_shear", "fluid_storage", "friction", "viscous", "radiated",
    "damping", "scheme", "spurious", "dropped",
)  # fmt: skip
WORK = ("work_boundaries", "work_wells", "work_pressure", "work_incident", "work_initial")
ENTRIES = (*STORED, *WORK, "joint_normal_closed", "residual", "residual_closed")
DILATION = "dilation"
CHANGE_OF_ROCK = "change_of_rock"
TAKE = (
    "friction",
    "damping",
    "scheme",
)  # energy, each; where a step does not resolve a motion they give some for a while
HELD = tuple(name for name in STORED if name not in TAKE)
# That of a vibration of omega in explicit steps is up to 1/(1 - (omega dt/2)^2): ten times at .95 of its critical step. Runs
# whose motion feeds on itself pass it within some tens of steps.
MOST_MADE = 10.0
UNSEEN = 1e-12  # of the energy of an acceleration over a step


def empty_balance(terms: Iterable[Term] = (), dilates: bool = False, is_handed: bool = False) -> dict[str, float]:
    """All entries at zero, those of terms beside the others, of joints that dilate, and of rock that may be meshed later."""
    more = [*([DILATION] if dilates else []), *([CHANGE_OF_ROCK] if is_handed else [])]
    return dict.fromkeys([*ENTRIES, *(name for term in terms for name in term.energy(0.0, 0.0)), *more], 0.0)


def update_balance(operators: Operators, old: State, new: State, dt: float, scheme: Scheme) -> dict[str, float]:
    """Totals after a step of length ``dt`` from ``old`` to ``new``.

    With ``scheme.storage`` the balance of the fluid includes the motion of walls, whose work is inner; else it is outer work
    (``work_pressure``). Collective.
    """
    ops = operators
    change = _sum(1.0, new.motion.displacement, -1.0, old.motion.displacement)
    term = change.duplicate()
    parts = {"scheme": 0.0, "work_boundaries": 0.0}
    sent = ops.joints.radiated(old.sections, new.sections, LawStep(new.time, dt, scheme.inertia))
    work = joint_work(ops.joints.weights, old.sections, new.sections)
    of_joints = sum_over_ranks(np.append(work, ops.joints.weights @ sent), ops.layout.comm)
    parts |= joint_parts(of_joints[:5]) | motion_parts(ops, old, new, dt, scheme) | term_parts(ops, old, new, dt)
    parts["friction"] -= of_joints[5]
    parts["radiated"] = parts.get("radiated", 0.0) + of_joints[5]
    mean_displacement = _sum(0.5, new.motion.displacement, 0.5, old.motion.displacement)
    ops.rock_force(mean_displacement, term)
    parts["rock_strain"] += term.dot(change) + ops.prestress.dot(change)
    outer = [force for state in (old, new) for force in (state.forces.load, state.forces.support)]
    parts["work_boundaries"] += 0.5 * sum(force.dot(change) for force in outer)
    if ops.flow is not None:
        pushed, swept = new.pressure.duplicate(), new.pressure.duplicate()
        ops.flow.pressure_load.multTranspose(change, pushed)
        ops.flow.storage_coupling.multTranspose(change, swept)
        parts |= fluid_parts(ops, old, new, (pushed, swept), dt, scheme)
        parts["scheme"] += parts.pop("fluid_scheme")
        destroy(pushed, swept)
    destroy(change, mean_displacement, term)
    return added(old.energy, parts)


def added(totals: Mapping[str, float], parts: Mapping[str, float]) -> dict[str, float]:
    """Totals after ``parts`` of a step, or of some."""
    names = dict.fromkeys([*ENTRIES, *totals])
    return _with_residuals({name: totals.get(name, 0.0) + parts.get(name, 0.0) for name in names})


def _sum(first: float, a: PETSc.Vec, second: float, b: PETSc.Vec) -> PETSc.Vec:
    result = a.copy()
    result.scale(first)
    result.axpy(second, b)
    return result


def switch(totals: Mapping[str, float], kinetic: float) -> dict[str, float]:
    """Totals where a stage begins with another kinetic energy than the last one ended with: the rest is dropped."""
    lost = totals["kinetic"] - kinetic
    return _with_residuals({**totals, "kinetic": kinetic, "dropped": totals["dropped"] + lost})


def pushed(totals: Mapping[str, float], kinetic: float) -> dict[str, float]:
    """Totals where supports begin to move at once: the kinetic energy that they add is work of boundaries."""
    given = kinetic - totals["kinetic"]
    return _with_residuals({**totals, "kinetic": kinetic, "work_boundaries": totals["work_boundaries"] + given})


def jumped(totals: Mapping[str, float], stored: float) -> dict[str, float]:
    """Totals where prescribed pressures jump as a stage begins: wells bring the energy that the fluid stores there at once."""
    stored_now, brought = totals["fluid_storage"] + stored, totals["work_wells"] + stored
    return _with_residuals({**totals, "fluid_storage": stored_now, "work_wells": brought})


def compressed(ops: Operators, old: State, new: State) -> float:
    """Work of (2.33b) on a compressible fluid between two states, int h ds - p dd, with h of ``Flow.potential``.

    Pressures p above those at rest; s is what the fracture of aperture d holds. Collective.
    """
    room = new.pressure.duplicate()
    change = _sum(1.0, new.motion.displacement, -1.0, old.motion.displacement)
    ops.network.storage_coupling.multTranspose(change, room)
    work = _compressed_beside(ops, old, new, room)
    destroy(room, change)
    return work


def _compressed_beside(ops: Operators, old: State, new: State, room: PETSc.Vec) -> float:
    """The same, where walls open ``room`` at the flow nodes."""
    taken = taken_between(ops, old, new)
    mean, driving = _potential(ops, (old, new)), _sum(0.5, new.pressure, 0.5, old.pressure)
    driving.axpy(-1.0, ops.network.resting)
    driving.aypx(-1.0, mean)
    work = float(mean.dot(taken)) + float(driving.dot(room))
    destroy(taken, mean, driving)
    return work


def _potential(ops: Operators, instants: tuple[State, ...]) -> PETSc.Vec:
    """Potential of a volume of fluid, as a mean over the instants, in a new vector [stress]."""
    network = ops.network
    if network.compressibility == 0.0:
        balanced = _sum(-1.0, network.resting, 1.0 / len(instants), instants[0].pressure)
        for state in instants[1:]:
            balanced.axpy(1.0 / len(instants), state.pressure)
        return balanced
    balanced, resting = network.resting.duplicate(), network.resting.getArray(readonly=True)
    each = [network.potential(state.pressure.getArray(readonly=True) - resting) for state in instants]
    balanced.setArray(sum(each) / len(instants))
    return balanced


def close_initial_balance(totals: Mapping[str, float]) -> dict[str, float]:
    """Totals of a start away from rest: the unaccounted energy was added before the first step."""
    held = _with_residuals({**totals, "scheme": 0.0})
    return _with_residuals({**held, "work_initial": held["residual"]})


def _with_residuals(totals: dict[str, float]) -> dict[str, float]:
    of_terms = [name for name in totals if name not in (*ENTRIES, DILATION)]
    work = [*WORK, *(name for name in of_terms if name.startswith("work_"))]
    stored = [*STORED, *(name for name in of_terms if name not in work)]
    left = sum(totals[name] for name in stored) - sum(totals[name] for name in work)
    return {
        **totals,
        "residual": left,
        "residual_closed": left - totals["joint_normal"] + totals["joint_normal_closed"],
    }


def share_of_balance(totals: Mapping[str, float], name: str) -> float:
    """The size of an entry over that of the largest one; 0 where all are."""
    largest = max(abs(totals[each]) for each in (*STORED, *WORK))
    return abs(totals[name]) / largest if largest > 0.0 else 0.0


def dissipated(before: Sections, after: Sections) -> Floats:
    """(2.27b) with (2.33b): plastic work at each section (s,) in a step, of which waves may carry off a part [energy/area]."""
    work = (before.traction + after.traction) * (after.inelastic - before.inelastic)
    return np.asarray(0.5 * work.sum(axis=1))


def work_missed(weights: Floats, before: Sections, after: Sections) -> float:
    """(2.27b) Work of friction that its mean over a step misses on this rank's sections whose slip turns in the step.

    There the shear traction that the step begins with is against the slip of the step. Its half of the mean gives energy
    back, where friction takes it all along [energy per thickness].

    weights  (s,) length or area that each section stands for
    """
    given = np.einsum("si,si->s", before.traction[:, :-1], (after.inelastic - before.inelastic)[:, :-1])
    return float(weights @ np.maximum(-0.5 * given, 0.0))


def joint_work(weights: Floats, before: Sections, after: Sections) -> Floats:
    """(2.27) with (2.33b): work (5,) on this rank's sections in a step.

    Normal and elastic shear, plastic, what they store, and the work of walls that slip apart against the normal traction.
    weights  (s,) length or area that each stands for
    """
    traction = 0.5 * weights[:, None] * (before.traction + after.traction)
    plastic = traction * (after.inelastic - before.inelastic)
    elastic = traction * (after.strain - before.strain) - plastic
    stored = np.sum(weights * (after.stored - before.stored))
    return np.array([elastic[:, -1].sum(), elastic[:, :-1].sum(), plastic.sum(), stored, -plastic[:, -1].sum()])


def joint_parts(work: Floats) -> dict[str, float]:
    """Entries of the balance of that (5,), summed over all ranks; and the closed form of the first two."""
    normal, shear, friction, closed, dilation = work.tolist()
    found = {"joint_normal": normal, "joint_shear": shear, "friction": friction, "joint_normal_closed": closed - shear}
    return found | {DILATION: dilation}


def fluid_parts(
    ops: Operators, old: State, new: State, walls: tuple[PETSc.Vec, PETSc.Vec], dt: float, scheme: Scheme
) -> dict[str, float]:
    """Terms of the balance (3.20) times the potential that drives, both as means over the instants where it holds.

    walls  volumes that walls open in the step at the flow nodes, by B and by B_F

    The mean pressure of the step acts on the walls. Its difference from the pressure in the storage of (3.20), and that of
    velocities, is counted as the scheme's, ``fluid_scheme``. The resting pressure is a dead load on the walls. Collective.
    """
    network, instants = ops.network, (new,) if scheme.balance == "end" else (old, new)
    pressure, share = _sum(0.5, new.pressure, 0.5, old.pressure), dt / len(instants)
    driving = _sum(1.0, pressure, -1.0, network.resting)
    balanced = _potential(ops, instants)
    push, sweep = walls
    pushed = float(push.dot(driving))
    parts = {
        "viscous": share * sum(state.forces.conduction.dot(balanced) for state in instants),
        "work_wells": share * sum(state.forces.source.dot(balanced) for state in instants),
        "work_pressure": float(push.dot(network.resting)),
        "fluid_scheme": 0.0,
    }
    for term in network.terms:
        rates = [rate_by(ops, term, state) for state in instants]
        lost = share * sum(each.dot(balanced) for each in rates)
        parts["viscous"] -= lost
        parts |= term.energy(lost, 0.0)
        destroy(*rates)
    if scheme.storage:
        swept = float(sweep.dot(driving))
        parts["spurious"] = swept - pushed
        if scheme.balance == "step":  # of the volume that the walls open
            stored = float(sweep.dot(balanced))
        else:
            stored = share * sum(_volume_rate(ops, state, balanced) for state in instants)
        stored += share * sum(state.uptake.dot(balanced) for state in instants if state.uptake is not None)
        parts["fluid_scheme"] = stored - swept
    else:
        parts["work_pressure"] += pushed
    if network.compressibility > 0.0:
        # without storage no fluid is drawn for it, and its work is outer as that on the walls
        parts["fluid_storage"] = _compressed_beside(ops, old, new, sweep)
        if scheme.storage:
            parts["fluid_scheme"] -= parts["fluid_storage"]
        else:
            parts["work_pressure"] += parts["fluid_storage"]
    destroy(pressure, driving, balanced)
    return parts


def _volume_rate(ops: Operators, state: State, balanced: PETSc.Vec) -> float:
    """B_F' v times a potential at the flow nodes. Collective."""
    rate = state.pressure.duplicate()
    ops.network.storage_coupling.multTranspose(state.motion.velocity, rate)
    found = float(rate.dot(balanced))
    rate.destroy()
    return found


def made_and_brought(totals: Mapping[str, float]) -> tuple[float, float]:
    """Energy that ``TAKE`` have given, and all that was put in or set free, by the totals of a balance [energy/thickness]."""
    made = sum(max(-totals[name], 0.0) for name in TAKE if name in totals)
    works = sum(max(value, 0.0) for name, value in totals.items() if name.startswith("work_"))
    return made, works + sum(max(-totals[name], 0.0) for name in HELD)


def refuse_made_energy(ops: Operators, state: State, dt: float) -> None:
    """Raise SolveError, on every rank, and free a state, where ``MOST_MADE`` times more energy was made than brought.

    A share ``UNSEEN`` of dt^2 a M a/2 is round-off, with the length ``dt`` of the step before. A support that starts with a
    jerk has that at once, and its work cancels. Collective.
    """
    made, brought = made_and_brought(state.energy)
    if made <= MOST_MADE * brought:
        return
    if made <= UNSEEN * dt**2 * kinetic_energy(ops, state.motion.acceleration):
        return
    worst, time = min(TAKE, key=lambda name: state.energy.get(name, 0.0)), state.time
    state.destroy()
    raise SolveError(
        f"time {time:.9g}: motion feeds on itself: energy/{worst} has given {made:.3g} per thickness, over {MOST_MADE:g}"
        f" times all that was brought, {brought:.3g}: take a smaller time_step, or another method.stepper"
    )
