"""T3, Q4, T4 and H8: patch test, rigid motion, mass, initial stress, errors."""

from __future__ import annotations

import numpy as np
import pytest

from fracflow.elements import facet, solid
from fracflow.elements.shape import shape_at
from fracflow.errors import InputError
from fracflow.laws.elastic import STIFFNESS, plane_strain_stiffness

pytestmark = pytest.mark.serial

# a unit square with one inner node off centre; (points, cells)
POINTS = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0.6, 0.45]], dtype=float)
TRIANGLES = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
# the patch of four distorted quadrilaterals around a smaller one
INNER = np.array([[0.3, 0.2], [0.75, 0.3], [0.8, 0.7], [0.25, 0.65]])
QUAD_POINTS = np.vstack([POINTS[:4], INNER])
QUADS = np.array([[0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7], [4, 5, 6, 7]])
# a unit cube around a distorted smaller one, of seven hexahedra, and these cut into tetrahedra around a node within each
CUBE = np.concatenate([np.column_stack([POINTS[:4], np.full(4, z)]) for z in (0.0, 1.0)])
SMALLER = 0.5 + 0.4 * (CUBE - 0.5) + 0.05 * np.random.default_rng(0).uniform(-1.0, 1.0, CUBE.shape)
SIDES = np.array(
    [[0, 1, 2, 3], [4, 7, 6, 5], [0, 4, 5, 1], [1, 5, 6, 2], [2, 6, 7, 3], [3, 7, 4, 0]]
)  # normals inwards
CUBE_POINTS = np.concatenate([CUBE, SMALLER])
HEXAHEDRA = np.concatenate([np.concatenate([SIDES, SIDES + 8], axis=1), [np.arange(8, 16)]])


def tetrahedra():
    """Twelve in each hexahedron; a side shared by two has one diagonal, from its lowest node."""
    points, cells = [CUBE_POINTS], []
    for number, cell in enumerate(HEXAHEDRA):
        points.append(CUBE_POINTS[cell].mean(axis=0, keepdims=True))
        for side in cell[SIDES]:
            a, b, c, d = np.roll(side, -np.argmin(side))
            cells += [[a, b, c, 16 + number], [a, c, d, 16 + number]]
    return np.concatenate(points), np.array(cells)


PATCHES = {
    "T3": (POINTS, TRIANGLES), "Q4": (QUAD_POINTS, QUADS), "T4": tetrahedra(), "H8": (CUBE_POINTS, HEXAHEDRA),
}  # fmt: skip
D = plane_strain_stiffness(10.0, 0.3)[0]


@pytest.fixture(params=sorted(PATCHES))
def patch(request):
    points, cells = PATCHES[request.param]
    return points, cells, points[cells]


def assembled(cells, nodes, element):
    dim = element.shape[1] // cells.shape[1]
    dofs = (dim * cells[:, :, None] + np.arange(dim)).reshape(len(cells), -1)
    if element.ndim == 2:
        vector = np.zeros(dim * nodes)
        np.add.at(vector, dofs, element)
        return vector
    matrix = np.zeros((dim * nodes, dim * nodes))
    np.add.at(matrix, (dofs[:, :, None], dofs[:, None, :]), element)
    return matrix


def moduli(cells, dim=2):
    return np.repeat(STIFFNESS[dim](10.0, 0.3), len(cells), axis=0)


GRADIENTS = {
    2: np.array([[1e-3, 2e-3], [-5e-4, 3e-3]]),
    3: np.array([[1e-3, 2e-3, -1e-3], [-5e-4, 3e-3, 4e-4], [7e-4, -2e-3, -1e-3]]),
}


def test_patch(patch):
    """A linear displacement of the boundary gives it inside too, and constant stress."""
    points, cells, corners = patch
    dim = points.shape[1]
    gradient, D = GRADIENTS[dim], moduli([0], dim)[0]
    K = assembled(cells, len(points), solid.stiffness(corners, moduli(cells, dim)))
    exact = (points @ gradient.T).ravel()
    outer = np.arange(dim * 2**dim)
    inner = np.arange(len(outer), dim * len(points))
    solved = exact.copy()
    solved[inner] = np.linalg.solve(K[np.ix_(inner, inner)], -K[np.ix_(inner, outer)] @ exact[outer])
    assert np.allclose(solved, exact, atol=1e-16)
    strain = solid.strain_at_centroid(corners, solved.reshape(-1, dim)[cells])
    voigt = solid.voigt(gradient + gradient.T)
    voigt[:dim] /= 2.0
    assert np.allclose(strain, voigt, rtol=1e-12)
    assert np.allclose(solid.stress(strain, moduli(cells, dim), np.ones(len(voigt))), D @ voigt + 1, rtol=1e-12)
    assert exact @ K @ exact == pytest.approx(voigt @ D @ voigt)
    none = np.zeros((*solid.stiffness_points(corners).shape[:2], len(voigt)))
    energy = solid.strain_energy(corners, solved.reshape(-1, dim)[cells], moduli(cells, dim), none)
    assert energy.sum() == pytest.approx(0.5 * voigt @ D @ voigt)


def test_rigid_motion(patch):
    points, cells, corners = patch
    dim = points.shape[1]
    K = solid.stiffness(corners, moduli(cells, dim))
    assert np.allclose(K, K.transpose(0, 2, 1))
    turn = np.random.default_rng(1).normal(size=(dim, dim))
    for motion in (np.ones_like(points), points @ (turn - turn.T)):
        assert np.allclose(np.einsum("nij,nj->ni", K, motion[cells].reshape(len(cells), -1)), 0, atol=1e-13)
    assert np.all(np.sum(np.linalg.eigvalsh(K) > 1e-10, axis=1) == K.shape[1] - dim * (dim + 1) // 2)


def test_mass(patch):
    _, cells, corners = patch
    density = np.linspace(1.0, 2.0, len(cells))
    consistent, lumped = solid.mass_consistent(corners, density), solid.mass_lumped(corners, density)
    assert np.allclose(consistent.sum(axis=2), lumped)
    assert np.allclose(lumped.sum(axis=1), density * solid.area(corners))
    assert solid.area(corners).sum() == pytest.approx(1.0)
    assert np.all(np.linalg.eigvalsh(consistent) > 0) and np.all(lumped > 0)
    if cells.shape[1] == 8:
        return  # the Jacobian of a distorted hexahedron is of a higher order than its rule
    # second moments of the unit square and cube are exact for linear functions
    M = solid.mass_consistent(corners, 1.0)
    x, y = np.moveaxis(corners, -1, 0)[:2]
    assert np.einsum("ni,nij,nj->", x, M, x) == pytest.approx(1 / 3)
    assert np.einsum("ni,nij,nj->", x, M, y) == pytest.approx(1 / 4)


def test_initial_stress_is_held_by_boundary_tractions(patch):
    points, cells, corners = patch
    dim = points.shape[1]
    tensor = np.array([[-2e5, -1.4e5, 3e4], [-1.4e5, -6e5, -5e4], [3e4, -5e4, -4e5]])[:dim, :dim]
    stress = np.repeat(solid.voigt(tensor)[None], len(cells), axis=0)
    inside = assembled(cells, len(points), solid.initial_stress_force(corners, stress))
    square = np.array([[0, 1], [1, 2], [2, 3], [3, 0]])
    lowest = np.array([np.roll(side, -np.argmin(side)) for side in SIDES])
    triangles = np.concatenate([lowest[:, [0, 1, 2]], lowest[:, [0, 2, 3]]])[:, ::-1]
    sides = square if dim == 2 else SIDES[:, ::-1] if cells.shape[1] == 8 else triangles
    normals = facet.frame(points[sides])[0][:, -1] * (-1.0 if dim == 2 else 1.0)
    outside = np.zeros((len(points), dim))
    np.add.at(outside, sides, solid.traction_force(points[sides], normals @ tensor))
    assert np.allclose(inside, outside.ravel(), atol=1e-9)


def test_shape_functions_at_a_place(patch):
    _, _, corners = patch
    for cell in corners[:3]:
        share = np.random.default_rng(2).uniform(0.5, 1.0, len(cell))
        place = (share / share.sum()) @ cell
        found = shape_at(cell, place)
        assert found.sum() == pytest.approx(1.0) and np.allclose(found @ cell, place, atol=1e-13)


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


def test_bad_cells_in_space_are_named():
    cells = np.stack([CUBE, CUBE[[4, 5, 6, 7, 0, 1, 2, 3]]])
    with pytest.raises(InputError, match=r"cells 1\): nodes must be ordered .* positive volume"):
        solid.stiffness(cells, moduli(cells, 3))


def test_unknown_shape():
    with pytest.raises(InputError, match=r"6 nodes: .* quadrilaterals"):
        solid.stiffness(np.zeros((1, 6, 2)), D[None])
    with pytest.raises(InputError, match=r"6 nodes: .* hexahedra"):
        solid.stiffness(np.zeros((1, 6, 3)), moduli([0], 3))
