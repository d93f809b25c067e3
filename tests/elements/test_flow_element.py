"""Flow kernels: matrices e, wall forces, conductivity and its derivative."""

from __future__ import annotations

import numpy as np
import pytest

from fracflow.elements import flow, joint
from fracflow.errors import InputError
from fracflow.laws import FLOW_LAWS
from fracflow.laws.cubic_flow import conductance

pytestmark = pytest.mark.serial
MEANS = {name: law.mean_cube for name, law in FLOW_LAWS.items()}

LENGTH = np.array([2.0, 5.0])


def walls(frame):
    """What the openings at the ends (n, 4 dim, 2) make of unit end forces."""
    return joint.jump_operator(frame, joint.RULES["nodal"][0])[:, :, -1].transpose(0, 2, 1)


def test_storage_matrices():
    assert np.allclose(flow.storage_matrix("consistent", LENGTH)[1], 5 / 6 * np.array([[2, 1], [1, 2]]))
    assert np.allclose(flow.storage_matrix("averaging", LENGTH)[1], 5 / 4 * np.ones((2, 2)))
    assert np.allclose(flow.storage_matrix("lumped", LENGTH)[1], 5 / 2 * np.eye(2))
    for kind in flow.STORAGE:
        assert np.allclose(flow.storage_matrix(kind, LENGTH).sum(axis=(1, 2)), LENGTH)
    with pytest.raises(InputError, match="consistent, averaging, lumped"):
        flow.storage_matrix("exact", LENGTH)


def test_wall_matrix_is_the_explicit_one():
    """(3.19), here per unit depth and in the order bottom 1, bottom 2, top 1, top 2."""
    points = np.array([[[1.0, 2.0], [4.0, 6.0]]])
    frame, length = joint.frame(points)
    load = walls(frame) @ flow.storage_matrix("averaging", length)
    dx, dy = 3.0, 4.0
    row = np.array([dy, -dx, dy, -dx, -dy, dx, -dy, dx]) / 4
    assert np.allclose(load[0].T, [row, row])


@pytest.mark.parametrize("kind", flow.STORAGE)
def test_pressure_opens_the_joint(kind):
    frame, length = joint.frame(np.array([[[0.0, 0.0], [0.0, 2.0]]]))
    load = walls(frame) @ flow.storage_matrix(kind, length) @ np.array([3.0, 3.0])
    by_face = load.reshape(2, 2, 2).sum(axis=1)
    assert np.allclose(by_face, [[6.0, 0.0], [-6.0, 0.0]]), "bottom (right) to +x, top (left) to -x"


def test_flow_goes_down_the_pressure():
    c, pressure = np.array([2.0, 3.0]), np.array([[5.0, 1.0], [0.0, 1.0]])
    assert np.allclose(flow.element_flow(c, pressure), [8.0, -3.0])
    into = np.einsum("nij,nj->ni", flow.conductivity(c), pressure)
    assert np.allclose(into, [[8.0, -8.0], [-3.0, 3.0]])


@pytest.mark.parametrize("mean", MEANS)
def test_conductivity_tangent(mean):
    rng = np.random.default_rng(0)
    aperture, pressure, length = rng.uniform(0.1, 1, (6, 2)), rng.normal(size=(6, 2)), rng.uniform(1, 2, 6)

    def inflow(d):
        c = conductance(MEANS[mean](d[:, 0], d[:, 1])[0], length, 0.1)
        return np.einsum("nij,nj->ni", flow.conductivity(c), pressure)

    _, *slopes = MEANS[mean](aperture[:, 0], aperture[:, 1])
    dconductance = conductance(np.stack(slopes, axis=-1), length[:, None], 0.1)
    blocks = flow.conductivity_tangent(dconductance, pressure)
    for j in range(2):
        shift = 1e-6 * np.eye(2)[j]
        difference = (inflow(aperture + shift) - inflow(aperture - shift)) / 2e-6
        assert np.allclose(blocks[:, :, j], difference, atol=1e-8)
