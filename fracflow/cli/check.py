"""All that can go wrong before the first step, and how large the problem is."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from fracflow._petsc import MPI
from fracflow.advance.explicit import explicit_cost
from fracflow.advance.initial_state import equilibrium_state, refuse_imbalance
from fracflow.advance.regime import wave_step
from fracflow.advance.slow_slip import SHARE
from fracflow.diagnostics import Number, pre_run_checks
from fracflow.errors import SolveError
from fracflow.mesh.read import network_of
from fracflow.mesh.split import summary
from fracflow.model.network_parts import parts_with_wells
from fracflow.model.setup import Model, geometry_of
from fracflow.reduction import Decision, decide
from fracflow.reduction.apply import planned, seconds_of_factors
from fracflow.reduction.prepare import prepare
from fracflow.scene.scene import Scene
from fracflow.solve.condensed_cost import BESIDES, ENTRIES, ITERATIONS, break_even, fits
from fracflow.solve.condensed_cost import planned as solved
from fracflow.solve.newton import BRIEF

PROGRAM, NUMBER = 1.5e8, 8.0  # bytes of the program with its libraries, and of a number
MATRICES = 150.0  # numbers an unknown in matrices and vectors
LONGER = 3  # steps without inertia before a stage auto makes them twice as long
OWN = 6e-3  # seconds an iteration takes besides: joint laws, balances, and what they are called by


@dataclass(frozen=True)
class NetworkCheck:
    """Traces that meet and traces that do not, for JSON.

    snap         what is nearer is one [length]; None of a mesh file
    near_misses  records of what all but meets
    well_parts   records of the parts of the network that have wells
    """

    snap: float | None
    near_misses: list[dict[str, object]]
    well_parts: list[dict[str, object]]


def set_up(scene: Scene) -> tuple[dict[str, Any], list[str], list[Number], list[Decision], NetworkCheck]:
    """Set a scene up as a run does, on one rank: sizes and cost, what was moved to fit, card, plan and network.

    InputError where it cannot be run.
    """
    model = prepare(scene, MPI.COMM_SELF)
    refuse_imbalance(model)
    assert model.mesh is not None
    layout, start, steps = model.operators.layout, 0.0, 0
    for stage in scene.stage:
        count = stage.step_count(start) or 0
        steps, start = steps + count, stage.finish(start)
    found = {
        **summary(model.mesh),
        "displacement unknowns": int(layout.solid_starts[-1]) - len(model.operators.blocks.solid.unused),
        "pressure unknowns": int(layout.flow_starts[-1]),
        "steps": steps,
    }
    sections = len(model.operators.joints.weights) * model.operators.joints.dim
    unknowns = int(layout.solid_starts[-1])
    pays = break_even(unknowns, sections)
    if sections and fits(unknowns, sections) and pays < math.inf and next(solved(model.scene), None) is not None:
        found["steps from which a condensed rock pays"] = pays
    card, notes = pre_run_checks(scene, model.mesh, model.placed.wells), [*model.mesh.notes, *model.placed.notes]
    network = _network(model)
    model, facts = planned(model)
    found |= _cost(model, steps, any(stage.kind == "auto" or stage.until for stage in scene.stage))
    return found, notes, card, decide(facts.with_card(card)), network


def _network(model: Model) -> NetworkCheck:
    assert model.mesh is not None
    parts = [part.as_record() for part in parts_with_wells(model.mesh, model.placed.wells)]
    if model.scene.geometry is None or not model.scene.geometry.fracture:
        return NetworkCheck(None, [], parts)
    _, snap, misses = network_of(geometry_of(model.scene))
    return NetworkCheck(snap, [miss.as_record() for miss in misses], parts)


def _cost(model: Model, steps: int, more: bool) -> dict[str, str]:
    """Memory and time of so many steps, by what factors of so many unknowns take; one factorisation is made and timed.

    Explicit steps have none: they take products with the rock's stiffness, which are timed likewise.

    more  events or a search make steps besides
    """
    unknowns = sum(
        int(starts[-1]) for starts in (model.operators.layout.solid_starts, model.operators.layout.flow_starts)
    )
    explicit = explicit_cost(model)
    steps -= explicit.steps if explicit is not None else 0
    solves = steps > 0 or more
    factors = ENTRIES * unknowns * math.log2(max(unknowns, 2)) if solves else 0.0
    memory = PROGRAM + NUMBER * (MATRICES * unknowns + factors)
    found, parts, seconds = {"memory, about": f"{memory / 1e9:.2g} GB"}, [], 0.0
    if explicit is not None:
        found["explicit steps"] = explicit.line
        part = explicit.seconds + OWN
        seconds += explicit.parts * part
        parts.append(f"{explicit.parts} explicit parts of about {part:.2g} s")
    if solves:
        lasted = seconds_of_factors(model.operators)
        each = lasted * (1.0 + BESIDES) + OWN
        seconds += steps * ITERATIONS * each
        found |= _cost_of_events(model, each, ITERATIONS)
        parts.append(f"{ITERATIONS} iterations a step, each with a factorisation, and one took {lasted:.2g} s here")
    without = ", without those of events and searches" if more else ""
    found[f"time of the steps planned, at most about{without}"] = f"{seconds:.2g} CPU s: {'; '.join(parts)}"
    return found


def _cost_of_events(model: Model, iteration: float, iterations: int) -> dict[str, str]:
    """Time that events and slow slip of each stage auto take beside the steps planned, by the seconds of a Newton iteration.

    iterations  of a step
    The number of events is not known: the cost is that of one.
    """
    found = {}
    for stage in (stage for stage in model.scene.stage if stage.kind == "auto"):
        state = equilibrium_state(model)
        try:
            least, period = wave_step(model, state, stage)
        except SolveError:
            continue
        finally:
            state.destroy()
        longest = max(stage.time_step or 0.0, least)
        trials = math.ceil(math.log2(longest / least))
        waves = math.ceil(max(1.0, stage.rest_periods) * period / least)
        after = LONGER * math.ceil(math.log2(max(longest / period, 1.0)))
        seconds = iteration * (trials * BRIEF + (waves + after) * iterations)
        found[f"each event in stage {stage.title}, about"] = (
            f"{trials} trials rejected before it, at least {waves} steps with inertia of {least:.3g}, {after} steps until"
            f" they are as long again: from {seconds:.2g} CPU s on"
        )
        if weakens := sum(1 for _ in _weakening(model)):
            steps = math.ceil(1.0 / SHARE) * weakens
            found[f"slow slip in stage {stage.title}, up to"] = (
                f"{steps} steps more, where {weakens} fractures weaken one after another, each over {1.0 / SHARE:.0f} steps:"
                f" {steps * iteration * iterations:.2g} CPU s, and half as many trials rejected"
            )
    return found


def _weakening(model: Model) -> Iterator[int]:
    """Fractures whose strength falls over a slip of some length."""
    joints, blocks = model.operators.joints, model.operators.blocks.joints
    pressed = np.maximum(-joints.initial[:, -1], 0.0)
    for number in range(len(blocks.fractures)):
        of_it = np.repeat(blocks.fracture == number, joints.points)
        for group in joints.laws:
            here = of_it[group.sections]
            lengths = group.law.slip_length(len(here))
            if np.any(here & (group.law.strength_drop(pressed[group.sections]) > 0.0) & (lengths > 0.0)):
                yield number
                break
