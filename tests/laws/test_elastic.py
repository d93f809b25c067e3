"""Moduli in the plane and in space."""

import numpy as np
import pytest

from fracflow.laws.elastic import (
    lame_modulus,
    out_of_plane_stress,
    p_wave_modulus,
    plane_strain_modulus,
    plane_strain_stiffness,
    plane_stress_stiffness,
    shear_modulus,
    solid_stiffness,
)

pytestmark = pytest.mark.serial


def test_inverse_is_the_plane_strain_compliance():
    modulus, ratio = np.array([5e8, 2.0]), np.array([0.25, 0.4])
    for E, nu, stiffness in zip(modulus, ratio, plane_strain_stiffness(modulus, ratio), strict=True):
        compliance = (1 + nu) / E * np.array([[1 - nu, -nu, 0], [-nu, 1 - nu, 0], [0, 0, 2]])
        assert np.allclose(stiffness @ compliance, np.eye(3), atol=1e-14)


def test_no_strain_out_of_plane():
    nu, stress = 0.25, np.array([[3.0, -1.0, 0.7]])
    assert np.allclose(out_of_plane_stress(stress, nu) - nu * (stress[:, 0] + stress[:, 1]), 0)
    assert plane_strain_stiffness(1.0, 0.0).shape == (1, 3, 3)


def test_all_are_one_law():
    """In space by the compliance; plane strain is its part without strain across, plane stress that without stress."""
    modulus, ratio = np.array([5e8, 2.0]), np.array([0.25, 0.4])
    whole, strain, stress = (
        law(modulus, ratio) for law in (solid_stiffness, plane_strain_stiffness, plane_stress_stiffness)
    )
    plane = np.ix_([0, 1, 5], [0, 1, 5])
    for E, nu, D, in_strain, in_stress in zip(modulus, ratio, whole, strain, stress, strict=True):
        compliance = np.diag([1.0 + nu] * 3 + [2.0 * (1.0 + nu)] * 3) / E
        compliance[:3, :3] -= nu / E
        assert np.allclose(D @ compliance, np.eye(6), atol=1e-14)
        assert np.allclose(in_strain, D[plane])
        assert np.allclose(in_stress @ compliance[plane], np.eye(3), atol=1e-14)


def test_moduli_are_those_of_the_stiffness():
    """Along one axis, across it and in shear; on a sheet that is free across and keeps its thickness."""
    modulus, ratio = np.array([5e8, 2.0]), np.array([0.25, 0.4])
    whole = plane_strain_stiffness(modulus, ratio)
    for law, (row, column) in ((p_wave_modulus, (0, 0)), (lame_modulus, (0, 1)), (shear_modulus, (2, 2))):
        assert np.allclose(law(modulus, ratio), whole[:, row, column], rtol=1e-14)
    free = whole[:, 0, 0] - whole[:, 0, 1] ** 2 / whole[:, 1, 1]
    assert np.allclose(plane_strain_modulus(modulus, ratio), free, rtol=1e-14)
