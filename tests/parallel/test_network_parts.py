"""Components of a network that ranks cut again and again are those of one rank, and no rank knows all nodes of one."""

from pathlib import Path

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.mesh.agreement import on_root
from fracflow.model.mass import inverse_mass
from fracflow.model.network_parts import NetworkComponents, leaving
from fracflow.model.undrained import change_volume, close, closure_row
from fracflow.reduction.prepare import prepare, read_split
from fracflow.reduction.sliced import Whole
from fracflow.scene.scene import load
from fracflow.solve.clusters import find_clusters

COMM = MPI.COMM_WORLD
SCENE = Path(__file__).parents[2] / "meshes" / "failures" / "no_outlet" / "scene.toml"
STRIPE = 0.8  # m along the fractures, of which each joint is about as long
OPEN = {"many": 0.85, "all": 1.1, "none": 0.0, "few": 0.3}  # of the joints that conduct; ranks run the first and last


@pytest.fixture(scope="module")
def models():
    """Cut in stripes among all ranks, and whole on each of them."""
    scene = load(SCENE, ["geometry.size_at_fractures=0.4"])
    mesh = on_root(COMM, lambda: read_split(scene))
    stripes = None
    if mesh is not None:
        stripes = (mesh.points[mesh.cells[:, :3]].mean(axis=1)[:, 0] // STRIPE).astype(int) % COMM.size
    return prepare(scene, COMM, Whole.of(mesh, COMM), stripes), prepare(
        scene, MPI.COMM_SELF, Whole.of(COMM.bcast(mesh, root=0), MPI.COMM_SELF)
    )


def conducts(blocks, share):
    """The same joints conduct on any number of ranks."""
    return np.random.default_rng(7).random(blocks.sizes.joints)[blocks.joints.ids] < share


def facts_of(model, share):
    """Node numbers of the mesh -> what is known of the component, and each component's text and closures' rows."""
    ops = model.operators
    parts, comm = NetworkComponents(ops, conducts(ops.blocks, share)), ops.layout.comm
    some = parts.any_of(ops.blocks.flow.ids % 5 == 0)
    moves = change_volume(ops, parts, model.loads.held)
    assert np.array_equal(parts.own, parts.at(ops.layout.flow_starts[comm.rank] + np.arange(len(parts.own))))
    rows = zip(
        ops.blocks.flow.ids.tolist(), *(each[parts.own].tolist() for each in (parts.sizes, some, moves)), strict=True
    )
    nodes = {node: facts for part in comm.allgather(list(rows)) for node, *facts in part}
    roots, count = parts.listed(~some)
    largest, same = parts.listed(~some, 3)
    assert count == same == len(roots) and set(largest.tolist()) <= set(roots.tolist())
    named, closed = parts.named(roots), []
    for part in named:
        for holds in (False, True):
            closure = close(ops, parts, part, parts.at_root(moves, part), holds)
            cols, weights = closure_row(closure, ops.layout)
            joined = comm.allreduce(np.array([len(cols), weights.sum(), np.abs(weights).sum(), len(closure.ends[0])]))
            closed.append((closure.by, *joined.tolist(), closure.size, comm.allreduce(len(closure.row))))
    found = (
        nodes,
        parts.count,
        sorted(part.count for part in named),
        sorted(closed),
        sorted(part.fractures for part in named),
    )
    parts.destroy()
    return found


@pytest.mark.parametrize("share", OPEN.values(), ids=OPEN)
def test_the_parts_are_those_of_one_rank(models, share):
    cut, whole = (facts_of(model, share) for model in models)
    assert cut[:3] == whole[:3]
    assert (whole[1] == 2) == (share > 1.0) and cut[4] == whole[4]
    for one, other in zip(cut[3], whole[3], strict=True):
        assert one[0] == other[0] and one[-1] == 1
        assert one[1:] == pytest.approx(other[1:], rel=1e-10, abs=1e-9)


def test_nodes_that_terms_drain_are_known_where_they_are_owned(models):
    cut, whole = models
    assert (
        len(leaving(cut.operators)) == cut.operators.layout.flow_count < len(leaving(whole.operators)) or COMM.size == 1
    )


def clusters_of(model):
    """Of each section, by the number of its joint: the numbers of its cluster, and what these move each other."""
    ops, comm = model.operators, model.operators.layout.comm
    inverse = inverse_mass(ops, model.loads.held)
    clusters = find_clusters(ops.joints, inverse, comm)
    inverse.destroy()
    ids = np.repeat(ops.blocks.joints.ids, ops.joints.points)
    there = clusters.exchange.there(ids[:, None].astype(float))[:, 0]
    found = np.full((len(there), 3), np.nan)
    for batch in clusters.batches:
        inside, size = there[batch.sections], np.abs(batch.compliance).sum(axis=(1, 2))
        each = np.stack([inside.sum(axis=1), np.full(len(inside), inside.shape[1]), size], axis=1)
        found[batch.sections] = each[:, None]
    rows = np.insert(clusters.exchange.back(found), 0, ids, axis=1)
    return np.array(sorted(np.concatenate(comm.allgather(rows)).round(20).tolist()))


def test_clusters_of_sections_are_those_of_one_rank():
    """At a crossing a section couples with two of three others, which may all be of other ranks."""
    scene = load(SCENE.parents[2] / "crossings" / "scene.toml")
    mesh = on_root(COMM, lambda: read_split(scene))
    whole = clusters_of(prepare(scene, MPI.COMM_SELF, Whole.of(COMM.bcast(mesh, root=0), MPI.COMM_SELF)))
    assert whole[:, 2].max() >= 4.0
    for seed in range(2):  # the one cuts a crossing so on three ranks, the other on two
        ranks = None if mesh is None else np.random.default_rng(seed).integers(COMM.size, size=len(mesh.cells))
        np.testing.assert_allclose(clusters_of(prepare(scene, COMM, Whole.of(mesh, COMM), ranks)), whole, rtol=1e-12)
