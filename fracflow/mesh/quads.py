"""Triangles and quads become quads only, each cut through the middles of its edges."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fracflow.mesh.data import Ints
from fracflow.mesh.facets import number_facets
from fracflow.mesh.gmsh import Elements
from fracflow.mesh.quality import corner_angles

FLAT = 170.0  # degrees: a quad with a corner wider than this is two triangles


def all_quads(elements: Elements) -> Elements:
    """Halve all lines, cut triangles in three and quads in four; every cell is convex.

    A quad that is not convex, or nearly so, is first cut in two triangles at its widest corner.
    """
    elements = _without_flat_quads(elements)
    lines, triangles, quads = (elements.nodes[kind] for kind in ("line", "triangle", "quad"))
    sides = [lines, *(np.stack([c, np.roll(c, -1, axis=1)], axis=2).reshape(-1, 2) for c in (triangles, quads))]
    numbers = number_facets(*sides)
    used, first = np.unique(np.concatenate(numbers), return_index=True)
    middles = elements.points[np.concatenate(sides)[first]].mean(axis=1)
    centres = [elements.points[cells].mean(axis=1) for cells in (triangles, quads)]
    points = np.concatenate([elements.points, middles, *centres])
    count = len(elements.points)
    middle = [count + np.searchsorted(used, number) for number in numbers]
    count += len(used)
    pieces = [
        _around_centre(triangles, middle[1], count),
        _around_centre(quads, middle[2], count + len(triangles)),
    ]
    halves = np.stack([lines[:, 0], middle[0], middle[0], lines[:, 1]], axis=1).reshape(-1, 2)
    members = elements.members
    of_quads = _children(members["quad"], 4)
    of_quads[:, 0] += 3 * len(triangles)
    return replace(
        elements,
        points=points,
        nodes={
            "point": elements.nodes["point"],
            "line": halves,
            "triangle": np.zeros((0, 3), dtype=np.int64),
            "quad": np.concatenate(pieces),
        },
        members={
            "point": members["point"],
            "line": _children(members["line"], 2),
            "triangle": np.zeros((0, 2), dtype=np.int64),
            "quad": np.concatenate([_children(members["triangle"], 3), of_quads]),
        },
    )


def _without_flat_quads(elements: Elements) -> Elements:
    quads = elements.nodes["quad"]
    angles = corner_angles(elements.points, quads)
    is_turned = angles.sum(axis=1) > 720  # four corners of 360 less the inside angle: listed clockwise
    angles = np.where(is_turned[:, None], 360 - angles, angles)
    rows = np.flatnonzero(angles.max(axis=1, initial=0) > FLAT)
    widest = np.argmax(angles[rows], axis=1)
    turned = np.take_along_axis(quads[rows], (widest[:, None] + np.arange(4)) % 4, axis=1)
    halves = np.stack([turned[:, [0, 1, 2]], turned[:, [0, 2, 3]]], axis=1).reshape(-1, 3)
    member = elements.members["quad"]
    number = np.full(len(quads), -1)
    number[np.setdiff1d(np.arange(len(quads)), rows)] = np.arange(len(quads) - len(rows))
    is_kept = number[member[:, 0]] >= 0
    place = np.searchsorted(rows, member[~is_kept, 0])
    new = len(elements.nodes["triangle"]) + 2 * place[:, None] + np.arange(2)
    more = np.stack([new.ravel(), np.repeat(member[~is_kept, 1], 2)], axis=1)
    return replace(
        elements,
        nodes={**elements.nodes, "quad": quads[number >= 0],
               "triangle": np.concatenate([elements.nodes["triangle"], halves])},
        members={**elements.members,
                 "quad": np.stack([number[member[is_kept, 0]], member[is_kept, 1]], axis=1),
                 "triangle": np.concatenate([elements.members["triangle"], more])},
    )  # fmt: skip


def _around_centre(cells: Ints, middle: Ints, first_centre: int) -> Ints:
    """A quad at each corner: corner, middle of the edge after it, centre, middle of the edge before it."""
    width = cells.shape[1]
    after = middle.reshape(-1, width)
    centre = np.broadcast_to(first_centre + np.arange(len(cells))[:, None], cells.shape)
    return np.stack([cells, after, centre, np.roll(after, 1, axis=1)], axis=2).reshape(-1, 4)


def _children(members: Ints, count: int) -> Ints:
    """Rows (element, group) of the ``count`` pieces of each element."""
    element = (members[:, :1] * count + np.arange(count)).ravel()
    return np.stack([element, np.repeat(members[:, 1], count)], axis=1)
