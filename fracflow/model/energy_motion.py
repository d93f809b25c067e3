"""Terms that motion adds to the energy balance in a step: kinetic energy, dissipation by the scheme, and work of terms."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fracflow._petsc import PETSc
from fracflow.integrators import Alphas
from fracflow.mesh.data import Floats, Ints
from fracflow.model.balance import static_balance_of
from fracflow.model.layout import product
from fracflow.model.operators import Operators
from fracflow.model.state import State


@dataclass(frozen=True)
class Scheme:
    """The rule of a step as the energy balance needs it; the first three as in ``integrators.Stepper``.

    alphas  of a step with inertia; None of one that only puts a motion in, and of an explicit one
    held    local numbers of the solid unknowns that are prescribed
    """

    inertia: bool = True
    storage: bool = True
    balance: str = "both"
    alphas: Alphas | None = None
    held: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))


def kinetic_energy(operators: Operators, velocity: PETSc.Vec) -> float:
    """(4.4a) v' M v / 2. Collective."""
    momentum = velocity.duplicate()
    operators.mass.mult(velocity, momentum)
    energy = 0.5 * velocity.dot(momentum)
    momentum.destroy()
    return float(energy)


def motion_parts(ops: Operators, old: State, new: State, dt: float, scheme: Scheme) -> dict[str, float]:
    """Kinetic energy, dissipation by the scheme, work at supports beside half the sum of reactions; or the dropped energy.

    Over a step the rock moves by d, and half the sum of S before and after it does the work of the other entries.
    Where it is free, M w + (1 - f) S_new + f S = 0, w the acceleration that the mass meets; so the scheme dissipates
    d.(M w - M dv/dt) + e.M dv/dt + (1/2 - f) d.(S_new - S), with d = dt (v + v_new)/2 + e and e of the accelerations alone.
    Where it is held, its inertia force does the work of its kinetic energy. That through M_fh on free nodes is no part of the
    scheme either. Without inertia the half of S that the last stage left is dropped; M a is not -S there, where a scheme uses
    the previous step. Collective.
    """
    change = _local(new.motion.displacement) - _local(old.motion.displacement)
    before, after = old.motion.values(), new.motion.values()
    mean = _times(ops.mass, 0.5 * (before.acceleration + after.acceleration))
    is_held = np.zeros(len(change), dtype=bool)
    is_held[scheme.held] = True
    if not scheme.inertia:  # an imbalance of the previous stage is released in the first step
        if old.motion.acceleration.norm() > 0.0:
            mean = np.where(is_held, mean, -0.5 * _static(ops, old))
        return {"dropped": _total(ops, change @ mean)}
    kinetic = kinetic_energy(ops, new.motion.velocity) - kinetic_energy(ops, old.motion.velocity)
    alphas = scheme.alphas
    if alphas is None:
        gained = 0.5 * (before.velocity + after.velocity) * _times(ops.mass, after.velocity - before.velocity)
        left = change * mean - gained
        scheme_part, given_part = float(left[~is_held].sum()), -float(left[is_held].sum())
        return {"kinetic": kinetic, "scheme": _total(ops, scheme_part), "work_boundaries": _total(ops, given_part)}
    # e = e_new a_new + e_old a of (4.2e,f)
    of_new, of_old = alphas.a1 / alphas.a0, alphas.a1 * alphas.a3 / alphas.a0 - alphas.a5
    e_new, e_old = 1.0 / alphas.a0 - 0.5 * dt * of_new, alphas.a3 / alphas.a0 - 0.5 * dt * of_old
    error = e_new * after.acceleration + e_old * before.acceleration
    gained, weighed = (after.velocity - before.velocity) / dt, 0.5 * (before.acceleration + after.acceleration)
    push, met = _times(ops.mass, gained), mean
    if alphas.looks_back:
        weighed = alphas.inertia * after.acceleration + alphas.inertia_old * before.acceleration
        weighed /= 1.0 + alphas.balance_old
        met = _times(ops.mass, weighed)
    each = change * (met - push) + error * push
    if alphas.looks_back:
        late = alphas.balance_old / (1.0 + alphas.balance_old)
        each += (0.5 - late) * change * (_static(ops, new) - _static(ops, old))
    shared = change * _times(ops.mass, np.where(is_held, weighed - gained, 0.0))
    shared += error * _times(ops.mass, np.where(is_held, gained, 0.0))
    each -= shared
    given = 0.5 * dt * (before.velocity + after.velocity) * push - change * mean
    return {
        "kinetic": kinetic,
        "scheme": _total(ops, float(each[~is_held].sum())),
        "work_boundaries": _total(ops, float(given[is_held].sum() - shared[~is_held].sum())),
    }


def term_parts(ops: Operators, old: State, new: State, dt: float) -> dict[str, float]:
    """Energy taken up by terms: mean force times motion. The work of their K is no strain energy. Collective."""
    before, after, parts = _local(old.motion.displacement), _local(new.motion.displacement), {"rock_strain": 0.0}
    for term in ops.terms:
        taken = brought = 0.0
        for state in (old, new):
            if term.name in state.forces.of_terms:
                taken += 0.5 * _total(ops, _local(state.forces.of_terms[term.name]) @ (after - before))
        brought = 0.5 * dt * (old.forces.powers.get(term.name, 0.0) + new.forces.powers.get(term.name, 0.0))
        if term.stiffness is not None:
            work = _total(ops, _times(term.stiffness, 0.5 * (before + after)) @ (after - before))
            taken, parts["rock_strain"] = taken + work, parts["rock_strain"] - work
        parts |= term.energy(taken, brought)
    return parts


def _static(ops: Operators, state: State) -> Floats:
    balance = static_balance_of(ops, state)
    local = balance.getArray().copy()
    balance.destroy()
    return local


def _times(matrix: PETSc.Mat, values: Floats) -> Floats:
    """A matrix of the solid unknowns times local ``values``. Collective."""
    vector = matrix.createVecRight()
    vector.setArray(values)
    result = product(matrix, vector)
    vector.destroy()
    return result


def _local(vector: PETSc.Vec) -> Floats:
    return vector.getArray(readonly=True)


def _total(ops: Operators, here: Any) -> float:
    return float(ops.layout.comm.allreduce(float(here)))
