"""Named sides of the rock: their facets, normals and forces."""

from __future__ import annotations

import numpy as np

from fracflow.mesh.blocks import Blocks
from fracflow.mesh.data import Floats, Ints


def side_facets(blocks: Blocks, name: str) -> Ints:
    """Local numbers of this rank's facets of a named side."""
    sides = blocks.solid.sides
    return np.flatnonzero(blocks.solid.side_of == sides.index(name)) if name in sides else np.zeros(0, dtype=np.int64)


def outward(blocks: Blocks, facets: Ints) -> Floats:
    """Outward unit normals (s, 2) of boundary facets."""
    points = blocks.solid.points
    ends = points[blocks.solid.side_facets[facets]]
    along = ends[:, 1] - ends[:, 0]
    normal = np.stack([along[:, 1], -along[:, 0]], axis=1) / np.linalg.norm(along, axis=1)[:, None]
    nodes = blocks.solid.cells[blocks.solid.side_cell[facets]]
    inside = np.where(nodes[..., None] >= 0, points[nodes], np.nan)
    away = ends.mean(axis=1) - np.nanmean(inside, axis=1) if len(facets) else ends.mean(axis=1)
    return normal * np.sign(np.einsum("si,si->s", normal, away))[:, None]
