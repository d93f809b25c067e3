"""How accurate a step is, estimated from its two ends."""

from __future__ import annotations

import numpy as np

from fracflow._petsc import MPI
from fracflow.assembly.operators import Operators
from fracflow.state import State
from fracflow.stepping import Stepper

LEAST = 1e-6  # of the natural displacement: smaller motions need no accuracy


def step_error(operators: Operators, stepper: Stepper, dt: float, old: State, new: State) -> float:
    """Largest local error of displacement over a step, relative to the largest displacement at its end. Collective.

    dt  length of the step, or of the equal parts that it is taken in, whose errors add up
    """
    wrong = stepper.local_error(dt, old.motion.values(), new.motion.values())
    moved = new.motion.displacement.getArray(readonly=True)
    here = np.array([np.abs(wrong).max(initial=0.0), np.abs(moved).max(initial=0.0)])
    largest = np.empty(2)
    operators.layout.comm.Allreduce(here, largest, op=MPI.MAX)
    return float(largest[0] / max(largest[1], LEAST * operators.scales.displacement))
