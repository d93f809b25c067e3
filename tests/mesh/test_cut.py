"""Cells cut in four on the rank that has them make the same mesh as cells cut before the split, numbered in another order."""

from dataclasses import fields, replace

import numpy as np
import pytest
from refined import refined
from scipy.spatial import cKDTree

from fracflow._petsc import MPI
from fracflow.mesh.cut_mesh import cut_mesh, near_mesh, sizes_of
from fracflow.mesh.data import RawMesh
from fracflow.mesh.distribute import distribute
from fracflow.mesh.near_cells import has_near_first, near_cells, with_near_first
from fracflow.mesh.split import split

COMM = MPI.COMM_WORLD
WIDE, HIGH = 6, 4


def _grid():
    """Quads on the left and triangles on the right; an X, a crack of one joint, one that ends on the side, two rigid blocks."""
    x, y = np.meshgrid(np.arange(WIDE + 1.0), np.arange(HIGH + 1.0), indexing="ij")
    at = np.arange(x.size).reshape(x.shape)
    a, b, c, d = at[:-1, :-1].ravel(), at[1:, :-1].ravel(), at[1:, 1:].ravel(), at[:-1, 1:].ravel()
    left = np.repeat(np.arange(WIDE), HIGH) < WIDE // 2
    none = np.full_like(a, -1)
    quads = np.stack([a, b, c, d], axis=1)[left]
    halves = [np.stack(part, axis=1)[~left] for part in ((a, b, c, none), (a, c, d, none))]
    cells = np.concatenate([quads, *halves])
    middle = np.where(cells[:, 3] < 0, x.ravel()[cells[:, :3]].mean(axis=1), x.ravel()[cells].mean(axis=1))
    rock = np.where(middle < 1.0, 1, np.where(middle > WIDE - 1.0, 1, 0))
    traces = [at[2:5, 2], at[3, 1:4], at[4, 3:5], at[1:3, 1]]
    facets = [np.stack([trace[:-1], trace[1:]], axis=1) for trace in traces]
    sides = [at[:, 0], at[0]]
    edges = [np.stack([side[:-1], side[1:]], axis=1) for side in sides]
    return RawMesh(
        points=np.stack([x.ravel(), y.ravel()], axis=1) * [1.0, 1.25],
        cells=cells,
        cell_rock=rock,
        rocks=("soft", "hard"),
        fracture_facets=np.concatenate(facets),
        fracture_of=np.repeat(np.arange(len(facets)), [len(each) for each in facets]),
        fractures=("flat", "steep", "ending", "short"),
        side_facets=np.concatenate(edges),
        side_of=np.repeat([0, 1], [len(each) for each in edges]),
        sides=("south", "west"),
        named_points={"corner": 0, "crossing": int(at[3, 2])},
    )


def _whole(blocks):
    """Tables of all ranks by numbers of the mesh, on rank 0; nodes, as their ghosts know them too."""
    solid, joints, flow, sizes = blocks.solid, blocks.joints, blocks.flow, blocks.sizes
    padded = np.append(solid.node_ids, -1)
    tables = {
        "cells": (solid.cell_ids, padded[solid.cells], sizes.cells),
        "rock": (solid.cell_ids, solid.cell_rock, sizes.cells),
        "faces": (joints.ids, padded[np.stack([joints.bottom, joints.top], axis=1)], sizes.joints),
        "fracture": (joints.ids, joints.fracture, sizes.joints),
        "along": (joints.ids, joints.along, sizes.joints),
        "flow": (joints.ids, joints.flow_ids, sizes.joints),
        "flow_number": (joints.ids, joints.flow, sizes.joints),
        "flow_points": (flow.ids, flow.points, sizes.flow_nodes),
        "flow_numbers": (flow.ids, flow.starts[COMM.rank] + np.arange(len(flow.ids)), sizes.flow_nodes),
    }
    nodes = ("points", "origin", "node_global", "unknown", "body", "piece")
    own = slice(solid.owned)
    tables |= {name: (solid.node_ids[own], getattr(solid, name)[own], sizes.nodes) for name in nodes}
    found = {name: blocks.gather(*table) for name, table in tables.items()}
    known = COMM.gather({name: getattr(solid, name) for name in ("node_ids", *nodes)})
    sides = COMM.gather((solid.side_of, padded[solid.side_facets], solid.cell_ids[solid.side_cell]))
    if COMM.rank == 0:
        for each in known:
            assert all(np.array_equal(each[name], found[name][each["node_ids"]]) for name in nodes)
        found |= dict(
            zip(("side_of", "side_facets", "side_cell"), map(np.concatenate, zip(*sides, strict=True)), strict=True)
        )
    return found


def _centres(mesh):
    points = np.append(mesh["points"], np.zeros((1, 2)), axis=0)[mesh["cells"]]
    return points.sum(axis=1) / (mesh["cells"] >= 0).sum(axis=1)[:, None]


def _same(groups, others):
    return sorted(map(sorted, groups)) == sorted(map(sorted, others))


def _near_first(mesh):
    return with_near_first(mesh, near_cells(mesh, np.array([[4.5, 0.6]])))


@pytest.mark.parametrize("cuts", [1, 3])
def test_the_same_mesh_as_if_cut_before_the_split(cuts):
    raw = _grid()
    fine = raw
    for _ in range(cuts):
        fine = refined(fine)
    meshes = [split(fine), _near_first(replace(split(raw), cuts=cuts))] if COMM.rank == 0 else [None, None]
    blocks = [distribute(mesh, COMM, ["hard"]) for mesh in meshes]
    asked, made = (_whole(each) for each in blocks)
    sizes = [each.sizes for each in blocks]
    assert replace(sizes[0], cut_joints=sizes[1].cut_joints) == sizes[1]  # at another level the partition differs
    if COMM.rank != 0:
        return
    away, cell = cKDTree(_centres(asked)).query(_centres(made))
    assert away.max() < 1e-12 and np.array_equal(np.sort(cell), np.arange(len(cell)))
    assert np.array_equal(asked["rock"][cell], made["rock"])
    cells = asked["cells"][cell]
    node = np.full(len(made["points"]), -1)
    for ours, theirs in zip(made["cells"], cells, strict=True):
        ours, theirs = ours[ours >= 0], theirs[theirs >= 0]
        gap = np.linalg.norm(made["points"][ours][:, None] - asked["points"][theirs], axis=2)
        assert gap.min(axis=1).max() < 1e-12
        found = theirs[gap.argmin(axis=1)]
        assert ((node[ours] < 0) | (node[ours] == found)).all()
        node[ours] = found
    assert np.array_equal(np.sort(node), np.arange(len(node)))  # no copy more and no copy less
    for name in ("body", "piece"):
        assert np.array_equal(asked[name][node], made[name])
    assert np.array_equal(node[made["faces"]], asked["faces"])
    assert np.array_equal(made["fracture"], asked["fracture"])
    assert made["along"] == pytest.approx(asked["along"], rel=1e-14)
    flow = np.full(len(made["flow_points"]), -1)
    flow[made["flow"]] = asked["flow"]
    assert np.array_equal(flow[made["flow"]], asked["flow"])
    assert made["flow_points"] == pytest.approx(asked["flow_points"][flow], rel=1e-14)
    assert np.array_equal(made["flow_numbers"][made["flow"]], made["flow_number"])
    # copies of a node have the lowest of their numbers in common
    first = made["origin"]
    assert np.array_equal(first[first], first) and (first <= np.arange(len(first))).all()
    copies = [node[first == each].tolist() for each in np.unique(first[first != np.arange(len(first))])]
    theirs = asked["origin"]
    assert _same(copies, [np.flatnonzero(theirs == each).tolist() for each in np.unique(theirs[len(fine.points) :])])
    sides = [
        np.column_stack([each["side_of"], number[each["side_facets"]]]).tolist()
        for each, number in ((made, node), (asked, np.arange(len(node))))
    ]
    assert sorted(sides[0]) == sorted(sides[1])
    assert all(
        np.isin(facet, made["cells"][at]).all()
        for facet, at in zip(made["side_facets"], made["side_cell"], strict=True)
    )


@pytest.mark.parametrize("cuts", [2])
def test_numbers_are_the_same_on_any_number_of_ranks(cuts):
    mesh = _near_first(replace(split(_grid()), cuts=cuts))
    alone = distribute(mesh, MPI.COMM_SELF, ["hard"])
    together = distribute(mesh if COMM.rank == 0 else None, COMM, ["hard"])
    at = np.empty(alone.sizes.nodes, dtype=int)
    at[alone.solid.node_ids] = np.arange(len(at))
    here = at[together.solid.node_ids]
    assert np.array_equal(alone.solid.points[here], together.solid.points)
    assert np.array_equal(alone.solid.origin[here], together.solid.origin)
    whole = np.append(alone.solid.node_ids, -1)[alone.solid.cells]
    assert np.array_equal(np.append(together.solid.node_ids, -1)[together.solid.cells], whole[together.solid.cell_ids])
    assert np.array_equal(alone.joints.flow_ids[together.joints.ids], together.joints.flow_ids)
    whole = cut_mesh(mesh)
    joints = together.joints.ids
    assert np.array_equal(whole.points[together.solid.node_ids], together.solid.points)
    assert np.array_equal(whole.origin[together.solid.node_ids], together.solid.origin)
    padded = np.append(together.solid.node_ids, -1)
    assert np.array_equal(whole.cells[together.solid.cell_ids], padded[together.solid.cells])
    assert np.array_equal(whole.joint_bottom[joints], padded[together.joints.bottom])
    assert np.array_equal(whole.joint_top[joints], padded[together.joints.top])
    assert np.array_equal(whole.joint_flow[joints], together.joints.flow_ids)
    assert np.array_equal(whole.points[whole.flow_origin[together.flow.ids]], together.flow.points)
    for face, cell in zip((whole.joint_bottom, whole.joint_top), whole.joint_cells.T, strict=True):
        assert (whole.cells[cell][:, None] == face[:, :, None]).any(axis=2).all()
    assert np.array_equal(whole.flow_origin[whole.joint_flow], whole.origin[whole.joint_bottom])
    near = near_mesh(mesh)
    assert len(near.cells) == 4**cuts * mesh.near < len(whole.cells) and has_near_first(mesh)
    assert sizes_of(near) == (len(whole.cells), len(whole.points)) == (together.sizes.cells, together.sizes.nodes)
    for field in fields(near):
        first, every = getattr(near, field.name), getattr(whole, field.name)
        same = first == every[: len(first)] if isinstance(first, np.ndarray) else first is every or first == every
        assert np.all(same), field.name
    around = np.isin(whole.cells, near.joint_bottom).any(axis=1)
    assert np.flatnonzero(around).max() < len(near.cells)
