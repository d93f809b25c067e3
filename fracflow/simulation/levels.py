"""The same scene on a finer mesh, with shorter steps: cells cut in four and steps in two, level by level."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

from fracflow.integrators import stepper_from
from fracflow.scene.boundary import Stage
from fracflow.scene.method import Table
from fracflow.scene.scene import Scene

Thing = TypeVar("Thing", bound=Table)
Spot = tuple[tuple[float, float], str | None]
"""Where something is, and on which rock or fracture; None where the scene need not say."""


def order_in_time(scene: Scene) -> int:
    """The least order of the rules that the stages step by; 2, the order of the mesh, where time has no part."""
    waves, flow = (scene.method.stepper,), (scene.method.flow_integrator,) if scene.has_flow else ()
    names = {"dynamic": waves, "quasi-static": flow, "auto": waves + flow}
    rules = [stepper_from(name, scene.method) for stage in scene.stage for name in names.get(stage.kind, ())]
    return min([2, *(rule.order for rule in rules)])


def at_level(scene: Scene, level: int, spots: Mapping[str, Spot]) -> Scene:
    """The scene with mesh and steps ``level`` times halved, and errors of steps asked to be as much smaller.

    spots  where the things of ``pinned`` sit on the mesh of level 0, by their paths: on finer ones they stay there
    """
    if level == 0:
        return scene
    parts, order, accuracy = 2**level, order_in_time(scene), scene.accuracy
    where = "geometry" if scene.geometry is not None else "mesh"
    table = getattr(scene, where)
    asked = {
        "tolerance": accuracy.tolerance and accuracy.tolerance / parts**order,
        "step_error": accuracy.step_error and accuracy.step_error / parts ** (order + 1),
    }
    return scene.model_copy(
        update={
            where: table.model_copy(update={"refine": table.refine + level}),
            "stage": tuple(_stage(stage, parts) for stage in scene.stage),
            "accuracy": accuracy.model_copy(update=asked),
            "output": scene.output.model_copy(update={"fields_every": scene.output.fields_every * parts}),
            "probe": tuple(_pinned(probe, spots.get(f"probe.{probe.name}")) for probe in scene.probe),
            "well": tuple(_pinned(well, spots.get(f"well.{well.name}")) for well in scene.well),
        }
    )


def _stage(stage: Stage, parts: int) -> Stage:
    changed: dict[str, float | int | None] = {
        "time_step": stage.time_step and stage.time_step / parts,
        "dynamic_time_step": stage.dynamic_time_step and stage.dynamic_time_step / parts,
        "increment_per_step": stage.increment_per_step and stage.increment_per_step / parts,
    }
    if stage.kind != "equilibrate":
        changed["steps"] = stage.steps and stage.steps * parts
    return stage.model_copy(update=changed)


def _pinned(thing: Thing, spot: Spot | None) -> Thing:
    if spot is None:
        return thing
    update: dict[str, object] = {"at": spot[0]} if spot[1] is None else {"at": spot[0], "on": spot[1]}
    return thing.model_copy(update=update)
