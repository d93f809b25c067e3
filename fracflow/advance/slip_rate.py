"""Steps by the rate of slip, where friction has a state: none may slip far beside the slip of its evolution.

A step is V dt <= xi L long, V of each section and L = D_c, or less by the slip law (``JointLaw.state_length``). As slip
slows down that alone would let each step be twice the last one. Then V falls by the same factor in each, whatever xi: an
error of first order. So without inertia (V dt/L) (ln V/V_old)^2 <= xi^3 as well. With inertia steps are never longer than
the scene's, and rates ring: the first bound alone holds, where ``accuracy.dynamic_slip_share`` asks for it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fracflow._petsc import MPI
from fracflow.advance.outcome import Advance, Outcome
from fracflow.integrators import Stepper
from fracflow.model.setup import Model
from fracflow.model.state import State
from fracflow.solve.request import StepRequest

MOST_HALVINGS = 44  # halvings of a step: one of a century is a fifth of a millisecond then
BENDS = 24.0  # a rate that changes by ln r within a step leaves an error of slip of (ln r)^2 over that
LEAST = 1e-3  # of the largest slip of a step: what slips less has no error that counts


def creeps(model: Model) -> bool:
    """Whether the friction of any fracture has a state that slip changes."""
    return any(group.law.creeps for group in model.operators.joints.laws)


def follows_slip(model: Model, stepper: Stepper) -> bool:
    """Whether the slip of a step by a rule bounds its length."""
    return creeps(model) and not (stepper.inertia and model.scene.accuracy.dynamic_slip_share is None)


def slip_of_states(model: Model, old: State, new: State, inertia: bool = False) -> float:
    """Largest slip of a step, or its error's root, over those of ``accuracy.slip_share``; over the tolerance's. Collective.

    accuracy.tolerance  also bounds the error of the slip of each step, over that slip
    inertia             the share is ``accuracy.dynamic_slip_share``; how the rate changes does not count
    """
    joints, asked = model.operators.joints, model.scene.accuracy
    share = (asked.dynamic_slip_share or np.inf) if inertia else asked.slip_share
    far = np.linalg.norm((new.sections.inelastic - old.sections.inelastic)[:, :-1], axis=1)
    over, error, most = 0.0, 0.0, model.operators.layout.comm.allreduce(float(far.max(initial=0.0)), op=MPI.MAX)
    groups = zip(joints.laws, old.sections.history, new.sections.history, strict=True)
    for group, before, after in ((g, b, a) for g, b, a in groups if g.law.creeps and len(g.sections)):
        slip = far[group.sections]
        rates = (np.maximum(group.law.slip_rate(each), np.finfo(float).tiny) for each in (before, after))
        evolved, bend = slip / group.law.state_length(after), np.diff(np.log(list(rates)), axis=0)[0] * (not inertia)
        over = max(over, float(np.maximum(evolved, np.cbrt(evolved * bend**2)).max()) / share)
        if asked.tolerance is None or most == 0.0:
            continue
        counts = np.where(slip > LEAST * most, slip / most, 0.0)
        error = max(error, float((counts * bend**2).max()) / BENDS / asked.tolerance)
    return float(model.operators.layout.comm.allreduce(max(over, np.sqrt(error)), op=MPI.MAX))


def longest_step(model: Model, state: State) -> float:
    """Time in which no section slips farther than a step may, at its present rate; inf where none creeps. Collective."""
    shortest = np.inf
    for group, past in zip(model.operators.joints.laws, state.sections.history, strict=True):
        if group.law.creeps and len(group.sections):
            rate = np.maximum(group.law.slip_rate(past), np.finfo(float).tiny)
            shortest = min(shortest, float((group.law.state_length(past) / rate).min()))
    return float(model.operators.layout.comm.allreduce(shortest, op=MPI.MIN)) * model.scene.accuracy.slip_share


@dataclass(frozen=True)
class BySlipRate:
    """Adds the slip of a substep, over that allowed, to its outcome, as if it were an error."""

    inner: Advance
    model: Model
    inertia: bool = False

    def advance(self, state: State, request: StepRequest) -> Outcome:
        """The same. Raises SolveError, on every rank. Collective."""
        found = self.inner.advance(state, request)
        slip = slip_of_states(self.model, state, found.state, self.inertia)
        return replace(found, error=max(found.error, slip))
