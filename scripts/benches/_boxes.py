"""Boxes of cubes or tetrahedra with planes that cut them, before the split."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import permutations

import numpy as np

from fracflow.elements.facet import frame
from fracflow.mesh.data import Floats, RawMesh
from fracflow.mesh.facets import half_facets

Plane = tuple[int, int, Callable[[Floats], np.ndarray]]


def box(counts: Sequence[int], planes: Sequence[Plane], tetrahedra: bool = False) -> RawMesh:
    """A grid in space of unit cubes, or of six tetrahedra in each.

    A plane is (axis, position, chosen), its normal along the axis; from the middles (f, 3) of its facets ``chosen`` tells
    which of them are the fracture's.
    """
    near = np.stack(np.meshgrid(*(np.arange(count + 1) for count in counts), indexing="ij"), axis=-1).reshape(-1, 3)
    shape = np.array(counts) + 1
    corner = near[(near < counts).all(axis=1)]

    def node(*offset: int) -> np.ndarray:
        return np.ravel_multi_index((corner + offset).T, shape)

    if tetrahedra:
        cells = []
        for order in permutations(np.eye(3, dtype=int)):
            one, two, both = order[0], order[0] + order[1], order[0] + order[1] + order[2]
            path = [node(0, 0, 0), node(*one), node(*two), node(*both)]
            cells.append(path if np.linalg.det(order) > 0 else [*path[:2], path[3], path[2]])
        cells = np.concatenate([np.stack(path, axis=1) for path in cells])
    else:
        flat = [(0, 0), (1, 0), (1, 1), (0, 1)]
        cells = np.stack([node(x, y, z) for z in (0, 1) for x, y in flat], axis=1)
    points = near.astype(float)
    half = half_facets(cells, 3).nodes
    middle, normal = points[half].mean(axis=1), frame(points[half])[0][:, -1]
    facets, owner = [], []
    for number, (axis, position, chosen) in enumerate([*planes, (2, 0, lambda x: x[:, 2] == 0)]):
        is_on = (points[half][..., axis] == position).all(axis=1) & (normal[:, axis] > 0.5) & chosen(middle)
        facets.append(half[is_on])
        owner.append(np.full(is_on.sum(), number))
    return RawMesh(
        points=points,
        cells=cells,
        cell_rock=np.zeros(len(cells), dtype=np.int64),
        rocks=("rock",),
        fracture_facets=np.concatenate([half[:0], *facets[:-1]]),
        fracture_of=np.concatenate([np.zeros(0, dtype=np.int64), *owner[:-1]]),
        fractures=tuple(f"f{number}" for number in range(len(planes))),
        side_facets=facets[-1],
        side_of=np.zeros(len(facets[-1]), dtype=np.int64),
        sides=("bottom",),
        named_points={"origin": 0},
    )
