"""Meshes with exact coordinates: grids of quads or triangles with fractures along their rows, and Gmsh's format 2.2."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
SIDES = ("south", "north", "west", "east")
KINDS = {1: (0, 15), 2: (1, 1), 3: (2, 2), 4: (2, 3)}  # corners -> dimension and Gmsh's number


def graded(first: float, end: float, growth: float, at_most: bool = True) -> Floats:
    """Points from 0 to ``end``, each interval ``growth`` times the one before, the first at most, or else about, ``first``."""
    count = np.log1p(end / first * (growth - 1.0)) / np.log(growth)
    steps = growth ** np.arange(np.ceil(count) if at_most else max(1, round(count)))
    return np.concatenate([[0.0], np.cumsum(steps)]) * end / steps.sum()


def onwards(*pieces: Floats) -> Floats:
    """Points of pieces that begin at 0 each, one after another."""
    points = pieces[0]
    for piece in pieces[1:]:
        points = np.concatenate([points, points[-1] + piece[1:]])
    return points


def mirrored(points: Floats) -> Floats:
    """Points from 0 on, and the same below 0."""
    return np.concatenate([-points[:0:-1], points])


def quads_of(node: Ints) -> Ints:
    """Quads (., 4), counter-clockwise, between rows and columns of nodes, (rows, columns) from the lower left."""
    return np.stack([node[:-1, :-1], node[:-1, 1:], node[1:, 1:], node[1:, :-1]], axis=-1).reshape(-1, 4)


def edges_of(nodes: Ints) -> Ints:
    """Edges (., 2) from node to node."""
    return np.stack([nodes[:-1], nodes[1:]], axis=1)


def rims(node: Ints) -> dict[str, Ints]:
    """The rows and columns along each of SIDES."""
    return dict(zip(SIDES, (node[0], node[-1], node[:, 0], node[:, -1]), strict=True))


def tensor(
    x: Floats, y: Floats, fractures: Mapping[str, tuple[float, float, float]], triangles: bool = False, below: str = ""
) -> str:
    """Text of a mesh of the points x, y: one rock, "rock", its four sides by name, fractures by y and the ends in x.

    Of quads, what is under y = 0 may be a rock of another name, ``below``.
    """
    n, m = len(x), len(y)
    node = np.arange(n * m).reshape(m, n)
    quads = quads_of(node)
    blocks: list[tuple[str, Ints]] = [("rock", quads)]
    if triangles:
        fall = np.add.outer(np.arange(m - 1), np.arange(n - 1)).ravel() % 2 == 1
        one, other = np.where(fall[:, None], quads[:, [0, 1, 3]], quads[:, [0, 1, 2]]), quads[:, [0, 2, 3]]
        other = np.where(fall[:, None], quads[:, [1, 2, 3]], other)
        blocks = [("rock", np.concatenate([one, other]))]
    if below:
        low = np.repeat(y[1:] <= 0.0, n - 1)
        blocks = [("rock", quads[~low]), (below, quads[low])]
    blocks += [(name, edges_of(nodes)) for name, nodes in rims(node).items()]
    for name, (level, start, end) in fractures.items():
        inside = (x >= start - 1e-12 * np.ptp(x)) & (x <= end + 1e-12 * np.ptp(x))
        blocks.append((name, edges_of(node[np.argmin(np.abs(y - level)), inside])))
    return msh(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2), blocks)


def msh(points: Floats, blocks: Sequence[tuple[str, Ints]]) -> str:
    """Gmsh's format 2.2 of points (n, 2) and of named points, edges, triangles or quads, (., corners)."""
    groups = list(dict.fromkeys((KINDS[block.shape[1]][0], name) for name, block in blocks))
    rows = []
    for name, block in blocks:
        dim, kind = KINDS[block.shape[1]]
        tag = groups.index((dim, name)) + 1
        rows += [f"{kind} 2 {tag} {tag} {' '.join(map(str, nodes))}" for nodes in (block + 1).tolist()]
    text = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat", "$PhysicalNames", str(len(groups))]
    text += [f'{dim} {tag} "{name}"' for tag, (dim, name) in enumerate(groups, 1)]
    text += ["$EndPhysicalNames", "$Nodes", str(len(points))]
    text += [f"{i} {x!r} {y!r} 0" for i, (x, y) in enumerate(points.tolist(), 1)]
    text += ["$EndNodes", "$Elements", str(len(rows)), *(f"{i} {row}" for i, row in enumerate(rows, 1))]
    return "\n".join([*text, "$EndElements", ""])
