"""The parts of the preconditioner of large scenes: what they move, what they leave, and that ranks make the same."""

from contextlib import nullcontext
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from fracflow._petsc import MPI, PETSc, destroy
from fracflow.errors import Unsolved
from fracflow.mesh.shared import Shared
from fracflow.model.layout import local_rows
from fracflow.output import read_history
from fracflow.reduction.prepare import prepare
from fracflow.scene.scene import Scene, load
from fracflow.simulation.run import run
from fracflow.solve.fractured_rock import FracturedRock, parts_of
from fracflow.solve.fractured_rock.coarse_jumps import coarse_jumps, grid_sizes
from fracflow.solve.fractured_rock.preconditioner import _are_pressures, _shift
from fracflow.solve.fractured_rock.small_system import SmallSystem
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


def through(rise, size=0.1, **more):
    """A square of rock that one fracture cuts in two."""
    cut = {"name": "cut", "points": [[0.0, 0.5 - 0.5 * rise], [1.0, 0.5 + 0.5 * rise]]}
    data = {
        "geometry": {"domain": [0.0, 0.0, 1.0, 1.0], "size": size, "fracture": [cut]},
        "rock": {"rock": {"youngs_modulus": 1e9, "poissons_ratio": 0.25, "density": 2500.0}},
        "fracture": {"cut": {"law": "linear", "normal_stiffness": 1e10, "shear_stiffness": 1e10}},
        "support": [{"on": ["south"]}],
        "stage": [{"kind": "quasi-static", "time_step": 1.0, "steps": 1}],
    }
    return Scene.from_data(data | more)


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


def test_a_block_that_slides_on_a_weak_cut_takes_few_iterations(shared_tmp):
    """Without jumps on the coarse grid it takes 24 a Newton iteration at this size, and 43 on cells of half the size."""
    weak = {"cut": {"law": "linear", "normal_stiffness": 1e7, "shear_stiffness": 1e7}}
    push = {"load": [{"on": ["north"], "traction": [1e5, -2e5]}], "method": {"rock_solver": "multigrid"}}
    run(through(0.3, 0.04, fracture=weak, output={"pictures": False}, **push), shared_tmp / "weak")
    MPI.COMM_WORLD.barrier()
    steps = read_history(shared_tmp / "weak" / "history.h5")
    assert 0 < steps["step/krylov"].sum() <= 8 * steps["step/newton"].sum()


def test_small_systems_follow_the_joints_and_the_time_step(operators):
    """Of a diagonal matrix: what stands anywhere, what joints add on the strips."""
    layout = operators.layout
    parts = parts_of(operators.blocks, layout, operators.scales.length, np.zeros(0, dtype=int))
    near = parts.strips.getIndices() - layout.start
    stands, matrix = (PETSc.Mat().createAIJ(_square(layout), nnz=1, comm=layout.comm) for _ in range(2))
    filled = SimpleNamespace(matrix=matrix, standing=lambda: nullcontext(stands), stood=0.0, alphas=0.0)
    context = FracturedRock(parts, filled, "monolithic", 1)
    for alphas, joints in ((1.0, 1.0), (1.0, 5.0), (4.0, 5.0)):
        filled.alphas = filled.stood = alphas
        values = np.full(layout.solid_count + layout.flow_count, alphas)
        _set_diagonal(stands, values)
        values[near] += joints
        _set_diagonal(matrix, values)
        context.setUp(PETSc.PC())
        for part, moved, whole in (("intact", parts.intact, stands), ("jumps", parts.jumps, matrix)):
            wanted, found = whole.PtAP(moved).getDiagonal(), context.systems[part].getDiagonal()
            is_moved = wanted.getArray() > 0.0
            assert np.allclose(found.getArray()[is_moved], wanted.getArray()[is_moved], rtol=1e-6)
            assert layout.comm.allreduce(int(is_moved.sum())) > 0
    context.destroy(PETSc.PC())


@pytest.mark.parametrize("by", ["umfpack", "mumps"])
def test_a_small_system_is_solved_on_one_rank_or_on_all(by, comm):
    options, count = PETSc.Options(), 3 * comm.rank or 3 * (comm.size == 1)  # rank 0 of several has no rows
    given = {"small_ksp_type": "preonly", "small_pc_type": "lu", "small_pc_factor_mat_solver_type": by}
    for name, value in given.items():
        options[name] = value
    system = SmallSystem(comm, "small_", max(comm.size - 2, 0))
    assert system.is_alone == (by == "umfpack" and comm.size > 1)
    matrix = PETSc.Mat().createAIJ(((count, None), (count, None)), nnz=(3, 2), comm=comm)
    first, last = matrix.getOwnershipRange()
    right, found = matrix.createVecs()
    right.setArray(np.cos(np.arange(first, last)))
    for scale in (1.0, 5.0):
        for row in range(first, last):
            cols = [col for col in (row - 1, row, row + 1) if 0 <= col < matrix.getSize()[0]]
            matrix.setValues(row, cols, [scale * (4.0 + row if col == row else 0.5 * (row - col)) for col in cols])
        matrix.assemble()
        system.take(matrix)
        assert system.factor() is None
        system.solve(right, found)
        left = right.duplicate()
        matrix.mult(found, left)
        left.axpy(-1.0, right)
        assert left.norm() < 1e-14
        left.destroy()
    destroy(system, matrix, right, found)
    for name in given:
        options.delValue(name)


@pytest.mark.serial
def test_pressures_along_a_cut_parallel_to_the_grid_leave_pivots():
    """Hats on both sides of a grid line have the same trace on the cut, but for a factor, and its fluid hardly flows."""
    wet = {"law": "linear", "normal_stiffness": 1e10, "shear_stiffness": 1e10, "aperture": 1e-6}
    scene = through(0.0, fracture={"cut": wet}, fluid={"viscosity": 1e-3})
    operators, none = prepare(scene, MPI.COMM_SELF).operators, np.zeros(0, dtype=int)
    nodes, layout = nodes_of(operators.blocks), operators.layout
    jumps = coarse_jumps(operators.blocks, layout, nodes, walls(operators.blocks, nodes) >= 0.0, [0.3], none)
    are_pressures = _are_pressures(jumps, layout.solid_count)
    dense = jumps[:, :]
    traces = dense[:, are_pressures] / np.linalg.norm(dense[:, are_pressures], axis=0)
    assert np.linalg.matrix_rank(traces) < are_pressures.sum()  # they do depend on each other
    rigid, thin = np.eye(layout.solid_count), 1e-12 * np.eye(layout.flow_count)
    couple = np.random.default_rng(0).standard_normal((layout.solid_count, layout.flow_count))
    fine = np.block([[rigid, couple], [-couple.T, thin]])
    count = jumps.getSize()[1]
    system = PETSc.Mat().createAIJ((count, count), nnz=count, comm=MPI.COMM_SELF)
    system[:, :] = dense.T @ fine @ dense
    system.assemble()

    def least_pivot():
        found = system[:, :]
        rock, flow = ~are_pressures, are_pressures
        left = found[np.ix_(flow, rock)] @ np.linalg.solve(found[np.ix_(rock, rock)], found[np.ix_(rock, flow)])
        pivots = found[np.ix_(flow, flow)] - left
        scale = np.sqrt(np.diag(pivots))
        return np.linalg.svd(pivots / np.outer(scale, scale), compute_uv=False).min()

    assert least_pivot() < 1e-13
    _shift(system, are_pressures)
    assert 1e-10 < least_pivot() < 1e-5
    destroy(system, jumps)
    nodes.destroy()


def test_factors_that_break_on_one_rank_break_on_all(operators, monkeypatch):
    layout = operators.layout
    parts = parts_of(operators.blocks, layout, operators.scales.length, np.zeros(0, dtype=int))
    matrix = PETSc.Mat().createAIJ(_square(layout), nnz=1, comm=layout.comm)
    _set_diagonal(matrix, np.ones(layout.solid_count + layout.flow_count))
    filled = SimpleNamespace(matrix=matrix, standing=lambda: nullcontext(matrix), stood=0.0, alphas=0.0)
    context = FracturedRock(parts, filled, "monolithic", 1)
    breaks = PETSc.Error(76) if layout.comm.rank == layout.comm.size - 1 else None
    monkeypatch.setattr(SmallSystem, "factor", lambda self: breaks)
    with pytest.raises(Unsolved, match="76"):
        context.setUp(PETSc.PC())
    context.destroy(PETSc.PC())
    matrix.destroy()


def _square(layout):
    size = layout.solid_count + layout.flow_count, layout.total
    return size, size


def _set_diagonal(matrix, values):
    vector = matrix.createVecLeft()
    vector.setArray(values)
    matrix.setDiagonal(vector)
    matrix.assemble()


@pytest.mark.serial
def test_grids_reach_from_the_joints_to_the_rock():
    """Where cells grow away from the fractures, each grid's cells are about four times those of the one before."""
    blocks, mean = prepare(through(0.3), MPI.COMM_SELF).operators.blocks, 0.1
    wall = walls(blocks, nodes_of(blocks)) >= 0.0
    even, graded = (grid_sizes(blocks, wall, length, 10.0) for length in (mean, mean / 100.0))
    assert len(even) == 1 and graded[0] == pytest.approx(0.1 * mean)
    assert len(graded) == 4 and all(3.0 < b / a < 6.0 for a, b in pairwise(graded))
    assert len(grid_sizes(blocks, np.zeros_like(wall), mean / 100.0, 10.0)) == 1  # no fracture


@pytest.mark.serial
def test_a_coarse_pressure_is_that_of_a_fracture_between_two_parts():
    operators = prepare(load("meshes/crossings/scene.toml"), MPI.COMM_SELF).operators
    blocks, layout = operators.blocks, operators.layout
    nodes = nodes_of(blocks)
    jumps = coarse_jumps(
        blocks, layout, nodes, walls(blocks, nodes) >= 0.0, [operators.scales.length], np.zeros(0, dtype=int)
    )
    rows = local_rows(jumps)
    is_pressure = rows.rows >= layout.solid_count
    opens = set()  # columns of displacements that part the walls of a joint, of each flow node
    touching = {}
    for row, col in zip(rows.rows[~is_pressure], rows.cols[~is_pressure], strict=True):
        touching.setdefault(row, set()).add(col)
    for number, (bottom, top) in zip(
        blocks.joints.flow.ravel(),
        zip(blocks.joints.bottom.ravel(), blocks.joints.top.ravel(), strict=True),
        strict=True,
    ):
        one, other = (touching[blocks.solid.unknown[node, 0]] for node in (bottom, top))
        opens |= {int(number)} if one != other else set()
    found = {int(row) - layout.solid_count for row in rows.rows[is_pressure & (rows.values > 0.0)]}
    assert found and found <= opens
