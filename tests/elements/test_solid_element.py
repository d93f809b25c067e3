"""T3 and Q4: patch test, rigid motion, mass, initial stress, errors."""

from __future__ import annotations

import numpy as np
import pytest

from fracflow.elements import facet, solid
from fracflow.errors import InputError
from fracflow.laws.elastic import plane_strain_stiffness

pytestmark = pytest.mark.serial

# a unit square with one inner node off centre; (points, cells)
POINTS = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0.6, 0.45]], dtype=float)
TRIANGLES = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
# the patch of four distorted quadrilaterals around a smaller one
INNER = np.array([[0.3, 0.2], [0.75, 0.3], [0.8, 0.7], [0.25, 0.65]])
QUAD_POINTS = np.vstack([POINTS[:4], INNER])
QUADS = np.array([[0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7], [4, 5, 6, 7]])
PATCHES = {"T3": (POINTS, TRIANGLES), "Q4": (QUAD_POINTS, QUADS)}
D = plane_strain_stiffness(10.0, 0.3)[0]


@pytest.fixture(params=sorted(PATCHES))
def patch(request):
    points, cells = PATCHES[request.param]
    return points, cells, points[cells]


def assembled(cells, nodes, element):
    dofs = (2 * cells[:, :, None] + np.arange(2)).reshape(len(cells), -1)
    if element.ndim == 2:
        vector = np.zeros(2 * nodes)
        np.add.at(vector, dofs, element)
        return vector
    matrix = np.zeros((2 * nodes, 2 * nodes))
    np.add.at(matrix, (dofs[:, :, None], dofs[:, None, :]), element)
    return matrix


def moduli(cells):
    return np.broadcast_to(D, (len(cells), 3, 3))


GRADIENT = np.array([[1e-3, 2e-3], [-5e-4, 3e-3]])


def test_patch(patch):
    """A linear displacement of the boundary gives it inside too, and constant stress."""
    points, cells, corners = patch
    K = assembled(cells, len(points), solid.stiffness(corners, moduli(cells)))
    exact = (points @ GRADIENT.T).ravel()
    inner = np.arange(8, 2 * len(points))
    outer = np.arange(8)
    solved = exact.copy()
    solved[inner] = np.linalg.solve(K[np.ix_(inner, inner)], -K[np.ix_(inner, outer)] @ exact[outer])
    assert np.allclose(solved, exact, atol=1e-16)
    strain = solid.strain_at_centroid(corners, solved.reshape(-1, 2)[cells])
    voigt = [GRADIENT[0, 0], GRADIENT[1, 1], GRADIENT[0, 1] + GRADIENT[1, 0]]
    assert np.allclose(strain, voigt, rtol=1e-12)
    assert np.allclose(solid.stress(strain, moduli(cells), np.ones(3)), D @ voigt + 1, rtol=1e-12)
    assert exact @ K @ exact == pytest.approx(voigt @ D @ voigt)


def test_rigid_motion(patch):
    points, cells, corners = patch
    K = solid.stiffness(corners, moduli(cells))
    assert np.allclose(K, K.transpose(0, 2, 1))
    spin = np.array([[0.0, -1.0], [1.0, 0.0]])
    for motion in (np.ones_like(points), points @ spin.T):
        assert np.allclose(np.einsum("nij,nj->ni", K, motion[cells].reshape(len(cells), -1)), 0, atol=1e-13)
    assert np.all(np.sum(np.linalg.eigvalsh(K) > 1e-10, axis=1) == K.shape[1] - 3)


def test_mass(patch):
    _, cells, corners = patch
    density = np.linspace(1.0, 2.0, len(cells))
    consistent, lumped = solid.mass_consistent(corners, density), solid.mass_lumped(corners, density)
    assert np.allclose(consistent.sum(axis=2), lumped)
    assert np.allclose(lumped.sum(axis=1), density * solid.area(corners))
    assert solid.area(corners).sum() == pytest.approx(1.0)
    assert np.all(np.linalg.eigvalsh(consistent) > 0) and np.all(lumped > 0)
    # second moments of the unit square are exact for linear functions
    M = solid.mass_consistent(corners, 1.0)
    x, y = np.moveaxis(corners, -1, 0)
    assert np.einsum("ni,nij,nj->", x, M, x) == pytest.approx(1 / 3)
    assert np.einsum("ni,nij,nj->", x, M, y) == pytest.approx(1 / 4)


def test_initial_stress_is_held_by_boundary_tractions(patch):
    points, cells, corners = patch
    tensor = np.array([[-2e5, -1.4e5], [-1.4e5, -6e5]])
    voigt = np.broadcast_to([tensor[0, 0], tensor[1, 1], tensor[0, 1]], (len(cells), 3))
    inside = assembled(cells, len(points), solid.initial_stress_force(corners, voigt))
    sides = np.array([[0, 1], [1, 2], [2, 3], [3, 0]])
    normals = np.array([[0, -1], [1, 0], [0, 1], [-1, 0]], dtype=float)
    outside = np.zeros((len(points), 2))
    np.add.at(outside, sides, solid.traction_force(points[sides], normals @ tensor))
    assert np.allclose(inside, outside.ravel(), atol=1e-9)


def test_body_force_and_tractions():
    corners = POINTS[[[0, 1, 2, 3]]]
    force = solid.body_force(corners, np.array([[0.0, -8.0]]))
    assert np.allclose(force, [[0, -2] * 4])
    edge = np.array([[[0.0, 0.0], [0.0, 3.0]]])
    assert np.allclose(facet.frame(edge)[1], 3.0)
    assert np.allclose(solid.traction_force(edge, np.array([[2.0, 4.0]])), [[[3, 6], [3, 6]]])
    linear = solid.traction_force(edge, np.array([[[0.0, 0.0], [6.0, 0.0]]]))
    assert np.allclose(linear, [[[3, 0], [6, 0]]])


@pytest.mark.parametrize("kernel", [solid.mass_lumped, solid.mass_consistent, solid.body_force])
def test_bad_cells_are_named(kernel):
    good = POINTS[[[0, 1, 2, 3]]]
    cells = np.concatenate([good, good[:, ::-1], good])
    load = np.zeros((3, 2)) if kernel is solid.body_force else 1.0
    with pytest.raises(InputError, match=r"cells 17\b"):
        kernel(cells, load, numbers=np.array([11, 17, 19]))
    with pytest.raises(InputError, match="cells 1\\)"):
        solid.stiffness(cells, moduli(cells))


def test_unknown_shape():
    with pytest.raises(InputError, match="6 nodes"):
        solid.stiffness(np.zeros((1, 6, 2)), D[None])
