"""Meshes with exact coordinates: tensor grids of quads or triangles with fractures along their rows, as Gmsh's 2.2 text."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
SIDES = ("south", "north", "west", "east")


def graded(first: float, end: float, growth: float) -> Floats:
    """Points from 0 to ``end``, the first interval at most ``first``, each ``growth`` times the one before."""
    count = np.log1p(end / first * (growth - 1.0)) / np.log(growth)
    steps = growth ** np.arange(np.ceil(count))
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


def tensor(
    x: Floats, y: Floats, fractures: Mapping[str, tuple[float, float, float]], triangles: bool = False, below: str = ""
) -> str:
    """Text of a mesh of the points x, y: one rock, "rock", its four sides by name, fractures by y and the ends in x.

    Of quads, what is under y = 0 may be a rock of another name, ``below``.
    """
    n, m = len(x), len(y)
    node = np.arange(n * m).reshape(m, n)
    quads = np.stack([node[:-1, :-1], node[:-1, 1:], node[1:, 1:], node[1:, :-1]], axis=-1).reshape(-1, 4)
    if triangles:
        fall = np.add.outer(np.arange(m - 1), np.arange(n - 1)).ravel() % 2 == 1
        one, other = np.where(fall[:, None], quads[:, [0, 1, 3]], quads[:, [0, 1, 2]]), quads[:, [0, 2, 3]]
        other = np.where(fall[:, None], quads[:, [1, 2, 3]], other)
    groups: list[tuple[int, NDArray[Any]]] = [(2, np.concatenate([one, other])) if triangles else (3, quads)]
    rocks = ["rock"]
    if below:
        low = np.repeat(y[1:] <= 0.0, n - 1)
        rocks, groups = ["rock", below], [(3, quads[~low]), (3, quads[low])]
    rows = [node[0], node[-1], node[:, 0], node[:, -1]]
    for level, start, end in fractures.values():
        inside = (x >= start - 1e-12 * np.ptp(x)) & (x <= end + 1e-12 * np.ptp(x))
        rows.append(node[np.argmin(np.abs(y - level)), inside])
    groups += [(1, np.stack([row[:-1], row[1:]], axis=1)) for row in rows]
    names = [*rocks, *SIDES, *fractures]
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    text = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat", "$PhysicalNames", str(len(names))]
    text += [f'{2 if i < len(rocks) else 1} {i + 1} "{name}"' for i, name in enumerate(names)]
    text += ["$EndPhysicalNames", "$Nodes", str(len(points))]
    text += [f"{i + 1} {a!r} {b!r} 0" for i, (a, b) in enumerate(points.tolist())]
    elements = [(kind, tag + 1, row) for tag, (kind, block) in enumerate(groups) for row in (block + 1).tolist()]
    text += ["$EndNodes", "$Elements", str(len(elements))]
    text += [f"{i + 1} {kind} 2 {tag} {tag} {' '.join(map(str, row))}" for i, (kind, tag, row) in enumerate(elements)]
    return "\n".join([*text, "$EndElements", ""])
