"""Tips in meshed rock: how much too stiff cells hold the first joint, where the displacement is a root of the distance.

Cells with constant or linear strain store too much energy around the tip of a crack. Openings and slips are too small by it,
by a share of order 1 in joint over crack. The energy is a product of stress intensities, whatever loads the crack, so that
energy taken off at the tip alone mends it (Egger, Ruede and Wohlmuth 2014). They take it off the stiffness of the cells at the
tip. Here it is taken off the jump of the nodes beside the tip, as ``dislocation.at_tips`` does in unmeshed rock. A displacement
without a jump has none of it: uniform stresses stay exact. One matrix serves both modes, and meshes without symmetry.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from fracflow.elements.shape import Floats, Ints, gauss
from fracflow.elements.solid import stiffness

REACH = 2.5  # joints from the tip to nodes whose cells are looked at
BEYOND = 1.04  # excess by all cells over that by those; see ``at_tip``
NEAREST = 1.0  # joints from the tip to other walls and sides: none is taken off; all of it from REACH on
MOST_LAME = 7.0 / 3.0  # lambda/G of nu = .35; see ``at_tip``
PLACES, SHARES = gauss(10)  # along an edge
ON_LINE = 1e-9  # of a distance behind the tip: a node so near to the line of the walls is on it


class Excess(NamedTuple):
    """Stiffness that cells have too much, against the jump of the nodes beside a tip.

    walls    node on the right of the trace towards the tip, and on its left
    modulus  (2, 2) force over jump [force/length per thickness]
    """

    walls: tuple[int, int]
    modulus: Floats


def singular_field(places: Floats, angle: Floats, moduli: Floats) -> tuple[Floats, Floats]:
    """Displacements (n, 2, 2) and stresses (n, 2, 3) of modes I and II beside a tip, of unit intensity (Williams 1957).

    places  (n, 2) from the tip, the crack along -x
    angle   (n,) of each, pi on the upper wall and -pi on the lower one
    moduli  (3, 3) of isotropic rock [stress]
    The second axis is the mode; stresses are xx, yy, xy.
    """
    lame, shear = moduli[0, 1], moduli[2, 2]
    kappa = (lame + 3.0 * shear) / (lame + shear)
    distance = np.hypot(*places.T)
    c, s, c3, s3 = np.cos(0.5 * angle), np.sin(0.5 * angle), np.cos(1.5 * angle), np.sin(1.5 * angle)
    opening = [c * (kappa - 1.0 + 2.0 * s * s), s * (kappa + 1.0 - 2.0 * c * c)]
    sliding = [s * (kappa + 1.0 + 2.0 * c * c), -c * (kappa - 1.0 - 2.0 * s * s)]
    size = np.sqrt(distance / (2.0 * np.pi)) / (2.0 * shear)
    moved = np.stack([np.stack(opening, axis=-1), np.stack(sliding, axis=-1)], axis=1) * size[:, None, None]
    tension = [c * (1.0 - s * s3), c * (1.0 + s * s3), s * c * c3]
    shearing = [-s * (2.0 + c * c3), s * c * c3, c * (1.0 - s * s3)]
    stress = np.stack([np.stack(tension, axis=-1), np.stack(shearing, axis=-1)], axis=1)
    return moved, stress / np.sqrt(2.0 * np.pi * np.maximum(distance, 1e-300))[:, None, None]


def at_tip(points: Floats, cells: Ints, tip: int, moduli: Floats) -> Excess | None:
    """The excess at a node ``tip`` among cells (m, k), -1 pads; None where it has none, as beside another junction.

    points (n, 2) [length], of all cells with a node no farther than REACH joints from the tip; moduli (3, 3) [stress]

    On the edge of those cells displacements are given those of the singular fields s, and found inside: s_h. The energies
    a(s - s_h, s - s_h) (2, 2) of both modes are to be taken off. With J the jumps of s_h, they are J' X J. Softer walls open
    more: the excess is A = (X^-1 + K^-1)^-1, with K the stiffness of jumps where the edge stays. So it is below K. Cells
    farther away have some of the energy. By all up to 32 joints away, in squares and triangles, A is 1.02 to 1.06 times that:
    BEYOND.

    The fields are those of a tip alone, and K is less in thin rock. So the excess falls where other walls and sides are nearer
    than REACH joints, to none at NEAREST. Cells of nearly incompressible rock lock, whatever the field, and their excess would
    leave none of K. That of nu = .35 and the same G is taken in their place. Bends of the walls are not seen.
    """
    shear = moduli[2, 2]
    lame = min(moduli[0, 1], MOST_LAME * shear)
    moduli = np.array([[lame + 2.0 * shear, lame, 0.0], [lame, lame + 2.0 * shear, 0.0], [0.0, 0.0, shear]])
    patch = _Patch.beside(points, cells, tip)
    if patch is None:
        return None
    found = patch.excess(moduli)
    if found is None:
        return None
    turn = patch.turn
    return Excess(patch.walls, BEYOND * patch.alone * turn.T @ found @ turn)


def _edges(cells: Ints) -> Ints:
    """Edges (e, 2) that one of the cells (m, k) has alone, its inside on the left."""
    count = (cells >= 0).sum(axis=1)
    parts = []
    for width in np.unique(count).tolist():
        chosen = cells[count == width][:, :width]
        parts.append(np.stack([chosen, np.roll(chosen, -1, axis=1)], axis=-1).reshape(-1, 2))
    edges = np.concatenate([np.zeros((0, 2), dtype=np.int64), *parts])
    _, number, times = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True, return_counts=True)
    return np.asarray(edges[times[number.ravel()] == 1])


def _walls(points: Floats, edges: Ints, tip: int) -> tuple[list[int], list[int]]:
    """Nodes of both walls from the tip on, lower and upper, as far as they lie on each other."""
    onward, back = {a: b for a, b in edges.tolist()}, {b: a for a, b in edges.tolist()}
    lower, upper = [tip], [tip]
    while True:
        below, above = onward.get(lower[-1]), back.get(upper[-1])
        if below is None or above is None or below == above or below in lower:
            return lower, upper
        if not np.array_equal(points[below], points[above]):
            return lower, upper
        lower.append(below)
        upper.append(above)


class _Patch(NamedTuple):
    """Cells around a tip in its own frame, lengths in joints, the crack along -x.

    walls  first nodes beside the tip: lower, upper
    angle  (n,) of nodes, +-pi on the walls
    edge   (e, 2) edges but those of the walls, whose nodes are held
    alone  share of the excess that other walls and sides leave
    turn   (2, 2) from the axes to the frame
    """

    points: Floats
    cells: Ints
    walls: tuple[int, int]
    angle: Floats
    edge: Ints
    alone: float
    turn: Floats

    @classmethod
    def beside(cls, points: Floats, cells: Ints, tip: int) -> _Patch | None:
        """The patch of a tip; None where its first nodes are on the edge."""
        edges = _edges(cells)
        lower, upper = _walls(points, edges, tip)
        if len(lower) < 2:
            return None
        ahead = points[tip] - points[lower[1]]
        length = float(np.hypot(*ahead))
        (x, y), here = ahead / length, (points - points[tip]) / length
        turn = np.array([[x, y], [-y, x]])
        here = here @ turn.T
        angle = np.arctan2(here[:, 1], here[:, 0])
        angle[lower], angle[upper] = -np.pi, np.pi
        on_walls = np.zeros(len(points), dtype=bool)
        on_walls[lower] = on_walls[upper] = True
        apart = _distance_from_origin(here[edges])
        own = {*pairwise(lower), *pairwise(upper[::-1])}
        behind = on_walls | ((here[:, 0] < 0.0) & (np.abs(here[:, 1]) <= ON_LINE * np.abs(here[:, 0])))
        other = ~behind[edges].all(axis=1)
        alone = float(np.clip((apart[other].min(initial=np.inf) - NEAREST) / (REACH - NEAREST), 0.0, 1.0))
        unclear = behind & ~on_walls
        used = cells >= 0
        angles = np.where(used & (cells != tip), angle[cells], np.nan)
        across = np.nanmax(angles, axis=1) - np.nanmin(angles, axis=1) > np.pi
        kept = cells[~across & ~(used & unclear[cells]).any(axis=1)]
        edge = np.array([each for each in _edges(kept).tolist() if tuple(each) not in own]).reshape(-1, 2)
        walls = lower[1], upper[1]
        if alone == 0.0 or not len(kept) or np.isin([*walls, tip], edge).any() or not np.isin(walls, kept).all():
            return None
        return cls(here, kept, walls, angle, edge, alone, turn)

    def excess(self, moduli: Floats) -> Floats | None:
        """A (2, 2) of all its cells, in its frame."""
        nodes, local = np.unique(self.cells[self.cells >= 0], return_inverse=True)
        cells = np.full(self.cells.shape, -1)
        cells[self.cells >= 0] = local.ravel()
        number = np.full(len(self.points), -1)
        number[nodes] = np.arange(len(nodes))
        whole = _whole_stiffness(self.points[nodes], cells, moduli)
        field = singular_field(self.points[nodes], self.angle[nodes], moduli)[0]
        moved = field.transpose(0, 2, 1).reshape(-1, 2)
        held = np.zeros((len(nodes), 2), dtype=bool)
        held[number[self.edge]] = True
        free, fixed = np.flatnonzero(~held), np.flatnonzero(held)
        jump = np.zeros((len(moved), 2))
        for sign, wall in zip((-1.0, 1.0), number[list(self.walls)], strict=True):
            jump[2 * wall : 2 * wall + 2] += sign * np.eye(2)
        right = np.hstack([-whole[np.ix_(free, fixed)] @ moved[fixed], jump[free]])
        solved = np.linalg.solve(whole[np.ix_(free, free)], right)
        moved[free] = solved[:, :2]
        soft, jumps = jump[free].T @ solved[:, 2:], jump.T @ moved
        stored = moved.T @ whole @ moved
        energy = stored + self._less(moduli, field)
        if np.linalg.matrix_rank(jumps) < 2 or np.linalg.eigvalsh(energy)[0] <= 0.0:
            return None
        found = np.linalg.inv(jumps @ np.linalg.solve(energy, jumps.T) + soft)
        return 0.5 * (found + found.T)

    def _less(self, moduli: Floats, field: Floats) -> Floats:
        """a(s, s) - a(s, s_h) - a(s_h, s) (2, 2) by the work of the tractions of s on the edge."""
        start, end = self.points[self.edge[:, 0]], self.points[self.edge[:, 1]]
        outward = np.stack([end[:, 1] - start[:, 1], start[:, 0] - end[:, 0]], axis=1)
        nodal = singular_field(self.points, self.angle, moduli)[0]
        angles = self.angle[self.edge]
        near = np.where(np.abs(angles[:, 0]) < np.abs(angles[:, 1]), *angles.T)
        total = np.zeros((2, 2))
        for place, share in zip(PLACES, SHARES, strict=True):
            at = start + place * (end - start)
            angle = np.arctan2(at[:, 1], at[:, 0])
            angle -= 2.0 * np.pi * np.round((angle - near) / (2.0 * np.pi))
            moved, stress = singular_field(at, angle, moduli)
            traction = np.stack(
                [
                    stress[..., 0] * outward[:, None, 0] + stress[..., 2] * outward[:, None, 1],
                    stress[..., 2] * outward[:, None, 0] + stress[..., 1] * outward[:, None, 1],
                ],
                axis=-1,
            )
            linear = (1.0 - place) * nodal[self.edge[:, 0]] + place * nodal[self.edge[:, 1]]
            total += share * np.einsum("eki,eli->kl", traction, 0.5 * moved - linear)
        return np.asarray(total + total.T)


def _whole_stiffness(points: Floats, cells: Ints, moduli: Floats) -> Floats:
    """K (2 n, 2 n) of cells on all of the points (n, 2)."""
    whole = np.zeros((2 * len(points), 2 * len(points)))
    count = (cells >= 0).sum(axis=1)
    for width in np.unique(count).tolist():
        chosen = cells[count == width][:, :width]
        numbers = (2 * chosen[:, :, None] + np.arange(2)).reshape(len(chosen), -1)
        values = stiffness(points[chosen], np.broadcast_to(moduli, (len(chosen), 3, 3)))
        np.add.at(whole, (numbers[:, :, None], numbers[:, None, :]), values)
    return whole


def _distance_from_origin(edges: Floats) -> Floats:
    """Distance (e,) of edges (e, 2, 2) from the origin."""
    start, step = edges[:, 0], edges[:, 1] - edges[:, 0]
    along = np.clip(-np.sum(start * step, axis=1) / np.sum(step**2, axis=1), 0.0, 1.0)
    return np.asarray(np.linalg.norm(start + along[:, None] * step, axis=1))
