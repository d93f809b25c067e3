"""Wells with a limit of their pressure: they bring their flow rate, or what the limit lets in, or nothing.

A well with a rate q_0 > 0 and a highest pressure p_max brings a rate q at a pressure p:

    q = q_0 where p < p_max,  0 <= q <= q_0 where p = p_max,  q = 0 where p > p_max

One that draws at a lowest pressure is its mirror image. A rate of the other sign has nothing to do with the limit. A step is
repeated until the wells at their limits, and those that are shut, agree with its end.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any, NoReturn

from fracflow._petsc import MPI, PETSc
from fracflow.errors import NotConverged
from fracflow.model.loads import Limit, Loads
from fracflow.model.state import State
from fracflow.model.well_volumes import WellStep
from fracflow.scene.time_table import Rates
from fracflow.solve.request import StepRequest, StepRule
from fracflow.solve.sections import SectionProblem

MOST_TRIES = 4  # of a step whose wells reach limits, or whose elements pinch shut
TRIES_A_LIMIT = 6  # as many more for each limit: at its flow_rate, kept at the limit, shut, and back
CLOSE = 1e-9  # of a limit: a pressure so near to it is at it


def reached_before(loads: Loads, state: State) -> frozenset[Limit]:
    """Limits that wells were kept at, or shut by, when a state was accepted; of two of one well the nearer to its pressure."""
    found: dict[str, tuple[float, Limit]] = {}
    for limit in loads.limits:
        away, is_shut = abs(at_node(limit, state.pressure) - limit.pressure), limit.well in state.wells_shut
        if (is_shut or limit.well in state.wells_at_limit) and away <= found.get(limit.well, (math.inf, limit))[0]:
            found[limit.well] = (away, replace(limit, is_shut=is_shut))
    return frozenset(limit for _, limit in found.values())


def reached_after(
    problem: SectionProblem, request: StepRequest, reached: frozenset[Limit], trial: State, depth: float
) -> frozenset[Limit]:
    """Limits at which wells have to be kept, or shut, once a trial of a step is known. Collective.

    A well reaches a limit when its pressure passes it. There it goes back to its flow_rate when more would flow, and is shut
    when fluid would flow the other way. A shut well opens when the pressure comes back to the limit. Of wells at one node
    only the first to come to its limit is kept there. Where the scene gives the pressure of the node, none is.
    """
    rule, now = problem.rule, dict[int, Limit]()
    shut = list[Limit]()
    for limit in sorted(request.loads.limits, key=lambda limit: limit.sign * limit.pressure):
        if not rule.pushes(request, limit):
            continue
        closed = replace(limit, is_shut=True)
        beyond = limit.sign * (at_node(limit, trial.pressure) - limit.pressure)
        if limit in reached:
            asked, comm = rule.demanded(request, limit.well), trial.pressure.getComm().tompi4py()
            flows = limit.sign * _alone(problem.request, rule, limit, trial, depth)
            lost = depth * float(comm.allreduce(problem.undetermined(limit.local), op=MPI.SUM))
            if flows - limit.sign * asked > CLOSE * abs(asked):
                continue
            is_shut = flows - limit.sign * rule.shut(request, limit.well) < -lost
        elif closed in reached:
            is_shut = beyond >= -CLOSE * abs(limit.pressure)
        elif beyond > CLOSE * abs(limit.pressure):
            is_shut = limit.is_given
        else:
            continue
        if is_shut:
            shut.append(closed)
        elif not limit.is_given:
            now.setdefault(limit.node, limit)
    return frozenset([*now.values(), *shut])


def through(
    request: StepRequest, rule: StepRule, reached: frozenset[Limit], old: State, new: State, depth: float
) -> dict[str, float]:
    """Mean flow rate, over a step, of each well that has a limit, as a multistep rule takes it.

    Collective. A rate q at the end is alpha_1 dt times that mean less alpha_6 times the one before, as are the walls'
    velocities. For a well that the loads of the request keep at a limit, q is the flow at the limit less that of other wells
    there. Otherwise it is the demanded rate; the mean of a shut well is zero.
    """
    alphas, before = rule.alphas, old.previous_step.through
    loads, kept = request.loads, {limit.well: limit for limit in reached if not limit.is_shut}
    found: dict[str, float] = {}
    for name in sorted({limit.well for limit in loads.limits}):
        if alphas.a6 > 0.0 and name not in before:
            continue
        if name in kept:
            rate = _alone(request, rule, kept[name], new, depth)
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


def one_changed(before: frozenset[Limit], after: frozenset[Limit]) -> frozenset[Limit]:
    """The limits before, but those of the first well, by its name, that the limits after differ in.

    All changes at once may cycle. Where a higher pressure at a well never makes more flow into others, one at a time ends
    (Murty, 1974: the principal pivoting of least index).
    """
    well = min((limit.well for limit in before ^ after), default="")
    return frozenset(limit for limit in before if limit.well != well) | {each for each in after if each.well == well}


class Trials:
    """Trials of a step, until its wells at limits and the components of its network are those of its end.

    reached  limits that the next trial holds
    spent    iterations of all so far
    """

    def __init__(self, loads: Loads, state: State) -> None:
        """Begin with the limits of a state."""
        self.reached = reached_before(loads, state) if loads.limits else frozenset[Limit]()
        self.spent, self._most = 0, MOST_TRIES + TRIES_A_LIMIT * len(loads.limits)
        self._failed: NotConverged | None = None
        self._is_same, self._cycles, self._tried = False, False, {self.reached}

    def __iter__(self) -> Iterator[frozenset[Limit]]:
        """The limits of each trial, as many as there are at most."""
        for _ in range(self._most):
            yield self.reached

    def agrees(self, now: frozenset[Limit], is_same: bool, iterations: int) -> bool:
        """Whether a trial ends as it began: with the limits ``now`` of its end, and with its components, ``is_same``."""
        self.spent, self._is_same, self._failed = self.spent + iterations, is_same, None
        if is_same and now == self.reached:
            return True
        self._cycles = is_same and (self._cycles or now in self._tried)
        self.reached = one_changed(self.reached, now) if self._cycles else now
        self._tried.add(self.reached)
        return False

    def fails(self, error: NotConverged, iterations: int) -> None:
        """Count a trial that did not converge."""
        self.spent += iterations
        self._failed = error.after(self.spent)

    def refuse(self, time: float) -> NoReturn:
        """Raise NotConverged: there were too many."""
        if self._is_same and self._failed is None:
            refuse_cycle(self.reached, time, self.spent)
        refuse_outlets(time, self.spent, self._failed)


def refuse_cycle(reached: frozenset[Limit], time: float, newton: int) -> NoReturn:
    """Raise NotConverged naming the wells that cycle between rate, limit and shut, after so many iterations."""
    found = [sorted({limit.well for limit in reached if limit.is_shut == shut}) for shut in (False, True)]
    at_limit, shut = (", ".join(names) or "none" for names in found)
    raise NotConverged(
        f"time {time:.6g}: wells keep changing between flow_rate, limit and shut (now at a limit: {at_limit}; shut: {shut}):"
        " move their limits apart, or take a smaller time_step",
        newton,
        kind="wells",
    )


def names_of(reached: frozenset[Limit]) -> dict[str, Any]:
    """Members of a state whose wells are kept at limits, or shut by them."""
    kept, shut = (tuple(sorted(limit.well for limit in reached if limit.is_shut == each)) for each in (False, True))
    return {"wells_at_limit": kept, "wells_shut": shut}


def refuse_outlets(time: float, newton: int, last: Exception | None) -> NoReturn:
    """Raise NotConverged where outlets keep changing, after so many iterations; ``last`` error of a try, if it had one."""
    raise NotConverged(
        f"time {time:.6g}: elements keep pinching shut and opening again, which changes the outlets: take a"
        f" smaller time_step, or give minimum_hydraulic_aperture{f' (last: {last})' if last else ''}",
        newton,
        kind="outlets",
    )


def _alone(request: StepRequest, rule: StepRule, limit: Limit, state: State, depth: float) -> float:
    """Flow rate of a well at a limit, less those of other wells at its node, over the whole depth. Collective."""
    local, wells = limit.local, request.loads.wells
    here = float(state.forces.source.getArray(readonly=True)[local].sum()) * depth
    for each in wells:
        share = float(each.vector.getArray(readonly=True)[local].sum())
        here -= share * depth * rule.demanded(request, str(each.well)) if share else 0.0
    return float(state.pressure.getComm().tompi4py().allreduce(here, op=MPI.SUM))


def at_node(limit: Limit, vector: PETSc.Vec) -> float:
    """The value of a vector of the flow at the node of a limit. Collective."""
    here = float(vector.getArray(readonly=True)[limit.local].sum())
    return float(vector.getComm().tompi4py().allreduce(here, op=MPI.SUM))
