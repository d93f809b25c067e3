"""Flow kernels: matrices e, wall forces, conductivity and its derivative."""

from __future__ import annotations

import numpy as np
import pytest
from facets import SIZE, facets

from fracflow.elements import facet, flow, joint
from fracflow.errors import InputError
from fracflow.laws import FLOW_LAWS
from fracflow.laws.cubic_flow import conductance

pytestmark = pytest.mark.serial
MEANS = {name: law.mean_cube for name, law in FLOW_LAWS.items()}

LENGTH = np.array([2.0, 5.0])
LINES = LENGTH[:, None, None] * np.array([[0.0, 0.0], [0.6, 0.8]])


def walls(points):
    """The openings at the nodes (n, 2 k dim, k) under unit nodal forces."""
    frame, nodes = facet.frame(points)[0], points.shape[1]
    shapes = facet.shapes(facet.RULES["nodal"][nodes].natural, nodes)
    return joint.jump_operator(frame, shapes)[:, :, -1].transpose(0, 2, 1)


def test_storage_matrices():
    assert np.allclose(flow.storage_matrix("consistent", LINES)[1], 5 / 6 * np.array([[2, 1], [1, 2]]))
    assert np.allclose(flow.storage_matrix("averaging", LINES)[1], 5 / 4 * np.ones((2, 2)))
    assert np.allclose(flow.storage_matrix("lumped", LINES)[1], 5 / 2 * np.eye(2))
    for kind in flow.STORAGE:
        assert np.allclose(flow.storage_matrix(kind, LINES).sum(axis=(1, 2)), LENGTH)
    with pytest.raises(InputError, match="consistent, averaging, lumped"):
        flow.storage_matrix("exact", LINES)


def test_wall_matrix_is_the_explicit_one():
    """(3.19), here per unit depth and in the order bottom 1, bottom 2, top 1, top 2."""
    points = np.array([[[1.0, 2.0], [4.0, 6.0]]])
    load = walls(points) @ flow.storage_matrix("averaging", points)
    dx, dy = 3.0, 4.0
    row = np.array([dy, -dx, dy, -dx, -dy, dx, -dy, dx]) / 4
    assert np.allclose(load[0].T, [row, row])


@pytest.mark.parametrize("kind", flow.STORAGE)
def test_pressure_opens_the_joint(kind):
    points = np.array([[[0.0, 0.0], [0.0, 2.0]]])
    load = walls(points) @ flow.storage_matrix(kind, points) @ np.array([3.0, 3.0])
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


@pytest.mark.parametrize("kind", flow.STORAGE)
@pytest.mark.parametrize("nodes", [3, 4])
def test_pressure_opens_a_surface(kind, nodes):
    """A constant pressure presses each face with its area, along the normal; opening makes the same volume."""
    points = facets(nodes)
    load = walls(points) @ flow.storage_matrix(kind, points)
    normal = facet.frame(points)[0][:, -1]
    by_face = (load @ np.ones(nodes)).reshape(len(points), 2, nodes, 3).sum(axis=2)
    assert np.allclose(by_face, SIZE[nodes] * np.stack([-normal, normal], axis=1))
    apart = np.concatenate([np.zeros_like(points), np.repeat(0.1 * normal[:, None], nodes, axis=1)], axis=1)
    volume = np.einsum("nji,nj->n", load, apart.reshape(len(points), -1))
    assert np.allclose(volume, 0.1 * SIZE[nodes])


def strip(nodes, columns, rows, taper):
    """A strip of surfaces (points, cells) between x = 0 and 2, y = 0 and 1, turned in space; its x; apertures at the nodes."""
    x, y = np.meshgrid(np.linspace(0.0, 2.0, columns + 1), np.linspace(0.0, 1.0, rows + 1))
    flat = np.stack([x.ravel(), y.ravel(), 0.0 * x.ravel()], axis=1)
    corner = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    cells = np.stack([corner, corner + 1, corner + columns + 2, corner + columns + 1], axis=1)
    cells = cells if nodes == 4 else np.concatenate([cells[:, [0, 1, 2]], cells[:, [0, 2, 3]]])
    turn = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]
    return flat @ turn.T, cells, flat[:, 0], 1e-3 * (1.0 + taper * flat[:, 0])


def total(nodes, columns, rows, taper, mean):
    """Flow rate through a strip by a unit of pressure, over 12 mu, and the residual of a linear pressure inside."""
    points, cells, x, aperture = strip(nodes, columns, rows, taper)
    cubes, _ = flow.SURFACE_MEANS[mean](aperture[cells])
    each = cubes[:, None, None] * flow.surface_conductivity(points[cells])
    whole = np.zeros((len(points), len(points)))
    np.add.at(whole, (cells[:, :, None], cells[:, None, :]), each)
    assert np.allclose(whole.sum(axis=1), 0.0, atol=1e-12 * np.abs(whole).max())
    inside = (x > 1e-9) & (x < 2.0 - 1e-9)
    pressure = 1.0 - 0.5 * x
    left = np.abs(whole @ pressure)[inside].max(initial=0.0) / np.abs(whole).max()
    pressure[inside] = np.linalg.solve(
        whole[np.ix_(inside, inside)], -(whole @ np.where(inside, 0.0, pressure))[inside]
    )
    return float((whole @ pressure)[x < 1e-9].sum()), left


@pytest.mark.parametrize("mean", flow.SURFACE_MEANS)
@pytest.mark.parametrize("nodes", [3, 4])
def test_linear_pressure_is_exact_between_parallel_walls(nodes, mean):
    rate, left = total(nodes, 4, 3, 0.0, mean)
    assert left < 1e-13 and rate == pytest.approx(1e-9 / 2.0, rel=1e-12)


@pytest.mark.parametrize("nodes", [3, 4])
def test_surface_against_the_line_on_a_tapered_strip(nodes):
    """Quadrilaterals conduct as the line's two-node mean, which is exact; triangles at second order."""
    ends = 1e-3, 1e-3 * 2.0
    exact = float(MEANS["exact"](*ends)[0]) / 2.0
    found = [total(nodes, columns, 2, 0.5, "exact")[0] / exact - 1.0 for columns in (4, 8)]
    if nodes == 4:
        assert np.abs(found).max() < 1e-12
    else:
        assert 0.0 < found[0] < 0.01 and found[1] < found[0] / 3.5


@pytest.mark.parametrize("nodes", [3, 4])
def test_means_over_surfaces(nodes):
    """Slopes against differences; one aperture everywhere is its cube; the exact mean is at most that of d^3; closed."""
    aperture = np.random.default_rng(6).uniform(0.1, 1.0, (8, nodes))
    for mean in flow.SURFACE_MEANS.values():
        _, slope = mean(aperture)
        assert np.allclose(mean(np.full((1, nodes), 0.3))[0], 0.027)
        for i in range(nodes):
            shift = 1e-6 * np.eye(nodes)[i]
            assert np.allclose(slope[:, i], (mean(aperture + shift)[0] - mean(aperture - shift)[0]) / 2e-6, atol=1e-8)
    exact, report = (flow.SURFACE_MEANS[name](aperture)[0] for name in ("exact", "report"))
    assert np.all(exact < report)
    aperture[:, 0] = -0.1
    assert np.all(flow.SURFACE_MEANS["exact"](aperture)[0] == 0.0)
    assert np.all(flow.SURFACE_MEANS["report"](aperture)[1][:, 0] == 0.0)


@pytest.mark.parametrize("nodes", [3, 4])
def test_surface_tangent(nodes):
    rng, unit = np.random.default_rng(7), flow.surface_conductivity(facets(nodes))
    aperture, pressure = rng.uniform(0.1, 1.0, (len(unit), nodes)), rng.normal(size=(len(unit), nodes))

    def inflow(d):
        return flow.SURFACE_MEANS["exact"](d)[0][:, None] * np.einsum("nij,nj->ni", unit, pressure)

    blocks = flow.surface_tangent(unit, flow.SURFACE_MEANS["exact"](aperture)[1], pressure)
    for j in range(nodes):
        shift = 1e-6 * np.eye(nodes)[j]
        difference = (inflow(aperture + shift) - inflow(aperture - shift)) / 2e-6
        assert np.allclose(blocks[:, :, j], difference, atol=1e-8)


def test_means_over_triangles_are_integrals():
    """Against a fine quadrature of linear apertures."""
    corners = np.array([[0.2, 0.5, 1.0]])
    edge = (np.arange(400) + 0.5) / 400
    a, b = (each.ravel() for each in np.meshgrid(edge, edge))
    inside = a + b < 1.0
    d = corners[0] @ np.stack([1.0 - a - b, a, b])[:, inside]
    assert float(flow.exact_surface_cube(corners)[0][0]) == pytest.approx(1.0 / np.mean(d**-3.0), rel=5e-3)
    assert float(flow.report_surface_cube(corners)[0][0]) == pytest.approx(np.mean(d**3.0), rel=5e-3)
