"""The cost of a stage auto beside the steps planned: an event, and slow slip."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from fracflow.advance.initial_state import equilibrium_state
from fracflow.advance.regime import wave_step
from fracflow.advance.slow_slip import SHARE
from fracflow.advance.substeps import CALM
from fracflow.errors import SolveError
from fracflow.model.setup import Model
from fracflow.solve.newton import BRIEF


def cost_of_events(model: Model, iteration: float, iterations: int, longest: float = 0.0) -> dict[str, str]:
    """Time that events and slow slip of each stage auto take beside the steps planned, by the seconds of a Newton iteration.

    iterations  of a step
    longest     period of vibration of the mesh that events get, where the rock has none [time]

    The number of events is not known: the cost is that of one. On one process.
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
        period = max(period, longest)
        usual = max(stage.time_step or 0.0, least)
        trials = math.ceil(math.log2(usual / least))
        waves = math.ceil(max(1.0, stage.rest_periods) * period / least)
        after = (CALM + 1) * math.ceil(math.log2(max(usual / period, 1.0)))
        seconds = iteration * (trials * BRIEF + (waves + after) * iterations)
        found[f"each event in stage {stage.title}, about"] = (
            f"{trials} trials rejected before it, at least {waves} steps with inertia of"
            f" {model.scene.time_text(least, 3)}, {after} steps until they are as long again: from {seconds:.2g} CPU s on"
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
