"""(2.1)-(2.2) Interpolation and quadrature on reference cells, chosen by dimension and number of nodes.

Line (1, 2), triangle (2, 3), quadrilateral (2, 4), tetrahedron (3, 4), hexahedron (3, 8), nodes ordered as Gmsh's.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from fracflow.errors import InputError

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@cache
def gauss(count: int) -> tuple[Floats, Floats]:
    """Gauss and Legendre's rule of so many points: places from 0 to 1 (count,), and weights (count,), whose sum is 1."""
    place, weight = np.polynomial.legendre.leggauss(count)  # type: ignore[no-untyped-call]
    return 0.5 * (1.0 + place), 0.5 * weight


@dataclass(frozen=True, eq=False)
class Rule:
    """Shape functions at quadrature points of a reference cell.

    weights   (q,)         sum to the reference size
    values    (q, k)       shape functions
    gradients (q, k, dim)  derivatives with respect to the natural coordinates
    """

    weights: Floats
    values: Floats
    gradients: Floats


_SQUARE = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
_CORNERS: dict[tuple[int, int], Floats] = {  # of cells that are products of lines; the others are simplices
    (1, 2): np.array([[-1.0], [1.0]]),
    (2, 4): _SQUARE,
    (3, 8): np.concatenate([np.column_stack([_SQUARE, np.full(4, z)]) for z in (-1.0, 1.0)]),
}
NAMES = {(2, 3): "triangles", (2, 4): "quadrilaterals", (3, 4): "tetrahedra", (3, 8): "hexahedra"}


def rule_at(nodes: int, places: Floats, weights: Floats) -> Rule:
    """(2.1) Shape functions of a reference cell with so many nodes at places (q, dim)."""
    dim = places.shape[1]
    if (dim, nodes) in _CORNERS:
        corner = _CORNERS[dim, nodes]
        factor = 1.0 + places[:, None, :] * corner
        slopes = [corner[:, i] * np.delete(factor, i, axis=2).prod(axis=2) for i in range(dim)]
        return Rule(weights, factor.prod(axis=2) / 2.0**dim, np.stack(slopes, axis=-1) / 2.0**dim)
    first = np.ones(len(places))
    for each in places.T:
        first = first - each
    gradients = np.concatenate([np.full((1, dim), -1.0), np.eye(dim)])
    return Rule(weights, np.stack([first, *places.T], axis=-1), np.tile(gradients, (len(weights), 1, 1)))


GAUSS2 = 1.0 / np.sqrt(3.0)  # abscissa of the two-point Gauss rule
_MOST, _MISS = 20, 1e-14  # iterations to a place in a cell, and how far from it they may end, over the cell's size
_A, _B = 0.25 + 0.15 * np.sqrt(5.0), 0.25 - 0.05 * np.sqrt(5.0)  # four points in a tetrahedron, of second order
_MIDDLES = {
    (dim, dim + 1): rule_at(dim + 1, np.full((1, dim), 1.0 / (dim + 1)), np.array([size]))
    for dim, size in ((2, 0.5), (3, 1.0 / 6.0))
}
GAUSS: dict[tuple[int, int], Rule] = {
    (2, 3): rule_at(3, np.array([[1.0, 1.0], [4.0, 1.0], [1.0, 4.0]]) / 6.0, np.full(3, 1.0 / 6.0)),
    (3, 4): rule_at(4, np.full((4, 3), _B) + (_A - _B) * np.eye(4, 3, -1), np.full(4, 1.0 / 24.0)),
} | {key: rule_at(key[1], GAUSS2 * corner, np.ones(key[1])) for key, corner in _CORNERS.items() if key in NAMES}

STIFFNESS_RULES = {**GAUSS, **_MIDDLES}
MASS_RULES = GAUSS
CENTROID_RULES = {
    **{key: rule_at(key[1], np.zeros((1, key[0])), np.array([2.0 ** key[0]])) for key in ((2, 4), (3, 8))},
    **_MIDDLES,
}


def shape_at(points: Floats, place: Floats) -> Floats:
    """(2.1) Shape functions (k,) of a convex cell with points (k, dim) at a place (dim,) inside it, by Newton's method."""
    nodes, dim = points.shape
    natural = np.full(dim, 1.0 / (dim + 1) if nodes == dim + 1 else 0.0)
    size = float(np.ptp(points, axis=0).max())
    for _ in range(_MOST):
        rule = rule_at(nodes, natural[None], np.ones(1))
        miss = place - rule.values[0] @ points
        if np.abs(miss).max() <= _MISS * size:
            break
        natural = natural + np.linalg.solve((rule.gradients[0].T @ points).T, miss)
    return np.asarray(rule.values[0])


def rule_for(rules: Mapping[tuple[int, int], Rule], points: Floats) -> Rule:
    """The rule for cells with points (n, k, dim). Raises InputError if there is none."""
    nodes, dim = points.shape[1:]
    if (dim, nodes) not in rules:
        known = {k: NAMES[d, k] for d, k in sorted(rules) if d == dim}
        raise InputError(f"cells of {nodes} nodes: allowed are {sorted(known)} ({', '.join(known.values())})")
    return rules[dim, nodes]


def listed(bad: Ints, numbers: Ints | None = None) -> str:
    """The first of some rows, by ``numbers`` (n,) if given, for messages."""
    named = bad if numbers is None else np.asarray(numbers)[bad]
    return ", ".join(str(i) for i in named[:5]) + (", ..." if bad.size > 5 else "")


def jacobian(points: Floats, rule: Rule, numbers: Ints | None = None) -> tuple[Floats, Floats]:
    """Jacobian matrices (n, q, dim, dim) [d x_j / d xi_i] and determinants (n, q) of cells with points (n, k, dim).

    Raises InputError naming the cells whose determinant is not positive, by ``numbers`` (n,) if given.
    """
    matrix, det = _jacobian(points, rule)
    dim = points.shape[2]
    bad = np.flatnonzero(~(det > 0.0).all(axis=1))
    if bad.size:
        which, how = f"cells {listed(bad, numbers)}", "run counter-clockwise around a convex cell of positive area"
        if matrix.shape[-1] == 3:
            how = "be ordered as Gmsh's, in a convex cell of positive volume"
        raise InputError(f"{bad.size} cells with a Jacobian that is not positive ({which}): nodes must {how}")
    shape = len(points), len(rule.weights)
    return np.broadcast_to(matrix, (*shape, dim, dim)), np.broadcast_to(det, shape)


def is_folded(points: Floats) -> NDArray[np.bool_]:
    """Which cells (n,) with points (n, k, dim) have a Jacobian that is not positive. Raises InputError if there is no rule."""
    _, det = _jacobian(points, rule_for(GAUSS, points))
    return np.asarray(~(det > 0.0).all(axis=1))


def _jacobian(points: Floats, rule: Rule) -> tuple[Floats, Floats]:
    """Matrices (n, q, dim, dim) and determinants (n, q) of any sign; q is 1 for simplices."""
    nodes, dim = points.shape[1:]
    places = slice(1) if nodes == dim + 1 else slice(None)  # in simplices it is the same everywhere
    matrix = rule.gradients[places].swapaxes(1, 2) @ points[:, None]
    if dim == 2:
        return matrix, matrix[..., 0, 0] * matrix[..., 1, 1] - matrix[..., 0, 1] * matrix[..., 1, 0]
    return matrix, np.einsum("nqi,nqi->nq", matrix[..., 0, :], np.cross(matrix[..., 1, :], matrix[..., 2, :]))


def gradients(points: Floats, rule: Rule, numbers: Ints | None = None) -> tuple[Floats, Floats]:
    """Shape function gradients (n, q, k, dim) [1/length] and weights (n, q) [area, volume]; errors as ``jacobian``."""
    matrix, det = jacobian(points, rule, numbers)
    adjugate = np.empty_like(matrix)
    if matrix.shape[-1] == 2:
        adjugate[..., 0, 0] = matrix[..., 1, 1]
        adjugate[..., 1, 1] = matrix[..., 0, 0]
        adjugate[..., 0, 1] = -matrix[..., 0, 1]
        adjugate[..., 1, 0] = -matrix[..., 1, 0]
    else:
        for i in range(3):
            adjugate[..., :, i] = np.cross(matrix[..., i - 2, :], matrix[..., i - 1, :])
    physical = rule.gradients @ (adjugate / det[..., None, None]).swapaxes(2, 3)
    return physical, det * rule.weights
