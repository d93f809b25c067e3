"""All that can go wrong before the first step, and how large the problem is."""

from __future__ import annotations

import math
from typing import Any

from fracflow._petsc import MPI
from fracflow.begin.planned import planned, seconds_of_factors
from fracflow.begin.regimes import foretold
from fracflow.begin.setup import Model, prepare
from fracflow.begin.start import settle
from fracflow.card import Number, scene_card
from fracflow.coupling.condensed_cost import BESIDES, ENTRIES, ITERATIONS, break_even, fits
from fracflow.mesh.split import summary
from fracflow.plan import Decision, decide
from fracflow.scene import Scene

PROGRAM, NUMBER = 1.5e8, 8.0  # bytes of the program with its libraries, and of a number
MATRICES = 150.0  # numbers an unknown in matrices and vectors
OWN = 6e-3  # seconds an iteration takes besides: joint laws, balances, and what they are called by


def set_up(scene: Scene) -> tuple[dict[str, Any], list[str], list[Number], list[Decision]]:
    """Set a scene up as a run does, on one rank: its sizes and cost, what was moved to fit, its card and its plan.

    InputError where it cannot be run.
    """
    model = prepare(scene, MPI.COMM_SELF)
    settle(model)
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
    if sections and fits(unknowns, sections) and pays < math.inf:
        found["steps from which a condensed rock pays"] = pays
    card, notes = scene_card(scene, model.mesh, model.placed.wells), [*model.mesh.notes, *model.placed.notes]
    model = planned(model)
    assert model.facts is not None
    found |= _cost(model, steps, any(stage.kind == "auto" or stage.until for stage in scene.stage))
    return found, notes, card, decide(model.facts.with_card(card))


def _cost(model: Model, steps: int, more: bool) -> dict[str, str]:
    """Memory and time of so many steps, by what factors of so many unknowns take; one factorisation is made and timed.

    more  events or a search make steps besides
    """
    unknowns = sum(
        int(starts[-1]) for starts in (model.operators.layout.solid_starts, model.operators.layout.flow_starts)
    )
    memory = PROGRAM + NUMBER * (MATRICES * unknowns + ENTRIES * unknowns * math.log2(max(unknowns, 2)))
    lasted = seconds_of_factors(model.operators)
    each = lasted * (1.0 + BESIDES) + OWN
    seconds = steps * ITERATIONS * each
    return {
        "memory, about": f"{memory / 1e9:.2g} GB",
        f"time of the steps planned, at most about{', without those of events and searches' if more else ''}": (
            f"{seconds:.2g} CPU s: {ITERATIONS} iterations a step, each with a factorisation, and one took {lasted:.2g} s here"
        ),
        **foretold(model, each, ITERATIONS),
    }
