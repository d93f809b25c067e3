"""Where Newton's method begins in a step: as the walls moved before, where that saves iterations."""

from __future__ import annotations

import numpy as np

from fracflow._petsc import MPI
from fracflow.advance.slip_rate import creeps
from fracflow.mesh.data import Floats
from fracflow.model.setup import Model
from fracflow.model.state import State
from fracflow.solve.problem import Guess
from fracflow.solve.request import StepRequest, StepRule

LEFT = 0.5  # of what the laws allow in an iteration: a guess that goes further towards closure is none


def first_guess(model: Model, rule: StepRule, state: State, request: StepRequest) -> Guess | None:
    """This rank's motion (n,) in the step and pressures (m,) to begin from; None to begin from the state. Collective.

    With inertia walls go on at their velocities. Accelerations would not help: they jump where a section begins to slide. The
    statuses of all sections are those of the last step meanwhile, so that none slips because the guess overshot. Friction of
    rate and state grows with the logarithm of the rate. Without inertia Newton's method needs some iterations for each
    decade of it from rest; with it a guess breaks events.
    """
    if creeps(model):
        before = state.previous_step.velocity
        moves = None if rule.inertia or before is None else before.getArray(readonly=True) * request.length
    else:
        holds = model.scene.method.overshoot == "hold"
        moves = _at_its_speed(model, state, request.length) if rule.inertia and holds else None
    return None if moves is None else (moves, state.pressure.getArray().copy())


def _at_its_speed(model: Model, state: State, dt: float) -> Floats | None:
    """Velocities times a step, where no section would come near the end of its closure. Collective."""
    joints, sections, change = model.operators.joints, state.sections, state.motion.velocity.copy()
    change.scale(dt)
    moves: Floats = change.getArray().copy()
    allowed = joints.step_limit(sections.strain, joints.strain(change) / LEFT, sections)
    change.destroy()
    is_far = bool(np.isfinite(moves).all()) and allowed >= 1.0
    return moves if model.operators.layout.comm.allreduce(is_far, op=MPI.LAND) else None
