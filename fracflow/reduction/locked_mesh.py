"""Fractures that the plan ties: found in a model, left out of its mesh, and watched from the rock beside them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import inf
from typing import TYPE_CHECKING

import numpy as np

from fracflow._petsc import MPI
from fracflow.elements import facet, joint
from fracflow.errors import ReductionInvalid
from fracflow.laws import JOINT_LAWS
from fracflow.laws.base import HELD
from fracflow.laws.elastic import p_wave_modulus, plane_strain_modulus
from fracflow.mesh.agreement import on_root
from fracflow.mesh.cut_mesh import near_mesh
from fracflow.mesh.data import Bools, Floats, Ints, SplitMesh
from fracflow.mesh.split import groups, merged_faces
from fracflow.mesh.whole import rock_areas
from fracflow.model.contact_mass import redistributes
from fracflow.model.dirichlet import nodes_on
from fracflow.model.properties import initial_pressure
from fracflow.model.setup import Model
from fracflow.model.state import State
from fracflow.model.stress import deforms, elastic_moduli, strain, stress_change, tensors
from fracflow.reduction.decision import LockedFractures, ReductionInput
from fracflow.reduction.locked_fractures import NONE, PART, USE, Fractures, choose, why_none
from fracflow.reduction.prepare import prepare
from fracflow.reduction.sliced import InPieces, Kept, Whole

if TYPE_CHECKING:
    from fracflow.mesh.slices.beside import CellsBeside

MOST = 1e7  # distances between fractures: some seconds
PRESSED = 1e-12  # of the natural pressure: the least that a wall is pressed by when its strength is asked for


def use_of_strength(model: Model, added: Floats) -> Floats:
    """Share of its strength that each section (s,) of this rank uses with tractions (s, dim) added to its initial ones.

    Infinite under tension, where the walls may part.
    """
    joints, found = model.operators.joints, np.zeros(len(added))
    least = PRESSED * model.operators.scales.pressure
    traction = joints.initial + added
    for group in joints.laws:
        here, count = traction[group.sections], len(group.sections)
        normal, shear = np.minimum(here[:, -1], -least), 0.0 * here[:, :-1]
        law = replace(group.law, initial_normal_traction=normal, initial_shear_traction=shear)  # type: ignore[type-var]
        strength = law.evaluate(np.zeros_like(here), law.initial_history(count, joints.dim), HELD).strength
        used = np.linalg.norm(here[:, :-1], axis=1) / np.maximum(strength, least)
        found[group.sections] = np.where(law.opens & (here[:, -1] >= 0.0), inf, used)
    return found


def _largest(model: Model, values: Floats, count: int) -> Floats:
    """Largest value (f,) on each fracture, of values (s,) at the sections of all ranks. Collective."""
    found = np.full(count, -inf)
    joints = model.operators.blocks.joints
    np.maximum.at(found, np.repeat(joints.fracture, model.operators.joints.points), values)
    model.operators.layout.comm.Allreduce(MPI.IN_PLACE, found, MPI.MAX)
    return found


def find_locked(model: Model, facts: ReductionInput) -> LockedFractures:
    """The fractures of a settled model that may be tied. Collective."""
    if why := why_none(facts):
        return LockedFractures(why=why)
    ops, comm, scene = model.operators, model.operators.layout.comm, model.scene
    known = comm.bcast(on_root(comm, lambda: _of_mesh(model)), root=0)
    if known is None:
        return LockedFractures(why=f"more than {MOST:g} distances between fractures would have to be found")
    count = len(known.names)
    if not count:
        return LockedFractures(why="there are none")
    joints, zero = ops.joints, np.zeros_like(ops.joints.initial)
    tangent = joints.evaluate(zero, joints.initial_history(), HELD).tangent
    least = np.einsum("sii->si", tangent).min(axis=1, initial=inf)
    shear = np.linalg.norm(joints.initial[:, :-1], axis=1)
    known = replace(known, stiffness=-_largest(model, -least, count), shear=_largest(model, shear, count))
    known = replace(known, held=_to_held(model))
    fracture = np.repeat(ops.blocks.joints.fracture, joints.points)

    def use(stress: Floats) -> Floats:
        added = np.copysign(stress[fracture, None], joints.initial)
        added[:, -1] = stress[fracture] * (2.0 if scene.has_flow else 1.0)  # fluid that stays takes up what presses
        return _largest(model, use_of_strength(model, added), count)

    mesh, wells = model.mesh, model.placed.wells
    spots = comm.bcast(None if mesh is None else {n: mesh.points[mesh.flow_origin[[*at]]] for n, at in wells.items()})
    return choose(facts, known, {name: initial_pressure(scene, points) for name, points in spots.items()}, use)


def _of_mesh(model: Model) -> Fractures | None:
    """Values of fractures from the mesh, on rank 0; those of ranks are yet 1, 0 and infinite. None for too many fractures."""
    mesh, scene, placed = model.mesh, model.scene, model.placed
    assert mesh is not None
    count, fracture = len(mesh.fractures), mesh.joint_fracture
    places = mesh.points[mesh.flow_origin]
    _, length = facet.frame(mesh.points[mesh.joint_bottom])
    joints, whole = (np.bincount(fracture, each, count).astype(float) for each in (np.ones_like(length), length))
    group = np.unique(groups(mesh), return_inverse=True)[1].ravel()
    probes = [*placed.probes.values()]
    probed = np.array([node for place in probes for node in place.stands_on], np.int64)
    wells = mesh.flow_origin[np.array([node for nodes in placed.wells.values() for node in nodes], dtype=np.int64)]
    named = np.union1d(wells, mesh.origin[probed])
    barred = np.array([scene.loses(name) for name in mesh.fractures], dtype=bool)
    barred[fracture[np.isin(mesh.flow_origin[mesh.joint_flow], named).any(axis=1)]] = True
    barred[fracture[~deforms(mesh, scene)[mesh.joint_cells].all(axis=1)]] = True
    if redistributes(scene):
        barred |= np.array([JOINT_LAWS[scene.fracture_named(name).law].opens for name in mesh.fractures], dtype=bool)
    nodes = [np.unique(mesh.joint_flow[group[fracture] == number]) for number in range(group.max(initial=-1) + 1)]
    if len(nodes) * len(places) > MOST:
        return None
    from scipy.spatial import KDTree  # imports much

    away = [KDTree(places[each]).query(places)[0] for each in nodes]  # (g, q) from every flow node
    apart = np.full((len(nodes), count), inf)
    for row, distance in zip(apart, away, strict=True):
        np.minimum.at(row, fracture, distance[mesh.joint_flow].min(axis=1))
    areas = rock_areas(mesh)
    elastic = [rock for rock in (scene.rock[mesh.rocks[i]] for i in np.flatnonzero(areas)) if not rock.rigid]
    keys = ("youngs_modulus", "poissons_ratio", "density")
    young, poisson, density = (np.array([getattr(rock, key) or 0.0 for rock in elastic]) for key in keys)
    return Fractures(
        names=mesh.fractures, group=group, jumps=joints * model.operators.joints.points * mesh.points.shape[1],
        length=whole, facet=whole / np.maximum(joints, 1.0), stiffness=np.ones(count), shear=np.zeros(count),
        barred=barred, apart=apart,
        reach=np.array([0.5 * np.linalg.norm(np.ptp(places[each], axis=0)) for each in nodes]),
        held=np.full(count, inf), probed=_to_probes(mesh, [place.point for place in probes]),
        area=float(areas.sum()),
        size=float(np.ptp(mesh.points, axis=0).min()),
        modulus=float(plane_strain_modulus(young, poisson).max(initial=0.0)),
        impedance=float(np.sqrt(density * p_wave_modulus(young, poisson)).max(initial=0.0)),
    )  # fmt: skip


def _to_held(model: Model) -> Floats:
    """Distance (f,) to supports and terms that hold sides, on average along each fracture; infinite without any. Collective."""
    scene, blocks = model.scene, model.operators.blocks
    solid, joints, comm = blocks.solid, blocks.joints, blocks.comm
    held = [np.zeros(0, dtype=np.int64)]
    for on in (*(each.on for each in scene.support), *(term.on for term in scene.terms if term.holds)):
        held += [nodes for name in on if (nodes := nodes_on(solid, name, model.placed.points)) is not None]
    nodes = np.unique(np.concatenate(held))
    if not comm.allreduce(len(nodes)):
        return np.full(len(joints.fractures), inf)
    _, one, end = np.unique(solid.origin[joints.bottom], return_index=True, return_inverse=True)
    places = solid.points[joints.bottom.ravel()[one]]
    away = _nearest(comm, solid.points[nodes], places)[end.reshape(joints.bottom.shape)].mean(axis=1)
    _, length = facet.frame(solid.points[joints.bottom])
    sums = np.zeros((2, len(joints.fractures)))
    np.add.at(sums.T, joints.fracture, np.column_stack([away * length, length]))
    comm.Allreduce(MPI.IN_PLACE, sums, MPI.SUM)
    return np.asarray(sums[0] / np.maximum(sums[1], NONE))


def _nearest(comm: MPI.Comm, points: Floats, places: Floats) -> Floats:
    """Distance (q,) of each of this rank's ``places`` (q, dim) from the nearest of the points (n, dim) of all. Collective."""
    from scipy.spatial import KDTree

    tree, found = KDTree(points) if len(points) else None, np.zeros(len(places))
    for rank in range(comm.size):  # the places of one rank at a time, for which all look
        asked = comm.bcast(places, root=rank)
        away = np.full(len(asked), inf) if tree is None else tree.query(asked)[0]
        comm.Reduce(away, found, MPI.MIN, root=rank)
    return found


def _to_probes(mesh: SplitMesh, points: Sequence[Floats]) -> Floats:
    """Distance (p, f) of each fracture from each of the ``points`` (dim,) of probes [length]."""
    found = np.full((len(points), len(mesh.fractures)), inf)
    for row, point in zip(found, points, strict=True):
        away = np.linalg.norm(mesh.points[mesh.flow_origin] - point, axis=1)
        np.minimum.at(row, mesh.joint_fracture, away[mesh.joint_flow].min(axis=1))
    return found


def _chosen(mesh: SplitMesh, names: tuple[str, ...]) -> Bools:
    return np.isin(np.array(mesh.fractures), names)


def tied(model: Model, names: tuple[str, ...], cell_rank: Ints | None = None) -> Model:
    """The model without the named fractures, to be settled; partition (cells,). Its ``whole`` is the old one. Collective."""
    from fracflow.mesh.slices.beside import CellsBeside  # few runs need it
    from fracflow.mesh.slices.merging import merged_slices

    comm, ops = model.operators.layout.comm, model.operators
    mesh, chosen = model.mesh, np.isin(np.array(ops.blocks.joints.fractures), names)
    kept: Kept
    if comm.bcast(mesh is not None and mesh.sums is not None, root=0):
        kept, cell_rank = InPieces(*merged_slices(mesh, ops.blocks, chosen)), None
    else:
        merged = on_root(comm, lambda: None if mesh is None else near_mesh(merged_faces(mesh.uncut, chosen)))
        kept = Whole.of(merged, comm)
    for matrix in (ops.stiffness, ops.mass):  # only its mesh and its laws are asked for again
        matrix.destroy()
    found = prepare(model.scene, comm, kept, cell_rank)
    beside = CellsBeside.of(mesh, ops.blocks, np.flatnonzero(chosen), found.operators.blocks)
    return replace(found, whole=model, locked=names, beside=beside, sides=model.sides)


def watch_locked(model: Model, state: State) -> None:
    """Raise ReductionInvalid, on every rank, where rock beside locked fractures uses more than USE of their strength.

    Collective.
    """
    whole, beside = model.whole, model.beside
    if whole is None or beside is None:
        return
    joints, names = whole.operators.joints, whole.operators.blocks.joints.fractures
    gained, found = _tractions(whole, beside, _gained(model, state, beside)), np.zeros(len(names))
    added = np.zeros((len(whole.operators.blocks.joints.ids), 2))
    for side in (0, 1):
        added[beside.joints] = gained[:, side]
        here = np.repeat(added, joints.points, axis=0)
        found = np.maximum(found, _largest(whole, use_of_strength(whole, here), len(names)))
    found[~np.isin(np.array(names), model.locked)] = 0.0
    if found.max() > USE:
        use, name = float(found.max()), names[int(found.argmax())]
        raise ReductionInvalid(PART, state.time, f"{use:.3g} of the strength of {name} would be used, above {USE:g}")


def _gained(model: Model, state: State, beside: CellsBeside) -> Floats:
    """Increase of stresses (k, 2, 4) of the cells below and above locked joints of this rank. Collective."""
    block, cells = model.operators.blocks.solid, beside.cells
    moved = model.operators.at_nodes(state.motion.displacement)
    strains = strain(block.points, block.cells[cells], moved)
    return beside.back(stress_change(strains, *elastic_moduli(block, model.scene, cells)))


def _tractions(whole: Model, beside: CellsBeside, stresses: Floats) -> Floats:
    """Tractions (k, 2, dim) of stresses (k, 2, 4) on both sides of the locked joints of this rank. Collective.

    A fluid that cannot leave takes up what presses the walls of its fractures, at most as much as anywhere along them.
    """
    blocks, count = whole.operators.blocks, len(beside.joints)
    gained = tensors(stresses.reshape(-1, 4))[:, :2, :2]
    frame, _ = facet.frame(blocks.solid.points[blocks.joints.bottom[beside.joints]])
    traction = joint.traction_from_stress(np.repeat(frame, 2, axis=0), gained).reshape(count, 2, 2)
    if whole.scene.has_flow:
        pressed = np.zeros(beside.groups)
        np.maximum.at(pressed, beside.group, -traction[:, :, -1].min(axis=1))
        blocks.comm.Allreduce(MPI.IN_PLACE, pressed, MPI.MAX)
        traction[:, :, -1] += pressed[beside.group, None]
    return traction
