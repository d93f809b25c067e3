"""Connected components of the network, the closure of an undrained one, and the wells of those that never meet."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Literal

import numpy as np

from fracflow._petsc import MPI, PETSc
from fracflow.mesh.blocks import owner_of, petsc_ints
from fracflow.mesh.data import Bools, Floats, Ints, SplitMesh
from fracflow.mesh.graph import components
from fracflow.mesh.shared import Shared, lowest_joined
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
    """A part of the network. All but ``nodes`` is the same on every rank.

    nodes      (n,) numbers of its flow nodes on this rank
    count      of its nodes on all ranks
    root       lowest number of its nodes, whose balance a closure replaces
    fractures  names of the fractures that its elements are of
    center     (dim,) mean of its nodes [length]
    """

    nodes: Ints
    count: int
    root: int
    fractures: tuple[str, ...]
    center: Floats

    def __str__(self) -> str:
        names = ", ".join(self.fractures)
        return f"{names} ({self.count} nodes around ({', '.join(f'{x:.6g}' for x in self.center)}))"


@dataclass(frozen=True)
class Closure:
    """The row in place of the balance at one node of an undrained component without storage.

    The balances of its nodes add up to zero, so one of them is redundant and the level is undetermined.

    by       "walls": it keeps its volume. "fluid": it keeps its compressible fluid. "level": it keeps its mean pressure,
             as its walls cannot move. So does one node pinched on all sides, which must be free to open again
    row      local number of the node on the rank that owns it, empty elsewhere
    weights  change of the volume with the displacements, or shares of the pressures in the mean
    size     of a volume, by which that of "walls" and "fluid" is divided [area]
    number   of the flow node that has the row, the same on every rank
    nodes    (n,) numbers of the flow nodes of the component on this rank
    ends     (j, 2) which joint ends of this rank are in a component that keeps its fluid
    touched  local numbers of the displacements that weights may depend on
    """

    by: Literal["walls", "fluid", "level"]
    row: Ints
    weights: PETSc.Vec
    size: float
    number: int
    nodes: Ints
    ends: Bools
    touched: Ints


def conducting(operators: Operators, conductance: Floats) -> Bools:
    """Which elements (j,) of this rank conduct. Collective."""
    network, nodes = operators.network, operators.layout.flow_vector()
    network.taken_up(np.repeat(conductance, 2), nodes)
    beside = network.at_ends(nodes).max(axis=1)
    nodes.destroy()
    return np.asarray(conductance > CONDUCTS * beside)


def holding(operators: Operators, compression: Compression | None) -> Bools:
    """Which flow nodes (q,) of this rank hold fluid that is compressible: none where walls meet. Collective."""
    network, layout = operators.network, operators.layout
    if compression is None:
        return np.zeros(layout.flow_count, dtype=bool)
    here = 0.5 * network.compressibility * network.length[:, None] * np.abs(network.aperture)
    weight, volume = (network.at_nodes(at_ends) for at_ends in (compression.weight, here))
    return np.asarray(weight > CONDUCTS * volume)


def leaving(operators: Operators, by_memory: bool = False) -> Bools:
    """Which flow nodes (q,) of this rank fluid leaves by terms with a memory, or by others, and so settles. Collective."""
    layout, flow = operators.layout, operators.blocks.joints.flow
    joints = [term.joints() for term in operators.terms if term.drains and term.has_memory == by_memory]
    here = np.unique(flow[np.concatenate([np.zeros(0, dtype=np.int64), *joints])])
    marks = layout.flow_vector()
    marks.setValues(petsc_ints(here), np.ones(len(here)), addv=PETSc.InsertMode.ADD_VALUES)
    marks.assemble()
    found = marks.getArray() > 0.0
    marks.destroy()
    return np.asarray(found)


class Parts:
    """The connected components of the network, spread over the ranks.

    Each rank knows those that its flow nodes, its joint ends or its walls touch, here called its k parts.

    roots  (k,) lowest number among the flow nodes of each, ascending
    own    (q,) which of the k parts each flow node of this rank is in
    ends   (j, 2) likewise each joint end
    sizes  (k,) flow nodes of each, over all ranks
    count  of all components of the network
    """

    def __init__(self, operators: Operators, conducts: Bools) -> None:
        """Find the components that the conducting elements (j,) of each rank make. Collective."""
        self._operators, blocks, layout = operators, operators.blocks, operators.layout
        comm, first, total = layout.comm, int(layout.flow_starts[layout.comm.rank]), int(layout.flow_starts[-1])
        here = first + np.arange(layout.flow_count)
        beside_walls = local_rows(operators.network.storage_coupling).cols
        self._numbers = np.unique(np.concatenate([here, blocks.joints.flow.ravel(), beside_walls]))
        links = np.searchsorted(self._numbers, blocks.joints.flow)
        tree = components(links[conducts, 0], links[conducts, 1], len(self._numbers))
        label = lowest_joined(comm, layout.flow_count, total, self._numbers, tree)
        self.roots, self._of = np.unique(label, return_inverse=True)
        self.own, self.ends = self._of[np.searchsorted(self._numbers, here)], self._of[links]
        self._shared = Shared(comm, layout.flow_count, total, self.roots)
        self._is_mine = (self.roots >= first) & (self.roots < first + layout.flow_count)
        self.sizes = self.summed(np.bincount(self.own, minlength=len(self.roots))).astype(np.int64)
        self.count = int(comm.allreduce(int(self._is_mine.sum())))

    def at(self, numbers: Ints) -> Ints:
        """Which of the k parts flow nodes (n,) are in that this rank knows."""
        return self._of[np.searchsorted(self._numbers, numbers)]

    def summed(self, values: Floats | Ints) -> Floats:
        """Sum (k,) over the ranks of what each has for its parts (k,). Collective."""
        return self._shared.summed(np.asarray(values, dtype=float))

    def largest(self, values: Floats) -> Floats:
        """Largest (k,) of what ranks have for their parts (k,). Collective."""
        return self._shared.largest(values)

    def any_of(self, nodes: Bools) -> Bools:
        """Whether any of the flow nodes (q,) of this rank, or of others, is in each of the parts (k,). Collective."""
        return np.asarray(self.summed(np.bincount(self.own[nodes], minlength=len(self.roots))) > 0.0)

    def root_at(self, node: int) -> int:
        """The root of the part of any flow node, by its number. Collective."""
        here = int(self.roots[self.at(np.array([node]))[0]]) if node in self._numbers else -1
        return int(self._operators.layout.comm.allreduce(here, op=MPI.MAX))

    def listed(self, chosen: Bools, most: int | None = None) -> tuple[Ints, int]:
        """Roots of the chosen parts (k,), the same on every rank, and how many there are. Collective.

        most  of them that are listed, the largest first; without it all of them, in ascending order
        """
        comm, mine = self._operators.layout.comm, np.flatnonzero(chosen & self._is_mine)
        if most is not None:
            mine = mine[np.argsort(-self.sizes[mine], kind="stable")][:most]
        parts = comm.allgather((self.roots[mine], self.sizes[mine]))
        roots, sizes = (np.concatenate(each) for each in zip(*parts, strict=True))
        count = int(comm.allreduce(int(np.count_nonzero(chosen & self._is_mine))))
        order = np.argsort(roots) if most is None else np.lexsort([roots, -sizes])[:most]
        return roots[order], count

    def named(self, roots: Ints) -> tuple[NetworkComponent, ...]:
        """The parts of some roots (n,), which are the same on every rank. Collective."""
        if not len(roots):
            return ()
        blocks, joints, count = self._operators.blocks, self._operators.blocks.joints, len(roots)
        place, order, known = np.full(len(self.roots), count), np.argsort(roots), np.isin(self.roots, roots)
        place[known] = order[np.searchsorted(roots[order], self.roots[known])]
        of_node = place[self.own]
        sums = np.zeros((count + 1, 1 + blocks.sizes.dim))
        np.add.at(sums, of_node, np.insert(blocks.flow.points, 0, 1.0, axis=1))
        blocks.comm.Allreduce(MPI.IN_PLACE, sums, op=MPI.SUM)
        pairs = np.stack([place[self.ends].ravel(), np.repeat(joints.fracture, self.ends.shape[1])], axis=1)
        here = {(part, joints.fractures[f]) for part, f in np.unique(pairs, axis=0).tolist() if part < count}
        names: list[list[str]] = [[] for _ in roots]
        for part, name in sorted(set().union(*blocks.comm.allgather(here))):
            names[part].append(name)
        in_order = np.argsort(of_node, kind="stable")
        ends = np.cumsum(np.bincount(of_node, minlength=count))[:count]
        nodes = np.split(in_order + int(blocks.flow.starts[blocks.comm.rank]), ends)
        return tuple(
            NetworkComponent(nodes[k], int(sums[k, 0]), int(root), tuple(names[k]), sums[k, 1:] / sums[k, 0])
            for k, root in enumerate(roots)
        )

    def at_root(self, facts: Bools, part: NetworkComponent) -> bool:
        """Whether a component has a fact that each rank knows of its parts (k,), the same on every rank. Collective."""
        here = bool(facts[self.roots == part.root].any())
        return bool(self._operators.layout.comm.allreduce(here, op=MPI.LOR))

    def destroy(self) -> None:
        """Free the way between the ranks. Collective."""
        self._shared.destroy()


def change_volume(operators: Operators, parts: Parts, fixed_solid: Ints) -> Bools:
    """Whether the volume of each part (k,) changes when its walls move, with some displacements held. Collective.

    Nor does it change where walls open on one side as much as they close on another, as around a floating rigid block.
    """
    layout, walls, count = operators.layout, local_rows(operators.network.storage_coupling), len(parts.roots)
    joined = layout.solid_numbers(int(layout.solid_starts[layout.comm.rank]) + np.arange(layout.solid_count))
    free = ~np.isin(joined, fixed_solid)[walls.rows]
    keys, inverse = np.unique(walls.rows[free] * count + parts.at(walls.cols[free]), return_inverse=True)
    room, size = np.zeros(len(keys)), np.zeros(len(keys))
    np.add.at(room, inverse, walls.values[free])
    np.add.at(size, inverse, np.abs(walls.values[free]))
    largest, gives = np.zeros(count), np.zeros(count)
    np.maximum.at(largest, keys % max(count, 1), size)
    largest = parts.largest(largest)
    np.logical_or.at(gives, keys % max(count, 1), np.abs(room) > FREE * largest[keys % max(count, 1)])
    return np.asarray(parts.largest(gives) > 0.0)


def close(operators: Operators, parts: Parts, part: NetworkComponent, gives: bool, holds: bool = False) -> Closure:
    """The closure of an undrained component, by whether its walls can move. The caller owns its weights. Collective.

    holds  whether it holds a fluid that is compressible, in a step that stores nothing
    """
    layout, network, scales = operators.layout, operators.network, operators.scales
    inside = layout.flow_vector()
    local = part.nodes - int(layout.flow_starts[layout.comm.rank])
    row = local[part.nodes == part.root]
    size, nothing = scales.length * scales.displacement, np.zeros(0, dtype=np.int64)
    no_ends = np.zeros(parts.ends.shape, dtype=bool)
    if not holds and (part.count == 1 or not gives):
        inside.getArray()[local] = 1.0 / part.count
        return Closure("level", row, inside, size, part.root, part.nodes, no_ends, nothing)
    inside.getArray()[local] = 1.0
    weights = layout.solid_vector()
    network.storage_coupling.mult(inside, weights)
    inside.destroy()
    if not holds:
        return Closure("walls", row, weights, size, part.root, part.nodes, no_ends, nothing)
    ends, walls = parts.roots[parts.ends] == part.root, local_rows(network.storage_coupling)
    volume = float(np.sum(np.where(ends, 0.5 * network.length[:, None] * np.maximum(network.aperture, 0.0), 0.0)))
    soft = network.compressibility * scales.pressure * layout.comm.allreduce(volume)
    touched = np.unique(walls.rows[parts.roots[parts.at(walls.cols)] == part.root])
    return Closure(
        "fluid", row, weights, max(size if gives else 0.0, soft) or size, part.root, part.nodes, ends, touched
    )


def closure_row(closure: Closure, layout: Layout) -> tuple[Ints, Floats]:
    """Joined numbers (n,) of the unknowns in a closure's row, and weights (n,); none on ranks without it. Collective."""
    local = closure.weights.getArray(readonly=True)
    first = closure.weights.getOwnershipRange()[0]
    entries = np.union1d(np.flatnonzero(local), closure.touched)
    number = layout.flow_numbers if closure.by == "level" else layout.solid_numbers
    fluid = layout.flow_numbers(closure.nodes) if closure.by == "fluid" else closure.nodes[:0]
    here = number(entries + first), fluid, local[entries], np.zeros(len(fluid))
    gathered = layout.comm.gather(here, root=int(owner_of(layout.flow_starts, np.array([closure.number]))[0]))
    if gathered is None:
        return closure.nodes[:0], local[:0]
    walls, held, weights, nothing = (np.concatenate(each) for each in zip(*gathered, strict=True))
    return np.concatenate([walls, held]), np.concatenate([weights, nothing])


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
