"""Copies, faces, signs and blocks of split meshes, on grids written by hand and on random networks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from _boxes import box
from hypothesis import given, settings
from hypothesis import strategies as st
from meshing import areas, check, copies_at, grid

from fracflow.errors import InputError
from fracflow.mesh.facets import components, half_facets
from fracflow.mesh.interpret import facet_order
from fracflow.mesh.split import split, summary

pytestmark = pytest.mark.serial

ALONG_X = [(0, 2), (1, 2), (2, 2), (3, 2), (4, 2)]
ALONG_Y = [(2, 0), (2, 1), (2, 2), (2, 3), (2, 4)]
LOOP = [(1, 1), (2, 1), (3, 1), (3, 2), (3, 3), (2, 3), (1, 3), (1, 2), (1, 1)]


def test_a_quad_on_each_side_by_hand():
    """Fault along +y: bottom is x > 0, and the first copy is that of the lowest cell."""
    raw = replace(grid(2, 1, [[(1, 0), (1, 1)]]), points=grid(2, 1, []).points - [1, 0])
    mesh = split(raw)
    check(raw, mesh)
    assert mesh.cells.tolist() == [[0, 1, 4, 3], [6, 2, 5, 7]]
    assert mesh.joint_top.tolist() == [[1, 4]] and mesh.joint_bottom.tolist() == [[6, 7]]
    assert mesh.joint_cells.tolist() == [[1, 0]]
    assert mesh.flow_origin.tolist() == [1, 4] and mesh.joint_flow.tolist() == [[0, 1]]
    assert mesh.side_facets.tolist() == [[0, 1], [6, 2]] and mesh.side_cell.tolist() == [0, 1]


@pytest.mark.parametrize("triangles", [False, True])
@pytest.mark.parametrize(
    ("traces", "copies", "blocks", "junctions", "tips"),
    [
        ([ALONG_X, ALONG_Y], {(2, 2): 4, (0, 2): 2, (2, 4): 2, (1, 2): 2, (1, 1): 1}, 4, 1, 0),
        ([ALONG_X, ALONG_Y[2:]], {(2, 2): 3, (2, 4): 2}, 3, 1, 0),
        ([ALONG_X[:3], ALONG_Y[2:4]], {(2, 2): 2, (2, 3): 1, (0, 2): 2}, 1, 0, 1),
        ([ALONG_X[1:4], ALONG_Y[1:4]], {(2, 2): 4, (1, 2): 1, (2, 3): 1}, 1, 1, 4),
        ([LOOP], {(1, 1): 2, (2, 3): 2}, 2, 0, 0),
        ([ALONG_X], {(0, 2): 2, (4, 2): 2}, 2, 0, 0),
        ([ALONG_X[1:3]], {(1, 2): 1, (2, 2): 1}, 1, 0, 2),
        ([], {(2, 2): 1}, 1, 0, 0),
    ],
    ids=["X", "T", "corner", "buried X", "loop", "cut", "one facet", "none"],
)
def test_copies_and_blocks(traces, copies, blocks, junctions, tips, triangles):
    raw = grid(4, 4, traces, triangles)
    mesh = split(raw)
    check(raw, mesh)
    assert {place: copies_at(mesh, place) for place in copies} == copies
    found = summary(mesh)
    assert (found["blocks"], found["junctions"], found["tips"]) == (blocks, junctions, tips)
    assert found["copies"] == len(mesh.points) - len(raw.points)
    assert found["lengths"] == pytest.approx({f"f{i}": len(trace) - 1.0 for i, trace in enumerate(traces)})
    assert areas(mesh).sum() == pytest.approx(16)


def everywhere(middle):
    return np.ones(len(middle), dtype=bool)


def inside(middle):
    """Of a plane in a box of four: what does not reach its sides."""
    return ((middle > 1.0) & (middle < 3.0)).all(axis=1)


@pytest.mark.parametrize("tetrahedra", [False, True])
@pytest.mark.parametrize(
    ("planes", "copies", "blocks", "junctions", "tips"),
    [
        ([], {(2, 2, 2): 1}, 1, 0, 0),
        ([(2, 2, everywhere)], {(2, 2, 2): 2, (0, 0, 2): 2, (4, 2, 2): 2, (2, 2, 1): 1}, 2, 0, 0),
        ([(2, 2, everywhere), (0, 2, everywhere)], {(2, 2, 2): 4, (2, 0, 2): 4, (1, 2, 2): 2, (2, 2, 1): 2}, 4, 4, 0),
        ([(2, 2, everywhere), (0, 2, lambda x: x[:, 2] > 2)], {(2, 2, 2): 3, (2, 2, 1): 1, (2, 2, 3): 2}, 3, 4, 0),
        ([(i, 2, everywhere) for i in range(3)], {(2, 2, 2): 8, (2, 2, 1): 4, (2, 1, 1): 2}, 8, 12, 0),
        ([(2, 2, lambda x: x[:, 0] < 2)], {(1, 2, 2): 2, (2, 2, 2): 1, (2, 0, 2): 1, (0, 0, 2): 2}, 1, 0, 4),
        ([(2, 2, inside)], {(2, 2, 2): 2, (1, 2, 2): 1, (1, 1, 2): 1, (3, 3, 2): 1}, 1, 0, 8),
        ([(2, 2, inside), (0, 2, inside)], {(2, 2, 2): 4, (2, 1, 2): 1, (2, 2, 1): 1, (2, 2, 3): 1}, 1, 2, 16),
    ],
    ids=["none", "plane", "two that cross", "one ends on another", "three that cross", "ends", "buried", "buried X"],
)
def test_planes_in_space(planes, copies, blocks, junctions, tips, tetrahedra):
    """Planes that end inside keep their edge joined; where planes cross, each piece of rock has its own copy."""
    raw = box((4, 4, 4), planes, tetrahedra)
    mesh = split(raw)
    check(raw, mesh)
    assert {place: copies_at(mesh, place) for place in copies} == copies
    found = summary(mesh)
    assert (found["blocks"], found["junctions"], found["tips"]) == (blocks, junctions, tips)
    area = {f"f{i}": float(np.sum(raw.fracture_of == i)) * (0.5 if tetrahedra else 1.0) for i in range(len(planes))}
    assert found["lengths"] == pytest.approx(area)
    tip = mesh.joint_bottom == mesh.joint_top
    assert np.array_equal(
        np.unique(mesh.origin[mesh.joint_bottom[tip]]), np.unique(mesh.flow_origin[mesh.joint_flow[tip]])
    )


@pytest.mark.parametrize("tetrahedra", [False, True])
def test_a_plane_in_space_that_is_turned(tetrahedra):
    """Another order of nodes about the same normal changes nothing; the other way round the faces change places."""
    raw = box((2, 2, 2), [(2, 1, everywhere)], tetrahedra)
    there = split(raw)
    rolled = split(replace(raw, fracture_facets=np.roll(raw.fracture_facets, 1, axis=1)))
    back = split(replace(raw, fracture_facets=raw.fracture_facets[:, ::-1]))
    assert np.array_equal(np.roll(there.joint_top, 1, axis=1), rolled.joint_top)
    assert np.array_equal(there.joint_bottom, back.joint_top[:, ::-1])
    assert np.array_equal(there.joint_cells, back.joint_cells[:, ::-1])
    assert there.joint_along.shape == there.joint_bottom.shape and not there.joint_along.any()


def test_cells_of_two_kinds_in_space():
    cubes, small = (box((2, 2, 2), [(2, 1, everywhere)], tetrahedra) for tetrahedra in (False, True))
    padded = np.concatenate([small.cells, np.full((len(small.cells), 4), -1)], axis=1)
    mixed = replace(cubes, cells=np.concatenate([cubes.cells, padded]))
    with pytest.raises(InputError, match="tetrahedra and hexahedra in one mesh"):
        split(mixed)


@settings(max_examples=20)
@given(st.data())
def test_random_planes_in_space(data):
    """Random facets of cubes: the copies of a node are the pieces into which they cut the cubes around it."""
    width = 3
    raw = box((width,) * 3, [(i, p, everywhere) for i in range(3) for p in range(1, width)])
    chosen = np.array(data.draw(st.lists(st.booleans(), min_size=len(raw.fracture_of), max_size=len(raw.fracture_of))))
    raw = replace(raw, fracture_facets=raw.fracture_facets[chosen], fracture_of=raw.fracture_of[chosen])
    mesh = split(raw)
    check(raw, mesh)
    cut = {tuple(sorted(facet)) for facet in raw.fracture_facets.tolist()}
    table = half_facets(raw.cells, 3)
    owners = {}
    for facet, cell in zip(table.nodes.tolist(), table.cell.tolist(), strict=True):
        owners.setdefault(tuple(sorted(facet)), []).append(cell)
    for node in range(len(raw.points)):
        around = np.flatnonzero((raw.cells == node).any(axis=1))
        links = [cells for facet, cells in owners.items() if node in facet and len(cells) == 2 and facet not in cut]
        one, other = np.array(links, dtype=np.int64).reshape(-1, 2).T
        pieces = len(np.unique(components(one, other, len(raw.cells))[around]))
        assert np.sum(mesh.origin == node) == pieces


def test_a_turned_trace_swaps_the_faces():
    there, back = (split(grid(4, 4, [trace])) for trace in (ALONG_X, ALONG_X[::-1]))
    assert np.array_equal(there.joint_bottom, back.joint_top[::-1, ::-1])
    assert np.array_equal(there.joint_cells, back.joint_cells[::-1, ::-1])


def test_padded_cells():
    raw = grid(4, 4, [ALONG_X, ALONG_Y])
    split_one = np.concatenate([raw.cells[1:], [[0, 1, 6, -1], [0, 6, 5, -1]]])
    raw = replace(raw, cells=split_one, cell_rock=np.zeros(17, dtype=np.int64))
    mesh = split(raw)
    check(raw, mesh)
    assert summary(mesh)["blocks"] == 4


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            dict(fracture_facets=[[0, 1]]),
            r'fracture "f0": the facet \(0, 0\) to \(1, 0\) has a cell on one side',
        ),
        (dict(fracture_facets=[[6, 12]]), r'"f0": the facet \(1, 1\) to \(2, 2\) is no edge of the mesh'),
        (dict(fracture_facets=[[6, 7], [7, 6]]), r"stands twice; fractures must not overlap"),
        (dict(side_facets=[[6, 7]]), r'side "south": the facet at \(1.5, 1\) is inside the mesh'),
        (dict(side_facets=[[0, 2]]), r'side "south": the facet at \(1, 0\) is no edge'),
    ],
)
def test_errors(change, message):
    change = {key: np.array(value) for key, value in change.items()}
    for key, of in (("fracture_facets", "fracture_of"), ("side_facets", "side_of")):
        if key in change:
            change[of] = np.zeros(len(change[key]), dtype=np.int64)
    with pytest.raises(InputError, match=message):
        split(replace(grid(4, 4, [ALONG_X]), **change))


def test_overlapping_or_clockwise_cells():
    raw = grid(4, 4, [ALONG_X])
    twice = replace(raw, cells=np.concatenate([raw.cells, raw.cells[4:5]]), cell_rock=np.zeros(17, dtype=np.int64))
    with pytest.raises(InputError, match="more than two cells share the edge"):
        split(twice)
    cells = raw.cells.copy()
    cells[8:12] = cells[8:12, ::-1]
    with pytest.raises(InputError, match="turn clockwise"):
        split(replace(raw, cells=cells))


@settings(max_examples=60)
@given(st.data())
def test_random_networks(data):
    """Random facets of a grid: the count of copies is that of the pieces of rock around each node."""
    width = 5
    inner = [((x, y), (x + 1, y)) for x in range(width) for y in range(1, width)]
    inner += [((x, y), (x, y + 1)) for x in range(1, width) for y in range(width)]
    chosen = data.draw(st.lists(st.sampled_from(inner), unique=True, max_size=len(inner)))
    turned = data.draw(st.lists(st.booleans(), min_size=len(chosen), max_size=len(chosen)))
    traces = [facet[::-1] if turn else facet for facet, turn in zip(chosen, turned, strict=True)]
    raw = grid(width, width, traces, data.draw(st.booleans()))
    mesh = split(raw)
    check(raw, mesh)
    around = np.bincount(raw.fracture_facets.ravel(), minlength=len(raw.points))
    on_boundary = np.any((raw.points == 0) | (raw.points == width), axis=1)
    expected = np.where(on_boundary, around + 1, np.maximum(around, 1))
    assert np.array_equal(np.bincount(mesh.origin, minlength=len(raw.points)), expected)


@given(st.lists(st.booleans(), min_size=3, max_size=12), st.booleans())
def test_orientation_of_chains_and_loops(turned, is_closed):
    count = len(turned)
    order = np.random.default_rng(count).permutation(count)
    nodes = np.arange(count + 1) % count if is_closed else np.arange(count + 1)
    straight = np.stack([nodes[:-1], nodes[1:]], axis=1)[order]
    mixed = np.where(np.array(turned)[:, None], straight[:, ::-1], straight)
    found = facet_order(mixed, np.zeros(count, dtype=np.int64))
    assert np.array_equal(found, straight[:, ::-1] if turned[0] else straight)


def test_orientation_keeps_fractures_apart_and_stops_at_junctions():
    # Fractures that meet do not follow each other; where three facets of one meet, nothing is constrained.
    facets = np.array([[0, 1], [2, 1], [1, 3], [4, 3]])
    assert np.array_equal(facet_order(facets, np.array([0, 1, 2, 2])), [[0, 1], [2, 1], [1, 3], [3, 4]])
    assert np.array_equal(facet_order(facets, np.zeros(4, dtype=np.int64)), [[0, 1], [2, 1], [1, 3], [3, 4]])
    assert facet_order(np.zeros((0, 2), dtype=np.int64), np.zeros(0, dtype=np.int64)).shape == (0, 2)


def test_components():
    assert components(np.array([0, 2]), np.array([1, 3]), 5).tolist() == [0, 0, 1, 1, 2]
