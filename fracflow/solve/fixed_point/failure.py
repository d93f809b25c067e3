"""Messages on cycles of (4.5) that do not converge: place, factor, number of cycles, remedy."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from fracflow.errors import MOST_NAMED, NotConverged
from fracflow.model.network_parts import NetworkComponents, conducting
from fracflow.scene.scene import Scene
from fracflow.solve.fixed_point.contraction import Cycle, Prediction, limits_of_time_step, scaled
from fracflow.solve.fixed_point.relaxation import RELAXATIONS
from fracflow.solve.jacobian import JoinedMatrix
from fracflow.solve.problem import StepProblem

LOOK_BACK = 5  # ratios of changes whose mean is the rate of relaxed cycles


def measured_factor(changes: list[float]) -> float:
    """The last ratio of successive changes; NaN where there is none."""
    ratios = [new / old for old, new in pairwise(changes) if old > 0.0]
    return ratios[-1] if ratios else np.nan


def cycles_needed(changes: list[float], left: float) -> int | None:
    """Cycles until what is ``left``, 1 where a test is met, is gone as fast as the last changes fell; None if they do not.

    One ratio says little of relaxed cycles: the mean of the last ones is taken.
    """
    last = changes[-LOOK_BACK - 1 :]
    if len(last) < 2 or not 0.0 < last[-1] < last[0] or not 1.0 < left < math.inf:
        return None
    rate = math.log(last[0] / last[-1]) / (len(last) - 1)
    return len(changes) + math.ceil(math.log(left) / rate)


def describe_divergence(
    scene: Scene,
    problem: StepProblem,
    matrix: JoinedMatrix,
    prediction: Prediction,
    changes: list[float],
    left: float,
    stop: str,
) -> str:
    """Why the cycles did not converge, and what to change; the trial is at the start of the step. Collective.

    changes  largest change of a pressure in each cycle
    left     how many times too large what is tested was in the end; NaN where it was not tested
    stop     what else ended them, or nothing
    """
    name, unit = scene.method.fixed_point, scene.unit_system.time
    time = f"time {problem.time:.6g} {unit}".rstrip()
    at = f'{time}: coupling = "fixed-point" ({name})'
    others = [f'"{other}"' for other in RELAXATIONS if other not in ("plain", name)]
    remedy = 'set method.coupling = "monolithic", or method.on_divergence = "monolithic"'
    if not np.isfinite(prediction.own):
        return (
            f"{at} cannot work here: no pressure is prescribed in {_sealed(problem) or prediction.fracture}, so the flow has"
            f' no solution while the walls are held: {remedy}, or method.fixed_point = "added-storage", or give a [[well]]'
            " with a pressure there"
        )
    measured = measured_factor(changes)
    ratio = f"{measured:.3g} measured" if np.isfinite(measured) else "none measured"
    what = f"the error of the pressures is multiplied by {prediction.own:.3g} a cycle (predicted; {ratio})"
    what += f", most in {prediction.fracture}"
    if name == "plain" and (prediction.factor >= 1.0 or measured > 1.0):
        limits = _time_steps(problem, matrix, prediction.factor, unit)
        return (
            f"{at} diverges: {what}; it must be below 1{limits}: {remedy}, or method.fixed_point = {' or '.join(others)}"
            + (f" ({stop})" if stop else "")
        )
    what = f"{at} did not converge in {len(changes)} cycles: {what}"
    if stop:
        return f"{what} ({stop}): {remedy}"
    needed = cycles_needed(changes, left)
    if needed is None:
        return f"{what}, and the changes no longer fall: {remedy}"
    return f"{what}: set accuracy.max_cycles = {needed}, which it needs at the rate of the last cycles, or {remedy}"


def _sealed(problem: StepProblem) -> str:
    """The parts of the network in which no pressure is prescribed, with all their fractures. Collective."""
    assert problem.conduction is not None
    operators, given = problem.operators, np.zeros(problem.operators.layout.flow_count, dtype=bool)
    given[problem.loads.given_pressures] = True
    parts = NetworkComponents(operators, conducting(operators, problem.conduction.conductance))
    shut, count = parts.listed(~parts.any_of(given), MOST_NAMED)
    named = parts.named(shut)
    parts.destroy()
    more = f" and {count - MOST_NAMED} more parts" if count > MOST_NAMED else ""
    return "; ".join(map(str, named)) + more


def _time_steps(problem: StepProblem, matrix: JoinedMatrix, factor: float, unit: str) -> str:
    """Between which time steps plain cycles diverge, as text. Collective."""
    dt = problem.time - problem.state.time
    if problem.alphas.a1 == 0.0 or not factor > 1.0 or not dt > 0.0:
        return ", and in a stage without storage no time_step makes it so" if problem.alphas.a1 == 0.0 else ""

    def radius(step: float) -> float:
        cycle = Cycle(matrix, problem, scaled(problem.alphas, step / dt))
        try:
            return cycle.radius()[0]
        except NotConverged:  # walls that cannot be solved for say nothing of a limit
            return np.inf
        finally:
            cycle.destroy()

    below, above = limits_of_time_step(radius, factor, dt)
    limits = [f"{sign} {step:.2g} {unit}".rstrip() for sign, step in (("<", below), (">", above)) if step is not None]
    if not limits:
        return ", which no time_step makes it"
    return f", as for a time_step {' or '.join(limits)}" + (", not for a smaller one" if below is None else "")
