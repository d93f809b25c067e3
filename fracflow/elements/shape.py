"""(2.1)-(2.2) Interpolation and quadrature: lines, triangles, quadrilaterals, chosen by number of nodes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fracflow.errors import InputError

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Rule:
    """Shape functions at quadrature points of a reference element.

    weights   (q,)       sum to the reference area
    values    (q, k)     shape functions
    gradients (q, k, 2)  derivatives with respect to the natural coordinates
    """

    weights: Floats
    values: Floats
    gradients: Floats


def line_shape(xi: Floats) -> Floats:
    """(2.2) psi_1, psi_2 at natural coordinates xi (q,) in [-1, 1]; returns (q, 2)."""
    xi = np.asarray(xi, dtype=float)
    return np.stack([(1.0 - xi) / 2.0, (1.0 + xi) / 2.0], axis=-1)


def _triangle(points: Floats, weights: Floats) -> Rule:
    xi, eta = points.T
    gradients = np.array([[-1.0, -1.0], [1.0, 0.0], [0.0, 1.0]])
    return Rule(weights, np.stack([1.0 - xi - eta, xi, eta], axis=-1), np.tile(gradients, (len(weights), 1, 1)))


def _quad(points: Floats, weights: Floats) -> Rule:
    corner = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    factor = 1.0 + points[:, None, :] * corner
    gradients = np.stack([corner[:, 0] * factor[..., 1], corner[:, 1] * factor[..., 0]], axis=-1) / 4.0
    return Rule(weights, factor[..., 0] * factor[..., 1] / 4.0, gradients)


_G = 1.0 / np.sqrt(3.0)
_MOST, _MISS = 20, 1e-14  # iterations to a place in a cell, and how far from it they may end, over the cell's size
_MIDDLE = _triangle(np.array([[1.0, 1.0]]) / 3.0, np.array([0.5]))
_THREE = _triangle(np.array([[1.0, 1.0], [4.0, 1.0], [1.0, 4.0]]) / 6.0, np.full(3, 1.0 / 6.0))
_GAUSS = _quad(np.array([[-_G, -_G], [_G, -_G], [_G, _G], [-_G, _G]]), np.ones(4))

STIFFNESS_RULES: dict[int, Rule] = {3: _MIDDLE, 4: _GAUSS}
MASS_RULES: dict[int, Rule] = {3: _THREE, 4: _GAUSS}
CENTROID_RULES: dict[int, Rule] = {3: _MIDDLE, 4: _quad(np.zeros((1, 2)), np.array([4.0]))}


def shape_at(points: Floats, place: Floats) -> Floats:
    """(2.1) Shape functions (k,) of a convex cell with points (k, 2) at a place (2,) inside it, by Newton's method."""
    shape = _triangle if len(points) == 3 else _quad
    natural, size = np.full(2, 1.0 / 3.0 if len(points) == 3 else 0.0), float(np.ptp(points, axis=0).max())
    for _ in range(_MOST):
        rule = shape(natural[None], np.ones(1))
        miss = place - rule.values[0] @ points
        if np.abs(miss).max() <= _MISS * size:
            break
        natural = natural + np.linalg.solve((rule.gradients[0].T @ points).T, miss)
    found: Floats = rule.values[0]
    return found


def rule_for(rules: dict[int, Rule], nodes: int) -> Rule:
    """The rule for cells of so many nodes; InputError if there is none."""
    if nodes not in rules:
        raise InputError(f"cells of {nodes} nodes: allowed are {sorted(rules)} (triangles, quadrilaterals)")
    return rules[nodes]


def jacobian(points: Floats, rule: Rule, numbers: Ints | None = None) -> tuple[Floats, Floats]:
    """Jacobian matrices (n, q, 2, 2) [d x_j / d xi_i] and determinants (n, q) of cells with points (n, k, 2).

    Raises InputError naming the cells whose determinant is not positive, by ``numbers`` (n,) if given.
    """
    matrix = rule.gradients.swapaxes(1, 2) @ points[:, None]
    det = matrix[..., 0, 0] * matrix[..., 1, 1] - matrix[..., 0, 1] * matrix[..., 1, 0]
    bad = np.flatnonzero(~(det > 0.0).all(axis=1))
    if bad.size:
        named = bad if numbers is None else np.asarray(numbers)[bad]
        listed = ", ".join(str(i) for i in named[:5]) + (", ..." if bad.size > 5 else "")
        raise InputError(
            f"{bad.size} cells with a Jacobian that is not positive (cells {listed}): "
            "nodes must run counter-clockwise around a convex cell of positive area"
        )
    return matrix, det


def gradients(points: Floats, rule: Rule, numbers: Ints | None = None) -> tuple[Floats, Floats]:
    """Shape function gradients (n, q, k, 2) [1/length] and weights (n, q) [area]; errors as ``jacobian``."""
    matrix, det = jacobian(points, rule, numbers)
    adjugate = np.empty_like(matrix)
    adjugate[..., 0, 0] = matrix[..., 1, 1]
    adjugate[..., 1, 1] = matrix[..., 0, 0]
    adjugate[..., 0, 1] = -matrix[..., 0, 1]
    adjugate[..., 1, 0] = -matrix[..., 1, 0]
    physical = rule.gradients @ (adjugate / det[..., None, None]).swapaxes(2, 3)
    return physical, det * rule.weights
