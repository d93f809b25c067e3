"""Cost of the explicit steps of a scene, before the run: their substeps, the critical time step, and CPU time."""

from __future__ import annotations

import math
from dataclasses import dataclass
from time import process_time

from fracflow.integrators import EXPLICIT
from fracflow.integrators.explicit import parts
from fracflow.model.operators import Operators
from fracflow.model.setup import Model
from fracflow.solve.explicit import ExplicitCoupling

PRODUCTS = 16.0  # the time of a substep, in products of the rock's stiffness: 7 with 4e5 unknowns, 15 with 7e4
TIMED = 5  # products


@dataclass(frozen=True)
class ExplicitCost:
    """Explicit steps of the stages whose number of steps is known, and their substeps.

    seconds   of CPU that a substep takes on this process, without the cost that every step has [s]
    critical  longest stable time step, by the rock alone; infinite where no rock deforms [time]
    told      a line for the user
    """

    steps: int
    parts: int
    seconds: float
    critical: float
    told: str


def explicit_cost(model: Model) -> ExplicitCost | None:
    """The cost of the explicit steps; None where no stage has any. Raises InputError as ``ExplicitCoupling``. Collective."""
    scene, start, planned, events = model.scene, 0.0, [], False
    if scene.method.stepper not in EXPLICIT:
        return None
    for stage in scene.stage:
        count, start = stage.step_count(start) or 0, stage.finish(start)
        events = events or stage.kind == "auto"
        if stage.kind == "dynamic" and stage.time_step is not None:
            planned.append((count, stage.time_step))
    if not planned and not events:
        return None
    coupling = ExplicitCoupling(scene, model.operators, model.loads)
    critical = coupling.critical
    coupling.destroy()
    cuts = [(count, dt, parts(dt, critical)) for count, dt in planned]
    unit = f" {scene.unit_system.time}".rstrip()
    ways = [f" in {n} parts of {dt / n:.4g}{unit}" if n > 1 else "" for _, dt, n in cuts]
    told = [f"{count} steps of {dt:.4g}{unit}{way}" for (count, dt, _), way in zip(cuts, ways, strict=True)]
    told += ["as many as events take"] if events else []
    limit = f"critical time step of the rock {critical:.4g}{unit}" if math.isfinite(critical) else "no rock deforms"
    return ExplicitCost(
        sum(count for count, _, _ in cuts),
        sum(count * n for count, _, n in cuts),
        PRODUCTS * _seconds_of_product(model.operators),
        critical,
        f"{', '.join(told)}; {limit}; without a factorisation",
    )


def _seconds_of_product(operators: Operators) -> float:
    """CPU time of a product of the rock's stiffness with a vector, on this process [s]. Collective."""
    moved, force = operators.layout.solid_vector(), operators.layout.solid_vector()
    operators.stiffness.mult(moved, force)
    began = process_time()
    for _ in range(TIMED):
        operators.stiffness.mult(moved, force)
    lasted = (process_time() - began) / TIMED
    moved.destroy()
    force.destroy()
    return lasted
