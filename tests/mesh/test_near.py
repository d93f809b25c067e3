"""A network follows from its traces alone, whatever the mesh; what all but meets is listed, with the snap that joins it."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from fracflow.errors import InputError
from fracflow.mesh.places import place_text
from fracflow.mesh.plane.near import HEAD, MOST, near_miss_lines
from fracflow.mesh.plane.traces import FRACTION, natural_snap
from fracflow.mesh.read import GeometrySpec, build_mesh, network_of
from fracflow.mesh.split import split, summary
from fracflow.remarks import bare

pytestmark = pytest.mark.serial

WIDTH = 100.0
SQUARE = WIDTH * np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
ALONG = [[10, 50], [90, 50]]


def spec(traces, domain=SQUARE, size=20.0, **more):
    named = tuple((f"f{number}", np.array(points, float)) for number, points in enumerate(traces))
    return GeometrySpec(np.array(domain, float), named, size, **more)


def misses_of(traces, **more):
    return network_of(spec(traces, **more))[2]


@pytest.mark.parametrize(
    ("trace", "line"),
    [
        ([[50, 51], [50, 80]], 'fracture "f1": end (50, 51) is 1 short of fracture "f0" at (50, 50);'
         " geometry.snap = 1 joins them"),
        ([[50, 49], [50, 80]], 'fracture "f1": end (50, 49) is 1 beyond fracture "f0" at (50, 50);'
         " geometry.snap = 1 takes it back"),
        ([[90.6, 50.8], [80, 80]], 'fracture "f0": end (90, 50) is 1 short of fracture "f1" at (90.6, 50.8);'
         " geometry.snap = 1 joins them"),
        ([[30, 70], [50, 51.2345], [70, 70]], 'fracture "f1": bend (50, 51.2345) is 1.23 from fracture "f0" at (50, 50);'
         " geometry.snap = 1.24 joins them"),
        ([[30, 70], [30, 98.6]], 'fracture "f1": end (30, 98.6) is 1.4 short of side north at (30, 100);'
         " geometry.snap = 1.41 joins them"),
    ],
    ids=["short", "beyond", "end to end", "bend", "side"],
)  # fmt: skip
def test_what_all_but_meets_is_named_with_the_snap_that_joins_it(trace, line):
    (miss,) = misses_of([ALONG, trace], snap=0.3)
    assert str(miss).startswith(f"near miss: {line}")
    assert misses_of([ALONG, trace], snap=miss.snap) == []
    assert misses_of([ALONG, trace], snap=miss.distance / 5.01) == []  # beyond five snaps
    mesh = build_mesh(spec([ALONG, trace], snap=0.3))
    assert mesh.notes[1] == str(miss) and mesh.notes[0].startswith(HEAD + "1 ")


@pytest.mark.parametrize(
    "trace",
    [
        [[50, 50], [50, 80]],  # a T
        [[30, 30], [60, 80]],  # a crossing
        [[90, 50], [80, 90]],  # ends that meet
        [[30, 0], [0, 30]],  # ends on sides
        [[50, 50], [51, 50.9], [80, 80]],  # a bend beside the T that it comes from
        [[50, 53], [50, 80]],  # far
    ],
)
def test_what_meets_or_stays_away_is_no_near_miss(trace):
    assert misses_of([ALONG, trace], snap=0.3) == []


def test_many_near_misses_are_counted():
    comb = [[[x, 50.4], [x, 60 + x / 10]] for x in np.linspace(12, 88, MOST + 5)]
    lines = near_miss_lines(misses_of([ALONG, *comb], snap=0.1))
    assert lines[0] == HEAD + f"{MOST + 5} do not meet, by no more than 5 times geometry.snap"
    assert len(lines) == MOST + 2 and lines[-1] == "near miss: 5 more, up to 0.4 apart"


def test_the_nearest_comes_first_and_stubs_come_last():
    found = misses_of([ALONG, [[50, 51], [50, 80]], [[30, 50.5], [30, 80]], [[70, 49.6], [70, 80]]], snap=0.3)
    assert [(miss.kind, miss.distance) for miss in found] == [
        ("end", pytest.approx(0.5)), ("end", pytest.approx(1.0)), ("end beyond", pytest.approx(0.4))
    ]  # fmt: skip


@pytest.mark.parametrize("gap", [0.2, 1.0])
def test_mesh_sizes_change_no_network(gap):
    """Tenfold smaller cells: a T that is a hair open stays shut, one that is wider stays open and is told."""
    traces = [ALONG, [[50, 50 + gap], [50, 95]]]
    found = [build_mesh(spec(traces, size_at_fractures=fine)) for fine in (10.0, 1.0)]
    assert [summary(split(raw))["junctions"] for raw in found] == ([1, 1] if gap < 1 else [0, 0])
    told = [[note for note in raw.notes if not bare(note).startswith("cells of")] for raw in found]
    assert told[0] == told[1] and bare(told[0][-1]).startswith("fracture" if gap < 1 else "near miss")


def test_cells_that_a_near_miss_costs_are_told():
    (note,) = [
        note for note in build_mesh(spec([ALONG, [[50, 50.5], [50, 95]]])).notes if bare(note).startswith("cells of")
    ]
    assert bare(note).startswith("cells of 0.884, 0.044 of size_at_fractures, at (50, 50.5): by the near miss of ")
    assert note.endswith('fracture "f1" and fracture "f0"')


def test_the_snap_is_a_share_of_the_median_and_no_quarter_of_anything():
    lines = [[[10, y], [10 + length, y]] for y, length in ((10, 20), (30, 30), (50, 80))]

    def of(traces, domain=SQUARE):
        return natural_snap(np.array(domain, float), spec(traces).traces)

    assert of(lines) == (pytest.approx(FRACTION * 30), "0.4 % of the median length of traces")
    assert of([*lines, [[10, 80], [10.2, 80]]])[0] == pytest.approx(0.05)  # a quarter of the shortest
    assert of([*lines, [[10, 70], [40, 70]]])[0] == of(lines)[0]  # one more far away
    assert of([[[-1e4, 50], [1e4, 50]]]) == (pytest.approx(FRACTION * WIDTH), "0.4 % of the domain's width")
    assert of(lines, [*SQUARE[:3], [0.1, 100], [0, 99.8]])[0] == pytest.approx(0.25 * 0.05**0.5)


@st.composite
def drawn(draw):
    """Ten to thirty traces anywhere in the middle, with ends near others."""
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    count = draw(st.integers(10, 30))
    middle, angle = random.uniform(20, 80, (count, 2)), random.uniform(0, np.pi, count)
    half = np.stack([np.cos(angle), np.sin(angle)], axis=1) * random.uniform(3, 18, (count, 1))
    traces = np.stack([middle - half, middle + half], axis=1)
    for k in range(1, count, 2):  # ends that all but meet the trace before
        along = random.uniform(0.1, 0.9)
        step = traces[k - 1, 1] - traces[k - 1, 0]
        off = np.array([-step[1], step[0]]) / np.linalg.norm(step) * random.uniform(-0.6, 0.6)
        traces[k, 0] = traces[k - 1, 0] + along * step + off
    return traces


def shape(traces, domain=SQUARE, names=None):
    """Counts of a network, and kinds and owners of its near misses, a side as one of them."""
    names = range(len(traces)) if names is None else names
    geometry = GeometrySpec(domain, tuple((f"f{k}", points) for k, points in zip(names, traces, strict=True)), 20.0)
    network, snap, misses = network_of(geometry)
    pairs = Counter(
        (miss.kind, frozenset([*miss.owners, miss.other.split('"')[1] if '"' in miss.other else "side"]))
        for miss in misses
    )
    return (len(network.points), len(network.edges), len(network.tips), pairs), snap


@settings(max_examples=40)
@given(
    traces=drawn(),
    scale=st.floats(1e-4, 1e4),
    degrees=st.floats(0, 360),
    mirrored=st.booleans(),
    seed=st.integers(0, 2**32 - 1),
)
def test_a_network_is_the_same_in_any_unit_turned_mirrored_and_in_any_order(traces, scale, degrees, mirrored, seed):
    try:
        expected, snap = shape(traces)
    except InputError:
        assume(False)
    cos, sin = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    turn = scale * np.array([[cos, sin], [-sin, cos]]) * ([-1, 1] if mirrored else [1, 1])
    order = np.random.default_rng(seed).permutation(len(traces))
    found, other = shape((traces @ turn)[order], SQUARE @ turn, order)
    assert other == pytest.approx(scale * snap)
    assert found == expected


@settings(max_examples=40)
@given(traces=drawn())
def test_the_snap_that_is_told_joins(traces):
    """Of each trace whose end stops short the two share a point then, and no near miss is nearer than the snap."""
    try:
        network, snap, misses = network_of(spec(traces))
        assert all(miss.distance > snap for miss in misses if miss.kind.startswith("end"))
        misses = [miss for miss in misses if miss.kind == "end" and miss.other.startswith("fracture")]
        joined = [network_of(spec(traces, snap=miss.snap))[0] for miss in misses[:1]]
    except InputError:
        assume(False)
    for network, miss in zip(joined, misses, strict=False):
        one, other = int(miss.owners[0][1:]), int(miss.other.split('"')[1][1:])
        at = [network.points[np.unique(network.edges[network.owner == owner])] for owner in (one, other)]
        away = np.linalg.norm(at[0][:, None] - at[1], axis=2).min()
        assert away == 0.0, (miss, away)


def test_a_coordinate_below_round_off_is_zero():
    assert place_text((-3.55e-14, 2.0), 100.0) == "(0, 2)"
    assert place_text((-3.55e-14, 2.0), 1e-6) == "(-3.55e-14, 2)"
