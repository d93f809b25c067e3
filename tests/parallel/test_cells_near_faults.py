"""The cells that are damped at a fault, and what they take off, are the same on any number of ranks, cut where they may."""

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.mesh.agreement import on_root
from fracflow.model.terms.fault_damping import cells_near, damping_at_faults
from fracflow.reduction.prepare import prepare, read_split
from fracflow.reduction.sliced import Whole
from fracflow.scene.scene import load

COMM = MPI.COMM_WORLD
LAYERS = 3
STRIPE = 150.0  # m across the fault, narrower than its cells: each rank's cells are beside another's
SCENE = """
method = {stepper = "explicit"}
rock.rock = {youngs_modulus = "80 GPa", poissons_ratio = 0.25, density = 2670}
initial_stress = {xx = "-120 MPa", yy = "-120 MPa", xy = "70 MPa"}
stage = [{kind = "dynamic", time_step = "10 ms", end = "1 s"}]
[geometry]
domain = ["-3 km", "-2 km", "3 km", "2 km"]
size = "600 m"
size_at_fractures = "200 m"
growth = 0.3
fracture = [{name = "main", points = [["-1.5 km", 0], ["1.5 km", "0.4 km"]]}]
[fracture.main]
law = "slip-weakening"
normal_stiffness = "1000 GPa/m"
shear_stiffness = "1000 GPa/m"
aperture = "1 m"
friction_coefficient = 0.677
dynamic_friction_coefficient = 0.525
slip_weakening_distance = "0.4 m"
"""
RISES = """fracture.main.pressure={along = ["0 km", "2 km", "3 km"], time = ["0 s", "1 s"], value = [[0, 0, 0],
["0 MPa", "0 MPa", "90 MPa"]]}"""


@pytest.fixture
def scene_and_mesh(shared_tmp):
    if COMM.rank == 0:
        (shared_tmp / "scene.toml").write_text(SCENE, encoding="utf-8")
    COMM.barrier()
    scene = load(shared_tmp / "scene.toml")
    mesh = on_root(COMM, lambda: read_split(scene))
    return scene, mesh


def in_stripes(mesh):
    """Rank of each cell (m,) by its place along the fault, on rank 0."""
    return (
        None if mesh is None else (mesh.points[mesh.cells[:, :3]].mean(axis=1)[:, 0] // STRIPE).astype(int) % COMM.size
    )


def power(model, scene):
    """v' D v of a velocity that depends on the place alone."""
    damping, block = damping_at_faults(model.operators, scene), model.operators.blocks.solid
    speed, force = (model.operators.layout.solid_vector() for _ in range(2))
    own = block.points[: block.owned]
    first = int(block.unknown_starts[model.operators.layout.comm.rank])
    speed.getArray()[block.unknown[: block.owned] - first] = np.sin(own / 170.0) + own[:, ::-1] / 3000.0
    damping.matrix.mult(speed, force)
    return speed.dot(force)


def test_cells_near_a_fault_that_ranks_cut(scene_and_mesh):
    scene, mesh = scene_and_mesh
    blocks = prepare(scene, COMM, Whole.of(mesh, COMM), in_stripes(mesh)).operators.blocks
    near = cells_near(blocks, np.ones(len(blocks.joints.bottom), dtype=bool), LAYERS)
    found = np.sort(np.concatenate(COMM.allgather(blocks.solid.cell_ids[near])))
    whole = COMM.bcast(mesh, root=0)
    reached, expected = np.concatenate([whole.joint_bottom.ravel(), whole.joint_top.ravel()]), np.zeros(0)
    for _ in range(LAYERS):
        expected = np.flatnonzero(np.isin(whole.cells, reached).any(axis=1))
        reached = whole.cells[expected].ravel()
    assert 0 < len(expected) < len(whole.cells)
    assert np.array_equal(found, expected)


@pytest.mark.parametrize("damps", ["by its walls", "by its pressure"])
def test_damping_of_a_fault_that_ranks_cut(scene_and_mesh, shared_tmp, damps):
    """Its walls call for 0.25 of the critical one; a pressure that rises at once in a part of it for 0.45 there."""
    scene, mesh = scene_and_mesh
    if damps == "by its pressure":
        scene = load(shared_tmp / "scene.toml", [RISES, "fluid={viscosity=1, specific_weight=1}"])
    cut = power(prepare(scene, COMM, Whole.of(mesh, COMM), in_stripes(mesh)), scene)
    alone = power(prepare(scene, MPI.COMM_SELF, Whole.of(COMM.bcast(mesh, root=0), MPI.COMM_SELF)), scene)
    assert cut == pytest.approx(alone, rel=1e-12) and alone > 0.0
