"""Joint kernels against the report's explicit forms, and the signs."""

from __future__ import annotations

import numpy as np
import pytest

from fracflow.elements import joint
from fracflow.errors import InputError

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
    frame, length = joint.frame(segments())
    c, s = np.cos(ANGLES), np.sin(ANGLES)
    assert np.allclose(frame, np.array([[c, s], [-s, c]]).transpose(2, 0, 1))
    assert np.allclose(length, 2.5) and np.allclose(np.linalg.det(frame), 1.0)


def test_facet_without_length():
    points = segments()
    points[2, 1] = points[2, 0]
    with pytest.raises(InputError, match="facets 42"):
        joint.frame(points, np.arange(40, 46))


def test_traction_from_stress():
    """(2.14b), with (xx, yy, zz, xy)."""
    frame, _ = joint.frame(segments())
    xx, yy, xy = -2e5, -6e5, -1.4e5
    stress = np.broadcast_to([[xx, xy], [xy, yy]], (len(ANGLES), 2, 2))
    c, s = np.cos(ANGLES), np.sin(ANGLES)
    shear = -s * c * xx + s * c * yy + (c**2 - s**2) * xy
    normal = s**2 * xx + c**2 * yy - 2 * s * c * xy
    assert np.allclose(joint.traction_from_stress(frame, stress), np.stack([shear, normal], axis=-1))


def test_fault_along_y():
    """Theta = 90 degrees: f_s = -sigma_xy, f_n = sigma_xx; the bottom is on the right, x > 0."""
    frame, _ = joint.frame(np.array([[[0.0, 0.0], [0.0, 1000.0]]]))
    assert np.allclose(frame[0], [[0, 1], [-1, 0]])
    traction = joint.traction_from_stress(frame, np.array([[[-2e5, -1.4e5], [-1.4e5, -6e5]]]))
    assert np.allclose(traction, [[1.4e5, -2e5]])


def test_strain_is_top_minus_bottom():
    frame, _ = joint.frame(segments())
    slip, opening = 0.3, 0.02
    top = np.array([slip, opening]) @ frame  # rows of the frame are the axes
    displacement = np.concatenate([np.zeros_like(top), np.zeros_like(top), top, top], axis=1) + 0.7
    for xi, _ in joint.RULES.values():
        strain = joint.strain(joint.jump_operator(frame, xi), displacement)
        assert strain.shape == (len(ANGLES), len(xi), 2)
        assert np.allclose(strain, [slip, opening])


def test_nodal_rule_sees_its_own_section():
    frame, _ = joint.frame(segments(np.zeros(1)))
    displacement = np.array([[0, 0, 0, 0, 1.0, 2.0, 3.0, 4.0]])
    assert np.allclose(
        joint.strain(joint.jump_operator(frame, joint.RULES["nodal"][0]), displacement), [[[1, 2], [3, 4]]]
    )


@pytest.mark.parametrize("rule", joint.RULES)
def test_rules_integrate(rule):
    xi, weights = joint.RULES[rule]
    length = np.array([2.5, 1.0])
    assert np.allclose(joint.section_length(length, weights).sum(axis=1), length)
    assert weights @ xi == pytest.approx(0.0)
    expected = {"nodal": 2.0, "gauss2": 2 / 3, "one-point": 0.0}
    assert weights @ xi**2 == pytest.approx(expected[rule])


def test_tangent_is_the_explicit_one():
    """(2.21a) with (2.32a), (2.32b)."""
    frame, length = joint.frame(segments())
    xi, weights = joint.RULES["nodal"]
    rng = np.random.default_rng(0)
    k_s, k_n = rng.uniform(1, 2, (2, len(ANGLES), 2))
    moduli = np.zeros((len(ANGLES), 2, 2, 2))
    moduli[..., 0, 0], moduli[..., 1, 1] = k_s, k_n
    tangent = joint.tangent(joint.jump_operator(frame, xi), moduli, joint.section_length(length, weights))

    def pattern(k1, k2):
        return np.array([[k1, 0, 0, -k1], [0, k2, -k2, 0], [0, -k2, k2, 0], [-k1, 0, 0, k1]])

    for i, c in enumerate(frame):
        blocks = np.zeros((4, 2, 4, 2))
        blocks[:, 0, :, 0] = length[i] / 2 * pattern(*k_s[i])
        blocks[:, 1, :, 1] = length[i] / 2 * pattern(*k_n[i])
        expected = np.einsum("am,iajb,bn->imjn", c, blocks, c)
        assert np.allclose(in_report_order(tangent[i]), expected)


@pytest.mark.parametrize("rule", joint.RULES)
def test_tangent_is_the_derivative_of_the_force(rule):
    frame, length = joint.frame(segments())
    xi, weights = joint.RULES[rule]
    operator, weight = joint.jump_operator(frame, xi), joint.section_length(length, weights)
    rng = np.random.default_rng(2)
    moduli = rng.normal(size=(len(ANGLES), len(xi), 2, 2))
    displacement = rng.normal(size=(len(ANGLES), 8))
    traction = np.einsum("nqij,nqj->nqi", moduli, joint.strain(operator, displacement))
    product = np.einsum("nij,nj->ni", joint.tangent(operator, moduli, weight), displacement)
    force = np.einsum("nqij,nqi->nj", operator, weight[..., None] * traction)
    assert np.allclose(force, product)


def test_gauss_couples_ends_and_nodal_does_not():
    frame, length = joint.frame(segments(np.zeros(1)))
    for rule, coupled in (("nodal", False), ("gauss2", True), ("one-point", True)):
        xi, weights = joint.RULES[rule]
        moduli = np.tile(np.eye(2), (1, len(xi), 1, 1))
        tangent = joint.tangent(joint.jump_operator(frame, xi), moduli, joint.section_length(length, weights))[0]
        assert (np.abs(tangent[0, 2]) > 1e-12) == coupled
