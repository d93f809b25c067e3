"""Stages auto: length of steps with inertia, most slip of a step without inertia, and cost of a change between them."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from fracflow._petsc import MPI
from fracflow.advance.initial_state import equilibrium_state
from fracflow.errors import SolveError
from fracflow.model.setup import Model
from fracflow.model.state import State
from fracflow.scene.boundary import Stage
from fracflow.scene.materials import Rock
from fracflow.solve.newton import BRIEF
from fracflow.solve.period import longest_period

SHARE = 0.1  # of the slip over which strength falls: no step without inertia may slip farther
PARTS = 50  # of the longest period, at least, in steps with inertia
LONGER = 3  # steps without inertia before they are twice as long


def wave_step(model: Model, state: State, stage: Stage) -> tuple[float, float]:
    """Length of a step with inertia, and the longest period of vibration [time].

    By default it is the time of a P wave through a typical joint, at most a share of the period. Raises SolveError where
    the duration of an event is unknown. Collective.
    """
    period = longest_period(model.operators, model.loads, state.sections)
    least = stage.dynamic_time_step or min(transit(model), period / PARTS)
    if not math.isfinite(least + period):
        raise SolveError(
            f"stage {stage.title}: nothing has mass and can move, so that there are no dynamics to change to"
        )
    return least, period


def transit(model: Model) -> float:
    """Time that a P wave takes through a joint of typical length; inf where no rock deforms, or without joints. Collective.

    The mean of the joints' lengths, weighted by themselves: one small cell does not determine the length of steps.
    """
    joints = model.operators.joints
    lengths = joints.weights.reshape(-1, joints.points).sum(axis=1)
    sums = np.array([lengths @ lengths, lengths.sum()])
    model.operators.layout.comm.Allreduce(MPI.IN_PLACE, sums, op=MPI.SUM)
    speed = max((_p_speed(rock) for rock in deforming(model)), default=0.0)
    return float(sums[0] / sums[1]) / speed if sums[1] > 0.0 and speed > 0.0 else math.inf


def deforming(model: Model) -> list[Rock]:
    """Rocks with mass that deform."""
    return [rock for rock in model.scene.rock.values() if not rock.rigid and rock.density]


def _p_speed(rock: Rock) -> float:
    """c_p [length/time]."""
    young, nu, density = rock.youngs_modulus or 0.0, rock.poissons_ratio or 0.0, rock.density or math.inf
    return math.sqrt(young * (1.0 - nu) / ((1.0 + nu) * (1.0 - 2.0 * nu)) / density)


def estimated_cost(model: Model, iteration: float, iterations: int) -> dict[str, str]:
    """Time that events and slow slip of each stage auto take beside the steps planned, by the seconds of a Newton iteration.

    iterations  of a step
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
