"""Which steps of a scene are taken with the rock condensed, known from the scene alone: a run that is resumed does the same."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from fracflow.integrators import EXPLICIT, Alphas, stepper_from
from fracflow.scene.boundary import Stage
from fracflow.scene.checks import against_condensing
from fracflow.scene.scene import Scene
from fracflow.solve.condensed_cost import break_even, condensed_step, fits, full_step
from fracflow.solve.options import is_large, is_meant

Key = tuple[float, float]
"""What of a rule of stepping the rock's matrix depends on: shares of mass and damping."""
SMALLEST = 500  # displacements: of fewer a factorisation is the least of a step (report_5_5: 3.4 against 4.1 CPU s)
CLEARLY = (
    1.5  # times less work in a step: where it is nearly the same, each step that is solved anew for all unknowns tells
)
AT_LEAST = 2.0  # times the number of steps at which condensing the rock breaks even


@dataclass(frozen=True)
class Condensing:
    """Number of steps planned of each kind, infinite where events make them; from how many on condensing pays.

    has_events  stages may make steps of a kind that is known when they begin
    """

    steps: Mapping[Key, float]
    pays: float
    has_events: bool = False

    def is_worth(self, key: Key) -> bool:
        """Whether steps of a kind are so many that one may trust the estimate."""
        return self.pays < math.inf and self.steps.get(key, 0.0) >= AT_LEAST * self.pays

    @property
    def any_worth(self) -> bool:
        """Whether steps of any kind are, or may be."""
        return (self.has_events and self.pays < math.inf) or any(self.is_worth(key) for key in self.steps)


def key_of(alphas: Alphas, damps: bool) -> Key:
    """Of a rule; ``damps``: rates of displacement meet dashpots."""
    return float(f"{alphas.mass:.12g}"), float(f"{alphas.a1 * damps:.12g}")


def condensing(scene: Scene, unknowns: int, jumps: int, ranks: int, damps: bool) -> Condensing:
    """What is planned, for so many displacements and jumps of joints."""
    clearly = full_step(unknowns) >= CLEARLY * condensed_step(unknowns, jumps, ranks=ranks)
    pays = break_even(unknowns, jumps, ranks=ranks) if jumps and clearly and fits(unknowns, jumps) else math.inf
    steps: dict[Key, float] = {}
    for _, alphas, count in planned(scene):
        key = key_of(alphas, damps)
        steps[key] = steps.get(key, 0.0) + count
    return Condensing(steps, pays, any(stage.kind == "auto" for stage in scene.stage))


def is_chosen(scene: Scene, unknowns: int, plan: Condensing) -> bool:
    """Whether the program condenses the rock of its own accord: the scene lets it, its methods are fit, and it is worth it."""
    return _may_choose(scene, unknowns) and plan.any_worth and not (is_meant("monolithic") or is_meant("solid"))


def _may_choose(scene: Scene, unknowns: int) -> bool:
    method = scene.method
    suits = method.newton == "newton" and not any(against_condensing(scene))
    suits = suits and unknowns >= SMALLEST and not is_large(unknowns)
    return scene.model == "default" and method.coupling == "auto" and suits


def planned(scene: Scene) -> Iterator[tuple[Stage, Alphas, float]]:
    """Stages, the rule of their steps and the number of these, infinite where it is not known; no explicit ones."""
    time, name = 0.0, scene.method.stepper
    for stage in scene.stage:
        count = stage.step_count(time)
        time, number = stage.finish(time), math.inf if count is None else float(count)
        if stage.kind != "dynamic":
            yield stage, Alphas(), number
        elif stage.time_step is not None and name not in EXPLICIT:
            yield stage, stepper_from(name, scene.method).alphas(stage.time_step), number
