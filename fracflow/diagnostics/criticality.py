"""How near the fractures are to slip before a run: slip tendency, and the rise of pressure that makes them slip."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fracflow.diagnostics.joints import at_ends, initial_tractions, joints_of_tables
from fracflow.laws import JOINT_LAWS
from fracflow.mesh.data import Floats, SplitMesh
from fracflow.scene.scene import Scene

SHEAR_ROUND_OFF = 1e-14  # of the normal traction: less shear is none


@dataclass(frozen=True)
class Criticality:
    """Joint ends (j, 2) under the initial stress and pressure; NaN where the fracture's law has no friction.

    Friction of rate and state counts by its coefficient at the reference slip rate: below it walls creep far more slowly. Its
    tendency is no nearness to slip, since it slips at any shear.

    tendency  |tau|/sigma_n', shear over effective normal traction [1]; inf where nothing presses the walls together
    rise      of the pressure, with the rock at rest, at which they slip or part [stress]: 0 past that, inf for never
    """

    tendency: Floats
    rise: Floats


def criticality(scene: Scene, mesh: SplitMesh) -> Criticality:
    """Slip tendency and critical rise of pressure of a scene on its mesh. On one process."""
    tables = joints_of_tables(scene, mesh)
    rubbing = [each for each in tables if (law := JOINT_LAWS[each[0].law]).status or law.creeps]
    friction, cohesion = (at_ends(mesh, rubbing, key) for key in ("friction", "cohesion"))
    return Criticality(*_near_slip(*initial_tractions(scene, mesh), friction, np.nan_to_num(cohesion)))


def _near_slip(shear: Floats, normal: Floats, friction: Floats, cohesion: Floats) -> tuple[Floats, Floats]:
    """Slip tendency, and the rise that brings |f_s| to the strength C - f_n tan phi of (2.12), or f_n to 0 before that."""
    size, pressed = np.abs(shear), np.maximum(-normal, 0.0)
    size = np.where(size > SHEAR_ROUND_OFF * pressed, size, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        tendency = np.where(pressed > 0.0, size / pressed, np.where(size > 0.0, np.inf, 0.0))
        slips = pressed - (size - cohesion) / friction
    slips = np.where(friction > 0.0, slips, np.where(size > cohesion, 0.0, np.inf))
    rise = np.clip(np.minimum(slips, pressed), 0.0, None)
    is_unknown = np.isnan(friction)
    return np.where(is_unknown, np.nan, tendency), np.where(is_unknown, np.nan, rise)
