"""Wells between which fluid never flows: the connected fractures of a mesh that hold them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass

import numpy as np

from fracflow.mesh.data import Bools, Floats, SplitMesh
from fracflow.mesh.graph import components
from fracflow.scene.scene import Scene
from fracflow.scene.units import LENGTH

MOST_NAMES = 12  # fractures that a line lists


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
