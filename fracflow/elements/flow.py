"""Flow elements along joints, lines and surfaces; the unknown is pressure. Flow rates of lines are per unit depth."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fracflow.elements.facet import RULES, consistent, frame, nodal_sizes, section_sizes, shapes, surface_gradients
from fracflow.elements.shape import Floats
from fracflow.errors import InputError


def _averaging(points: Floats) -> Floats:
    nodes = points.shape[1]
    return frame(points)[1][:, None, None] * (np.ones((nodes, nodes)) / nodes**2)


def _lumped(points: Floats) -> Floats:
    return nodal_sizes(points)[:, :, None] * np.eye(points.shape[1])


STORAGE: dict[str, Callable[[Floats], Floats]] = {
    "consistent": consistent,  # (2.37)
    "averaging": _averaging,  # (3.16)
    "lumped": _lumped,
}
_ENDS = np.array([1.0, -1.0])


def storage_matrix(kind: str, points: Floats) -> Floats:
    """(2.37), (3.16) Matrices e (n, k, k) [length], of surfaces [area]; the nodes' own sizes on the diagonal if "lumped".

    kind "consistent", "averaging" or "lumped"; points (n, k, dim). Raises InputError for other kinds. e maps nodal pressures
    to nodal wall forces, and nodal opening rates to nodal storage rates.
    """
    if kind not in STORAGE:
        raise InputError(f"storage matrix {kind!r}: allowed are {', '.join(STORAGE)}")
    return STORAGE[kind](points)


def conductivity(conductance: Floats) -> Floats:
    """(3.8)-(3.14a) k_F (n, 2, 2) of conductances (n,) [flow rate/pressure]; k_F p = flow rates into it."""
    return np.asarray(conductance[:, None, None] * np.outer(_ENDS, _ENDS))


def element_flow(conductance: Floats, pressure: Floats) -> Floats:
    """(3.4) Flow rate (n,) at mid-element, positive in +s: c (p_1 - p_2); pressure (n, 2)."""
    return conductance * (pressure[:, 0] - pressure[:, 1])


def conductivity_tangent(dconductance: Floats, pressure: Floats) -> Floats:
    """(3.14) Derivative (n, 2, 2) of k_F p: [flow node, end opening].

    dconductance (n, 2) derivatives of the conductance with respect to the two end openings, pressure (n, 2).
    """
    drop: Floats = pressure[:, 0] - pressure[:, 1]
    return np.asarray(_ENDS[:, None] * (drop[:, None] * dconductance)[:, None, :])


def surface_conductivity(points: Floats) -> Floats:
    """(3.14a) int grad N_i grad N_j dA (n, k, k) over surfaces (n, k, 3): K_F of a transmissivity d^3/(12 mu) of 1.

    A triangle without an obtuse angle has no positive off-diagonal: pressures then stay within those that are prescribed.
    """
    sections = RULES["gauss2"][points.shape[1]]
    slope = surface_gradients(points, sections)
    return np.asarray(np.einsum("nq,nqid,nqjd->nij", section_sizes(points, sections), slope, slope))


def surface_tangent(unit: Floats, slope: Floats, pressure: Floats) -> Floats:
    """(3.14) Derivative (n, k, k) of K_F p over surfaces: [flow node, opening of a node].

    unit (n, k, k) of ``surface_conductivity``; slope (n, k) of the transmissivity by the nodal openings; pressure (n, k).
    """
    return np.asarray(np.einsum("nij,nj->ni", unit, pressure)[:, :, None] * slope[:, None, :])


def exact_surface_cube(aperture: Floats) -> tuple[Floats, Floats]:
    """(3.4) 1/mean(1/d^3) (n,) over surfaces with apertures d (n, k) at the nodes [length^3], and its slopes (n, k).

    Triangle: d1 d2 d3, exact where d is linear. Quadrilateral: 4 d1 d2 d3 d4/(d1 + d2 + d3 + d4), from the triangles at its
    four corners; where d changes along one side only it is the line's 2 d1^2 d2^2/(d1 + d2). d < 0 counts as closed.
    """
    d = np.maximum(aperture, 0.0)
    product = d.prod(axis=1)
    others = np.stack([np.delete(d, i, axis=1).prod(axis=1) for i in range(d.shape[1])], axis=1)
    if d.shape[1] == 3:
        return product, others
    total = d.sum(axis=1)
    safe = np.where(total > 0.0, total, 1.0)
    mean = 4.0 * product / safe
    return mean, (4.0 * others - mean[:, None]) / safe[:, None]


def report_surface_cube(aperture: Floats) -> tuple[Floats, Floats]:
    """(3.14f) Mean of d^3 (n,) over surfaces with apertures d (n, k) at the nodes [length^3], and its slopes (n, k).

    Triangle: mean of the ten products d_i d_j d_k; quadrilateral: of a parallelogram. d < 0 counts as closed.
    """
    d = np.maximum(aperture, 0.0)
    if d.shape[1] == 3:
        first, second, third = (np.sum(d**power, axis=1)[:, None] for power in (1, 2, 3))
        mean = (first**3 + 3.0 * first * second + 2.0 * third)[:, 0] / 60.0
        slope = (first**2 + second + 2.0 * first * d + 2.0 * d**2) / 20.0
    else:
        sections = RULES["gauss2"][4]  # exact for cubes
        values, share = shapes(sections.natural, 4), sections.weights / sections.weights.sum()
        inside = d @ values.T
        mean = inside**3 @ share
        slope = 3.0 * (inside**2 * share) @ values
    return mean, np.where(d > 0.0, slope, 0.0)


SURFACE_MEANS = {"exact": exact_surface_cube, "report": report_surface_cube}
"""Mean cubed apertures of surfaces, by the names of those of lines."""
