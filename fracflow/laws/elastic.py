"""Isotropic linear elasticity; Voigt order xx, yy, xy or xx, yy, zz, yz, xz, xy with engineering shear strain."""

from __future__ import annotations

from typing import TypeVar

import numpy as np

from fracflow.laws.base import Floats, Parameter

Moduli = TypeVar("Moduli", float, Floats)


def shear_modulus(youngs_modulus: Moduli, poissons_ratio: Moduli) -> Moduli:
    """(2.13) G = E/(2 (1 + nu)) of a rock, or of each (n,) [stress]; infinite where E is."""
    return youngs_modulus / (2.0 * (1.0 + poissons_ratio))


def lame_modulus(youngs_modulus: Moduli, poissons_ratio: Moduli) -> Moduli:
    """(2.13) Lame's lambda = E nu/((1 + nu) (1 - 2 nu)), of a rock or of each (n,), nu below 1/2 [stress]."""
    return youngs_modulus * poissons_ratio / ((1.0 + poissons_ratio) * (1.0 - 2.0 * poissons_ratio))


def p_wave_modulus(youngs_modulus: Moduli, poissons_ratio: Moduli) -> Moduli:
    """(2.13) lambda + 2 G = rho c_p^2, of a rock or of each (n,): of strain along one axis alone [stress]."""
    return youngs_modulus * (1.0 - poissons_ratio) / ((1.0 + poissons_ratio) * (1.0 - 2.0 * poissons_ratio))


def plane_strain_modulus(youngs_modulus: Moduli, poissons_ratio: Moduli) -> Moduli:
    """(2.13) E' = E/(1 - nu^2), of a rock or of each (n,): stress over strain along a free sheet that keeps zz [stress]."""
    return youngs_modulus / (1.0 - poissons_ratio**2)


def plane_strain_stiffness(youngs_modulus: Parameter, poissons_ratio: Parameter) -> Floats:
    """(2.13) Stiffness D (n, 3, 3) with stress = D strain [stress].

    youngs_modulus (n,) [stress], poissons_ratio (n,), below 1/2; numbers give n = 1.
    """
    return _stiffness(*_moduli(youngs_modulus, poissons_ratio), 2)


def plane_stress_stiffness(youngs_modulus: Parameter, poissons_ratio: Parameter) -> Floats:
    """Stiffness (n, 3, 3) of a thin sheet, sigma_zz = 0 [stress]; arguments as for ``plane_strain_stiffness``."""
    lame, shear = _moduli(youngs_modulus, poissons_ratio)
    return _stiffness(2.0 * lame * shear / (lame + 2.0 * shear), shear, 2)


def solid_stiffness(youngs_modulus: Parameter, poissons_ratio: Parameter) -> Floats:
    """(2.13) Stiffness D (n, 6, 6) in three dimensions [stress]; arguments as for ``plane_strain_stiffness``."""
    return _stiffness(*_moduli(youngs_modulus, poissons_ratio), 3)


STIFFNESS = {2: plane_strain_stiffness, 3: solid_stiffness}
"""Of rock, by dimension."""


def _moduli(youngs_modulus: Parameter, poissons_ratio: Parameter) -> tuple[Floats, Floats]:
    """Lame's lambda and mu (n,) [stress]."""
    given = (np.atleast_1d(np.asarray(each, float)) for each in (youngs_modulus, poissons_ratio))
    modulus, ratio = np.broadcast_arrays(*given)
    return lame_modulus(modulus, ratio), shear_modulus(modulus, ratio)


def _stiffness(lame: Floats, shear: Floats, dim: int) -> Floats:
    normal, size = np.arange(dim), dim * (dim + 1) // 2
    stiffness = np.zeros((len(lame), size, size))
    stiffness[:, :dim, :dim] = lame[:, None, None]
    stiffness[:, normal, normal] = (lame + 2.0 * shear)[:, None]
    stiffness[:, np.arange(dim, size), np.arange(dim, size)] = shear[:, None]
    return stiffness


def out_of_plane_stress(stress: Floats, poissons_ratio: Parameter) -> Floats:
    """(2.13) sigma_zz (n,) = nu (sigma_xx + sigma_yy) of a stress change (n, 3) from the initial state."""
    return np.multiply(poissons_ratio, stress[:, 0] + stress[:, 1])
