"""Joint kernels against the report's explicit forms, and the signs."""

from __future__ import annotations

import numpy as np
import pytest
from facets import SIZE, facets

from fracflow.elements import facet, joint

pytestmark = pytest.mark.serial

ANGLES = np.radians([0.0, 30.0, 90.0, 135.0, 200.0, -70.0])
# dofs of the report's nodes 1, 2, 3, 4 (bottom 1, bottom 2, top 2, top 1) in our order
REPORT_NODES = np.array([0, 1, 3, 2])


def segments(angles=ANGLES, length=2.5):
    ends = length * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    start = np.tile([3.0, -1.0], (len(angles), 1))
    return np.stack([start, start + ends], axis=1)


def in_report_order(matrix):
    """Reorder (8, 8) to the report's nodes, (node, component)."""
    return matrix.reshape(4, 2, 4, 2)[REPORT_NODES][:, :, REPORT_NODES]


def test_frame():
    frame, length = facet.frame(segments())
    c, s = np.cos(ANGLES), np.sin(ANGLES)
    assert np.allclose(frame, np.array([[c, s], [-s, c]]).transpose(2, 0, 1))
    assert np.allclose(length, 2.5) and np.allclose(np.linalg.det(frame), 1.0)


NODES = pytest.mark.parametrize("nodes", [2, 3, 4])


def test_traction_from_stress():
    """(2.14b), with (xx, yy, zz, xy)."""
    frame, _ = facet.frame(segments())
    xx, yy, xy = -2e5, -6e5, -1.4e5
    stress = np.broadcast_to([[xx, xy], [xy, yy]], (len(ANGLES), 2, 2))
    c, s = np.cos(ANGLES), np.sin(ANGLES)
    shear = -s * c * xx + s * c * yy + (c**2 - s**2) * xy
    normal = s**2 * xx + c**2 * yy - 2 * s * c * xy
    assert np.allclose(joint.traction_from_stress(frame, stress), np.stack([shear, normal], axis=-1))


def test_fault_along_y():
    """Theta = 90 degrees: f_s = -sigma_xy, f_n = sigma_xx; the bottom is on the right, x > 0."""
    frame, _ = facet.frame(np.array([[[0.0, 0.0], [0.0, 1000.0]]]))
    assert np.allclose(frame[0], [[0, 1], [-1, 0]])
    traction = joint.traction_from_stress(frame, np.array([[[-2e5, -1.4e5], [-1.4e5, -6e5]]]))
    assert np.allclose(traction, [[1.4e5, -2e5]])


@NODES
def test_strain_is_top_minus_bottom(nodes):
    """The slips and opening of a joint whose bottom moves rigidly, and its top with it."""
    points = facets(nodes)
    frame, _ = facet.frame(points)
    dim = points.shape[2]
    jump = np.array([0.3, -0.1, 0.02])[-dim:]
    top = np.einsum("i,nij->nj", jump, frame)  # rows of the frame are the axes
    turn = np.random.default_rng(0).normal(size=(dim, dim))
    rigid = points @ (turn - turn.T) + 0.7
    displacement = np.stack([rigid, rigid + top[:, None]], axis=1).reshape(len(points), -1)
    for rule in facet.RULES.values():
        shapes = facet.shapes(rule[nodes].natural, nodes)
        strain = joint.strain(joint.jump_operator(frame, shapes), displacement)
        assert strain.shape == (len(points), len(shapes), dim)
        assert np.allclose(strain, jump)


@NODES
def test_nodal_rule_sees_its_own_section(nodes):
    frame, _ = facet.frame(facets(nodes)[:1])
    dim = len(frame[0])
    top = np.arange(1.0, nodes * dim + 1.0).reshape(nodes, dim)
    displacement = np.concatenate([np.zeros(nodes * dim), top.ravel()])[None]
    shapes = facet.shapes(facet.RULES["nodal"][nodes].natural, nodes)
    assert np.allclose(joint.strain(joint.jump_operator(frame, shapes), displacement), top @ frame[0].T)


@pytest.mark.parametrize("rule", facet.RULES)
def test_rules_integrate(rule):
    sections, length = facet.RULES[rule][2], np.array([2.5, 1.0])
    xi, weights = sections.natural, sections.weights
    lines = length[:, None, None] * np.array([[0.0, 0.0], [0.6, 0.8]])
    assert np.allclose(facet.section_sizes(lines, sections).sum(axis=1), length)
    assert weights @ xi == pytest.approx(0.0)
    expected = {"nodal": 2.0, "gauss2": 2 / 3, "one-point": 0.0}
    assert weights @ xi**2 == pytest.approx(expected[rule])


def parts(points, rule):
    """Operator and sizes of a rule's sections."""
    sections, nodes = facet.RULES[rule][points.shape[1]], points.shape[1]
    operator = joint.jump_operator(facet.frame(points)[0], facet.shapes(sections.natural, nodes))
    return operator, facet.section_sizes(points, sections)


def test_tangent_is_the_explicit_one():
    """(2.21a) with (2.32a), (2.32b)."""
    frame, length = facet.frame(segments())
    rng = np.random.default_rng(0)
    k_s, k_n = rng.uniform(1, 2, (2, len(ANGLES), 2))
    moduli = np.zeros((len(ANGLES), 2, 2, 2))
    moduli[..., 0, 0], moduli[..., 1, 1] = k_s, k_n
    operator, sizes = parts(segments(), "nodal")
    tangent = joint.tangent(operator, moduli, sizes)

    def pattern(k1, k2):
        return np.array([[k1, 0, 0, -k1], [0, k2, -k2, 0], [0, -k2, k2, 0], [-k1, 0, 0, k1]])

    for i, c in enumerate(frame):
        blocks = np.zeros((4, 2, 4, 2))
        blocks[:, 0, :, 0] = length[i] / 2 * pattern(*k_s[i])
        blocks[:, 1, :, 1] = length[i] / 2 * pattern(*k_n[i])
        expected = np.einsum("am,iajb,bn->imjn", c, blocks, c)
        assert np.allclose(in_report_order(tangent[i]), expected)


@NODES
@pytest.mark.parametrize("rule", facet.RULES)
def test_tangent_is_the_derivative_of_the_force(nodes, rule):
    """Whatever the moduli; symmetric where they are, and then the force is the derivative of the energy."""
    operator, weight = parts(facets(nodes), rule)
    joints, points, dim, dofs = operator.shape
    rng = np.random.default_rng(2)
    moduli = rng.normal(size=(joints, points, dim, dim))
    displacement = rng.normal(size=(joints, dofs))
    traction = np.einsum("nqij,nqj->nqi", moduli, joint.strain(operator, displacement))
    product = np.einsum("nij,nj->ni", joint.tangent(operator, moduli, weight), displacement)
    force = np.einsum("nqij,nqi->nj", operator, weight[..., None] * traction)
    assert np.allclose(force, product)

    moduli = moduli + moduli.swapaxes(2, 3)
    tangent = joint.tangent(operator, moduli, weight)
    assert np.allclose(tangent, tangent.swapaxes(1, 2))

    def energy(motion):
        strain = joint.strain(operator, motion)
        return 0.5 * np.einsum("nq,nqi,nqij,nqj->n", weight, strain, moduli, strain)

    way = rng.normal(size=(joints, dofs))
    slope = (energy(displacement + way) - energy(displacement - way)) / 2.0  # exact of what is quadratic
    assert np.allclose(slope, np.einsum("ni,nij,nj->n", way, tangent, displacement))


@NODES
@pytest.mark.parametrize("rule", facet.RULES)
def test_rigid_motion_and_constant_traction(nodes, rule):
    """Rigid motion costs nothing; a constant traction is shared among the nodes, the whole of it on each face."""
    points = facets(nodes)
    operator, weight = parts(points, rule)
    dim, rng = points.shape[2], np.random.default_rng(3)
    turn = rng.normal(size=(dim, dim))
    rigid = points @ (turn - turn.T) + rng.normal(size=dim)
    assert np.allclose(joint.strain(operator, np.concatenate([rigid, rigid], axis=1).reshape(len(points), -1)), 0.0)
    traction = rng.normal(size=dim)
    force = np.einsum("nqij,nq,i->nj", operator, weight, traction).reshape(len(points), 2, nodes, dim)
    whole = SIZE[nodes] * np.einsum("i,nij->nj", traction, facet.frame(points)[0])
    assert np.allclose(force.sum(axis=2), np.stack([-whole, whole], axis=1))
    if rule == "gauss2" or (rule == "nodal" and nodes < 4):
        about = points - points.mean(axis=1, keepdims=True)
        moment = np.einsum("nki,nkj->nij", about, force[:, 1])
        weighed = np.einsum("nk,nki->ni", facet.consistent(points).sum(axis=1), about)
        assert np.allclose(moment, weighed[:, :, None] * whole[:, None] / SIZE[nodes], atol=1e-12)


@NODES
def test_gauss_couples_nodes_and_nodal_does_not(nodes):
    points = facets(nodes)[:1]
    for rule, coupled in (("nodal", False), ("gauss2", True), ("one-point", True)):
        operator, sizes = parts(points, rule)
        moduli = np.tile(np.eye(points.shape[2]), (1, operator.shape[1], 1, 1))
        tangent = joint.tangent(operator, moduli, sizes)[0]
        assert (np.abs(tangent[0, points.shape[2]]) > 1e-12) == coupled
