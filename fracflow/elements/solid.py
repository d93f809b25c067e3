"""Plane strain solids of unit thickness: T3 and Q4 by the number of nodes; dofs (x, y) node by node."""

from __future__ import annotations

import numpy as np

from fracflow.elements.shape import (
    CENTROID_RULES,
    MASS_RULES,
    STIFFNESS_RULES,
    Floats,
    Ints,
    Rule,
    gradients,
    jacobian,
    rule_for,
)


def _strain_operator(points: Floats, rule: Rule, numbers: Ints | None) -> tuple[Floats, Floats]:
    """Voigt strain-displacement matrices (n, q, 3, 2k) and weights (n, q)."""
    slope, weight = gradients(points, rule, numbers)
    cells, places, nodes, _ = slope.shape
    operator = np.zeros((cells, places, 3, nodes, 2))
    operator[:, :, 0, :, 0] = operator[:, :, 2, :, 1] = slope[..., 0]
    operator[:, :, 1, :, 1] = operator[:, :, 2, :, 0] = slope[..., 1]
    return operator.reshape(cells, places, 3, 2 * nodes), weight


def stiffness(points: Floats, elasticity: Floats, numbers: Ints | None = None) -> Floats:
    """(2.39) Element matrices of K_S: int B' D B.

    points (n, k, 2) [length], elasticity D (n, 3, 3) [stress]; returns (n, 2k, 2k) [stress]. InputError names
    cells of non-positive Jacobian, by ``numbers`` (n,) if given; so in all functions here.
    """
    operator, weight = _strain_operator(points, rule_for(STIFFNESS_RULES, points.shape[1]), numbers)
    cells, _, _, dofs = operator.shape
    weighted = (weight[..., None, None] * (elasticity[:, None] @ operator)).reshape(cells, -1, dofs)
    result: Floats = operator.reshape(cells, -1, dofs).transpose(0, 2, 1) @ weighted
    return result


def mass_consistent(points: Floats, density: Floats | float, numbers: Ints | None = None) -> Floats:
    """(2.38) Consistent mass int rho N_i N_j (n, k, k), one for both components; density number or (n,)."""
    rule = rule_for(MASS_RULES, points.shape[1])
    _, det = jacobian(points, rule, numbers)
    shapes = np.einsum("q,qi,qj->qij", rule.weights, rule.values, rule.values)
    result: Floats = np.einsum("nq,qij->nij", det * np.atleast_1d(density)[:, None], shapes)
    return result


def mass_lumped(points: Floats, density: Floats | float, numbers: Ints | None = None) -> Floats:
    """(2.38) Nodal masses (n, k), row sums of the consistent mass: int rho N_i; density number or (n,)."""
    rule = rule_for(MASS_RULES, points.shape[1])
    _, det = jacobian(points, rule, numbers)
    result: Floats = (det * np.atleast_1d(density)[:, None]) @ (rule.weights[:, None] * rule.values)
    return result


def area(points: Floats, numbers: Ints | None = None) -> Floats:
    """Areas (n,) of cells with points (n, k, 2)."""
    result: Floats = mass_lumped(points, 1.0, numbers).sum(axis=1)
    return result


def body_force(points: Floats, force: Floats, numbers: Ints | None = None) -> Floats:
    """(2.38) Nodal forces (n, 2k) of a body force (n, 2) [force/volume], constant in each cell: int N b."""
    nodal = mass_lumped(points, 1.0, numbers)[:, :, None] * np.asarray(force, dtype=float)[:, None, :]
    result: Floats = nodal.reshape(len(points), -1)
    return result


def stiffness_points(points: Floats) -> Floats:
    """Places (n, q, 2) of the points by which the stiffness of cells with nodes (n, k, 2) is integrated."""
    rule = rule_for(STIFFNESS_RULES, points.shape[1])
    result: Floats = np.einsum("qk,nkd->nqd", rule.values, points)
    return result


def initial_stress_force(points: Floats, stress: Floats, numbers: Ints | None = None) -> Floats:
    """(4.4b) F_s(sigma_0) = int B' sigma_0: internal nodal forces (n, 2k) of a stress xx, yy, xy.

    stress (n, 3), constant in each cell, or (n, q, 3) at its ``stiffness_points`` [stress].
    """
    operator, weight = _strain_operator(points, rule_for(STIFFNESS_RULES, points.shape[1]), numbers)
    at_points = np.broadcast_to(stress[:, None], (*weight.shape, 3)) if stress.ndim == 2 else stress
    result: Floats = np.einsum("nq,nqij,nqi->nj", weight, operator, at_points)
    return result


def strain_at_centroid(points: Floats, displacement: Floats, numbers: Ints | None = None) -> Floats:
    """Strain (n, 3), xx, yy, engineering xy, at the centres of cells from nodal displacements (n, k, 2)."""
    operator, _ = _strain_operator(points, rule_for(CENTROID_RULES, points.shape[1]), numbers)
    result: Floats = np.einsum("nij,nj->ni", operator[:, 0], displacement.reshape(len(points), -1))
    return result


def stress(strain: Floats, elasticity: Floats, initial_stress: Floats | float = 0.0) -> Floats:
    """(2.13) Stress (n, 3), xx, yy, xy, tension positive: sigma_0 + D strain; elasticity (n, 3, 3)."""
    result: Floats = np.einsum("nij,nj->ni", elasticity, strain) + initial_stress
    return result


def strain_energy(points: Floats, displacement: Floats, elasticity: Floats, initial_stress: Floats) -> Floats:
    """(2.13) Energy (n,) stored in cells by nodal displacements (n, k, 2): int (eps D eps / 2 + sigma_0 eps).

    elasticity (n, 3, 3), initial_stress (n, q, 3) at the ``stiffness_points`` [stress]; per unit thickness.
    """
    operator, weight = _strain_operator(points, rule_for(STIFFNESS_RULES, points.shape[1]), None)
    strain = np.einsum("nqij,nj->nqi", operator, displacement.reshape(len(points), -1))
    mean_stress = 0.5 * np.einsum("nij,nqj->nqi", elasticity, strain) + initial_stress
    result: Floats = np.einsum("nq,nqi,nqi->n", weight, strain, mean_stress)
    return result


def kinetic_energy(points: Floats, velocity: Floats, density: Floats, lumped: bool) -> Floats:
    """(4.4a) Kinetic energy (n,) of cells with nodal velocities (n, k, 2), of the lumped or the consistent mass of (2.38)."""
    if lumped:
        result: Floats = 0.5 * np.einsum("nk,nkd->n", mass_lumped(points, density), velocity**2)
    else:
        result = 0.5 * np.einsum("nkl,nkd,nld->n", mass_consistent(points, density), velocity, velocity)
    return result


def edge_length(points: Floats) -> Floats:
    """Lengths (s,) of facets with points (s, 2, 2)."""
    result: Floats = np.linalg.norm(points[:, 1] - points[:, 0], axis=-1)
    return result


def traction_force(points: Floats, traction: Floats) -> Floats:
    """(2.38) Consistent nodal forces (s, 2, 2) [facet, node, component] of a traction in global axes.

    points (s, 2, 2); traction (s, 2), constant on each facet, or (s, 2, 2), linear between its nodes.
    """
    traction = np.asarray(traction, dtype=float)
    at_nodes = np.stack([traction, traction], axis=1) if traction.ndim == 2 else traction
    pair = np.array([[2.0, 1.0], [1.0, 2.0]]) / 6.0
    result: Floats = edge_length(points)[:, None, None] * np.einsum("ij,sjd->sid", pair, at_nodes)
    return result
