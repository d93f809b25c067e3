"""What to tell whose step did not converge: where, what was tried, what to change."""

from __future__ import annotations

import numpy as np

from fracflow._petsc import PETSc
from fracflow.coupling.newton_methods import NEWTON_METHODS
from fracflow.coupling.step_problem import StepProblem
from fracflow.laws.base import Bools
from fracflow.mesh.blocks import Blocks
from fracflow.scene import Scene


def describe_failure(scene: Scene, problem: StepProblem, restless: Bools, reason: int, iterations: int) -> str:
    """The message of a SolveError, the same on every rank; ``restless`` (s,) changed status last. Collective."""
    blocks, accuracy, name = problem.operators.blocks, scene.accuracy, scene.method.newton
    weakness, start = NEWTON_METHODS[name].weakness, problem.state.sections
    slipped = fractures_of(blocks, start.is_sliding | start.inelastic.any(axis=1)) if weakness else ""
    changing = fractures_of(blocks, restless) if not slipped else ""
    what = "Newton" if name == "newton" else f'method.newton = "{name}"'
    remedy = "try a smaller time_step" if name == "newton" else 'set method.newton = "newton"'
    if not slipped:
        remedy += ", or raise accuracy.max_iterations"
    where = f"sections of {changing} keep changing between sticking and sliding; " if changing else ""
    where += f"{weakness} (slipped before: {slipped}); " if slipped else ""
    reasons = {v: k for k, v in vars(PETSc.SNES.ConvergedReason).items() if isinstance(v, int)}
    reason = PETSc.SNES.ConvergedReason.DIVERGED_FNORM_NAN if not np.isfinite(problem.residual.solid) else reason
    wanted = f"relative residual of the solid {problem.residual.solid:.2e}, of the flow {problem.residual.flow:.2e}"
    wanted += f", wanted {accuracy.residual:.0e}"
    if scene.method.newton_test == "out-of-balance" and accuracy.out_of_balance is not None:
        wanted = f"out-of-balance force {problem.residual.out_of_balance:.2e}, wanted {accuracy.out_of_balance:.0e}"
    return (
        f"time {problem.time:.6g}: {what} did not converge in {iterations} iterations"
        f" ({reasons.get(reason, reason)}): {where}{wanted}; {remedy}"
    )


def fractures_of(blocks: Blocks, chosen: Bools) -> str:
    """Names, over all ranks, of the fractures that have one of the chosen sections (s,). Collective."""
    points = max(1, len(chosen) // max(1, len(blocks.joints.ids)))
    here = {blocks.joints.fractures[f] for f in blocks.joints.fracture[np.flatnonzero(chosen) // points]}
    return ", ".join(sorted(set().union(*blocks.comm.allgather(here))))
