"""Wells that change from a flow rate to a limit of their pressure, and back."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NoReturn

from fracflow._petsc import MPI, PETSc
from fracflow.errors import NotConverged
from fracflow.model.loads import Limit, Loads
from fracflow.model.state import State
from fracflow.model.well_volumes import WellStep
from fracflow.scene.time_table import Rates
from fracflow.solve.request import StepRequest, StepRule

CLOSE = 1e-9  # of a limit: a pressure so near to it is at it


def reached_before(loads: Loads, state: State) -> frozenset[Limit]:
    """Limits that wells were kept at when a state was accepted; of two of one well the one its pressure is nearer to."""
    found: dict[str, tuple[float, Limit]] = {}
    for limit in loads.limits:
        away = abs(at_node(limit, state.pressure) - limit.pressure)
        if limit.well in state.wells_at_limit and away <= found.get(limit.well, (math.inf, limit))[0]:
            found[limit.well] = (away, limit)
    return frozenset(limit for _, limit in found.values())


def reached_after(
    request: StepRequest, rule: StepRule, reached: frozenset[Limit], trial: State, depth: float
) -> frozenset[Limit]:
    """Limits at which wells have to be kept once a trial of a step is known. Collective.

    A well reaches a limit when its pressure passes it. It leaves the limit when more flows there than its flow_rate.
    """
    now = set(reached)
    for limit in request.loads.limits:
        pressure = at_node(limit, trial.pressure)
        if limit in reached:
            through = at_node(limit, trial.forces.source) * depth
            asked = rule.demanded(request, limit.well)
            if limit.sign * (through - asked) > CLOSE * abs(asked):
                now.discard(limit)
        elif limit.sign * (pressure - limit.pressure) > CLOSE * abs(limit.pressure):
            now = {other for other in now if other.well != limit.well} | {limit}
    return frozenset(now)


def through(
    request: StepRequest, rule: StepRule, reached: frozenset[Limit], old: State, new: State, depth: float
) -> dict[str, float]:
    """Mean flow rate, over a step, of each well that has a limit, as a multistep rule takes it.

    Collective. A rate q at the end is alpha_1 dt times that mean less alpha_6 times the one before, as are the walls'
    velocities. For a well that the loads of the request keep at a limit, q is the flow at the limit less that of other wells
    there. Otherwise it is the demanded rate.
    """
    loads, alphas = request.loads, rule.alphas
    kept, before = {limit.well: limit for limit in reached}, old.previous_step.through
    found: dict[str, float] = {}
    for name in sorted({limit.well for limit in loads.limits}):
        if alphas.a6 > 0.0 and name not in before:
            continue
        if name in kept:
            limit = kept[name]
            rate = at_node(limit, new.forces.source) * depth
            others = ((each.vector, str(each.well)) for each in loads.wells)
            rate -= sum(at_node(limit, vector) * depth * rule.demanded(request, well) for vector, well in others)
        else:
            rate = rule.demanded(request, name)
        found[name] = (rate + alphas.a6 * before.get(name, 0.0)) / (alphas.a1 * request.length)
    return found


def well_step(
    request: StepRequest, rule: StepRule, means: Mapping[str, float], begin: float, stores: bool, depth: float
) -> WellStep:
    """Wells in a step from ``begin``, with the ``means`` that a multistep rule takes of those with limits [volume rate]."""
    loads, names = request.loads, [str(each.well) for each in request.loads.wells]
    demanded = {name: rule.demanded(request, name) for name in names}
    whole, tabled = Rates(now=1.0, share=0.0, begin=begin), demanded
    if stores and request.length > 0.0:
        tabled = {name: loads.demanded(name, request.time, request.controls, rates=whole) for name in names}
    return WellStep(loads, rule.alphas, demanded, tabled, means, depth)


def refuse_cycle(reached: frozenset[Limit], time: float, newton: int) -> NoReturn:
    """Raise NotConverged naming the wells that cycle between rate and limit, after so many iterations."""
    names = ", ".join(sorted({limit.well for limit in reached})) or "none"
    raise NotConverged(
        f"time {time:.6g}: wells keep changing between their flow_rate and a limit of their pressure (now at a limit:"
        f" {names}): move their limits apart, or take a smaller time_step",
        newton,
        kind="wells",
    )


def at_node(limit: Limit, vector: PETSc.Vec) -> float:
    """The value of a vector of the flow at the node of a limit. Collective."""
    here = float(vector.getArray(readonly=True)[limit.local].sum())
    return float(vector.getComm().tompi4py().allreduce(here, op=MPI.SUM))
