"""What the scene card needs of every joint, gathered once from the scene and its split mesh, on one process."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components, dijkstra

from fracflow.laws import JOINT_LAWS
from fracflow.mesh.data import Floats, Ints, SplitMesh
from fracflow.profiles import sample
from fracflow.scene import Scene

Bools = np.ndarray


@dataclass(frozen=True)
class CardJoints:
    """Values of all joints (j,), or at their two ends (j, 2); NaN where the scene does not say.

    names, fracture  names of the fractures, and the one of each joint
    length           h [length]
    normal, shear    (j, 2) k_n and k_s at the initial state [stress/length]
    aperture         (j, 2) d at the initial state [length]
    conducting       (j, 2) flow per thickness and pressure gradient: d^3/(12 mu), or what is given
    is_cubic         (j,) whether the cubic law gives it
    ratio            (j, 2) stick-slip ratio, 1 where a law knows no friction
    modulus          E' = E/(1 - nu^2) of the rock beside, two rocks in series; inf where both are rigid [stress]
    shear_modulus    mu* = G/(1 - nu), likewise [stress]
    impedance        rho c_p of both sides in series, rho c_p/2 where they are equal [stress time/length]
    mass             m_rel, what of the walls' lumped masses moves against each other, per length of joint; rho h/4 between
                     equal cells of depth h [stress time^2/length]
    component        hydraulic component
    reach            of its component, the longest way along the network to a prescribed pressure; inf where none is [length]
    """

    names: tuple[str, ...]
    fracture: Ints
    length: Floats
    normal: Floats
    shear: Floats
    aperture: Floats
    conducting: Floats
    is_cubic: Bools
    ratio: Floats
    modulus: Floats
    shear_modulus: Floats
    impedance: Floats
    mass: Floats
    component: Ints
    reach: Floats


def gather(scene: Scene, mesh: SplitMesh, wells: Mapping[str, int]) -> CardJoints:
    """The joints of a mesh; ``wells`` name -> flow node."""
    length = np.linalg.norm(np.diff(mesh.points[mesh.joint_bottom], axis=1)[:, 0], axis=-1)

    def ends(key: str) -> Floats:
        values = np.full((len(length), 2), np.nan)
        for number, name in enumerate(mesh.fractures):
            here = mesh.joint_fracture == number
            values[here] = sample(getattr(scene.fracture_named(name), key), mesh.joint_along[here])
        return values

    aperture, given = ends("aperture"), ends("conductance")
    viscosity = scene.fluid.viscosity if scene.fluid is not None and scene.has_flow else np.nan
    cubic = np.maximum(aperture, ends("minimum_hydraulic_aperture")) ** 3 / (12.0 * viscosity)
    rubs = [
        "stick_slip_ratio" in {f.name for f in fields(JOINT_LAWS[scene.fracture_named(name).law])}
        for name in mesh.fractures
    ]
    has_friction = np.array(rubs, dtype=bool)[mesh.joint_fracture] if len(length) else np.zeros(0, dtype=bool)
    rock = _rocks(scene, mesh)
    component, reach = _reaches(scene, mesh, wells, length)
    return CardJoints(
        mesh.fractures,
        mesh.joint_fracture,
        length,
        ends("normal_stiffness"),
        ends("shear_stiffness"),
        aperture,
        np.where(np.isnan(given), cubic, given),
        np.isnan(given).all(axis=1),
        np.where(has_friction[:, None], ends("stick_slip_ratio"), 1.0),
        2.0 * _in_series(rock["modulus"][mesh.joint_cells]),
        2.0 * _in_series(rock["shear_modulus"][mesh.joint_cells]),
        _in_series(rock["impedance"][mesh.joint_cells]),
        _in_series(_wall_masses(mesh, rock["density"], rock["rigid"], length)),
        component,
        reach,
    )


def _in_series(sides: Floats) -> Floats:
    """1/(1/a + 1/b) of pairs (j, 2)."""
    with np.errstate(divide="ignore"):
        result: Floats = 1.0 / (1.0 / sides).sum(axis=1)
    return result


def _rocks(scene: Scene, mesh: SplitMesh) -> dict[str, Floats]:
    """Properties (m,) of the rock of each cell; a rigid one has infinite moduli."""
    tables = [scene.rock[name] for name in mesh.rocks]
    rigid = np.array([rock.rigid for rock in tables], dtype=float)
    young = np.array([np.inf if r.rigid or r.youngs_modulus is None else r.youngs_modulus for r in tables])
    nu = np.array([0.0 if r.rigid or r.poissons_ratio is None else r.poissons_ratio for r in tables])
    density = np.array([np.nan if r.density is None else r.density for r in tables])
    wave = np.sqrt(young * (1.0 - nu) / ((1.0 + nu) * (1.0 - 2.0 * nu)) / density)
    found = {
        "modulus": young / (1.0 - nu**2),
        "shear_modulus": young / (2.0 * (1.0 + nu) * (1.0 - nu)),
        "impedance": density * wave,
        "density": density,
        "rigid": rigid,
    }
    return {key: values[mesh.cell_rock] for key, values in found.items()}


def _wall_masses(mesh: SplitMesh, density: Floats, rigid: Floats, length: Floats) -> Floats:
    """Lumped mass per length of joint of the bottom and the top wall (j, 2); of a rigid rock, that of all of it."""
    is_node = mesh.cells >= 0
    corners = np.where(is_node, mesh.cells, mesh.cells[:, :1])
    x, y = np.moveaxis(mesh.points[corners], -1, 0)
    after = np.roll(np.arange(corners.shape[1]), -1)
    # a pad is the first node again: its edges add nothing
    volume = density * 0.5 * np.abs((x * y[:, after] - x[:, after] * y).sum(axis=1))
    count = len(mesh.points)
    share = (volume / is_node.sum(axis=1))[:, None] * is_node
    at_node = np.bincount(corners.ravel(), share.ravel(), count)
    faces = np.stack([mesh.joint_bottom, mesh.joint_top], axis=1)  # (j, side, end)
    wall = np.broadcast_to(0.5 * length[:, None, None], faces.shape)
    of_wall = np.bincount(faces.ravel(), wall.ravel(), count)
    per_length = np.divide(at_node, of_wall, out=np.zeros(count), where=of_wall > 0.0)[faces].mean(axis=2)
    for number in range(len(mesh.rocks)):
        inside = mesh.cell_rock == number
        if inside.any() and rigid[inside].all():
            sides = mesh.cell_rock[mesh.joint_cells] == number
            per_length[sides] = volume[inside].sum() / max(float((length[:, None] * sides).sum()), 1e-300)
    return per_length


def _reaches(scene: Scene, mesh: SplitMesh, wells: Mapping[str, int], length: Floats) -> tuple[Ints, Floats]:
    """Hydraulic component of each joint, and the longest way in it to a prescribed pressure (j,)."""
    count, ends = len(mesh.flow_origin), mesh.joint_flow
    if not scene.has_flow or not count:
        return np.zeros(len(length), dtype=np.int64), np.full(len(length), np.inf)
    graph = sparse.coo_matrix((length, (ends[:, 0], ends[:, 1])), shape=(count, count)).tocsr()
    label = connected_components(graph, directed=False)[1]
    kept = [scene.fracture_named(name).pressure is not None for name in mesh.fractures]
    held = {wells[well.name] for well in scene.well if well.pressure is not None}
    held |= set(ends[np.array(kept, dtype=bool)[mesh.joint_fracture]].ravel().tolist())
    away = np.full(count, np.inf)
    if held:
        away = dijkstra(graph, directed=False, indices=sorted(held), min_only=True)
    farthest = np.zeros(label.max() + 1)
    np.maximum.at(farthest, label, away)
    component = label[ends[:, 0]].astype(np.int64)
    return component, farthest[component]
