"""Values of probes at a step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fracflow.elements import solid
from fracflow.mesh.data import Floats, SplitMesh
from fracflow.mesh.locate import FracturePlace, RockPlace
from fracflow.model import stress as rock
from fracflow.model.probes import MOTION, SOLID, Place, available
from fracflow.output.sampling import Snapshot
from fracflow.scene.scene import Scene


def probe_record(scene: Scene, mesh: SplitMesh, places: Mapping[str, Place], snapshot: Snapshot) -> dict[str, Any]:
    """History entries ``probe/NAME/QUANTITY`` of all probes.

    On a fracture ``displacement``, velocity and acceleration are those of the top face, the left of the trace; what
    belongs to joints is the mean over those that end there. In the rock, strain and stress are means by area over the
    cells around the node, sigma_0 being that of the node itself; inside a cell everything is interpolated from its corners
    by their shape functions, but for sigma_0, which is that of the point.
    """
    record: dict[str, Any] = {}
    for probe in scene.probe:
        place = places[probe.name]
        if isinstance(place, FracturePlace):
            values = _on_fracture(scene, place, snapshot)
        else:
            values = _in_rock(scene, mesh, place, snapshot, wants_strain(probe.quantities))
        names: Sequence[str] = probe.quantities or available(scene, mesh, place)
        record |= {f"probe/{probe.name}/{name}": values[name] for name in names}
    return record


def wants_strain(quantities: Sequence[str] | None) -> bool:
    """Whether a probe in the rock asks for strain or stress."""
    return quantities is None or not set(SOLID).isdisjoint(quantities)


def _moves(node: int, snapshot: Snapshot) -> dict[str, Floats]:
    return dict(zip(MOTION, snapshot.nodes[node], strict=True))


def _on_fracture(scene: Scene, place: FracturePlace, snapshot: Snapshot) -> dict[str, Any]:
    values: dict[str, Any] = _moves(place.nodes[1], snapshot)
    values["displacement_bottom"] = snapshot.nodes[place.nodes[0]][0]
    values |= snapshot.at_ends(place.joints, place.ends)
    if "pressure" in values and scene.fluid is not None and scene.fluid.specific_weight:
        values["head"] = values["pressure"] / scene.fluid.specific_weight
    return values


def _in_rock(scene: Scene, mesh: SplitMesh, place: RockPlace, snapshot: Snapshot, strained: bool) -> dict[str, Any]:
    found = []
    for part in place.within or (place,):
        moves: dict[str, Any] = _moves(part.node, snapshot)
        found.append(moves | _in_cells(scene, mesh, part, snapshot) if strained else moves)
    values, shares = found[0], np.array(place.shares)
    if place.within:
        values = {name: shares @ np.array([each[name] for each in found]) for name in values}
    if "stress" in values:
        values["stress"] = values["stress"] + rock.initial_components(scene, place.point)
    return values


def _in_cells(scene: Scene, mesh: SplitMesh, place: RockPlace, snapshot: Snapshot) -> dict[str, Any]:
    """Strain and the stress it adds (4,) at a node: xx, yy, zz, xy."""
    able = rock.deforms(mesh, scene)[place.cells]
    if not able.any():
        return {}
    cells, corners = place.cells[able], place.corners[able]
    nodes, inverse = np.unique(corners[corners >= 0], return_inverse=True)
    local = np.full(corners.shape, -1)
    local[corners >= 0] = inverse
    points, moved = mesh.points[nodes], np.array([snapshot.nodes[int(node)][0] for node in nodes])
    strains = rock.strain(points, local, moved)
    moduli = (rock.properties(mesh, scene, key, cells) for key in ("youngs_modulus", "poissons_ratio"))
    change = rock.stress_change(strains, *moduli)
    area = rock.per_cell(local, lambda _, corner: solid.area(points[corner]))
    mean = area / area.sum()
    return {"strain": mean @ strains, "stress": mean @ change}
