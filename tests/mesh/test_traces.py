"""Traces as users have them: what is snapped, cut, refined or refused, and what is said about it."""

from __future__ import annotations

import numpy as np
import pytest
from meshing import areas, check, copies_at

from fracflow.errors import InputError
from fracflow.mesh.plane.planar_graph import boxes_that_meet, merge, planar_graph_of
from fracflow.mesh.plane.quality import corner_angles
from fracflow.mesh.plane.traces import tidy
from fracflow.mesh.read import GeometrySpec, build_mesh, side_names
from fracflow.mesh.split import split, summary
from fracflow.remarks import bare, note

pytestmark = pytest.mark.serial

SQUARE = np.array([[0, 0], [4, 0], [4, 4], [0, 4]], dtype=float)
BOTH = pytest.mark.parametrize("cells", ["triangles", "quads"])


def spec(traces, cells="triangles", size=1.0, fine=0.4, domain=SQUARE, **more):
    named = tuple((chr(ord("a") + number), np.array(points, float)) for number, points in enumerate(traces))
    return GeometrySpec(np.array(domain, float), named, size, fine, cells, **more)


def network(traces, snap=0.05, domain=SQUARE):
    domain = np.array(domain, float)
    return tidy(domain, side_names(domain), spec(traces).traces, snap, 0.4)


ALONG = [[1, 1], [3, 1]]


@pytest.mark.parametrize(
    ("traces", "said", "junction"),
    [
        ([ALONG, [[2, 1.03], [2, 3]]], '"b": end (2, 1.03) moved by 0.03 to (2, 1) onto fracture "a"', (2, 1)),
        ([ALONG, [[2, 0.96], [2, 3]]], '"b": end (2, 0.96) moved by 0.04 to (2, 1) onto fracture "a"', (2, 1)),
        ([ALONG, [[3.03, 1.04], [3, 3]]], '"b": end (3.03, 1.04) moved by 0.05 to (3, 1) onto fracture "a"', (3, 1)),
        ([ALONG, [[2, 3], [2.02, 1.02], [2.5, 3]]], '"b": point (2.02, 1.02) moved by 0.02 to (2.02, 1) onto fracture "a"',
         (2.02, 1)),
        ([ALONG, [[1, 3], [0.03, 2]]], '"b": end (0.03, 2) moved by 0.03 to (0, 2) onto side west', (0, 2)),
        ([ALONG, [[1, 3], [-0.03, 2]]], '"b": end (-0.03, 2) moved by 0.03 to (0, 2) onto side west', (0, 2)),
        ([ALONG, [[1, 3], [0.02, 0.03]]], '"b": end (0.02, 0.03) moved by 0.0361 to (0, 0) onto side south and side west',
         (0, 0)),
        ([ALONG, [[2, 0.5], [2, 3]], [[1.5, 0.47], [2.5, 1.47]]],
         'fracture "c" and fracture "b" and fracture "a": crossing (2.03, 1) moved by 0.03 to (2, 1)', (2, 1)),
        ([ALONG, [[2, 0.5], [2.02, 1.04], [2, 3]]], '"b": point (2.02, 1.04) moved by 0.04 to (2.02, 1) onto fracture "a"',
         (2.02, 1)),
        ([ALONG, [[1, 3], [5, 3]]], '"b": cut at (4, 3), where it leaves the domain; 1 is left out', (4, 3)),
        ([ALONG, [[-1, 3], [6, 3]]], '"b": cut at (0, 3), (4, 3), where it leaves the domain; 3 is left out', (4, 3)),
    ],
    ids=["short", "beyond", "tips", "bend", "side", "outside", "corner", "three", "bend and crossing", "cut", "twice"],
)  # fmt: skip
def test_what_is_changed_is_said(traces, said, junction):
    found = network(traces)
    assert any(said in line for line in found.notes), found.notes
    assert np.linalg.norm(found.points - junction, axis=1).min() < 1e-12


def test_what_meets_already_is_left_alone():
    assert network([ALONG, [[2, 1], [2, 3]], [[1, 1], [0, 2]], [[0, 0], [1, 0.5]]]).notes == ()
    assert network([ALONG, [[2, 1.051], [2, 3]]]).notes == ()  # a gap over the tolerance
    assert len(network([ALONG, [[2, 1.03], [2, 3]]], snap=0.02).tips) == 4


@BOTH
def test_a_trace_cut_by_a_domain_with_a_notch_has_two_parts(cells):
    notch = [[0, 0], [4, 0], [4, 4], [3, 4], [3, 2], [1, 2], [1, 4], [0, 4]]
    raw = build_mesh(spec([[[-1, 3], [5, 3]]], cells, domain=notch))
    mesh = split(raw)
    check(raw, mesh)
    found = summary(mesh)
    assert (found["blocks"], found["lengths"]["a"]) == (3, pytest.approx(2)) and areas(mesh).sum() == pytest.approx(12)
    assert raw.notes == (
        note('fracture "a": cut at (0, 3), (1, 3), (3, 3), (4, 3), where it leaves the domain; 4 is left out'),
    )


@BOTH
@pytest.mark.parametrize("degrees", [0.5, 0.2, 3.0])
def test_a_crossing_at_half_a_degree(cells, degrees):
    end = 1.9 * np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])
    raw = build_mesh(spec([[[0.1, 2], [3.9, 2]], [2 - end, 2 + end]], cells, snap=0.005))
    mesh = split(raw)
    check(raw, mesh)
    assert areas(mesh).min() > 0 and areas(mesh).sum() == pytest.approx(16, rel=1e-12)
    assert all(bare(line).startswith(("near miss", "cells of")) for line in raw.notes)  # nothing is moved or shared
    assert copies_at(mesh, (2, 2)) == 4 and summary(mesh)["tips"] == 4
    angles = corner_angles(raw.points, raw.cells)
    assert angles.min() == pytest.approx(degrees, rel=0.6) and angles.max() < 180
    assert len(raw.cells) < 30000  # refined only down to twice the tolerance


@BOTH
def test_between_parallel_traces_cells_are_as_fine_as_the_gap(cells):
    wide, narrow = (build_mesh(spec([[[1, 1], [3, 1]], [[1, 1 + gap], [3, 1 + gap]]], cells)) for gap in (0.5, 0.05))
    step = np.linalg.norm(np.diff(narrow.points[narrow.fracture_facets], axis=1)[:, 0], axis=1)
    wanted = 0.1 if cells == "triangles" else 0.05  # twice the gap; quads are pairs of triangles cut in four
    assert 0.5 * wanted < step.min() and step.max() < 1.3 * wanted
    step = np.linalg.norm(np.diff(wide.points[wide.fracture_facets], axis=1)[:, 0], axis=1)
    assert step.min() > 0.25  # as asked, 0.4
    assert corner_angles(narrow.points, narrow.cells).min() > 20
    assert len(narrow.cells) < 3000


@BOTH
def test_a_crossing_is_refined_evenly_down_to_any_tolerance(cells):
    end = 1.9 * np.array([np.cos(np.radians(2)), np.sin(np.radians(2))])
    traces = [[[0.1, 2], [3.9, 2]], [2 - end, 2 + end]]
    counts = [len(build_mesh(spec(traces, cells, snap=0.4 * 10.0**-power)).cells) for power in (2, 3, 4)]
    # From one tolerance to the next as many more: cells as long as the gap, towards the crossing.
    assert counts[2] - counts[1] == pytest.approx(counts[1] - counts[0], rel=0.25)


@BOTH
def test_sizes_at_fractures_at_tips_and_away(cells):
    raw = build_mesh(spec([[[1, 2], [3, 2]]], cells, size=0.8, fine=0.2, size_at_tips=0.02, growth=0.2))
    steps = raw.points[raw.fracture_facets]
    length, middle = np.linalg.norm(steps[:, 1] - steps[:, 0], axis=1), steps.mean(axis=1)[:, 0]
    from_tip = np.minimum(middle - 1, 3 - middle)
    wanted = np.minimum(0.02 + 0.2 * from_tip, 0.2)
    assert np.all((length / wanted > 0.6) & (length / wanted < 1.6))
    corner = np.abs(raw.points[raw.cells].mean(axis=1) - 2).min(axis=1) > 1.5
    assert areas(raw)[corner].mean() > 0.05  # about 0.5 away from the fracture
    assert length.max() > 5 * length.min() and corner_angles(raw.points, raw.cells).min() > 20


@BOTH
@pytest.mark.parametrize(("rise", "is_wedge"), [(0.1, True), (0.3, True), (1.0, False)])
def test_cells_are_fine_where_a_wedge_of_rock_ends(cells, rise, is_wedge):
    # The longer trace goes on past the tip of the other, where the wedge between them is as thick as it rises.
    raw = build_mesh(spec([[[0.5, 1], [3.5, 1]], [[1, 1], [2.5, 1 + rise]]], cells, size=0.8, fine=0.3, snap=0.01))
    length = np.linalg.norm(np.diff(raw.points[raw.fracture_facets], axis=1)[:, 0], axis=1)
    at_tip = np.any(np.all(np.isclose(raw.points[raw.fracture_facets], [2.5, 1 + rise]), axis=2), axis=1)
    assert np.all(length[at_tip] < 1.3 * rise / 16) == is_wedge
    own_end = np.any(np.all(np.isclose(raw.points[raw.fracture_facets], [3.5, 1]), axis=2), axis=1)
    assert length[own_end] > 0.1  # no wedge ends here


@pytest.mark.parametrize(
    ("traces", "message"),
    [
        ([ALONG, [[1, 1.01], [3, 1.02]]], '"b": runs along fracture "a" for 2, from .*remove one, or lower snap'),
        ([ALONG, [[3, 1], [1, 1]]], '"b": runs along fracture "a" for 2'),
        ([ALONG, [[2, 1.01], [3.9, 1.02]]], '"b": runs along fracture "a" for 1'),
        ([[[0.5, 0.5], [1, 1], [3, 1], [3.5, 2]], [[0.5, 3], [1, 1.01], [3, 1.01], [3.5, 3]]], '"b": runs along .* for 2'),
        ([[[1, 3.99], [3, 4.01]]], '"a": runs along side north for 2, .*move it inside'),
        ([[[1, 5], [3, 5]]], '"a": lies outside the domain; move or remove it'),
        ([[[1, 5], [3, 5]], ALONG, [[5, 1], [6, 1]]], r'"a": lies outside the domain \(and 1 more: "c"\); move'),
        ([[[1, 1], [1.03, 1]]], '"a": is shorter than snap = 0.05'),
        ([[[1, 1], [3, 1], [1, 1.01]]], '"a": folds back on itself'),
    ],
)  # fmt: skip
def test_refused_by_name(traces, message):
    with pytest.raises(InputError, match=message) as caught:
        network(traces)
    assert "\n" not in str(caught.value) and str(caught.value).startswith("geometry: fracture")


@pytest.mark.parametrize(
    ("domain", "message"),
    [
        ([[0, 0], [4, 4], [4, 0], [0, 4]], "geometry.domain: the sides cross each other"),
        (
            [[0, 0], [4, 0], [4, 0.01], [0, 4]],
            r"geometry.domain: the side that starts at \(4, 0\) is no longer than snap",
        ),
        ([[0, 0], [2, 0], [4, 0]], "geometry.domain"),
        ([[0, 0], [4, 0], [2, 0.01], [4, 4], [0, 4]], r"geometry.domain: the corner \(2, 0.01\) is within snap"),
    ],
)
def test_domains_that_are_none(domain, message):
    with pytest.raises(InputError, match=message):
        network([], domain=domain)


def test_traces_that_cross_slowly_share_what_is_too_narrow():
    """Where a third trace crosses two that part at one degree, nearer to each other than the tolerance."""
    end = 1.9 * np.array([np.cos(np.radians(1)), np.sin(np.radians(1))])
    found = network([[[0.1, 2], [3.9, 2]], [2 - end, 2 + end], [[2.3, 1], [2.3, 3]]], snap=0.01)
    assert any('"b": shares 0.3 from (2, 2) to (2.3, 2) with fracture "a", which keeps it' in n for n in found.notes)
    assert not np.any(
        found.owner[np.all(np.abs(found.points[found.edges].mean(axis=1) - [2.15, 2]) < 0.01, axis=1)] == 1
    )


def test_boxes_that_meet_are_those_of_all_pairs():
    """Points, lines and boxes alike among them, and many ends at one place; a hundred thousand take no minute."""
    rng = np.random.default_rng(0)
    for each in range(100):
        low, high = (np.round(part, 1 + each % 3) for part in rng.uniform(-1.0, 1.0, (2, 30, 2)))
        ends = np.stack([low, low + (high - low) * rng.choice([0.0, 0.1, 1.0], (30, 2))], axis=1)
        low, high = ends.min(axis=1) - 0.05, ends.max(axis=1) + 0.05
        found = np.nonzero(np.triu(np.all((low[:, None] <= high) & (low <= high[:, None]), axis=2), 1))
        np.testing.assert_array_equal(boxes_that_meet(ends, 0.05), found)
    start = rng.uniform(0.0, 1000.0, (100_000, 2))
    one, other = boxes_that_meet(np.stack([start, start + rng.uniform(-2.0, 2.0, start.shape)], axis=1), 0.0)
    assert np.all(one < other) and len(one) > 1e4


def test_a_line_of_many_points_within_a_snap_keeps_few():
    """A line drawn far finer than the snap: of 40 000 points, with 8e7 pairs of near ones, 200 stay."""
    x = np.linspace(0.1, 9.9, 40_000)
    line = planar_graph_of(10.0 * np.array([[0, 0], [1, 0], [1, 1], [0, 1]]), [np.stack([x, 5.0 + 0.0 * x], axis=1)])
    merged = merge(line, 0.05)
    kept = np.unique(merged.edges[merged.owner == 0])
    gaps = np.diff(np.sort(merged.points[kept, 0]))
    assert len(kept) < 200 and 0.05 < gaps.min() < gaps.max() < 0.11
