"""Far jumps act on each other through series: as all pairs of segments do, and symmetrically."""

import numpy as np
import pytest
from scipy import sparse

from fracflow.elements.cells import divided, pairs_of
from fracflow.elements.dislocation import energies
from fracflow.elements.multipoles import FarJumps, Hats


def fans(count=12, joints=12):
    """Straight cracks with sizes over a decade, at random: hats at their inner nodes, places, and what these reach."""
    draw = np.random.default_rng(3)
    segments, hat, segment, sign, places, reach = [], [], [], [], [], []
    for _ in range(count):
        middle, angle, half = draw.uniform(0, 10, 2), draw.uniform(0, np.pi), 10 ** draw.uniform(-1, 0)
        along = np.sort(draw.uniform(-1, 1, joints + 1))[:, None]
        nodes = middle + along * half * np.array([np.cos(angle), np.sin(angle)])
        for i in range(1, joints):
            hat += [len(places)] * 2
            segment += [len(segments) + i - 1, len(segments) + i]
            sign += [1.0, -1.0]
            places.append(nodes[i])
            reach.append([nodes[i - 1 : i + 2].min(axis=0), nodes[i - 1 : i + 2].max(axis=0)])
        segments += [nodes[i : i + 2] for i in range(joints)]
    ends = np.array(segments)
    cells = divided(np.array(places), np.array(reach), 6)
    return Hats(np.array(hat), np.array(segment), np.array(sign), cells.leaf, ends), cells


@pytest.fixture(scope="module")
def whole():
    """The far part by all pairs of segments (h, 2, h, 2), and what it is made of."""
    hats, cells = fans()
    count, pairs = len(hats.leaf), pairs_of(cells)
    grows = sparse.csr_matrix((hats.sign, (hats.segment, hats.hat)), shape=(len(hats.ends), count))
    means = energies(hats.ends, np.arange(len(hats.ends)))
    parts = [grows.T @ (grows.T @ means[..., part]).T for part in range(3)]
    is_near = np.zeros((len(cells.centre),) * 2, dtype=bool)
    is_near[tuple(pairs.near.T)] = True
    is_far = ~is_near[hats.leaf[:, None], hats.leaf]
    found = np.empty((count, 2, count, 2))
    for i, j, part in ((0, 0, 0), (1, 1, 1), (0, 1, 2), (1, 0, 2)):
        found[:, i, :, j] = np.where(is_far, parts[part], 0.0)
    assert 0.3 < is_far.mean() < 0.9
    return hats, cells, pairs, found


def acted(far, moved):
    """Forces (h, 2) of displacements (h, 2)."""
    found = far.forces(far.leaf_moments(moved @ [1, 1j]))
    return np.stack([found.real, found.imag], axis=1)


@pytest.mark.parametrize(("tolerance", "error"), [(1e-4, 1e-3), (1e-8, 1e-7), (1e-12, 1e-11)])
def test_series_are_what_all_pairs_of_segments_are(whole, tolerance, error):
    hats, cells, pairs, found = whole
    moved = np.random.default_rng(0).standard_normal((len(hats.leaf), 2))
    wanted = np.tensordot(found, moved, axes=2)
    far = acted(FarJumps(cells, pairs, hats, tolerance), moved)
    assert np.abs(far - wanted).max() < error * np.abs(wanted).max()


def test_series_are_symmetric_to_round_off(whole):
    hats, cells, pairs, _ = whole
    far, draw = FarJumps(cells, pairs, hats, 1e-4), np.random.default_rng(0)
    one, other = draw.standard_normal((2, len(hats.leaf), 2))
    there, back = np.sum(acted(far, one) * other), np.sum(acted(far, other) * one)
    assert there == pytest.approx(back, rel=1e-12)


def test_each_pair_of_points_is_in_one_pair_of_cells(whole):
    hats, cells, pairs, _ = whole
    inside = np.zeros((len(cells.centre), len(hats.leaf)), dtype=int)
    inside[hats.leaf, np.arange(len(hats.leaf))] = 1
    for cell in reversed(range(len(cells.centre))):
        if cells.child[cell] >= 0:
            inside[cell] = inside[cells.child[cell]] + inside[cells.child[cell] + 1]
    count = sum(inside[one][:, None] * inside[other] for one, other in np.concatenate([pairs.far, pairs.near]))
    np.testing.assert_array_equal(count, 1)
