"""(Lysmer and Kuhlemeyer 1969) Dashpots on a side, plane waves that meet it, and what it sends back."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def lame(youngs_modulus: Any, poissons_ratio: Any) -> tuple[Any, Any]:
    """Lame's lambda and mu of plane strain [stress]."""
    shear = youngs_modulus / (2.0 * (1.0 + poissons_ratio))
    return 2.0 * shear * poissons_ratio / (1.0 - 2.0 * poissons_ratio), shear


def impedance_blocks(length: Floats, normal: Floats, of_p: Floats, of_s: Floats) -> Floats:
    """What each end of facets (n,) resists its velocity with, (n, dim, dim): L/2 (rho c_p n n' + rho c_s (1 - n n')).

    normal  (n, dim) unit normals; of_p, of_s  rho c_p and rho c_s (n,) [stress time/length]
    """
    along = np.einsum("ni,nj->nij", normal, normal)
    across = np.eye(normal.shape[1]) - along
    blocks: Floats = 0.5 * length[:, None, None] * (of_p[:, None, None] * along + of_s[:, None, None] * across)
    return blocks


def wave_traction(normal: Floats, direction: Any, motion: Any, lam: Any, shear: Any, speed: Any) -> Any:
    """Traction (n, dim) on planes with ``normal`` (n, dim) in a plane wave, per unit of its particle velocity.

    The wave travels along the unit vector ``direction`` at ``speed``, its rock moves along the unit vector ``motion``:
    stress -(lambda div + 2 mu sym)(motion direction)/speed.
    """
    lam, shear, speed = (np.asarray(x, dtype=float)[..., None] for x in (lam, shear, speed))
    across, turned = normal @ direction, normal @ motion
    both = motion * across[..., None] + direction * turned[..., None]
    return -(lam * (motion @ direction) * normal + shear * both) / speed


ANGLES = (0.0, 45.0, 60.0, 75.0)


def reflections(poissons_ratio: float) -> str:
    """What comes back of a P wave by its angle, in words."""
    return ", ".join(f"{reflection(poissons_ratio, angle):.3f} at {angle:.0f}" for angle in ANGLES) + " degrees"


def reflection(poissons_ratio: float, degrees: float, kind: str = "p") -> float:
    """Amplitude that dashpots send back in a wave's own kind, over that of the plane wave that meets them at an angle.

    degrees  between the way of the wave and the normal, below 90
    kind     "p", or "s" in the plane

    From the balance of tractions: that of the incident and both reflected waves is -C of their velocities.
    """
    lam, shear = lame(2.0 * (1.0 + poissons_ratio), poissons_ratio)  # mu = 1, rho = 1
    fast, slow = np.sqrt(lam + 2.0 * shear), np.sqrt(shear)
    speed = fast if kind == "p" else slow
    slowness = np.sin(np.radians(degrees)) / speed
    normal, damping = np.array([1.0, 0.0]), np.diag([fast, slow])

    def way(at: float, sign: float) -> Any:
        """Unit vector of a wave of that speed; beyond the critical angle complex, of one that fades into the rock."""
        along = slowness * at
        return np.array([sign * np.conj(np.sqrt(complex(1.0 - along**2))), along])

    def left(direction: Any, motion: Any, at: float) -> Any:
        return wave_traction(normal[None], direction, motion, lam, shear, at)[0] + damping @ motion

    def across(direction: Any) -> Any:
        return np.array([-direction[1], direction[0]])

    out_p, out_s, come = way(fast, -1.0), way(slow, -1.0), way(speed, 1.0)
    back = np.stack([left(out_p, out_p, fast), left(out_s, across(out_s), slow)], axis=1)
    amplitudes = np.linalg.solve(back, -left(come, come if kind == "p" else across(come), speed))
    return float(abs(amplitudes[0 if kind == "p" else 1]))
