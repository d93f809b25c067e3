"""The energy of jumps in unbounded rock that are far from each other, as series: a fast multipole method.

In complex numbers two dislocations b and c at a distance z have the energy (``dislocation``)
-(E'/(8 pi)) Re((c* b + c b*) ln z - c b z*/z), a star for the conjugate. About the centres of two cells, at a distance D, ln z
is a double series of what lies in them. So cells act on each other through moments of their jumps:
alpha_l = int b s^l, beta_l = int b* s^l, gamma_l = int b s* s^l. Here s is the place from the centre (Greengard and Rokhlin
1987; Peirce and Napier 1995 for jumps). Series end at the same order on both sides.
So the operator stays symmetric to round-off.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from math import comb

import numpy as np
from numpy.typing import NDArray

from fracflow.elements.cells import CellPairs, Cells, Complexes
from fracflow.elements.shape import Floats, Ints

PAIRS_AT_ONCE = 1 << 11  # pairs of cells whose series fit a processor's cache
STEP = 4  # between the orders of series


@dataclass(frozen=True)
class Hats:
    """Jumps that one displacement each makes: linear along the segments that meet at a place, and nothing beyond.

    hat, segment  (k,)    which segments a hat lies on, sorted by hats
    sign          (k,)    by how much the jump grows from the first end of the segment to its second, for a unit
    leaf          (h,)    cell of each hat
    ends          (n, 2, 2) of the segments [length]
    """

    hat: Ints
    segment: Ints
    sign: Floats
    leaf: Ints
    ends: Floats


class FarJumps:
    """The share of far pairs of cells in K of (2.39), without its factor -E'/(4 pi), for some of the hats."""

    def __init__(self, cells: Cells, pairs: CellPairs, hats: Hats, tolerance: float) -> None:
        """Prepare the series; ``tolerance`` bounds what they leave out, over the size of a block."""
        self.cells, self.leaf = cells, hats.leaf
        asked = np.ceil(np.log(tolerance) / np.log(np.maximum(pairs.seen, 1e-3)) / STEP).astype(np.int64) * STEP
        self.order = int(asked.max(initial=STEP))
        self.powers, self.bent = self._moments(hats)
        self.shifts = [self._shift(level) for level in range(1, len(cells.levels) - 1)]
        takes = self._holding(hats.leaf)[pairs.far[:, 0]]
        self.groups = []
        for order in np.unique(asked[takes]):
            chosen = pairs.far[takes & (asked == order)]
            chosen = chosen[np.argsort(chosen[:, 0], kind="stable")]
            self.groups += [(int(order), chosen[i : i + PAIRS_AT_ONCE]) for i in range(0, len(chosen), PAIRS_AT_ONCE)]

    def _holding(self, leaf: Ints) -> NDArray[np.bool_]:
        """Whether each cell has hats of these leaves."""
        holds = np.zeros(len(self.cells.centre), dtype=bool)
        holds[leaf] = True
        for first, last in reversed(list(zip(self.cells.levels[:-1], self.cells.levels[1:], strict=True))):
            parents = first + np.flatnonzero(self.cells.child[first:last] >= 0)
            holds[parents] = holds[self.cells.child[parents]] | holds[self.cells.child[parents] + 1]
        return holds

    def _moments(self, hats: Hats) -> tuple[Complexes, Complexes]:
        """Moments int s^l and int s* s^l (order, h) of the change of each hat, over the power l of the radius of its cell."""
        cell, order = hats.leaf[hats.hat], self.order
        start, end = ((hats.ends[hats.segment, k] @ [1, 1j] - self.cells.centre[cell]) for k in (0, 1))
        radius = self.cells.radius[cell]
        start, end = start / radius, end / radius
        mean = np.empty((order + 1, len(start)), dtype=complex)
        total, power = np.ones(len(start), dtype=complex), np.ones(len(start), dtype=complex)
        for degree in range(order + 1):  # the mean of s^l is the sum of start^j end^(l - j) over l + 1
            mean[degree] = total / (degree + 1)
            power = power * start
            total = end * total + power
        turn = np.conj(end - start) / (end - start)
        bent = radius * ((np.conj(start) - turn * start) * mean[:-1] + turn * mean[1:])
        first = np.searchsorted(hats.hat, np.arange(len(hats.leaf)))
        powers, turned = (np.add.reduceat(hats.sign * each, first, axis=1) for each in (mean[:-1], bent))
        return powers, turned

    def _shift(self, level: int) -> tuple[Ints, slice, Floats, Complexes]:
        """Parents of a level's cells, these cells, their offsets, and what carries moments from them to their parents."""
        cells, here = self.cells, slice(*self.cells.levels[level : level + 2])
        above = np.arange(*self.cells.levels[level - 1 : level + 1])
        parents = above[cells.child[above] >= 0]
        parent, order = np.repeat(parents, 2), self.order
        offset = cells.centre[here] - cells.centre[parent]
        moved, shrunk = offset / cells.radius[parent], cells.radius[here] / cells.radius[parent]
        carried = np.zeros((len(parent), order, order), dtype=complex)
        for column in range(order):
            term = shrunk**column + 0j
            for row in range(column, order):
                carried[:, row, column] = comb(row, column) * term
                term = term * moved
        return parents, here, offset, carried

    def leaf_moments(self, moved: Complexes) -> Complexes:
        """Moments (order, 3, c) of the cells that are not divided, by displacements (h,) of these hats."""
        found = np.zeros((self.order, 3, len(self.cells.centre)), dtype=complex)
        for place, part in enumerate((self.powers * moved, self.powers * np.conj(moved), self.bent * moved)):
            for degree in range(self.order):
                found[degree, place] = np.bincount(self.leaf, part[degree].real, len(self.cells.centre))
                found[degree, place] += 1j * np.bincount(self.leaf, part[degree].imag, len(self.cells.centre))
        return found

    def forces(self, moments: Complexes) -> Complexes:
        """Forces (h,) on these hats, of moments of the leaves of all of them (order, 3, c), which are used up."""
        self._gather(moments)
        felt = self._across(moments)
        self._spread(felt)
        a, b, g = (felt[:, place][:, self.leaf] for place in range(3))
        result = (b * self.powers).sum(axis=0) + np.conj((a * self.powers + g * self.bent).sum(axis=0))
        return np.asarray(0.5 * result)

    def _gather(self, moments: Complexes) -> None:
        """From the children up."""
        for parents, here, offset, carried in reversed(self.shifts):
            below = np.moveaxis(moments[:, :, here], 2, 0).copy()
            below[:, :, 2] += np.conj(offset)[:, None] * below[:, :, 0]
            found = np.matmul(carried, below)
            moments[:, :, parents] = np.moveaxis(found[0::2] + found[1::2], 0, 2)

    def _spread(self, felt: Complexes) -> None:
        """From the parents down, by the transpose of the same."""
        for parents, here, offset, carried in self.shifts:
            above = np.repeat(np.moveaxis(felt[:, :, parents], 2, 0), 2, axis=0)
            found = np.matmul(carried.transpose(0, 2, 1), above)
            found[:, :, 0] += np.conj(offset)[:, None] * found[:, :, 2]
            felt[:, :, here] += np.moveaxis(found, 0, 2)

    def _across(self, moments: Complexes) -> Complexes:
        """Factors (order, 3, c) of the moments of each cell in the energy with all that is far from it."""
        felt, cells = np.zeros_like(moments), self.cells
        for order, group in self.groups:
            one, other = group.T
            arm = cells.centre[one] - cells.centre[other]
            there, here = cells.radius[other] / arm, cells.radius[one] / arm
            acting, power = np.empty((order, 3, len(one)), dtype=complex), np.ones(len(one), dtype=complex)
            for degree in range(order):
                np.multiply(moments[degree][:, other], power, out=acting[degree])
                power *= there
            series = (_logarithm(order) @ acting.reshape(order, -1).view(float)).view(complex).reshape(order + 1, 3, -1)
            power = np.ones(len(one), dtype=complex)
            for degree in range(order + 1):
                series[degree] *= power
                power *= here
            grows = np.arange(1, order + 1)[:, None] / cells.radius[one]
            result = np.empty((order, 3, len(one)), dtype=complex)
            result[:, 0] = series[:-1, 1] + grows * (series[1:, 2] - np.conj(arm) * series[1:, 0])
            result[:, 1] = series[:-1, 0]
            result[:, 2] = -grows * series[1:, 0]
            first = np.flatnonzero(np.diff(one, prepend=-1))
            felt[:order, :, one[first]] += np.add.reduceat(result, first, axis=2)
        return felt


@cache
def _logarithm(order: int) -> Floats:
    """Coefficients (order + 1, order) of t^k s^l in ln(1 + t - s), but for the first."""
    found = np.zeros((order + 1, order))
    for k in range(order + 1):
        for m in range(order):
            if k + m:
                found[k, m] = -((-1.0) ** k) / (k + m) * comb(k + m, k)
    return found
