"""Zero-thickness joints between two facets of k nodes.

Dofs: nodes of the bottom, then those of the top, components x, y (, z) each (the report numbers the top nodes 4, 3).
Strain and traction have the components of the facet's frame, slips first and normal last, tension and opening positive.
"""

from __future__ import annotations

import numpy as np

from fracflow.elements.shape import Floats


def jump_operator(frame: Floats, shapes: Floats) -> Floats:
    """(2.1)-(2.9) Operator (n, q, dim, 2 k dim) from joint dofs to strain (slips, opening) at points.

    frame (n, dim, dim) global to local; shapes (q, k) shape functions of the facet there. Strain = top minus bottom
    displacement, joint frame [length].
    """
    phi = np.concatenate([-shapes, shapes], axis=-1)
    joints, dim, _ = frame.shape
    operator: Floats = np.einsum("qa,nij->nqiaj", phi, frame)
    return operator.reshape(joints, len(phi), dim, phi.shape[1] * dim)


def strain(jump_operator: Floats, displacement: Floats) -> Floats:
    """(2.5) Strain (n, q, dim) of joint displacements (n, 2 k dim) [length]."""
    return np.asarray(np.einsum("nqij,nj->nqi", jump_operator, displacement))


def traction_from_stress(frame: Floats, stress: Floats) -> Floats:
    """(2.14) Traction (n, dim) in the joint frame of a stress tensor (n, dim, dim): frame sigma n.

    Total traction if the stress is total; the effective one has the pressure added to the normal component.
    """
    return np.asarray(np.einsum("nij,njk,nk->ni", frame, stress, frame[:, -1]))


def tangent(jump_operator: Floats, moduli: Floats, weight: Floats) -> Floats:
    """(2.20)-(2.23), (2.32) Tangent (n, 2 k dim, 2 k dim); moduli d traction / d strain (n, q, dim, dim).

    weight (n, q) length or area that each point stands for.
    """
    joints, _, _, dofs = jump_operator.shape
    weighted = (weight[..., None, None] * (moduli @ jump_operator)).reshape(joints, -1, dofs)
    return np.asarray(jump_operator.reshape(joints, -1, dofs).transpose(0, 2, 1) @ weighted)
