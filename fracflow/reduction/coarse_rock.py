"""Rock that coarsens too fast beside a fracture that weakens with slip: its compliance decides when slip runs away."""

from __future__ import annotations

import numpy as np

from fracflow.diagnostics import slip
from fracflow.diagnostics.number import CheckInput
from fracflow.mesh.data import Floats, SplitMesh
from fracflow.scene.advice import GENTLE
from fracflow.scene.scene import Scene
from fracflow.scene.units import LENGTH


def may_run_away(scene: Scene) -> bool:
    """Whether a stage has no inertia, so that the onset of slip is a matter of the rock at rest."""
    return any(stage.kind != "dynamic" for stage in scene.stage)


def coarse_beside(view: CheckInput, mesh: SplitMesh, edges: Floats) -> list[str]:
    """A line for each fracture whose joints may resolve where slip runs away, and the rock beside it, of ``edges`` (m,), not.

    Rock is too stiff by the square of the rate at which its cells grow away from a patch of the nucleation length.
    """
    if not view.weakens.any() or not may_run_away(view.scene):
        return []
    from scipy.spatial import cKDTree  # imports much

    joints = view.joints
    middle = mesh.points[mesh.joint_bottom].mean(axis=1)
    reach = np.nanmin(np.where(view.weakens, slip.nucleation_lengths(view), np.inf), axis=1)
    weak = np.flatnonzero(np.isfinite(reach))
    corners = mesh.points[np.where(mesh.cells >= 0, mesh.cells, mesh.cells[:, :1])]
    away, nearest = cKDTree(middle[weak]).query(corners.mean(axis=1)) if len(weak) else (np.zeros(0), np.zeros(0, int))
    lines = []
    for number, name in enumerate(joints.names):
        own = weak[nearest]
        here = joints.fracture[own] == number
        here &= (away > 2.0 * joints.length[own]) & (away < reach[own])
        if not here.any():
            continue
        grows = float((edges[here] - joints.length[own[here]]).sum() / away[here].sum())
        if grows > GENTLE:
            lines.append(
                f"mesh: the nucleation length of {name} is not resolved in the rock beside it: within"
                f" {reach[own[here]].min():.3g}{view.unit(LENGTH)} cells grow by {grows:.3g} of the distance, more than"
                f" {GENTLE:g}, which holds the fracture too stiffly and lets slip run away late: geometry.growth ="
                f" {GENTLE:g}, or refine"
            )
    return lines
