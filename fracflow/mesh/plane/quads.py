"""Triangles become quads: most in pairs, all cut through the middles of their edges."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fracflow.mesh.data import Floats, Ints
from fracflow.mesh.facets import half_facets, match, number_facets
from fracflow.mesh.files.gmsh import Elements
from fracflow.mesh.plane.quality import corner_angles

WORST = 75.0  # degrees: corners of a pair of triangles are nearer than this to a right angle


def all_quads(elements: Elements) -> Elements:
    """Join triangles in pairs, halve all lines, and cut pairs in four and the triangles left over in three quads.

    No node moves and every quad is convex, in the narrowest wedge too. Each element's pieces are in its groups.
    """
    lines, triangles = elements.nodes["line"], elements.nodes["triangle"]
    quads, leader, left = _in_pairs(elements.points, triangles, lines)
    group = np.full(len(triangles), -1)
    group[elements.members["triangle"][:, 0]] = elements.members["triangle"][:, 1]
    triangles = triangles[left]
    edges = [lines, *(np.stack([c, np.roll(c, -1, axis=1)], axis=2).reshape(-1, 2) for c in (triangles, quads))]
    numbers = number_facets(*edges)
    used, first = np.unique(np.concatenate(numbers), return_index=True)
    count = len(elements.points)
    middle = [count + np.searchsorted(used, number) for number in numbers]
    centre = count + len(used)
    cells = [_around_centre(triangles, middle[1], centre), _around_centre(quads, middle[2], centre + len(triangles))]
    rows = np.arange(3 * len(triangles) + 4 * len(quads))
    groups = np.concatenate([np.repeat(group[left], 3), np.repeat(group[leader], 4)])
    on_line, of_line = elements.members["line"].T
    none = np.zeros((0, 2), dtype=np.int64)
    return replace(
        elements,
        points=np.concatenate([
            elements.points, elements.points[np.concatenate(edges)[first]].mean(axis=1),
            elements.points[triangles].mean(axis=1), elements.points[quads].mean(axis=1),
        ]),
        nodes={
            "point": elements.nodes["point"],
            "line": np.stack([lines[:, 0], middle[0], middle[0], lines[:, 1]], axis=1).reshape(-1, 2),
            "triangle": triangles[:0],
            "quad": np.concatenate(cells),
        },
        members={
            "point": elements.members["point"],
            "line": np.stack([(2 * on_line[:, None] + [0, 1]).ravel(), np.repeat(of_line, 2)], axis=1),
            "triangle": none,
            "quad": np.stack([rows, groups], axis=1)[groups >= 0],
        },
    )  # fmt: skip


def _in_pairs(points: Floats, triangles: Ints, lines: Ints) -> tuple[Ints, Ints, Ints]:
    """Quads (q, 4) of neighbouring triangles, the first of each pair (q,), and the triangles left over.

    No pair faces each other across a line. The pair nearest to a rectangle goes first, wherever it is the best of both.
    """
    half = half_facets(triangles, 2)
    inside = match(half, lines).inside
    one, other = half.cell[inside].T
    # Ahead along the shared edge, to the far corner on the other side, back along it, and to that on this side.
    start, end = half.nodes[inside[:, 0]].T
    far = [triangles[half.cell[side], 3 - half.corner[side].sum(axis=1)] for side in inside.T]
    quads = np.stack([start, far[1], end, far[0]], axis=1)
    worst = np.abs(corner_angles(points, quads) - 90.0).max(axis=1)
    fit = np.flatnonzero(worst < WORST)
    order = fit[np.argsort(worst[fit], kind="stable")]
    is_free, chosen = np.ones(len(triangles), dtype=bool), []
    while len(order):
        first = np.full(len(triangles), len(order))
        for side in (one, other):
            np.minimum.at(first, side[order], np.arange(len(order)))
        is_best = (first[one[order]] == np.arange(len(order))) & (first[other[order]] == np.arange(len(order)))
        chosen.append(order[is_best])
        is_free[one[chosen[-1]]] = is_free[other[chosen[-1]]] = False
        order = order[is_free[one[order]] & is_free[other[order]]]
    pairs = np.concatenate([np.zeros(0, dtype=np.int64), *chosen])
    return quads[pairs], one[pairs], np.flatnonzero(is_free)


def _around_centre(cells: Ints, middle: Ints, first_centre: int) -> Ints:
    """A quad at each corner: corner, middle of the edge after it, centre, middle of the edge before it."""
    width = cells.shape[1]
    after = middle.reshape(-1, width)
    centre = np.broadcast_to(first_centre + np.arange(len(cells))[:, None], cells.shape)
    return np.stack([cells, after, centre, np.roll(after, 1, axis=1)], axis=2).reshape(-1, 4)
