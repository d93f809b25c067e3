"""(Lysmer and Kuhlemeyer 1969) Dashpots on a side, plane waves that meet it, and what it sends back."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fracflow.elements.shape import gauss

Floats = NDArray[np.float64]


def impedance_blocks(size: Floats, normal: Floats, of_p: Floats, of_s: Floats) -> Floats:
    """Resistance of each node of facets to its velocity, (n, k, dim, dim): A (rho c_p n n' + rho c_s (1 - n n')).

    size  (n, k) length or area A that each node stands for, L/2 of lines
    normal  (n, dim) unit normals; of_p, of_s  rho c_p and rho c_s (n,) [stress time/length]
    """
    along = np.einsum("ni,nj->nij", normal, normal)
    across = np.eye(normal.shape[1]) - along
    each = of_p[:, None, None] * along + of_s[:, None, None] * across
    return np.asarray(size[:, :, None, None] * each[:, None])


def wave_traction(normal: Floats, direction: Any, motion: Any, lam: Any, shear: Any, speed: Any) -> Any:
    """Traction (n, dim) on planes with ``normal`` (n, dim) in a plane wave, per unit of its particle velocity.

    The wave travels along the unit vector ``direction`` at ``speed``, its rock moves along the unit vector ``motion``:
    stress -(lambda div + 2 mu sym)(motion direction)/speed.
    """
    lam, shear, speed = (np.asarray(x, dtype=float)[..., None] for x in (lam, shear, speed))
    across, turned = normal @ direction, normal @ motion
    both = motion * across[..., None] + direction * turned[..., None]
    return -(lam * (motion @ direction) * normal + shear * both) / speed


def silent_distance(fast: float, time: float) -> float:
    """Distance c_p t/2 of a side [length]: nothing that leaves then or later is back from it within that ``time``.

    fast  c_p of the rock on the way, the largest [length/time]
    """
    return 0.5 * fast * time


DashpotShares = float | tuple[float, float]
"""Of the dashpots rho c_p across and rho c_s along a side, of both or of each: 0 leaves a free side."""
ANGLES = {"p": (0.0, 45.0, 60.0, 75.0), "s": (0.0, 30.0, 45.0, 60.0, 75.0)}
STEEPEST = 60.0  # degrees: waves further from the normal graze a side
POINTS = 24  # of Gauss's rule over directions, on each side of the critical angle


@cache
def reflections(poissons_ratio: float) -> tuple[str, str]:
    """Reflections of a P and of an S wave, energy and amplitudes by angle, in words that begin with the wave."""
    p, s = (_reflections(poissons_ratio, kind) for kind in ("p", "s"))
    return p, s


def _reflections(poissons_ratio: float, kind: str) -> str:
    critical = _critical(poissons_ratio, kind)
    met = [(angle, returned(poissons_ratio, angle, kind)) for angle in ANGLES[kind]]
    own, other = (0, 1) if kind == "p" else (1, 0)
    alike = ", ".join(f"{pair[own]:.3f} at {angle:.0f}" for angle, pair in met)
    unlike = ", ".join(f"{pair[other]:.3f}" for angle, pair in met if angle < critical)
    most = max(energy_returned(poissons_ratio, float(angle), kind) for angle in np.arange(STEEPEST + 1.0))
    return (
        f"{'a P' if kind == 'p' else 'an S'} wave {energy_over_directions(poissons_ratio, kind):.1%} of the energy comes back"
        f" over all directions, at most {most:.1%} up to {STEEPEST:.0f} degrees from the normal; of its amplitude {alike}"
        f" degrees as {'PS'[own]}, {unlike} as {'PS'[other]}{'' if kind == 'p' else f' (none beyond {critical:.0f})'}"
    )


def reflection(poissons_ratio: float, degrees: float, kind: str = "p") -> float:
    """Amplitude that dashpots send back in a wave's own kind; see ``returned``."""
    return returned(poissons_ratio, degrees, kind)[0 if kind == "p" else 1]


def returned(poissons_ratio: float, degrees: float, kind: str, share: DashpotShares = 1.0) -> tuple[float, float]:
    """Amplitudes of the P and S wave that dashpots send back, over that of the plane wave that meets them at an angle.

    degrees  between the way of the wave and the normal, below 90
    kind     "p", or "s" in the plane
    share    of the dashpots

    From the balance of tractions: that of the incident and both reflected waves is -C of their velocities. A P wave that
    fades into the rock, of an S wave beyond its critical angle, carries nothing away and counts as 0.
    """
    amplitudes, cosines = _sent_back(poissons_ratio, degrees, kind, share)
    p, s = np.where(cosines > 0.0, amplitudes, 0.0)
    return float(p), float(s)


def energy_returned(poissons_ratio: float, degrees: float, kind: str, share: DashpotShares = 1.0) -> float:
    """Power that both waves carry away from a unit of the side, over what the wave brings; arguments as of ``returned``."""
    (fast, slow), (amplitudes, cosines) = _speeds(poissons_ratio), _sent_back(poissons_ratio, degrees, kind, share)
    own = fast if kind == "p" else slow
    return float((amplitudes**2 * cosines) @ (fast, slow) / (own * np.cos(np.radians(degrees))))


@cache
def energy_over_directions(poissons_ratio: float, kind: str, share: DashpotShares = 1.0) -> float:
    """Share of the energy that comes back where waves of one kind come as strong from all directions of the plane.

    Of P and S together it is least with 0.75 of the dashpots along a side at Poisson's ratio 1/4: 6.4 % for 8.1 %. The whole
    ones stay: with less, 1/7 of the amplitude of an S wave along the normal comes back, which otherwise leaves without a rest.
    """
    critical = _critical(poissons_ratio, kind)
    at, weight = gauss(POINTS)
    back = 0.0
    for low, high in ((0.0, critical), (critical, 90.0)):
        angles = low + (high - low) * at
        weights = np.radians(high - low) * weight * np.cos(np.radians(angles))  # power on a unit of the side
        back += sum(
            w * energy_returned(poissons_ratio, float(a), kind, share) for a, w in zip(angles, weights, strict=True)
        )
    return float(back)


def _speeds(poissons_ratio: float) -> tuple[float, float]:
    """c_p and c_s where mu = rho = 1."""
    return float(np.sqrt(_lame_over_shear(poissons_ratio) + 2.0)), 1.0


def _lame_over_shear(poissons_ratio: float) -> float:
    """lambda/mu = 2 nu/(1 - 2 nu)."""
    return 2.0 * poissons_ratio / (1.0 - 2.0 * poissons_ratio)


def _critical(poissons_ratio: float, kind: str) -> float:
    """Degrees beyond which the P wave that comes back fades into the rock; 90 of P, which never does."""
    fast, slow = _speeds(poissons_ratio)
    return 90.0 if kind == "p" else float(np.degrees(np.arcsin(slow / fast)))


def _sent_back(poissons_ratio: float, degrees: float, kind: str, share: DashpotShares) -> tuple[Floats, Floats]:
    """Amplitudes (2,) of the P and S wave, and the cosines of their angles to the normal, 0 of one that fades."""
    lam, shear = _lame_over_shear(poissons_ratio), 1.0
    fast, slow = _speeds(poissons_ratio)
    speed = fast if kind == "p" else slow
    slowness = np.sin(np.radians(degrees)) / speed
    normal, damping = np.array([1.0, 0.0]), np.diag(share * np.array([fast, slow]))

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
    given = -left(come, come if kind == "p" else across(come), speed)
    try:
        amplitudes = np.linalg.solve(back, given)
    except np.linalg.LinAlgError:  # a P wave along a free side loads it nowhere at a ratio of 0: any amplitude will do
        amplitudes = np.linalg.lstsq(back, given, rcond=None)[0]
    return np.abs(amplitudes), -np.array([out_p[0].real, out_s[0].real])
