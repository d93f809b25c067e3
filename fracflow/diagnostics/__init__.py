"""Pre-run checks: numbers that show before a run where its methods may fail, each with its limit and a remedy.

A limit warns only where the scene uses the method that it is about; else the number is there as information.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from math import isfinite

from fracflow.diagnostics import fracture_flow, slip
from fracflow.diagnostics.joints import gather
from fracflow.diagnostics.number import CheckInput, Number
from fracflow.mesh.data import SplitMesh
from fracflow.scene.scene import Scene

__all__ = ["Number", "as_lines", "as_records", "pre_run_checks"]

NUMBERS = (
    slip.stiffness, slip.length_scale, fracture_flow.transient, fracture_flow.steady, fracture_flow.ringing,
    slip.joint_step, fracture_flow.fluid_inertia, fracture_flow.compressibility, slip.nucleation, fracture_flow.contrast,
    slip.cohesive_zone, slip.dissimilar_rock,
)  # fmt: skip
OF_STATES = (slip.state_zone, slip.state_nucleation, slip.rate_dependence, slip.state_at_start)
"""Numbers of friction with a state, where a fracture has it."""


def pre_run_checks(scene: Scene, mesh: SplitMesh, wells: Mapping[str, tuple[int, ...]]) -> list[Number]:
    """The numbers of a scene on its mesh; ``wells`` name -> flow nodes. On one process."""
    view = CheckInput(scene, gather(scene, mesh, wells))
    more = (slip.start_past_strength,) if scene.carries_unbalanced else ()
    return [number(view) for number in (*NUMBERS, *more, *(OF_STATES if view.joints.evolution.any() else ()))]


def as_lines(numbers: list[Number]) -> list[str]:
    """For the log."""
    lines = []
    for number in numbers:
        text = f"check: {number.name}, {number.formula}: "
        text += "none" if number.value is None else f"{number.value:.4g}"
        text += f", limit {number.limit:.4g}" if number.limit is not None else ""
        text += f" ({number.note})" if number.note else ""
        text += f", {number.where}" if number.where else ""
        lines.append(text + (f"; out of range: {number.remedy}" if number.out_of_range else ""))
    return lines


def as_records(numbers: list[Number]) -> list[dict[str, object]]:
    """For plan.json and ``check --json``: the fields of each number, and ``value_text`` and ``limit_text``.

    JSON has no infinity: where a value or limit is "inf" in its text, the field itself is null; where there is none, both
    are null.
    """
    return [asdict(number) | _texts("value", number.value) | _texts("limit", number.limit) for number in numbers]


def _texts(name: str, value: float | None) -> dict[str, object]:
    known = value if value is not None and isfinite(value) else None
    return {name: known, f"{name}_text": None if value is None else f"{value:.3g}"}
