"""Values that a scene gives at places: properties along the fractures, stress and pressure before the first step, sides."""

from __future__ import annotations

import numpy as np

from fracflow.elements import facet
from fracflow.mesh.blocks import Blocks
from fracflow.mesh.data import Floats, Ints
from fracflow.scene.profiles import sample
from fracflow.scene.scene import Scene


def on_joints(at_nodes: Floats, natural: Floats) -> Floats:
    """Values at the nodes of joints (j, k, ...) brought to natural coordinates (q,) or (q, 2): (j, q, ...)."""
    return np.einsum("qa,ja...->jq...", facet.shapes(natural, at_nodes.shape[1]), at_nodes)


def along_fractures(blocks: Blocks, scene: Scene, key: str, natural: Floats) -> Floats:
    """A property of the fractures (j, q) at natural coordinates (q,) or (q, 2) of this rank's joints; NaN for none."""
    block = blocks.joints
    distance = on_joints(block.along, natural)
    values = np.full(distance.shape, np.nan)
    for number, name in enumerate(block.fractures):
        here = block.fracture == number
        values[here] = sample(getattr(scene.fracture_named(name), key), distance[here])
    return values


def initial_stress(scene: Scene, points: Floats) -> Floats:
    """sigma_0 (..., 3, 3) at points (..., dim) [stress], tension positive; zero where the scene names none."""
    given = scene.initial_stress
    stress = np.zeros((*points.shape[:-1], 3, 3))
    if given is None:
        return stress
    depth = given.datum - points[..., -1]
    for row, column, name in ((0, 0, "xx"), (1, 1, "yy"), (2, 2, "zz"), (0, 1, "xy"), (1, 0, "xy")):
        stress[..., row, column] = getattr(given, name) + getattr(given.gradient, name) * depth
    return stress


def resting_pressure(scene: Scene, points: Floats) -> Floats:
    """The part of p0 that changes with depth (...) at points (..., dim) [stress]: the fluid does not flow at it."""
    if scene.fluid is None or scene.fluid.pressure_gradient == 0.0:
        return np.zeros(points.shape[:-1])
    return np.asarray(scene.fluid.pressure_gradient * (scene.fluid.datum - points[..., -1]))


def initial_pressure(scene: Scene, points: Floats) -> Floats:
    """p0 (...) at points (..., dim) [stress], in balance with the initial tractions of the joints."""
    return resting_pressure(scene, points) + (scene.fluid.initial_pressure if scene.fluid is not None else 0.0)


def body_force(scene: Scene, rock: str) -> Floats:
    """Force (2,) on the volume of a rock [force/length**3]."""
    given = scene.body_force
    if given is None:
        return np.zeros(2)
    weight = (scene.rock[rock].density or 0.0) * given.gravity
    return np.array([given.x, given.y - weight])


def side_facets(blocks: Blocks, name: str) -> Ints:
    """Local numbers (f,) of this rank's facets of a named side."""
    sides = blocks.solid.sides
    return np.flatnonzero(blocks.solid.side_of == sides.index(name)) if name in sides else np.zeros(0, dtype=np.int64)


def outward(blocks: Blocks, facets: Ints) -> Floats:
    """Outward unit normals (s, dim) of boundary facets."""
    points = blocks.solid.points
    corners = points[blocks.solid.side_facets[facets]]
    normal = -facet.frame(corners)[0][:, -1]
    nodes = blocks.solid.cells[blocks.solid.side_cell[facets]]
    inside = np.where(nodes[..., None] >= 0, points[nodes], np.nan)
    away = corners.mean(axis=1) - np.nanmean(inside, axis=1) if len(facets) else corners.mean(axis=1)
    return normal * np.sign(np.einsum("si,si->s", normal, away))[:, None]
