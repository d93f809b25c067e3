"""How rough walls conduct: a hydraulic aperture apart from the mechanical one, and a conductance that grows with slip."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fracflow.laws.base import Floats


@dataclass(frozen=True, eq=False)
class PlasticSlip:
    """Plastic slip at both ends of n elements: ``slip`` (n, 2, dim-1), and its derivatives ``by_strain`` (n, 2, dim-1, dim)."""

    slip: Floats
    by_strain: Floats

    @staticmethod
    def of(slip: Floats, moduli: Floats, shear_stiffness: Floats) -> PlasticSlip:
        """That of n sections, eps_s - (f_s - f_s0)/k_s; moduli d f_s/d eps (n, dim-1, dim), k_s (n,) or NaN without slip."""
        slips = np.isfinite(shear_stiffness)[:, None, None]
        elastic = moduli / np.where(slips, shear_stiffness[:, None, None], 1.0)
        return PlasticSlip(slip, np.where(slips, np.eye(moduli.shape[2])[:-1] - elastic, 0.0))


@dataclass(frozen=True, eq=False)
class Roughness:
    """Of walls at both ends of n elements; arrays (n, 2).

    aperture  w_h0, hydraulic aperture at the initial state [length]
    ratio     f, of the hydraulic to the mechanical opening
    most      m, conductance after much slip over that without
    distance  L of that slip [length]; any where m is 1

    The cubic law has the aperture w_h = w_h0 + f (w - w_0) (Rutqvist and Stephansson 2003). A conductance is F(s) times that
    without slip, F = m - (m - 1) exp(-s/L), the mean of both ends. It solves dk/ds = (k_max - k)/L, as the permeability of
    Zhu, Allison, Dunham and Yang (2020) does in slip one way without healing. Their walls keep it when
    they slip back. These conduct less again, since s is the length of the net plastic slip.
    """

    aperture: Floats
    ratio: Floats
    most: Floats
    distance: Floats

    @property
    def grows(self) -> bool:
        """Whether slip changes a conductance of these."""
        return bool(np.any(self.most != 1.0))

    def factor(self, plastic: PlasticSlip) -> tuple[Floats, Floats]:
        """F (n,) of the elements, and its derivatives (n, 2, dim) by the strains of their ends."""
        size = np.linalg.norm(plastic.slip, axis=2)
        way = plastic.slip / np.where(size > 0.0, size, 1.0)[:, :, None]
        grows = self.most != 1.0
        distance = np.where(grows, self.distance, 1.0)
        left = (self.most - 1.0) * np.exp(-size / distance)
        slope = 0.5 * np.where(grows, left / distance, 0.0)
        by_strain = slope[:, :, None] * np.einsum("net,netd->ned", way, plastic.by_strain)
        return np.asarray((self.most - left).mean(axis=1)), by_strain
