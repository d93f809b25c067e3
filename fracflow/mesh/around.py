"""A mesh around joints that are there already: the rock of an event, on fractures that were run without cells.

Joints, flow nodes and nodes of fractures keep their numbers, so that all that is known of them goes on.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fracflow.errors import InputError
from fracflow.mesh.data import Floats, SplitMesh
from fracflow.mesh.files.gmsh import run_worker
from fracflow.mesh.interpret import interpret
from fracflow.mesh.plane.sizes import STEP, Source
from fracflow.mesh.read import GeometrySpec, side_names
from fracflow.mesh.split import split

SAME = 1e-9  # of the domain: distance of two places that are one


def mesh_around(geometry: GeometrySpec, unmeshed: SplitMesh) -> SplitMesh:
    """The mesh of a domain whose fractures, inside it, have the joints of rock that was not meshed.

    Cells are as long as the joints beside them and grow by ``growth`` to ``size``. Raises InputError where Gmsh makes no
    such mesh.
    """
    corners = np.asarray(geometry.domain, dtype=float)
    count, facets, owner = len(unmeshed.flow_origin), unmeshed.joint_flow, unmeshed.joint_fracture
    places, around = unmeshed.points[:count], count + np.arange(len(corners))
    sides = side_names(corners)
    job = {
        "points": np.concatenate([places, corners]).tolist(),
        "sides": {name: [pair] for name, pair in zip(sides, _pairs(around), strict=True)},
        "traces": {name: facets[owner == k].tolist() for k, name in enumerate(unmeshed.fractures)},
        "size": float(geometry.size),
        "sources": [(size, size / 2, spots.tolist()) for size, spots in _sources(unmeshed) if size < geometry.size],
        "growth": float(geometry.growth),
        "right_angled": False,
        "rock": geometry.rock,
        "whole": True,
    }
    raw = interpret(run_worker(job, "geometry"), unmeshed.fractures, "geometry")
    found = _numbers(raw.points, places, float(np.ptp(corners, axis=0).max()))
    rest = np.setdiff1d(np.arange(len(raw.points)), found)
    number = np.empty(len(raw.points), dtype=np.int64)
    number[np.concatenate([found, rest])] = np.arange(len(number))
    if _edges(number[raw.fracture_facets]) != _edges(facets):
        raise InputError("geometry: Gmsh has cut joints of the fractures in pieces: change geometry.size a little")
    return split(
        replace(
            raw,
            points=np.concatenate([places, raw.points[rest]]),
            cells=np.where(raw.cells >= 0, number[raw.cells], -1),
            fracture_facets=facets,
            fracture_of=owner,
            fractures=unmeshed.fractures,
            side_facets=number[raw.side_facets],
            named_points={},
            notes=unmeshed.notes,
        )
    )


def _pairs(loop: np.ndarray) -> list[list[int]]:
    return np.stack([loop, np.roll(loop, -1)], axis=1).tolist()


def _edges(facets: np.ndarray) -> set[tuple[int, ...]]:
    return set(map(tuple, np.sort(facets, axis=1).tolist()))


def _sources(unmeshed: SplitMesh) -> list[Source]:
    """Lengths of joints, in steps of ``STEP``, and ends and middles of those that are so long."""
    ends = unmeshed.points[unmeshed.joint_bottom]
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    level = np.ceil(np.log(length.max() / length) / np.log(STEP) - SAME).astype(np.int64)
    spots = np.stack([ends[:, 0], ends[:, 1], ends.mean(axis=1)], axis=1)
    return [(float(length[level == k].max()), spots[level == k].reshape(-1, 2)) for k in np.unique(level).tolist()]


def _numbers(points: Floats, places: Floats, extent: float) -> np.ndarray:
    """The point (n,) at each place (n, 2). Raises InputError where there is none."""
    from scipy.spatial import cKDTree  # imports much

    away, found = cKDTree(points).query(places)
    if away.max(initial=0.0) > SAME * extent or len(np.unique(found)) != len(places):
        raise InputError("geometry: Gmsh has left out nodes of the fractures: change geometry.size a little")
    return np.asarray(found, dtype=np.int64)
