"""Random networks through Gmsh and the split, held against the arrangement of their traces in exact fractions."""

from __future__ import annotations

import re

import numpy as np
import pytest
from arrangement import arrange, least_angle, least_gap
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from meshing import areas, check

from fracflow.errors import InputError
from fracflow.mesh.facets import components
from fracflow.mesh.plane.traces import tidy
from fracflow.mesh.read import GeometrySpec, build_mesh, side_names
from fracflow.mesh.split import split, summary
from fracflow.remarks import bare

pytestmark = pytest.mark.serial

WIDTH, SNAP, FINE = 12, 0.01, 0.9
SQUARE = np.array([[0, 0], [WIDTH, 0], [WIDTH, WIDTH], [0, WIDTH]], dtype=float)


@st.composite
def networks(draw):
    """Two to seven traces of two or three of a few points: many share ends, meet in T's, cross at bends, leave the domain."""
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    pool = random.integers(-1, WIDTH + 2, (draw(st.integers(5, 14)), 2))
    lengths = draw(st.lists(st.integers(2, 3), min_size=2, max_size=7))
    traces = [[tuple(map(int, p)) for p in pool[random.permutation(len(pool))[:length]]] for length in lengths]
    assume(all(len(set(trace)) == len(trace) for trace in traces))
    return traces


def blocks_of(mesh):
    """Block of each node."""
    cell, corner = np.nonzero(mesh.cells >= 0)
    nodes = mesh.cells[cell, corner]
    piece = components(mesh.cells[cell, 0], nodes, len(mesh.points))
    return np.unique(piece, return_inverse=True)[1]


def geometry(traces, cells):
    named = tuple((f"f{number}", np.array(points, float)) for number, points in enumerate(traces))
    return GeometrySpec(SQUARE, named, 2.0, FINE, cells, snap=SNAP)


@settings(max_examples=60)
@given(traces=networks())
def test_what_runs_along_another_or_lies_outside_is_refused(traces):
    exact = arrange(WIDTH, traces)
    assume(least_gap(exact) > 2 * SNAP)
    named = [(f"f{number}", np.array(points, float)) for number, points in enumerate(traces)]
    if exact.repeated or exact.empty:
        with pytest.raises(InputError, match=r"runs along|folds back|outside the domain"):
            tidy(SQUARE, side_names(SQUARE), named, SNAP, FINE)
        return
    network = tidy(SQUARE, side_names(SQUARE), named, SNAP, FINE)
    assert len(network.edges) == len(exact.edges) and len(network.points) == len(exact.points)
    assert all(": cut at" in note for note in network.notes)


@settings(max_examples=60, suppress_health_check=[HealthCheck.filter_too_much])
@given(traces=networks(), seed=st.integers(0, 2**32 - 1))
def test_traces_drawn_by_hand_meet_as_they_were_meant(traces, seed):
    """Each point is a tenth of the tolerance off: T's, shared tips and crossings at bends come out all the same."""
    exact = arrange(WIDTH, traces)
    assume(not exact.repeated and not exact.empty and least_gap(exact) > 3 * SNAP and least_angle(exact) > 20)
    assume(all(0 < part < WIDTH or part in (-1, WIDTH + 1) for trace in traces for point in trace for part in point))
    random = np.random.default_rng(seed)
    drawn = [np.array(points) + 0.07 * SNAP * random.uniform(-1, 1, (len(points), 2)) for points in traces]
    named = [(f"f{number}", points) for number, points in enumerate(drawn)]
    network = tidy(SQUARE, side_names(SQUARE), named, SNAP, FINE)
    assert (len(network.edges), len(network.points)) == (len(exact.edges), len(exact.points))
    found = np.sort(np.linalg.norm(network.points[:, None] - points_of(exact), axis=2).min(axis=1))
    assert found.max() < SNAP and len(network.tips) == len(exact.tips)


def points_of(exact):
    return np.array([[float(x), float(y)] for x, y in exact.points])


@pytest.mark.parametrize("cells", ["triangles", "quads"])
@settings(max_examples=25, suppress_health_check=[HealthCheck.filter_too_much])
@given(traces=networks())
def test_a_random_network_is_cut_as_its_traces_say(cells, traces):
    exact = arrange(WIDTH, traces)
    assume(least_gap(exact) > 2 * SNAP and not exact.repeated and not exact.empty)
    raw = build_mesh(geometry(traces, cells))
    mesh = split(raw)
    check(raw, mesh)  # faces of each joint coincide, bottom on the right
    assert areas(mesh).min() > 0 and areas(mesh).sum() == pytest.approx(WIDTH**2, rel=1e-12)

    found = summary(mesh)
    assert (found["blocks"], found["junctions"]) == (exact.blocks, exact.junctions)
    block = blocks_of(mesh)
    if exact.areas is not None:
        assert np.sort(np.bincount(block[mesh.cells[:, 0]], areas(mesh))) == pytest.approx(exact.areas)

    # Flow: the nodes of the exact graph, and its connection.
    flow = mesh.points[mesh.flow_origin]
    ends = np.array([[float(part) for part in p] for edge, own in exact.edges.items() if own is not None for p in edge])
    assert np.linalg.norm(ends[:, None] - flow, axis=2).min(axis=1).max() < 1e-9
    hangs = components(*mesh.joint_flow.T, len(flow))
    hangs, of = hangs[mesh.joint_flow[:, 0]], np.array([int(name[1:]) for name in mesh.fractures])[mesh.joint_fracture]
    assert sorted(np.unique(of[hangs == part]).tolist() for part in np.unique(hangs)) == exact.networks

    # Tips, and only they, have no jump.
    closed = np.unique(mesh.joint_bottom[mesh.joint_bottom == mesh.joint_top])
    tips = np.array(sorted([float(x), float(y)] for x, y in exact.tips)).reshape(-1, 2)
    order = np.lexsort(np.round(mesh.points[closed], 6).T[::-1])
    assert np.allclose(mesh.points[closed][order], tips, atol=1e-9)
    turn_one_block(mesh, block, 0)
    turn_one_block(mesh, block, block.max())


def turn_one_block(mesh, block, chosen):
    """A rigid motion of a block opens the joints between it and others, and no other."""
    away = mesh.points - [-3.0, 17.0]
    motion = np.stack([-away[:, 1], away[:, 0]], axis=1) * (block == chosen)[:, None]
    jump = np.linalg.norm(motion[mesh.joint_top] - motion[mesh.joint_bottom], axis=2).min(axis=1)
    below, above = (block[mesh.cells[mesh.joint_cells[:, side], 0]] == chosen for side in (0, 1))
    assert np.array_equal(jump > 1.0, below != above)
    assert jump[below == above].max(initial=0) == 0


@pytest.mark.parametrize("cells", ["triangles", "quads"])
def test_two_hundred_traces(cells):
    """Straight traces, anywhere and at all angles: none is lost, and blocks follow from Euler's formula."""
    random = np.random.default_rng(1)
    middle, angle = random.uniform(0, WIDTH, (200, 2)), random.uniform(0, np.pi, 200)
    half = np.stack([np.cos(angle), np.sin(angle)], axis=1) * random.uniform(0.2, 1.5, (200, 1))
    traces = {f"f{i}": np.stack([middle[i] - half[i], middle[i] + half[i]]) for i in range(200)}
    spec = GeometrySpec(SQUARE, tuple(traces.items()), 1.0, 0.25, cells)
    raw = build_mesh(spec)
    network = tidy(SQUARE, side_names(SQUARE), spec.traces, 0.0125, 0.25)
    mesh = split(raw)
    check(raw, mesh)
    found = summary(mesh)
    pieces = components(*network.edges.T, len(network.points)).max() + 1
    assert found["blocks"] == len(network.edges) - len(network.points) + pieces
    assert areas(mesh).min() > 0 and areas(mesh).sum() == pytest.approx(WIDTH**2, rel=1e-12)
    assert set(mesh.fractures) == set(traces) and found["cells under 20 degrees"] < 0.02
    for name, points in traces.items():
        is_whole = np.all((points > 0) & (points < WIDTH)) and not any(f'"{name}"' in note for note in raw.notes)
        if is_whole:
            assert found["lengths"][name] == pytest.approx(np.linalg.norm(points[1] - points[0]), abs=0.0125)
    out = {name for name, points in traces.items() if np.any((points < -0.0125) | (points > WIDTH + 0.0125))}
    assert {re.match(r'fracture "(\w+)": cut', bare(note))[1] for note in raw.notes if ": cut at" in note} == out
