"""Facets of lines, triangles and quadrilaterals: frames, sizes, shape functions, rules."""

from __future__ import annotations

import numpy as np
import pytest
from facets import FLAT, SIZE, facets

from fracflow.elements import facet
from fracflow.errors import InputError

pytestmark = pytest.mark.serial

NODES = pytest.mark.parametrize("nodes", [2, 3, 4])
RULES = pytest.mark.parametrize("rule", facet.RULES)


@NODES
def test_frames_are_right_handed_and_sizes_do_not_turn(nodes):
    points = facets(nodes)
    frame, size = facet.frame(points)
    assert np.allclose(frame @ frame.swapaxes(1, 2), np.eye(points.shape[2]))
    assert np.allclose(np.linalg.det(frame), 1.0) and np.allclose(size, SIZE[nodes])
    assert np.allclose(np.einsum("ni,nki->nk", frame[:, -1], points - points[:, :1]), 0.0)
    turned, _ = facet.frame(points[:, ::-1])
    assert np.allclose(turned[:, -1], -frame[:, -1])


def test_frame_of_a_surface_is_strike_dip_and_normal():
    """All facets of a plane have one frame, whatever their first node; that of a level one is x, y, z."""
    dip = np.radians(30.0)
    plane = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(dip), np.sin(dip)]])
    flat = np.random.default_rng(0).normal(size=(5, 3, 2))
    flat = np.where((np.linalg.det(flat[:, 1:] - flat[:, :1]) > 0.0)[:, None, None], flat, flat[:, ::-1])
    frame, _ = facet.frame(flat @ plane)
    assert np.allclose(frame, [*plane, np.cross(*plane)])
    level, _ = facet.frame(FLAT[4][None])
    assert np.allclose(level, np.eye(3))


@pytest.mark.parametrize(("nodes", "what"), [(2, "length"), (3, "area"), (4, "area")])
def test_facet_without_size(nodes, what):
    points = facets(nodes)
    points[2, 1:] = points[2, 0]
    with pytest.raises(InputError, match=rf"no {what} \(facets 42\)"):
        facet.frame(points, np.arange(40, 46))


def test_quadrilateral_that_is_not_convex():
    points = FLAT[4].copy()
    points[2] = [0.3, 0.2, 0.0]
    with pytest.raises(InputError, match="not convex"):
        facet.nodal_sizes(points[None])


@NODES
@RULES
def test_rules_integrate(nodes, rule):
    """Constants by all; what is linear in space by all but the one point of a quadrilateral that is no parallelogram."""
    points, sections = facets(nodes), facet.RULES[rule][nodes]
    shapes, sizes = facet.shapes(sections.natural, nodes), facet.section_sizes(points, sections)
    assert np.allclose(shapes.sum(axis=1), 1.0)
    assert np.allclose(sizes.sum(axis=1), SIZE[nodes])
    if nodes < 4 or rule == "gauss2":
        moment = np.einsum("nq,qk,nkd->nd", sizes, shapes, points)
        exact = np.einsum("nk,nkd->nd", facet.consistent(points).sum(axis=1), points)
        assert np.allclose(moment, exact)
        if nodes == 4:
            one, other = points[:, [0, 1, 2]], points[:, [0, 2, 3]]
            parts = sum(facet.frame(each)[1][:, None] * each.mean(axis=1) for each in (one, other))
            assert np.allclose(moment, parts)
        else:
            assert np.allclose(moment, SIZE[nodes] * points.mean(axis=1))


@NODES
def test_shape_functions_of_the_nodes(nodes):
    natural = facet.RULES["nodal"][nodes].natural
    assert np.array_equal(facet.shapes(natural, nodes), np.eye(nodes))
    assert np.array_equal(facet.to_nodes(natural), np.eye(nodes))


@NODES
def test_values_of_the_nodes_from_sections(nodes):
    """Values at nodes, taken to the sections, come back; one point does not tell."""
    natural, values = facet.RULES["gauss2"][nodes].natural, np.random.default_rng(1).normal(size=nodes)
    assert np.allclose(facet.to_nodes(natural) @ (facet.shapes(natural, nodes) @ values), values)
    assert facet.to_nodes(facet.RULES["one-point"][nodes].natural) is None


@NODES
def test_spread_fields(nodes):
    """Sums and moments of what is linear in space; a constant field is shared as the nodes' sizes of the consistent matrix."""
    points, rng = facets(nodes), np.random.default_rng(2)
    values = rng.normal(size=(len(points), nodes, 3))
    spread = facet.spread(points, values)
    assert np.allclose(spread, np.einsum("nij,njc->nic", facet.consistent(points), values))
    assert np.allclose(
        spread.sum(axis=1),
        np.einsum("nk,nkc->nc", facet.spread(points, np.ones((len(points), nodes, 1)))[..., 0], values),
    )
    assert np.all(np.linalg.eigvalsh(facet.consistent(points)) > 0.0)


@pytest.mark.parametrize("nodes", [3, 4])
@RULES
def test_gradients_along_a_surface(nodes, rule):
    """A field linear in space has its own gradient but for the part along the normal."""
    points, slope = facets(nodes), np.array([1.0, -2.0, 0.5])
    found = np.einsum("nqkd,nk->nqd", facet.surface_gradients(points, facet.RULES[rule][nodes]), points @ slope)
    normal = facet.frame(points)[0][:, -1]
    along = slope - (normal @ slope)[:, None] * normal
    assert np.allclose(found, along[:, None])
