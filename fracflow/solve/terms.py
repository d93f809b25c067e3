"""Terms of both balances at one instant, for the energy books."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from fracflow.model.balance import static_balance
from fracflow.model.state import Forces, Motion

if TYPE_CHECKING:
    from fracflow.solve.problem import StepProblem


def balance_terms(problem: StepProblem, motion: Motion) -> Forces:
    """Terms of both balances with the reactions of what is held. Collective."""
    ops = problem.operators
    absorbed = problem.absorption.force(motion.velocity)
    support = static_balance(
        ops, motion.displacement, problem.sections.traction, problem.pressure, problem.load, absorbed
    )
    ops.mass.multAdd(motion.acceleration, support, support)
    conduction, source = ops.layout.flow_vector(), problem.source.copy()
    if ops.flow is not None:
        assert problem.conduction is not None
        ops.flow.outflow(problem.conduction, conduction)
        drawn = ops.layout.flow_vector()
        ops.flow.squeeze.multTranspose(motion.velocity, drawn)
        drawn.axpy(1.0, conduction)
        if (uptake := problem.uptake()) is not None:
            drawn.axpy(1.0, uptake)
            uptake.destroy()
        for part in problem.loads.pressures:
            source.getArray()[part.numbers] = drawn.getArray()[part.numbers]
        drawn.destroy()
    held = np.zeros(ops.layout.solid_count, dtype=bool)
    held[problem.loads.held] = True
    support.getArray()[~held] = 0.0
    anchor = problem.absorption.anchor
    kept = None if anchor is None else anchor.copy()
    return Forces(problem.load.copy(), support, conduction, source, absorbed, kept, problem.absorption.incident)
