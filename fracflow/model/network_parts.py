"""Connected components of the network, the closure of an undrained one, and the wells of those that never meet."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Literal

import numpy as np

from fracflow._petsc import MPI, PETSc
from fracflow.mesh.data import Bools, Floats, Ints, SplitMesh
from fracflow.mesh.graph import components
from fracflow.model.flow import Compression
from fracflow.model.layout import Layout, local_rows
from fracflow.model.operators import Operators
from fracflow.scene.scene import Scene
from fracflow.scene.units import LENGTH

CONDUCTS = 1e-15
"""Of the conductance of all elements at its ends: an element with less is pinched, as it is lost in the balance there.
Elements elsewhere do not count: a thin fracture far from a wide one conducts."""
FREE = 1e-10  # of the volume that single nodes take up by a wall's motion: less is round-off
MOST_NAMES = 12  # fractures that a line lists


@dataclass(frozen=True)
class NetworkComponent:
    """A part of the network, the same on every rank.

    nodes      (n,) numbers of its flow nodes
    fractures  names of the fractures that its elements are of
    center     (dim,) mean of its nodes [length]
    """

    nodes: Ints
    fractures: tuple[str, ...]
    center: Floats

    def __str__(self) -> str:
        names = ", ".join(self.fractures)
        return f"{names} ({len(self.nodes)} nodes around ({', '.join(f'{x:.6g}' for x in self.center)}))"


@dataclass(frozen=True)
class Closure:
    """The row in place of the balance at one node of an undrained component without storage.

    The balances of its nodes add up to zero, so one of them is redundant and the level is undetermined.

    by       "walls": it keeps its volume. "fluid": it keeps its compressible fluid. "level": it keeps its mean pressure,
             as its walls cannot move. So does one node pinched on all sides, which must be free to open again
    row      local number of the node on the rank that owns it, empty elsewhere
    weights  change of the volume with the displacements, or shares of the pressures in the mean
    size     of a volume, by which that of "walls" and "fluid" is divided [area]
    nodes    (n,) numbers of the flow nodes of the component, the first has the row
    touched  local numbers of the displacements that weights may depend on
    """

    by: Literal["walls", "fluid", "level"]
    row: Ints
    weights: PETSc.Vec
    size: float
    nodes: Ints
    touched: Ints


def conducting(operators: Operators, conductance: Floats) -> np.ndarray:
    """Which elements (j,) of this rank conduct. Collective."""
    network, nodes = operators.network, operators.layout.flow_vector()
    network.taken_up(np.repeat(conductance, 2), nodes)
    beside = network.at_ends(nodes).max(axis=1)
    nodes.destroy()
    return np.asarray(conductance > CONDUCTS * beside)


def holding(operators: Operators, compression: Compression | None) -> np.ndarray:
    """Which of all flow nodes (n,) hold fluid that is compressible: none where walls meet. Collective."""
    network, layout = operators.network, operators.layout
    if compression is None:
        return np.zeros(int(layout.flow_starts[-1]), dtype=bool)
    found, here = [], 0.5 * network.compressibility * network.length[:, None] * np.abs(network.aperture)
    for at_ends in (compression.weight, here):
        nodes = layout.flow_vector()
        network.taken_up(at_ends, nodes)
        found.append(nodes.getArray().copy())
        nodes.destroy()
    return np.concatenate(layout.comm.allgather(found[0] > CONDUCTS * found[1]))


def leaving(operators: Operators, by_memory: bool = False) -> np.ndarray:
    """Whether fluid leaves by terms at each flow node (n,), which determines its pressure; by those with a memory, or others.

    Collective.
    """
    layout, flow = operators.layout, operators.blocks.joints.flow
    joints = [term.joints() for term in operators.terms if term.drains and term.has_memory == by_memory]
    here = flow[np.concatenate([np.zeros(0, dtype=np.int64), *joints])].ravel()
    return np.isin(np.arange(int(layout.flow_starts[-1])), np.concatenate(layout.comm.allgather(here)))


def find_components(operators: Operators, conducts: np.ndarray) -> tuple[NetworkComponent, ...]:
    """All components, by the elements (j,) of this rank that conduct; the same on every rank. Collective."""
    blocks = operators.blocks
    comm, joints, count = blocks.comm, blocks.joints, int(blocks.flow.starts[-1])
    links = np.concatenate(comm.allgather(joints.flow))[np.concatenate(comm.allgather(conducts))]
    label = components(links[:, 0], links[:, 1], count)
    points = np.concatenate(comm.allgather(blocks.flow.points))
    pairs = np.stack([label[joints.flow].ravel(), np.repeat(joints.fracture, joints.flow.shape[1])], axis=1)
    here = {(part, joints.fractures[f]) for part, f in np.unique(pairs, axis=0).tolist()}
    names: dict[int, list[str]] = {}
    for part, name in sorted(set().union(*comm.allgather(here))):
        names.setdefault(part, []).append(name)
    order = np.argsort(label, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(label[order])) + 1) if count else []
    return tuple(
        NetworkComponent(nodes, tuple(names.get(int(label[nodes[0]]), [])), points[nodes].mean(axis=0))
        for nodes in groups
    )


def change_volume(operators: Operators, parts: tuple[NetworkComponent, ...], fixed_solid: Ints) -> np.ndarray:
    """Whether the volume of each component (k,) changes when its walls move, with some displacements held. Collective.

    Nor does it change where walls open on one side as much as they close on another, as around a floating rigid block.
    """
    layout, network = operators.layout, operators.network
    part_of = np.zeros(int(layout.flow_starts[-1]), dtype=np.int64)
    for number, part in enumerate(parts):
        part_of[part.nodes] = number
    walls = local_rows(network.storage_coupling)
    joined = layout.solid_numbers(int(layout.solid_starts[layout.comm.rank]) + np.arange(layout.solid_count))
    free = ~np.isin(joined, fixed_solid)[walls.rows]
    keys, inverse = np.unique(walls.rows[free] * len(parts) + part_of[walls.cols[free]], return_inverse=True)
    room, size = np.zeros(len(keys)), np.zeros(len(keys))
    np.add.at(room, inverse, walls.values[free])
    np.add.at(size, inverse, np.abs(walls.values[free]))
    largest, gives = np.zeros(len(parts)), np.zeros(len(parts), dtype=bool)
    np.maximum.at(largest, keys % len(parts), size)
    layout.comm.Allreduce(MPI.IN_PLACE, largest, op=MPI.MAX)
    np.logical_or.at(gives, keys % len(parts), np.abs(room) > FREE * largest[keys % len(parts)])
    layout.comm.Allreduce(MPI.IN_PLACE, gives, op=MPI.LOR)
    return gives


def close(operators: Operators, part: NetworkComponent, gives: bool, holds: bool = False) -> Closure:
    """The closure of an undrained component, by whether its walls can move. The caller owns its weights. Collective.

    holds  whether it holds a fluid that is compressible, in a step that stores nothing
    """
    layout, network, scales = operators.layout, operators.network, operators.scales
    inside = layout.flow_vector()
    first = int(layout.flow_starts[layout.comm.rank])
    local = part.nodes[(part.nodes >= first) & (part.nodes < first + layout.flow_count)] - first
    row = local[local + first == part.nodes[0]]
    size, nothing = scales.length * scales.displacement, np.zeros(0, dtype=np.int64)
    if not holds and (len(part.nodes) == 1 or not gives):
        inside.getArray()[local] = 1.0 / len(part.nodes)
        return Closure("level", row, inside, size, part.nodes, nothing)
    inside.getArray()[local] = 1.0
    weights = layout.solid_vector()
    network.storage_coupling.mult(inside, weights)
    inside.destroy()
    if not holds:
        return Closure("walls", row, weights, size, part.nodes, nothing)
    walls, here = local_rows(network.storage_coupling), np.isin(operators.blocks.joints.flow, part.nodes)
    volume = float(np.sum(np.where(here, 0.5 * network.length[:, None] * np.maximum(network.aperture, 0.0), 0.0)))
    soft = network.compressibility * scales.pressure * layout.comm.allreduce(volume)
    touched = np.unique(walls.rows[np.isin(walls.cols, part.nodes)])
    return Closure("fluid", row, weights, max(size if gives else 0.0, soft) or size, part.nodes, touched)


def closure_row(closure: Closure, layout: Layout) -> tuple[Ints, Floats]:
    """Joined numbers (n,) of the unknowns in a closure's row, and weights (n,); the same on every rank. Collective."""
    local = closure.weights.getArray(readonly=True)
    first = closure.weights.getOwnershipRange()[0]
    entries = np.union1d(np.flatnonzero(local), closure.touched)
    number = layout.flow_numbers if closure.by == "level" else layout.solid_numbers
    gathered = layout.comm.allgather((number(entries + first), local[entries].copy()))
    cols, values = (np.concatenate(each) for each in zip(*gathered, strict=True))
    if closure.by != "fluid":
        return cols, values
    return np.concatenate([cols, layout.flow_numbers(closure.nodes)]), np.append(values, np.zeros(len(closure.nodes)))


@dataclass(frozen=True)
class WellPart:
    """Fractures that meet each other, with wells in them.

    wells      their names
    fractures  names of the fractures, in the order of the mesh
    length     of all of them [length]
    apart      distance from the nearest part with other wells, between nodes; inf where there is none [length]
    near       its fracture and that of the other part where they come so near
    """

    wells: tuple[str, ...]
    fractures: tuple[str, ...]
    length: float
    apart: float = np.inf
    near: tuple[str, str] = ("", "")

    def __str__(self) -> str:
        many = len(self.fractures)
        names = ", ".join(self.fractures[:MOST_NAMES]) + (f" and {many - MOST_NAMES} more" if many > MOST_NAMES else "")
        return f"{', '.join(self.wells)} in {names} ({many} fracture{'s' * (many > 1)}, {self.length:.4g} long)"

    def as_record(self) -> dict[str, object]:
        """For JSON, which has no infinity."""
        return asdict(self) | {"apart": self.apart if np.isfinite(self.apart) else None}


def parts_with_wells(mesh: SplitMesh, wells: Mapping[str, tuple[int, ...]]) -> list[WellPart]:
    """Components of a network with wells, that of the first well first; ``wells`` name -> flow nodes. On one process.

    Whatever the motion of walls, fluid never flows from one to the other.
    """
    count = len(mesh.flow_origin)
    if not wells or not count:
        return []
    label = components(mesh.joint_flow[:, 0], mesh.joint_flow[:, 1], count)
    of_joint = label[mesh.joint_flow[:, 0]]
    length = np.linalg.norm(np.diff(mesh.points[mesh.joint_bottom], axis=1)[:, 0], axis=1)
    inside: dict[int, list[str]] = {}
    for name, nodes in wells.items():
        for part in np.unique(label[list(nodes)]).tolist():
            inside.setdefault(part, []).append(name)
    found = []
    for part, names in inside.items():
        here = of_joint == part
        fractures = tuple(mesh.fractures[k] for k in np.unique(mesh.joint_fracture[here]))
        others = np.isin(label, [each for each in inside if each != part])
        nearest = _nearest(mesh, label == part, others)
        found.append(WellPart(tuple(names), fractures, float(length[here].sum()), *nearest))
    return found


def unconnected_wells(scene: Scene, mesh: SplitMesh, wells: Mapping[str, tuple[int, ...]]) -> list[str]:
    """Lines about wells between which nothing can flow; none where all are in one part. On one process."""
    parts = parts_with_wells(mesh, wells)
    if len(parts) < 2:
        return []
    unit = scene.unit_system.behind(LENGTH)
    nearest = min(parts, key=lambda part: part.apart)
    return [
        f"wells: they are in {len(parts)} parts of the network that never meet: no fluid flows from one to another",
        *(f"wells: part {number}: {part}" for number, part in enumerate(parts, 1)),
        f'wells: parts come nearest at fracture "{nearest.near[0]}" and fracture "{nearest.near[1]}", {nearest.apart:.3g}{unit}'
        " apart: move a well, or join them in the traces",
    ]


def _nearest(mesh: SplitMesh, inside: Bools, others: Bools) -> tuple[float, tuple[str, str]]:
    """Least distance between nodes of two sets (n,) and a fracture at each of the two."""
    if not others.any():
        return np.inf, ("", "")
    from scipy.spatial import cKDTree  # imports much

    points: Floats = mesh.points[mesh.flow_origin]
    one, other = np.flatnonzero(inside), np.flatnonzero(others)
    distance, nearest = cKDTree(points[other]).query(points[one])
    best = int(np.argmin(distance))

    def name(node: int) -> str:
        return mesh.fractures[mesh.joint_fracture[int(np.argmax(np.any(mesh.joint_flow == node, axis=1)))]]

    return float(distance[best]), (name(int(one[best])), name(int(other[nearest[best]])))
