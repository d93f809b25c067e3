"""A binary tree of cells around points in the plane, and which pairs of cells are far from each other.

A cell is a disc around all that its points reach. Two of them are far where each is small as seen from the other. Their
interaction is then a short series (Greengard and Rokhlin 1987).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fracflow.elements.shape import Floats, Ints

Complexes = NDArray[np.complex128]

MOST = 16  # points in a cell that is not divided
SEEN = 0.5  # radius of a cell over the least distance to it from another that is far


@dataclass(frozen=True)
class Cells:
    """Cells of a tree, the whole first; both children of a cell follow each other, and cells of a level too.

    centre  (c,)    x + iy [length]
    radius  (c,)    of a disc around what its points reach [length]
    child   (c,)    number of the first child, -1 where a cell is not divided
    levels  (l+1,)  first cell of each level, and the number of cells
    leaf    (n,)    the cell of each point that is not divided
    """

    centre: Complexes
    radius: Floats
    child: Ints
    levels: Ints
    leaf: Ints


@dataclass(frozen=True)
class CellPairs:
    """Pairs (m, 2) of cells that together have each pair of points once, and each pair of cells either way round.

    far   pairs whose interaction is a series, ``seen`` (m,) the larger radius over distance of both
    near  pairs of cells that are not divided
    """

    far: Ints
    seen: Floats
    near: Ints


def divided(points: Floats, reach: Floats, most: int = MOST) -> Cells:
    """The tree of points (n, 2), each with a box (n, 2, 2) that it reaches, lowest and highest corner [length].

    A cell with more than ``most`` points is cut into halves across its longer side. It depends on the points alone, and their
    order.
    """
    whole = np.arange(len(points))
    level, levels, child = [whole], [0], list[int]()
    groups: list[Ints] = []
    leaf = np.zeros(len(points), dtype=np.int64)
    while level:
        following: list[Ints] = []
        first = len(groups)
        levels.append(first + len(level))
        for number, group in enumerate(level, first):
            groups.append(group)
            if len(group) <= most:
                leaf[group] = number
                child.append(-1)
                continue
            child.append(levels[-1] + len(following))
            here = points[group]
            order = np.argsort(here[:, np.ptp(here, axis=0).argmax()], kind="stable")
            following += np.split(group[order], [len(group) // 2])
        level = following
    boxes = np.array([[reach[each, 0].min(axis=0), reach[each, 1].max(axis=0)] for each in groups])
    middle, radius = boxes.mean(axis=1), 0.5 * np.linalg.norm(boxes[:, 1] - boxes[:, 0], axis=1)
    return Cells(middle[:, 0] + 1j * middle[:, 1], radius, np.array(child), np.array(levels), leaf)


def pairs_of(cells: Cells, seen: float = SEEN) -> CellPairs:
    """All pairs of cells that are far, or near and not divided."""
    one, other = np.zeros(1, dtype=np.int64), np.zeros(1, dtype=np.int64)
    far, shares, near = [], [], []
    while len(one):
        distance = np.abs(cells.centre[one] - cells.centre[other])
        share = _seen(cells.radius[one], cells.radius[other], distance)
        is_far = share <= seen
        both = np.stack([one, other], axis=1)
        far.append(both[is_far])
        shares.append(share[is_far])
        divides = np.stack([cells.child[one] >= 0, cells.child[other] >= 0])
        near.append(both[~is_far & ~divides.any(axis=0)])
        left = np.flatnonzero(~is_far & divides.any(axis=0))
        one, other, divides = one[left], other[left], divides[:, left]
        same = one == other
        of_one = ~same & divides[0] & (~divides[1] | (cells.radius[one] >= cells.radius[other]))
        of_other = ~same & ~of_one
        inside, first, second = cells.child[one[same]], cells.child[one[of_one]], cells.child[other[of_other]]
        one, other = (
            np.concatenate([inside, inside, inside + 1, first, first + 1, one[of_other], one[of_other]]),
            np.concatenate([inside, inside + 1, inside + 1, other[of_one], other[of_one], second, second + 1]),
        )
    apart, close, share = np.concatenate(far), np.concatenate(near), np.concatenate(shares)
    mirrored = close[close[:, 0] != close[:, 1]]
    return CellPairs(
        np.concatenate([apart, apart[:, ::-1]]), np.tile(share, 2), np.concatenate([close, mirrored[:, ::-1]])
    )


def _seen(one: Floats, other: Floats, distance: Floats) -> Floats:
    """The larger radius (m,) over the distance of the nearest point of the other disc; infinite where discs meet."""
    apart = distance - one - other
    shares = np.maximum(
        one / np.where(apart > 0.0, apart + one, 1.0), other / np.where(apart > 0.0, apart + other, 1.0)
    )
    return np.where(apart > 0.0, shares, np.inf)
