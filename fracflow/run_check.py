"""All that can go wrong before the first step, and how large the problem is."""

from __future__ import annotations

import math
from typing import Any

from fracflow._petsc import MPI
from fracflow.card import Number, scene_card
from fracflow.coupling.condensed_cost import break_even, fits
from fracflow.mesh.split import summary
from fracflow.run_setup import prepare
from fracflow.run_start import settle
from fracflow.scene import Scene


def set_up(scene: Scene) -> tuple[dict[str, Any], list[str], list[Number]]:
    """Set a scene up as a run does, on one rank: its sizes, what was moved to fit, and its card.

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
    return found, [*model.mesh.notes, *model.placed.notes], scene_card(scene, model.mesh, model.placed.wells)
