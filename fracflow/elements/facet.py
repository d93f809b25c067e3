"""Facets of 2 nodes (lines), 3 (triangles) or 4 (quadrilaterals): frames, sizes, and the points that stand for them.

A facet with points (k, dim) has dim - 1 natural coordinates, (q,) of lines and (q, 2) of surfaces. Its normal comes last in
its frame: of a line s turned left, of a surface that about which its nodes run counter-clockwise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fracflow.elements.shape import GAUSS2, Floats, Ints, Rule, listed, rule_at
from fracflow.errors import InputError

LEVEL = 1e-9  # sine of the dip below which a surface counts as level, and its strike as x
_CORNERS = {2: np.array([-1.0, 1.0]), 3: np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]),
            4: np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])}  # fmt: skip
_INNER = np.array([[1.0, 1.0], [4.0, 1.0], [1.0, 4.0]]) / 6.0
# of what is linear between the nodes, over the size of the facet; the quadrilateral's changes with its shape
_CONSISTENT = {2: np.array([[2.0, 1.0], [1.0, 2.0]]) / 6.0, 3: (np.ones((3, 3)) + np.eye(3)) / 12.0}


@dataclass(frozen=True, eq=False)
class SectionRule:
    """Where the sections of a facet with k nodes lie.

    natural   (q,) or (q, 2) natural coordinates
    weights   (q,) sum to the reference size: 2 of lines, 1/2 of triangles, 4 of quadrilaterals
    """

    natural: Floats
    weights: Floats


RULES: dict[str, dict[int, SectionRule]] = {
    "nodal": {
        2: SectionRule(_CORNERS[2], np.array([1.0, 1.0])),
        3: SectionRule(_CORNERS[3], np.full(3, 1.0 / 6.0)),
        4: SectionRule(_CORNERS[4], np.ones(4)),
    },
    "gauss2": {
        2: SectionRule(np.array([-GAUSS2, GAUSS2]), np.array([1.0, 1.0])),
        3: SectionRule(_INNER, np.full(3, 1.0 / 6.0)),
        4: SectionRule(GAUSS2 * _CORNERS[4], np.ones(4)),
    },
    "one-point": {
        2: SectionRule(np.array([0.0]), np.array([2.0])),
        3: SectionRule(np.array([[1.0, 1.0]]) / 3.0, np.array([0.5])),
        4: SectionRule(np.zeros((1, 2)), np.array([4.0])),
    },
}
"""Rules of joints, by name and number of nodes; "nodal" is (2.30)."""


def shapes(natural: Floats, nodes: int) -> Floats:
    """(2.2) Shape functions (q, k) of a facet with so many nodes at natural coordinates (q,) or (q, 2)."""
    return rule_of(natural, nodes).values


def rule_of(natural: Floats, nodes: int) -> Rule:
    """Shape functions and their gradients at natural coordinates (q,) or (q, 2); weights of 1."""
    places = np.asarray(natural, dtype=float)
    return rule_at(nodes, places.reshape(len(places), -1), np.ones(len(places)))


def to_nodes(natural: Floats) -> Floats | None:
    """Matrix (k, k) that extends values at a rule's k sections to the nodes; None for a rule of one section.

    natural (k,) or (k, 2): sections that lie as the nodes do, drawn together towards the middle.
    """
    if len(natural) == 1:
        return None
    corners = _CORNERS[len(natural)]
    middle = corners.mean(axis=0)
    shrink = (natural[0] - middle) / (corners[0] - middle)
    return shapes(middle + (corners - middle) / shrink, len(natural))


def frame(points: Floats, numbers: Ints | None = None) -> tuple[Floats, Floats]:
    """(2.3b) Frames (n, dim, dim), rows tangents and normal, and sizes (n,) [length] or [area] of facets (n, k, dim).

    Line: s from node 1 to node 2, n = s turned left. Surface: strike (level, z x n), up the dip, n; a level one has x as its
    strike. So all facets of a plane have one frame. Raises InputError that names facets of no size, by ``numbers`` (n,) if
    given.
    """
    dim = points.shape[2]
    if dim == 2:
        across = points[:, 1] - points[:, 0]
    elif points.shape[1] == 3:
        across = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])
    else:
        across = np.cross(points[:, 2] - points[:, 0], points[:, 3] - points[:, 1])
    length = np.linalg.norm(across, axis=-1)
    bad = np.flatnonzero(~(length > 0.0))
    if bad.size:
        what = "length" if dim == 2 else "area"
        how = "end points must differ" if dim == 2 else "corners must not lie on a line"
        raise InputError(f"{bad.size} fracture facets of no {what} (facets {listed(bad, numbers)}): {how}")
    unit = across / length[:, None]
    if dim == 2:
        return np.stack([unit, np.stack([-unit[:, 1], unit[:, 0]], axis=-1)], axis=1), length
    level = np.hypot(unit[:, 0], unit[:, 1])
    x = np.array([1.0, 0.0, 0.0]) - unit[:, :1] * unit
    strike = np.where((level > LEVEL)[:, None], np.stack([-unit[:, 1], unit[:, 0], 0.0 * level], axis=-1), x)
    strike /= np.linalg.norm(strike, axis=-1)[:, None]
    return np.stack([strike, np.cross(unit, strike), unit], axis=1), 0.5 * length


def section_sizes(points: Floats, sections: SectionRule) -> Floats:
    """(2.30) Length or area (n, q) that each section of facets (n, k, dim) stands for; L/2 times its weight of lines.

    They sum to the facet's size. Raises InputError that names quadrilaterals that are not convex.
    """
    width, (frames, size) = points.shape[1], frame(points)
    if width in _CONSISTENT:
        return (0.5 if width == 2 else 2.0) * size[:, None] * sections.weights
    slope = np.einsum("qka,nkd->nqad", rule_of(sections.natural, 4).gradients, points)
    part = np.einsum("nqd,nd->nq", np.cross(slope[:, :, 0], slope[:, :, 1]), frames[:, -1])
    bad = np.flatnonzero(~(part > 0.0).all(axis=1))
    if bad.size:
        raise InputError(f"{bad.size} fracture facets that are not convex (facets {listed(bad)})")
    return np.asarray(part * sections.weights)


def nodal_sizes(points: Floats) -> Floats:
    """Length or area (n, k) that each node of facets (n, k, dim) stands for."""
    return section_sizes(points, RULES["nodal"][points.shape[1]])


def spread(points: Floats, at_nodes: Floats) -> Floats:
    """Integrals of N_i f (n, k, c) over facets (n, k, dim) of a field with values (n, k, c) at the nodes, between them as N."""
    width = points.shape[1]
    if width in _CONSISTENT:
        size = frame(points)[1]
        return np.asarray(size[:, None, None] * np.einsum("ij,sjd->sid", _CONSISTENT[width], at_nodes))
    return np.asarray(np.einsum("nij,njc->nic", consistent(points), at_nodes))


def consistent(points: Floats) -> Floats:
    """Integrals of N_i N_j (n, k, k) over facets (n, k, dim)."""
    width = points.shape[1]
    if width in _CONSISTENT:
        return frame(points)[1][:, None, None] * _CONSISTENT[width]
    rule = RULES["gauss2"][4]
    values = shapes(rule.natural, 4)
    return np.asarray(np.einsum("nq,qi,qj->nij", section_sizes(points, rule), values, values))


def surface_gradients(points: Floats, sections: SectionRule) -> Floats:
    """Gradients (n, q, k, dim) along facets (n, k, dim) of their shape functions at sections [1/length]."""
    rule = rule_of(sections.natural, points.shape[1])
    slope = np.einsum("qka,nkd->nqad", rule.gradients, points)
    metric = slope @ slope.swapaxes(2, 3)
    dual = np.linalg.solve(metric, slope)  # rows: gradients of the natural coordinates
    return rule.gradients @ dual
