"""The parts of the preconditioner of large scenes: what they move, what they leave, and that ranks make the same."""

import numpy as np
import pytest

from fracflow._petsc import MPI, PETSc
from fracflow.model.layout import local_rows
from fracflow.reduction.prepare import prepare
from fracflow.scene.scene import Scene, load
from fracflow.solve.fractured_rock import parts_of
from fracflow.solve.fractured_rock.coarse_jumps import coarse_jumps
from fracflow.solve.fractured_rock.shared import Shared
from fracflow.solve.fractured_rock.subspaces import grown, walls


@pytest.fixture(scope="module")
def operators():
    return prepare(load("meshes/crossings/scene.toml"), MPI.COMM_WORLD).operators


def nodes_of(blocks):
    return Shared(blocks.comm, blocks.solid.owned, blocks.sizes.nodes, blocks.solid.node_global)


def test_values_of_numbers_that_ranks_share(comm):
    numbers = np.array([0, comm.rank])
    shared = Shared(comm, 1, comm.size, numbers)
    last = comm.size - 1
    assert shared.largest(np.full(2, comm.rank)).tolist() == [last, comm.rank or last]
    assert shared.of_owners(np.array([10.0 * comm.rank])).tolist() == (10.0 * numbers).tolist()
    shared.destroy()


def test_no_joint_feels_a_displacement_that_walls_share(operators):
    parts = parts_of(operators.blocks, operators.layout, operators.scales.length, np.zeros(0, dtype=int))
    given = parts.intact.createVecRight()
    given.setArray(np.random.default_rng(operators.layout.comm.rank).uniform(-1.0, 1.0, given.getLocalSize()))
    moved, displacement = parts.intact.createVecLeft(), operators.layout.solid_vector()
    parts.intact.mult(given, moved)
    displacement.setArray(moved.getArray()[: operators.layout.solid_count])
    assert displacement.norm(PETSc.NormType.INFINITY) > 0.5  # of 1
    assert np.abs(operators.joints.strain(displacement)).max(initial=0.0) < 1e-15
    assert parts.intact.getSize()[1] < operators.layout.solid_starts[-1]
    pressures = operators.layout.flow_starts[-1]
    assert parts.strips.getSize() < operators.layout.total and parts.jumps.getSize()[1] > pressures


def test_strips_grow_by_whole_cells(operators):
    blocks = operators.blocks
    nodes = nodes_of(blocks)
    marked = walls(blocks, nodes) >= 0.0
    for _ in range(3):
        cells = blocks.solid.cells
        more = grown(blocks, nodes, marked, 1)
        touched = (marked[cells] & (cells >= 0)).any(axis=1)
        assert more[cells[touched]][cells[touched] >= 0].all() and (more | ~marked).all()
        marked = more


def through(rise):
    """A square of rock that one fracture cuts in two; the grid has one cell."""
    cut = {"name": "cut", "points": [[0.0, 0.5 - 0.5 * rise], [1.0, 0.5 + 0.5 * rise]]}
    data = {
        "geometry": {"domain": [0.0, 0.0, 1.0, 1.0], "size": 0.1, "fracture": [cut]},
        "rock": {"rock": {"youngs_modulus": 1e9, "poissons_ratio": 0.25, "density": 2500.0}},
        "fracture": {"cut": {"law": "linear", "normal_stiffness": 1e10, "shear_stiffness": 1e10}},
        "support": [{"on": ["south"]}],
        "stage": [{"kind": "quasi-static", "time_step": 1.0, "steps": 1}],
    }
    return Scene.from_data(data)


def cut_hats(rise, comm):
    """Blocks, and the parts of hats on a grid of one cell, of a square that one fracture cuts."""
    operators = prepare(through(rise), comm).operators
    blocks = operators.blocks
    nodes = nodes_of(blocks)
    is_wall = walls(blocks, nodes) >= 0.0
    return blocks, coarse_jumps(blocks, operators.layout, nodes, is_wall, [1.01], np.zeros(0, dtype=int))


@pytest.mark.parametrize("rise", [0.0, 0.3])
def test_each_side_of_a_cut_has_hats_that_sum_to_one(rise, comm):
    jumps = cut_hats(rise, comm)[1]
    assert jumps.getSize()[1] == 2 * 4 * 2  # sides, hats, components
    ones, sums = jumps.createVecRight(), jumps.createVecLeft()
    ones.set(1.0)
    jumps.mult(ones, sums)
    assert np.allclose(sums.getArray(), 1.0, atol=1e-12)


@pytest.mark.serial
def test_each_side_of_a_cut_moves_as_a_body():
    blocks, jumps = cut_hats(0.3, MPI.COMM_SELF)
    rows, block = local_rows(jumps), blocks.solid
    dense = np.zeros(jumps.getSize())
    dense[rows.rows, rows.cols] = rows.values
    for piece in range(2):
        for motion in np.eye(2), np.array([[0.0, 1.0], [-1.0, 0.0]]), np.array([[0.0, 0.0], [1.0, 0.0]]):
            here = (block.piece == piece)[:, None]
            wanted = np.zeros(len(dense))
            wanted[block.unknown] = here * (block.points @ motion + 1.0)
            assert np.abs(dense @ np.linalg.lstsq(dense, wanted, rcond=None)[0] - wanted).max() < 1e-12
