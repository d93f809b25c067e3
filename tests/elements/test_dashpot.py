"""Dashpots on lines and surfaces: they take up plane waves along their normal, and shares of nodes add up."""

from __future__ import annotations

import numpy as np
import pytest
from facets import SIZE, facets

from fracflow.elements import dashpot, facet, solid
from fracflow.laws.elastic import STIFFNESS, lame_modulus, shear_modulus

pytestmark = pytest.mark.serial


@pytest.mark.parametrize("nodes", [2, 3, 4])
def test_dashpots_balance_a_wave_along_the_normal(nodes):
    """-C v is the traction of a P or an S wave that leaves by the normal, by any elasticity of that dimension."""
    points = facets(nodes)
    frame, dim = facet.frame(points)[0], points.shape[2]
    young, ratio, density = 3.0, 0.25, 2.0
    lam, shear = lame_modulus(young, ratio), shear_modulus(young, ratio)
    for row, stiffness in ((dim - 1, lam + 2.0 * shear), *((i, shear) for i in range(dim - 1))):
        speed = np.sqrt(stiffness / density)
        impedances = (density * np.sqrt(each / density) * np.ones(len(points)) for each in (lam + 2.0 * shear, shear))
        blocks = dashpot.impedance_blocks(facet.nodal_sizes(points), frame[:, -1], *impedances)
        assert blocks.shape == (len(points), nodes, dim, dim)
        for number, (normal, motion) in enumerate(zip(frame[:, -1], frame[:, row], strict=True)):
            gradient = -np.outer(motion, normal) / speed  # of a unit particle velocity
            strain = solid.voigt(gradient + gradient.T)
            strain[:dim] /= 2.0
            stress = np.zeros((dim, dim))
            for value, (i, j) in zip(STIFFNESS[dim](young, ratio)[0] @ strain, solid.VOIGT[dim], strict=True):
                stress[i, j] = stress[j, i] = value
            traction = dashpot.wave_traction(normal[None], normal, motion, lam, shear, speed)[0]
            assert np.allclose(traction, stress @ normal)
            assert np.allclose(blocks[number].sum(axis=0) @ motion, -SIZE[nodes] * traction)
