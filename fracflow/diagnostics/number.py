"""A number of the pre-run checks, and the input of all of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from fracflow.diagnostics.joints import CheckJoints
from fracflow.integrators import stepper_from
from fracflow.laws import JointLaw
from fracflow.mesh.data import Floats
from fracflow.scene.boundary import Stage
from fracflow.scene.scene import Scene


@dataclass(frozen=True)
class Number:
    """One number of the pre-run checks.

    formula        its symbol, then what it is: "t_v = rho_f d^2/(12 mu)"
    value, limit   None where the scene does not define it, or where nothing here is bounded
    out_of_range   whether the value is past a limit of a method that the scene uses
    where          fracture and stage of the worst value
    remedy         what to change, empty in range
    note           why there is no limit, or what the value stands for
    """

    name: str
    formula: str
    value: float | None = None
    limit: float | None = None
    out_of_range: bool = False
    where: str = ""
    remedy: str = ""
    note: str = ""


@dataclass(frozen=True)
class FlowStage:
    """A stage in which walls move the fluid: its step, alpha_1 and alpha_0 of (4.3), and whether by the trapezoid."""

    name: str
    time_step: float
    alpha_1: float
    alpha_0: float
    is_trapezoid: bool


WEIGHT = {"backward-euler": 1.0, "bdf2": 1.5, "trapezoid": 2.0}
"""alpha_1 dt of the integrators of fracture flow in stages without inertia."""


def flow_stages(scene: Scene, stage: Stage) -> Iterator[FlowStage]:
    """The steps of fracture flow in a stage, of a stage auto with and without inertia; nothing without flow."""
    method, name = scene.method, stage.name or stage.kind
    waves = {"dynamic": stage.time_step, "auto": stage.dynamic_time_step}.get(stage.kind)
    if waves is not None:
        alphas = stepper_from(method.stepper, method).alphas(waves)
        yield FlowStage(name, waves, alphas.a1, alphas.mass, alphas.a4 != 0.0)
    if stage.time_step is not None and stage.kind in ("quasi-static", "auto"):
        dt = stage.time_step
        yield FlowStage(name, dt, WEIGHT[method.flow_integrator] / dt, 0.0, method.flow_integrator == "trapezoid")


def spans(scene: Scene) -> Iterator[tuple[Stage, float, float]]:
    """The stages that take time, with their start and end as far as the scene bounds them."""
    clock = 0.0
    for stage in scene.stage:
        if not stage.takes_no_time:
            after = clock + (stage.steps or 0) * (stage.time_step or 0.0) if stage.end is None else stage.end
            yield stage, clock, after
            clock = after


class CheckInput:
    """A scene and its joints, as the numbers look at them."""

    def __init__(self, scene: Scene, joints: CheckJoints) -> None:
        """Sort the stages."""
        self.scene, self.joints = scene, joints
        self.stages = [each for stage in scene.stage for each in flow_stages(scene, stage)]
        self.dynamic = [each for each in self.stages if each.alpha_0 > 0.0]
        self.flows = scene.has_flow and len(joints.length) > 0
        self.drops = joints.distance == 0.0
        self.weakens = (joints.drop > 0.0) & (joints.distance > 0.0) & np.isfinite(joints.distance)

    def worst(self, values: Floats) -> tuple[float | None, int, str]:
        """Largest value of (j,) or (j, 2), its joint, and the name of its fracture; None where none is known."""
        if not np.isfinite(values).any() and not np.isposinf(values).any():
            return None, -1, ""
        each = np.where(np.isnan(values), -np.inf, values).reshape(len(values), -1).max(axis=1)
        joint = int(each.argmax())
        return float(each[joint]), joint, self.joints.names[self.joints.fracture[joint]]

    def law(self, joint: int) -> type[JointLaw]:
        """That of a joint."""
        return self.joints.laws[self.joints.fracture[joint]]

    def dynamic_time(self) -> float:
        """How long the stages with inertia last, as far as the scene bounds them [time]."""
        return sum(end - start for stage, start, end in spans(self.scene) if stage.kind == "dynamic")

    def unit(self, dimension: str) -> str:
        """The unit to write behind a number, with a blank before it."""
        return self.scene.unit_system.behind(dimension)
