"""Nodes that move as one: those of a side under a platen, or of two facing sides of a periodic piece of rock."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fracflow.errors import InputError
from fracflow.mesh.data import Ints, SplitMesh
from fracflow.mesh.facets import components

NEAR = 1e-6  # of a side's extent: facets this near to each other, once shifted, face each other


def tied_nodes(mesh: SplitMesh, sides: Sequence[str]) -> Ints:
    """Pairs (m, 2) of split nodes that move alike on one side, or on two that face each other.

    Facets are matched by their middles, so that copies of a node at the end of a fracture find the copy on
    their own side of it. Raises InputError where two sides do not coincide by a translation.
    """
    chosen = [mesh.side_facets[mesh.side_of == mesh.sides.index(name)] for name in sides]
    if len(sides) == 1:
        nodes = np.unique(chosen[0])
        return np.stack([np.full(len(nodes) - 1, nodes[0]), nodes[1:]], axis=1)
    from scipy.spatial import cKDTree  # imports much

    ends = [mesh.points[facets] for facets in chosen]
    low, high = (np.array([part.min(axis=(0, 1)), part.max(axis=(0, 1))]) for part in ends)
    shift, extent = (high - low).mean(axis=0), float(np.ptp(low, axis=0).max())
    gap, partner = cKDTree(ends[1].mean(axis=1)).query(ends[0].mean(axis=1) + shift)
    meets = np.linalg.norm(ends[0][:, :, None] + shift - ends[1][partner][:, None], axis=-1)
    place = meets.argmin(axis=2)
    is_apart = (gap > NEAR * extent) | (meets.min(axis=2).max(axis=1) > NEAR * extent)
    if len(chosen[0]) != len(chosen[1]) or is_apart.any():
        raise InputError(
            f'tie: the sides "{sides[0]}" and "{sides[1]}" do not face each other: {len(chosen[0])} and {len(chosen[1])}'
            " facets, which no translation brings to coincide; mesh them alike"
        )
    pairs = np.stack([chosen[0], np.take_along_axis(chosen[1][partner], place, axis=1)], axis=-1)
    return np.unique(pairs.reshape(-1, 2), axis=0)


def representatives(pairs: Ints, count: int) -> Ints:
    """The lowest of all that are tied to each of ``count`` things, by pairs (m, 2); itself where it is not tied."""
    label = components(pairs[:, 0], pairs[:, 1], count)
    lowest = np.full(count, count, dtype=np.int64)
    np.minimum.at(lowest, label, np.arange(count))
    return lowest[label]
