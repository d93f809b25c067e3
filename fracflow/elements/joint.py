"""Zero-thickness joints between two faces.

Dofs: bottom 1, bottom 2, top 1, top 2, components x, y each (the report numbers the top nodes 4, 3).
Strain and traction have components (s, n), normal last, tension and opening positive.
"""

from __future__ import annotations

import numpy as np

from fracflow.elements.shape import Floats, Ints, line_shape
from fracflow.errors import InputError

_G = 1.0 / np.sqrt(3.0)
# natural coordinates and weights on [-1, 1]; "nodal" is (2.30)
RULES: dict[str, tuple[Floats, Floats]] = {
    "nodal": (np.array([-1.0, 1.0]), np.array([1.0, 1.0])),
    "gauss2": (np.array([-_G, _G]), np.array([1.0, 1.0])),
    "one-point": (np.array([0.0]), np.array([2.0])),
}


def frame(points: Floats, numbers: Ints | None = None) -> tuple[Floats, Floats]:
    """(2.3b) Frames (n, 2, 2), rows s and n, s from node 1 to node 2, n = s turned left; and lengths (n,).

    points (n, 2, 2) of one face. InputError names the joints of no length, by ``numbers`` (n,) if given.
    """
    along = points[:, 1] - points[:, 0]
    length = np.linalg.norm(along, axis=-1)
    bad = np.flatnonzero(~(length > 0.0))
    if bad.size:
        named = bad if numbers is None else np.asarray(numbers)[bad]
        listed = ", ".join(str(i) for i in named[:5]) + (", ..." if bad.size > 5 else "")
        raise InputError(f"{bad.size} fracture facets of no length (facets {listed}): end points must differ")
    s = along / length[:, None]
    n = np.stack([-s[:, 1], s[:, 0]], axis=-1)
    return np.stack([s, n], axis=1), length


def jump_operator(frame: Floats, xi: Floats) -> Floats:
    """(2.1)-(2.9) Operator (n, q, dim, 4 dim) from joint dofs to strain (slip, opening) at points xi (q,).

    frame (n, dim, dim) global to local. Strain = top minus bottom displacement, joint frame [length].
    """
    psi = line_shape(xi)
    phi = np.concatenate([-psi, psi], axis=-1)
    joints, dim, _ = frame.shape
    operator: Floats = np.einsum("qa,nij->nqiaj", phi, frame)
    return operator.reshape(joints, len(phi), dim, phi.shape[1] * dim)


def section_length(length: Floats, weights: Floats) -> Floats:
    """(2.30) Length (n, q) each rule point stands for: L/2 times its weight."""
    each: Floats = 0.5 * length[:, None] * np.asarray(weights, dtype=float)
    return each


def strain(jump_operator: Floats, displacement: Floats) -> Floats:
    """(2.5) Strain (n, q, dim) of joint displacements (n, 4 dim)."""
    jump: Floats = np.einsum("nqij,nj->nqi", jump_operator, displacement)
    return jump


def traction_from_stress(frame: Floats, stress: Floats) -> Floats:
    """(2.14) Traction (n, dim) in the joint frame of a stress tensor (n, dim, dim): frame sigma n.

    Total traction if the stress is total; the effective one has the pressure added to the normal component.
    """
    traction: Floats = np.einsum("nij,njk,nk->ni", frame, stress, frame[:, -1])
    return traction


def tangent(jump_operator: Floats, moduli: Floats, weight: Floats) -> Floats:
    """(2.20)-(2.23), (2.32) Tangent (n, 4 dim, 4 dim); moduli d traction / d strain (n, q, dim, dim)."""
    joints, _, _, dofs = jump_operator.shape
    weighted = (weight[..., None, None] * (moduli @ jump_operator)).reshape(joints, -1, dofs)
    stiffness: Floats = jump_operator.reshape(joints, -1, dofs).transpose(0, 2, 1) @ weighted
    return stiffness
