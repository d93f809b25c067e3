"""Blocks on 1, 2 and 3 ranks: everything owned once, joints with both faces at hand, original numbers kept."""

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.mesh.agreement import on_root
from fracflow.mesh.distribute import distribute, partition_cells, rigid_bodies
from fracflow.reduction.prepare import read_split
from fracflow.scene.scene import load

COMM = MPI.COMM_WORLD


@pytest.fixture(params=["crossings", "report_5_2", "report_5_5"])
def parts(request):
    scene = load(f"meshes/{request.param}/scene.toml")
    mesh = on_root(COMM, lambda: read_split(scene))
    rigid = [name for name, rock in scene.rock.items() if rock.rigid]
    return distribute(mesh, COMM, rigid), COMM.bcast(mesh, root=0), rigid


def _everywhere(numbers):
    return np.concatenate(COMM.allgather(numbers))


def test_everything_has_one_owner(parts):
    blocks, mesh, _ = parts
    solid = blocks.solid
    for mine, total in (
        (solid.cell_ids, len(mesh.cells)),
        (solid.node_ids[: solid.owned], len(mesh.points)),
        (blocks.joints.ids, len(mesh.joint_bottom)),
        (blocks.flow.ids, len(mesh.flow_origin)),
        (solid.node_global[: solid.owned], len(mesh.points)),
    ):
        assert np.array_equal(np.sort(_everywhere(mine)), np.arange(total))
    start = solid.node_starts[COMM.rank]
    assert np.array_equal(np.sort(solid.node_global[: solid.owned]), start + np.arange(solid.owned))


def test_local_numbers_mean_the_same_as_the_original_ones(parts):
    blocks, mesh, _ = parts
    solid, joints = blocks.solid, blocks.joints
    padded = np.append(solid.node_ids, -1)
    assert np.array_equal(padded[solid.cells], mesh.cells[solid.cell_ids])
    assert np.array_equal(solid.node_ids[joints.bottom], mesh.joint_bottom[joints.ids])
    assert np.array_equal(solid.node_ids[joints.top], mesh.joint_top[joints.ids])
    assert np.array_equal(joints.flow_ids, mesh.joint_flow[joints.ids])
    assert np.array_equal(solid.points, mesh.points[solid.node_ids])


def test_ghosts_know_the_numbers_of_their_owners(parts):
    blocks, mesh, _ = parts
    solid = blocks.solid
    numbers = np.full(len(mesh.points), -1)
    for ids, values in COMM.allgather((solid.node_ids[: solid.owned], solid.node_global[: solid.owned])):
        numbers[ids] = values
    assert np.array_equal(numbers[solid.node_ids], solid.node_global)


def test_unknowns_are_numbered_once(parts):
    blocks, mesh, rigid = parts
    body, rock = rigid_bodies(mesh, rigid)
    solid = blocks.solid
    assert np.array_equal(body[solid.node_ids], solid.body)
    free = solid.unknown[: solid.owned][solid.body[: solid.owned] < 0].ravel()
    own_bodies = solid.body_unknown[solid.body_owner == COMM.rank].ravel()
    mine = np.concatenate([free, own_bodies])
    first, last = solid.unknown_starts[COMM.rank], solid.unknown_starts[COMM.rank + 1]
    assert np.array_equal(np.sort(mine), np.arange(first, last))
    assert len(rock) == len(solid.body_unknown)


def test_joints_of_a_network_are_not_cut():
    mesh = on_root(COMM, lambda: read_split(load("meshes/crossings/scene.toml")))
    assert distribute(mesh, COMM).sizes.cut_joints == 0
    if mesh is not None:  # random numbers of the partitioner do not go on from one run of a process to its next
        parts = np.array([partition_cells(mesh, 3) for _ in range(6)])
        assert np.ptp(parts, axis=0).max() == 0
