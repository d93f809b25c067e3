"""Two-node flow elements along joints; the unknown is pressure, flow rates are per unit depth."""

from __future__ import annotations

import numpy as np

from fracflow.elements.shape import Floats
from fracflow.errors import InputError

STORAGE: dict[str, Floats] = {
    "consistent": np.array([[2.0, 1.0], [1.0, 2.0]]) / 6.0,  # (2.37)
    "averaging": np.array([[1.0, 1.0], [1.0, 1.0]]) / 4.0,  # (3.16)
    "lumped": np.array([[1.0, 0.0], [0.0, 1.0]]) / 2.0,
}
_ENDS = np.array([1.0, -1.0])


def storage_matrix(kind: str, length: Floats) -> Floats:
    """(2.37), (3.16) Matrices e (n, 2, 2) [length], L/2 times the identity if "lumped".

    kind "consistent", "averaging" or "lumped", InputError for others; length (n,). e maps end pressures to
    end wall forces, and end opening rates to end storage rates.
    """
    if kind not in STORAGE:
        raise InputError(f"storage matrix {kind!r}: allowed are {', '.join(STORAGE)}")
    matrices: Floats = np.asarray(length, dtype=float)[:, None, None] * STORAGE[kind]
    return matrices


def conductivity(conductance: Floats) -> Floats:
    """(3.8)-(3.14a) k_F (n, 2, 2) of conductances (n,) [flow rate/pressure]; k_F p = flow rates into it."""
    matrices: Floats = np.einsum("n,i,j->nij", conductance, _ENDS, _ENDS)
    return matrices


def element_flow(conductance: Floats, pressure: Floats) -> Floats:
    """(3.4) Flow rate (n,) at mid-element, positive in +s: c (p_1 - p_2); pressure (n, 2)."""
    return conductance * (pressure[:, 0] - pressure[:, 1])


def conductivity_tangent(dconductance: Floats, pressure: Floats) -> Floats:
    """(3.14) Derivative (n, 2, 2) of k_F p: [flow node, end opening].

    dconductance (n, 2) derivatives of the conductance with respect to the two end openings, pressure (n, 2).
    """
    drop: Floats = pressure[:, 0] - pressure[:, 1]
    blocks: Floats = _ENDS[:, None] * (drop[:, None] * dconductance)[:, None, :]
    return blocks
