"""What a step leaves on record: probes, fracture nodes and rock, gathered on rank 0 in original order."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from fracflow.assembly.operators import Operators
from fracflow.assembly.solid import by_shape
from fracflow.elements import solid
from fracflow.laws.elastic import plane_strain_stiffness
from fracflow.mesh.blocks import Blocks
from fracflow.mesh.data import Floats, Ints, SplitMesh
from fracflow.mesh.locate import FracturePlace, RockPlace
from fracflow.scene import Scene
from fracflow.state import State

COLUMNS = (
    "slip", "opening", "slip_rate", "shear_traction", "normal_traction", "plastic_slip", "sliding", "open", "utilisation",
    "margin", "pressure", "aperture", "flow_rate",
)  # fmt: skip
"""What is gathered at each joint end, in 2-D."""


@dataclass(frozen=True)
class Snapshot:
    """A state on rank 0: joint ends (joints, 2, columns) in original order, and probe nodes' motion."""

    ends: Floats
    nodes: Mapping[int, Floats]

    def column(self, name: str) -> Floats:
        """One quantity at all joint ends (joints, 2)."""
        return self.ends[:, :, COLUMNS.index(name)]


def joint_ends(operators: Operators, state: State, flow_depth: float) -> Floats:
    """Quantities at this rank's joint ends (j, 2, columns). Collective."""
    joints, sections = operators.joints, state.sections
    count = len(operators.blocks.joints.ids)
    points = len(sections.strain) // count if count else 1
    at_end = [0, points - 1]
    rate = joints.strain(state.motion.velocity)
    columns = [
        sections.strain[:, 0], sections.strain[:, -1], rate[:, 0], sections.traction[:, 0], sections.traction[:, -1],
        sections.inelastic[:, 0], sections.is_sliding, sections.is_open, sections.utilisation, sections.margin,
    ]  # fmt: skip
    table = np.stack(columns, axis=-1).astype(float).reshape(count, points, len(columns))[:, at_end]
    fluid = np.full((count, 2, 3), np.nan)
    if operators.flow is not None:
        network = operators.flow.conduct(state.motion.displacement, state.pressure)
        fluid[:, :, 0] = network.pressure + operators.flow.resting_end
        fluid[:, :, 1] = operators.flow.apertures(state.motion.displacement)
        through = network.conductance * (network.pressure[:, 0] - network.pressure[:, 1])
        fluid[:, :, 2] = through[:, None] * flow_depth
    return np.concatenate([table, fluid], axis=-1)


def take(operators: Operators, state: State, flow_depth: float, nodes: Ints) -> Snapshot | None:
    """Gather what probes, events and the fracture fields need; None off rank 0. Collective."""
    blocks: Blocks = operators.blocks
    ends = blocks.gather(blocks.joints.ids, joint_ends(operators, state, flow_depth), blocks.sizes.joints)
    motions = [
        operators.nodal(vector)
        for vector in (state.motion.displacement, state.motion.velocity, state.motion.acceleration)
    ]
    here = np.flatnonzero(np.isin(blocks.solid.node_ids[: blocks.solid.owned], nodes))
    values = np.stack([m.getArray(readonly=True).reshape(-1, blocks.sizes.dim)[here] for m in motions], axis=1)
    for vector in motions:
        vector.destroy()
    parts = blocks.comm.gather((blocks.solid.node_ids[here], values), root=0)
    if parts is None or ends is None:
        return None
    return Snapshot(ends, {int(n): v for numbers, rows in parts for n, v in zip(numbers, rows, strict=True)})


def all_displacements(operators: Operators, state: State) -> Floats | None:
    """Displacements of all split nodes (n, dim) on rank 0, original order. Collective."""
    blocks = operators.blocks
    nodal = operators.nodal(state.motion.displacement)
    local = nodal.getArray(readonly=True).reshape(-1, blocks.sizes.dim).copy()
    nodal.destroy()
    return blocks.gather(blocks.solid.node_ids[: blocks.solid.owned], local, blocks.sizes.nodes)


def probe_nodes(places: Mapping[str, FracturePlace | RockPlace]) -> Ints:
    """Split nodes whose motion the probes need."""
    nodes = [p.nodes if isinstance(p, FracturePlace) else (p.node, p.node) for p in places.values()]
    return np.unique(np.array(nodes, dtype=np.int64).reshape(-1))


def probe_record(scene: Scene, places: Mapping[str, FracturePlace | RockPlace], snapshot: Snapshot) -> dict[str, Any]:
    """History entries of all probes; on a fracture ``displacement`` is that of the top face, the left of the trace."""
    record: dict[str, Any] = {}
    weight = scene.fluid.specific_weight if scene.fluid is not None else None
    for probe in scene.probe:
        place = places[probe.name]
        node = place.nodes[1] if isinstance(place, FracturePlace) else place.node
        motion = snapshot.nodes[node]
        values: dict[str, Any] = dict(zip(("displacement", "velocity", "acceleration"), motion, strict=True))
        if isinstance(place, FracturePlace):
            values["displacement_bottom"] = snapshot.nodes[place.nodes[0]][0]
            ends = snapshot.ends[place.joints, place.ends].mean(axis=0)
            skip = ("sliding", "open", "utilisation", "margin") + (
                () if scene.has_flow else ("pressure", "aperture", "flow_rate")
            )
            values |= {name: v for name, v in zip(COLUMNS, ends, strict=True) if name not in skip}
            if scene.has_flow and weight:
                values["head"] = values["pressure"] / weight
        chosen = values if probe.quantities is None else {q: values[q] for q in probe.quantities if q in values}
        record |= {f"probe/{probe.name}/{name}": value for name, value in chosen.items()}
    return record


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


def rock_stress(mesh: SplitMesh, scene: Scene, displacement: Floats) -> Floats:
    """Stress (cells, 3), xx yy xy [stress], at cell centres; zero in rigid rock."""
    stress = np.zeros((len(mesh.cells), 3))
    given = scene.initial_stress
    initial = np.zeros(3) if given is None else np.array([given.xx, given.yy, given.xy])
    for number, name in enumerate(mesh.rocks):
        rock = scene.rock[name]
        if rock.rigid:
            continue
        of_rock = np.flatnonzero(mesh.cell_rock == number)
        for group, nodes in by_shape(mesh.cells[of_rock]):
            chosen = of_rock[group]
            strain = solid.strain_at_centroid(mesh.points[nodes], displacement[nodes])
            moduli = plane_strain_stiffness(
                np.full(len(chosen), rock.youngs_modulus), np.full(len(chosen), rock.poissons_ratio)
            )
            stress[chosen] = solid.stress(strain, moduli, initial)
    return stress
