"""Inertia where loads are slow: a stage dynamic is then run as a stage auto, which has inertia only while something fails.

A load whose rate changes at once by r sets a mode of period T swinging by r T/(2 pi) about the quasi-static response
(Biggs 1964, 2.3). For a ramp that takes T_load, with a kink at each end, this is at most T/(pi T_load) of the effect of
the load. Many small changes in time with a mode add up, for as long as they last.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import isfinite, pi

import numpy as np

from fracflow.integrators import EXPLICIT
from fracflow.reduction.decision import Decision, ReductionInput
from fracflow.scene.boundary import Stage
from fracflow.scene.quantities import probed
from fracflow.scene.scene import Scene
from fracflow.scene.time_table import TimeTable

FEWER = 10.0  # times fewer steps, at least: each costs about as much as one with inertia, and all may have been in vain
PART = "inertia"
CRITERION = "T sum(changes of load rate)/(2 pi range), T the longest period, joints sticking"


def kink_response(table: TimeTable, start: float, end: float, period: float) -> float:
    """Sum of all changes of rate, times the period over 2 pi times the range of the table [1].

    Nothing damps a mode, and no two changes are sure not to add up. Between two instants, before the first of which nothing
    moves; a table without jumps there.
    """
    times = np.array(table.times)
    inside = times[(times > start) & (times < end)]
    at = np.concatenate([[start], inside, [end]])
    values = table.around(at, 0.0, 0.0)
    size = float(np.ptp(values))
    if size == 0.0:
        return 0.0
    return float(np.abs(np.diff(np.diff(values) / np.diff(at), prepend=0.0)).sum()) * period / (2.0 * pi * size)


def spans(scene: Scene) -> Iterator[tuple[int, Stage, float, float]]:
    """Number, stage, start and end of all stages that the scene bounds in time."""
    start = 0.0
    for number, stage in enumerate(scene.stage):
        if not stage.takes_no_time and stage.step_count(start) is None:
            return
        end = start if stage.takes_no_time else stage.finish(start)
        yield number, stage, start, end
        start = end


def why_not(scene: Scene, number: int, start: float, end: float) -> str:
    """Why a dynamic stage has inertia whatever its loads' rates are; empty where they decide."""
    earlier = scene.stage[:number]
    if scene.method.stepper in EXPLICIT:
        return f'method.stepper = "{scene.method.stepper}"'
    if scene.control:
        return "a [control] raises loads at once"
    if scene.initial is not None or scene.carries_unbalanced:
        return "a start that is not at rest"
    if any(stage.kind == "dynamic" for stage in earlier):
        return "the stage before has inertia"
    if scene.creeps:
        return "a fracture that creeps, where steps follow the rate of slip"
    rates = {name for name, row in probed().items() if row.is_rate}
    for probe in scene.probe:
        if asked := sorted(rates.intersection(probe.quantities or rates)):
            own = "of which vibration is all (its quantities may leave that out)"
            return f"probe {probe.name} measures {asked[0]}, {own}"
    for term in scene.terms:
        if term.moving:
            return term.moving
    if any(start <= time <= end for time in scene.jump_times):
        return "something prescribed jumps"
    pumped = [well.flow_rate for well in scene.well if well.flow_rate is not None]
    if scene.has_flow and number == 0 and any(rate(start) != 0.0 for rate in pumped):
        return "a well begins at once"
    return ""


def asks_period(scene: Scene) -> bool:
    """Whether the longest period is of use."""
    return any(stage.kind == "dynamic" and not why_not(scene, n, start, end) for n, stage, start, end in spans(scene))


def _kicks(facts: ReductionInput, start: float, end: float) -> float:
    return max((kink_response(table, start, end, facts.period) for table in facts.scene.time_tables), default=0.0)


def longest_step(facts: ReductionInput, value: float, start: float, end: float) -> float:
    """Step without inertia: the tolerance's share of the shortest ramp, twice that without flow, which takes time."""
    ramp = facts.period / (pi * value) if value > 0.0 else end - start
    return min(ramp, end - start) * facts.tolerance * (1.0 if facts.scene.has_flow else 2.0)


def decide_stage(facts: ReductionInput, number: int, stage: Stage, start: float, end: float) -> Decision:
    """Whether a dynamic stage goes without inertia until something fails."""
    label = f"{number} ({stage.title})"
    limit, error = facts.tolerance, "the vibration that slow loads set off, relative to what they do"

    def kept(why: str, value: float | str, criterion: str = CRITERION) -> Decision:
        return Decision(PART, False, criterion, value, limit, error, f"nothing: {why}", label)

    if not facts.leaves_out:
        return kept(f'model = "{facts.scene.model}" leaves nothing out', "not asked")
    at_once = f"{facts.unrest:.3g} of the loads come at once" if facts.unrest > limit else ""
    if why := why_not(facts.scene, number, start, end) or at_once:
        return kept("inertia is what moves it", why, "slow loads, and no jump")
    if not isfinite(facts.period):
        return kept("inertia is what holds it", "no longest period: something floats")
    value = _kicks(facts, start, end)
    if value == 0.0:
        return kept("no load changes, so that whatever moves was there at the start", value)
    if value >= limit:
        return kept("the loads are not slow", value)
    fewer = longest_step(facts, value, start, end) / (stage.time_step or 1.0)
    if fewer < FEWER:
        return kept(f"steps without inertia would be only {fewer:.3g} times longer", value)
    return Decision(PART, True, CRITERION, value, limit, error, f"steps up to {fewer:.3g} times longer", label)


def decide_inertia(facts: ReductionInput) -> Iterator[Decision]:
    """One decision for each dynamic stage, or one for a scene that has none."""
    found = [span for span in spans(facts.scene) if span[1].kind == "dynamic"]
    for number, stage, start, end in found:
        yield decide_stage(facts, number, stage, start, end)
    if not found:
        kinds = ", ".join(sorted({stage.kind for stage in facts.scene.stage}))
        yield Decision(
            PART, not facts.scene.has_dynamics, "a dynamic stage in the scene", f"stages {kinds}", "dynamic, auto",
            "slip in stages without inertia is that of a slow process: up to half of the dynamic one",
            "what the scene does not ask for",
        )  # fmt: skip


def key_of(number: int, stage: Stage) -> str:
    """The name of the decision on a stage where it is undone."""
    return f"{PART}, {number} ({stage.title})"


def slow_stages(facts: ReductionInput) -> dict[int, Stage]:
    """Number -> the stage auto that takes the place of a dynamic one, where that was not undone."""
    found = {}
    for number, stage, start, end in spans(facts.scene) if facts.leaves_out else ():
        if stage.kind != "dynamic" or key_of(number, stage) in facts.undone:
            continue
        decision = decide_stage(facts, number, stage, start, end)
        if decision.left_out and isinstance(decision.value, float):
            step = longest_step(facts, decision.value, start, end)
            times = {"end": end, "time_step": step, "dynamic_time_step": stage.time_step}
            found[number] = stage.model_copy(update={"kind": "auto", "steps": None, "name": stage.title, **times})
    return found


def reduced(facts: ReductionInput) -> Scene:
    """The scene that is run: what the plan leaves out is not in it."""
    slow = slow_stages(facts)
    stages = tuple(slow.get(number, stage) for number, stage in enumerate(facts.scene.stage))
    return facts.scene.model_copy(update={"stage": stages}) if slow else facts.scene
