"""How accurate a step is, estimated from its two ends."""

from __future__ import annotations

import numpy as np

from fracflow._petsc import MPI, PETSc
from fracflow.assembly.operators import Operators
from fracflow.mesh.data import Floats
from fracflow.state import State
from fracflow.stepping import Stepper

LEAST = 1e-9  # of the length of a joint: smaller motions need no accuracy


def step_error(
    operators: Operators, stepper: Stepper, dt: float, old: State, new: State, largest: float = 0.0
) -> float:
    """Largest local error of a node's displacement over a step, relative to the largest displacement.

    dt       length of the step, or of the equal parts that it is taken in, whose errors add up [time]
    largest  that of earlier states [length]; by default the end of the step is all there is
    Both are lengths of vectors at nodes, those of rigid bodies too: they know neither axes nor units. Collective.
    """
    wrong = new.motion.displacement.duplicate()
    wrong.setArray(stepper.local_error(dt, old.motion.values(), new.motion.values()))
    error = _longest(operators, wrong)
    wrong.destroy()
    moved = max(largest, largest_displacement(operators, new))
    return error / max(moved, LEAST * operators.scales.length)


def largest_displacement(operators: Operators, state: State) -> float:
    """How far the node has moved that has moved the most [length]. Collective."""
    return _longest(operators, state.motion.displacement)


def _longest(operators: Operators, unknowns: PETSc.Vec) -> float:
    """Length of the longest of the nodes' vectors u = E q."""
    nodal = operators.nodal(unknowns)
    values: Floats = nodal.getArray(readonly=True).reshape(-1, operators.blocks.sizes.dim)
    here = float(np.linalg.norm(values, axis=1).max(initial=0.0))
    nodal.destroy()
    return operators.layout.comm.allreduce(here, op=MPI.MAX)
