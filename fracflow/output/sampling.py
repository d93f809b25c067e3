"""What a step leaves on record: probes, fracture nodes and rock, gathered on rank 0 in original order."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fracflow._petsc import MPI, PETSc
from fracflow.mesh.data import Floats, Ints, SplitMesh
from fracflow.mesh.locate import FracturePlace, RockPlace
from fracflow.model.operators import Operators
from fracflow.model.properties import along_fractures
from fracflow.model.state import State
from fracflow.scene.scene import Scene

COLUMNS = (
    "slip", "opening", "slip_rate", "shear_traction", "normal_traction", "plastic_slip", "sliding", "open", "strength",
    "utilisation", "margin", "stored_energy", "friction_energy", "aperture", "pressure", "flow_rate",
)  # fmt: skip
"""What there is at each joint end, in 2-D; the energies are per area of the fracture, since the start."""
EVERY_STEP = ("sliding", "open", "margin", "plastic_slip", "slip_rate", "shear_traction")
"""What events and counts need of all joint ends at every step."""
FLOW = {"aperture", "pressure", "flow_rate"}


@dataclass(frozen=True)
class Sampler:
    """What of this rank goes on record.

    aperture  (j, 2) initial aperture at the joint ends, NaN where none is given [length]
    nodes     (n,) owned nodes whose motion probes need
    probed    (k,) joints that end at probes
    names     columns that events and probes need at every step; the same on all ranks
    """

    operators: Operators
    flow_depth: float
    aperture: Floats
    nodes: Ints
    probed: Ints
    names: tuple[str, ...]


def make_sampler(operators: Operators, scene: Scene, places: Mapping[str, FracturePlace | RockPlace]) -> Sampler:
    """Find what the probes need on this rank."""
    blocks = operators.blocks
    ends = np.array([-1.0, 1.0])
    on_fractures = [place for place in places.values() if isinstance(place, FracturePlace)]
    joints = np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *(place.joints for place in on_fractures)]))
    asked = {q for p in scene.probe if isinstance(places[p.name], FracturePlace) for q in p.quantities or COLUMNS}
    asked |= {"pressure"} if "head" in asked else set()
    depth = scene.fluid.flow_depth if scene.fluid is not None else 1.0
    return Sampler(
        operators,
        depth,
        along_fractures(blocks, scene, "aperture", ends),
        np.flatnonzero(np.isin(blocks.solid.node_ids[: blocks.solid.owned], _nodes(places))),
        np.flatnonzero(np.isin(blocks.joints.ids, joints)),
        (*EVERY_STEP, *(name for name in COLUMNS if name in asked and name not in EVERY_STEP)),
    )


def _nodes(places: Mapping[str, FracturePlace | RockPlace]) -> Ints:
    """Split nodes that the places need: faces of a fracture; a node of the rock with the corners of its cells."""
    parts = [
        np.array(p.nodes) if isinstance(p, FracturePlace) else np.append(p.corners.ravel(), p.node)
        for p in places.values()
    ]
    return np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *parts]))


@dataclass(frozen=True)
class Snapshot:
    """A state on rank 0.

    ends    (joints, 2, EVERY_STEP) in original order
    probed  joint -> (2, names) at the joints that end at probes
    names   columns of ``probed``
    nodes   node -> (3, dim) its displacement, velocity and acceleration
    least   number of joint ends that conduct by their minimum aperture, and the most that flows through one
    """

    ends: Floats
    probed: Mapping[int, Floats]
    names: tuple[str, ...]
    nodes: Mapping[int, Floats]
    least: tuple[int, float] = (0, 0.0)

    def column(self, name: str) -> Floats:
        """One quantity of every step at all joint ends (joints, 2)."""
        return self.ends[:, :, EVERY_STEP.index(name)]

    def at_ends(self, joints: Ints, ends: Ints) -> dict[str, float]:
        """Means of the columns over some ends of probed joints."""
        rows = np.array([self.probed[int(joint)][end] for joint, end in zip(joints, ends, strict=True)])
        return dict(zip(self.names, rows.mean(axis=0).tolist(), strict=True))


def joint_ends(sampler: Sampler, state: State, names: tuple[str, ...]) -> Floats:
    """Quantities at this rank's joint ends (j, 2, names). Collective."""
    operators, sections = sampler.operators, state.sections
    joints, flow = operators.joints, operators.flow
    rate = joints.strain(state.motion.velocity)
    found: dict[str, Floats] = dict(
        slip=sections.strain[:, 0], opening=sections.strain[:, -1], slip_rate=rate[:, 0],
        shear_traction=sections.traction[:, 0], normal_traction=sections.traction[:, -1],
        plastic_slip=sections.inelastic[:, 0], sliding=sections.is_sliding, open=sections.is_open,
        strength=sections.strength, utilisation=sections.utilisation, margin=sections.margin,
        stored_energy=sections.stored, friction_energy=state.friction,
    )  # fmt: skip
    count = len(sampler.aperture)
    found = {name: values.reshape(count, joints.points)[:, [0, -1]] for name, values in found.items() if name in names}
    if flow is None and not FLOW.isdisjoint(names):
        found["aperture"] = sampler.aperture + sections.strain[:, -1].reshape(count, joints.points)[:, [0, -1]]
        found["pressure"] = found["flow_rate"] = np.full((count, 2), np.nan)
    if flow is not None and not FLOW.isdisjoint(names):
        opening = joints.openings(sections.strain)
        network = flow.conduct(state.motion.displacement, state.pressure, joints.walls(sections, flow.law))
        found["pressure"] = network.pressure + flow.resting_end
        found["aperture"] = flow.apertures(state.motion.displacement, opening)
        through = network.conductance * (network.pressure[:, 0] - network.pressure[:, 1])
        found["flow_rate"] = np.repeat(through[:, None] * sampler.flow_depth, 2, axis=1)
    return np.stack([found[name] for name in names], axis=-1).astype(float)


def take(sampler: Sampler, state: State) -> Snapshot | None:
    """Gather what probes and events need; None off rank 0. Collective."""
    blocks = sampler.operators.blocks
    table = joint_ends(sampler, state, sampler.names)
    ends = blocks.gather(blocks.joints.ids, table[:, :, : len(EVERY_STEP)], blocks.sizes.joints)
    motion = _motion(
        sampler, (state.motion.displacement, state.motion.velocity, state.motion.acceleration), sampler.nodes
    )
    here = (blocks.joints.ids[sampler.probed], table[sampler.probed], blocks.solid.node_ids[sampler.nodes], motion)
    least = _at_least(sampler, state)
    parts = blocks.comm.gather(here, root=0)
    if parts is None or ends is None:
        return None
    joints = {int(n): v for numbers, rows, _, _ in parts for n, v in zip(numbers, rows, strict=True)}
    nodes = {int(n): v for _, _, numbers, rows in parts for n, v in zip(numbers, rows, strict=True)}
    return Snapshot(ends, joints, sampler.names, nodes, least)


def _at_least(sampler: Sampler, state: State) -> tuple[int, float]:
    flow, comm = sampler.operators.flow, sampler.operators.blocks.comm
    if flow is None:
        return 0, 0.0
    opening = sampler.operators.joints.openings(state.sections.strain)
    ends = flow.at_least(state.motion.displacement, opening)
    walls = sampler.operators.joints.walls(state.sections, flow.law)
    network = flow.conduct(state.motion.displacement, state.pressure, walls)
    through = np.abs(network.conductance * (network.pressure[:, 0] - network.pressure[:, 1]))[ends.any(axis=1)]
    most = comm.allreduce(float(through.max(initial=0.0)), op=MPI.MAX) * sampler.flow_depth
    return comm.allreduce(int(ends.sum())), most


def all_ends(sampler: Sampler, state: State) -> Floats | None:
    """All columns at all joint ends (joints, 2, COLUMNS) on rank 0, original order. Collective."""
    blocks = sampler.operators.blocks
    return blocks.gather(blocks.joints.ids, joint_ends(sampler, state, COLUMNS), blocks.sizes.joints)


def all_motion(sampler: Sampler, state: State) -> Floats | None:
    """Displacement and velocity (n, 2, dim) of all split nodes on rank 0, original order. Collective."""
    blocks = sampler.operators.blocks
    local = _motion(sampler, (state.motion.displacement, state.motion.velocity), np.arange(blocks.solid.owned))
    return blocks.gather(blocks.solid.node_ids[: blocks.solid.owned], local, blocks.sizes.nodes)


def _motion(sampler: Sampler, vectors: tuple[PETSc.Vec, ...], rows: Ints) -> Floats:
    """Values (n, vectors, dim) at owned nodes. Collective."""
    operators = sampler.operators
    values = []
    for vector in vectors:
        nodal = operators.nodal(vector) if operators.expand is not None else vector
        values.append(nodal.getArray(readonly=True).reshape(-1, operators.blocks.sizes.dim)[rows])
        if nodal is not vector:
            nodal.destroy()
    return np.stack(values, axis=1)


def node_table(mesh: SplitMesh) -> tuple[Ints, Ints, Ints]:
    """Pairs (fracture, flow node), and for each joint end (joints * 2,) the pair it belongs to."""
    pairs = np.stack([np.repeat(mesh.joint_fracture, 2), mesh.joint_flow.ravel()], axis=1)
    unique, inverse = (
        np.unique(pairs, axis=0, return_inverse=True) if len(pairs) else (pairs, np.zeros(0, dtype=np.int64))
    )
    return unique[:, 0], unique[:, 1], inverse.ravel()


def at_nodes(snapshot: Snapshot, name: str, inverse: Ints, count: int, any_of: bool = False) -> Floats:
    """A quantity of joint ends brought to fracture nodes (count,): their mean, or 1 where any end has it."""
    values = snapshot.column(name).ravel()
    total = np.bincount(inverse, weights=values, minlength=count)
    if any_of:
        return (total > 0).astype(float)
    return total / np.maximum(np.bincount(inverse, minlength=count), 1)
