"""Solids: T3 and Q4 of unit thickness in the plane, T4 and H8 in space, by the number of nodes.

Dofs (x, y) or (x, y, z) node by node. Voigt order xx, yy, xy or xx, yy, zz, yz, xz, xy, engineering shear strain.
"""

from __future__ import annotations

import numpy as np

from fracflow.elements.facet import spread
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

VOIGT = {2: ((0, 0), (1, 1), (0, 1)), 3: ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))}
"""Components (i, j) of tensors by dimension, v of them: 3 or 6."""


def voigt(tensor: Floats) -> Floats:
    """Components (..., v) of symmetric tensors (..., dim, dim), shear as it stands."""
    return np.stack([tensor[..., i, j] for i, j in VOIGT[tensor.shape[-1]]], axis=-1)


def _strain_operator(points: Floats, rule: Rule, numbers: Ints | None) -> tuple[Floats, Floats]:
    """Voigt strain-displacement matrices (n, q, v, dim k) and weights (n, q)."""
    slope, weight = gradients(points, rule, numbers)
    cells, places, nodes, dim = slope.shape
    operator = np.zeros((cells, places, len(VOIGT[dim]), nodes, dim))
    for row, (i, j) in enumerate(VOIGT[dim]):
        operator[:, :, row, :, i] = slope[..., j]
        operator[:, :, row, :, j] = slope[..., i]
    return operator.reshape(cells, places, -1, dim * nodes), weight


def _strain(points: Floats, displacement: Floats, rule: Rule, numbers: Ints | None) -> tuple[Floats, Floats]:
    """Voigt strains (n, q, v) of nodal displacements (n, k, dim), with engineering shear, and weights (n, q)."""
    slope, weight = gradients(points, rule, numbers)
    parts = VOIGT[slope.shape[-1]]
    result = np.empty((*slope.shape[:2], len(parts)))
    for row, (i, j) in enumerate(parts):
        result[..., row] = np.einsum("nqk,nk->nq", slope[..., i], displacement[..., j])
        if i != j:
            result[..., row] += np.einsum("nqk,nk->nq", slope[..., j], displacement[..., i])
    return result, weight


def stiffness(points: Floats, elasticity: Floats, numbers: Ints | None = None) -> Floats:
    """(2.39) Element matrices of K_S: int B' D B.

    points (n, k, dim) [length], elasticity D (n, v, v) [stress]; returns (n, dim k, dim k) [force/length]. InputError
    names cells of non-positive Jacobian, by ``numbers`` (n,) if given; so in all functions here.
    """
    operator, weight = _strain_operator(points, rule_for(STIFFNESS_RULES, points), numbers)
    cells, _, _, dofs = operator.shape
    weighted = (weight[..., None, None] * (elasticity[:, None] @ operator)).reshape(cells, -1, dofs)
    return np.asarray(operator.reshape(cells, -1, dofs).transpose(0, 2, 1) @ weighted)


def mass_consistent(points: Floats, density: Floats | float, numbers: Ints | None = None) -> Floats:
    """(2.38) Consistent mass int rho N_i N_j (n, k, k), one for all components; density number or (n,)."""
    rule = rule_for(MASS_RULES, points)
    _, det = jacobian(points, rule, numbers)
    shapes = np.einsum("q,qi,qj->qij", rule.weights, rule.values, rule.values)
    return np.asarray(np.einsum("nq,qij->nij", det * np.atleast_1d(density)[:, None], shapes))


def mass_lumped(points: Floats, density: Floats | float, numbers: Ints | None = None) -> Floats:
    """(2.38) Nodal masses (n, k), row sums of the consistent mass: int rho N_i; density number or (n,)."""
    rule = rule_for(MASS_RULES, points)
    _, det = jacobian(points, rule, numbers)
    return np.asarray((det * np.atleast_1d(density)[:, None]) @ (rule.weights[:, None] * rule.values))


def area(points: Floats, numbers: Ints | None = None) -> Floats:
    """Areas, or volumes, (n,) of cells with points (n, k, dim)."""
    return np.asarray(mass_lumped(points, 1.0, numbers).sum(axis=1))


def body_force(points: Floats, force: Floats, numbers: Ints | None = None) -> Floats:
    """(2.38) Nodal forces (n, dim k) of a body force (n, dim) [force/volume], constant in each cell: int N b."""
    nodal = mass_lumped(points, 1.0, numbers)[:, :, None] * np.asarray(force, dtype=float)[:, None, :]
    return np.asarray(nodal.reshape(len(points), -1))


def stiffness_points(points: Floats) -> Floats:
    """Places (n, q, dim) of the points by which the stiffness of cells with nodes (n, k, dim) is integrated."""
    rule = rule_for(STIFFNESS_RULES, points)
    return np.asarray(np.einsum("qk,nkd->nqd", rule.values, points))


def initial_stress_force(points: Floats, stress: Floats, numbers: Ints | None = None) -> Floats:
    """(4.4b) F_s(sigma_0) = int B' sigma_0: internal nodal forces (n, dim k) of a stress.

    stress (n, v), constant in each cell, or (n, q, v) at its ``stiffness_points`` [stress].
    """
    operator, weight = _strain_operator(points, rule_for(STIFFNESS_RULES, points), numbers)
    at_points = np.broadcast_to(stress[:, None], operator.shape[:3]) if stress.ndim == 2 else stress
    return np.asarray(np.einsum("nq,nqij,nqi->nj", weight, operator, at_points))


def strain_at_centroid(points: Floats, displacement: Floats, numbers: Ints | None = None) -> Floats:
    """Strain (n, v) at the centres of cells from nodal displacements (n, k, dim)."""
    return _strain(points, displacement, rule_for(CENTROID_RULES, points), numbers)[0][:, 0]


def stress(strain: Floats, elasticity: Floats, initial_stress: Floats | float = 0.0) -> Floats:
    """(2.13) Stress (n, v), tension positive: sigma_0 + D strain; elasticity (n, v, v)."""
    return np.asarray(np.einsum("nij,nj->ni", elasticity, strain) + initial_stress)


def strain_energy(points: Floats, displacement: Floats, elasticity: Floats, initial_stress: Floats) -> Floats:
    """(2.13) Energy (n,) stored in cells by nodal displacements (n, k, dim): int (eps D eps / 2 + sigma_0 eps).

    elasticity (n, v, v), initial_stress (n, q, v) at the ``stiffness_points`` [stress]; per unit thickness in the plane.
    """
    strain, weight = _strain(points, displacement, rule_for(STIFFNESS_RULES, points), None)
    mean_stress = 0.5 * np.einsum("nij,nqj->nqi", elasticity, strain) + initial_stress
    return np.asarray(np.einsum("nq,nqi,nqi->n", weight, strain, mean_stress))


def kinetic_energy(points: Floats, velocity: Floats, density: Floats, lumped: bool) -> Floats:
    """(4.4a) Kinetic energy (n,) of cells with nodal velocities (n, k, dim), of the lumped or the consistent mass of (2.38)."""
    if lumped:
        return np.asarray(0.5 * np.einsum("nk,nkd->n", mass_lumped(points, density), velocity**2))
    return np.asarray(0.5 * np.einsum("nkl,nkd,nld->n", mass_consistent(points, density), velocity, velocity))


def traction_force(points: Floats, traction: Floats) -> Floats:
    """(2.38) Consistent nodal forces (s, k, dim) [facet, node, component] of a traction in global axes.

    points (s, k, dim) of facets; traction (s, dim), constant on each, or (s, k, dim), linear between its nodes [stress].
    """
    traction = np.asarray(traction, dtype=float)
    at_nodes = np.stack([traction] * points.shape[1], axis=1) if traction.ndim == 2 else traction
    return spread(points, at_nodes)
