"""Isotropic linear elasticity in plane strain; Voigt order xx, yy, xy with engineering shear strain."""

from __future__ import annotations

import numpy as np

from fracflow.laws.base import Floats, Parameter


def plane_strain_stiffness(youngs_modulus: Parameter, poissons_ratio: Parameter) -> Floats:
    """(2.13) Stiffness D (n, 3, 3) with stress = D strain [stress].

    youngs_modulus (n,) [stress], poissons_ratio (n,), below 1/2; numbers give n = 1.
    """
    modulus, ratio = np.broadcast_arrays(
        np.atleast_1d(np.asarray(youngs_modulus, float)), np.atleast_1d(np.asarray(poissons_ratio, float))
    )
    lame = modulus * ratio / ((1.0 + ratio) * (1.0 - 2.0 * ratio))
    shear = modulus / (2.0 * (1.0 + ratio))
    stiffness = np.zeros((len(modulus), 3, 3))
    stiffness[:, 0, 0] = stiffness[:, 1, 1] = lame + 2.0 * shear
    stiffness[:, 0, 1] = stiffness[:, 1, 0] = lame
    stiffness[:, 2, 2] = shear
    return stiffness


def out_of_plane_stress(stress: Floats, poissons_ratio: Parameter) -> Floats:
    """(2.13) sigma_zz (n,) = nu (sigma_xx + sigma_yy) of a stress change (n, 3) from the initial state."""
    sigma_zz: Floats = np.multiply(poissons_ratio, stress[:, 0] + stress[:, 1])
    return sigma_zz
