"""Multigrid, the choice for large scenes: what it is told of the rock is true, and it finds what a factorisation finds."""

import os
import re
import resource

import numpy as np
import pytest

from fracflow._petsc import MPI, PETSc, destroy
from fracflow.errors import InputError, SolveError
from fracflow.output import read_history
from fracflow.reduction.prepare import prepare
from fracflow.scene.method import Method
from fracflow.scene.scene import load
from fracflow.simulation.run import run
from fracflow.solve import options as defaults
from fracflow.solve import rock_cost
from fracflow.solve.fractured_rock.preconditioner import parts_of
from fracflow.solve.fractured_rock.rigid_motions import near_null_space, rigid_motions

FEW = 20  # Krylov iterations in a Newton iteration, beyond those with exact blocks


@pytest.mark.parametrize("scene", ["crossings", "report_5_1"])  # the latter with rigid rock
def test_rigid_motions_strain_neither_rock_nor_joints(scene, comm):
    operators = prepare(load(f"meshes/{scene}/scene.toml"), comm).operators
    motions = rigid_motions(operators.blocks)
    assert motions.shape == (operators.layout.solid_count, 3)
    motion, force = operators.layout.solid_vector(), operators.layout.solid_vector()

    def strained(values):
        motion.setArray(values)
        operators.stiffness.mult(motion, force)
        jump = np.abs(operators.joints.strain(motion)).max(initial=0.0)
        return (
            force.norm(PETSc.NormType.INFINITY),
            comm.allreduce(jump, op=MPI.MAX),
            motion.norm(PETSc.NormType.INFINITY),
        )

    stiff = operators.stiffness.norm(PETSc.NormType.INFINITY)
    for values in motions.T:
        pull, jump, size = strained(values)
        assert size >= 1.0
        assert pull <= 1e-12 * stiff * size and jump <= 1e-12 * size
    pull, _, size = strained(motions[:, 2] ** 2)  # no rigid motion
    assert pull > 1e-6 * stiff * size
    space = near_null_space(operators)
    vectors = space.getVecs()
    gram = [[one.dot(other) for other in vectors] for one in vectors]
    assert np.allclose(gram, np.eye(3), atol=1e-12)
    space.destroy()


@pytest.mark.parametrize(
    ("scene", "overrides", "natural"),
    [
        ("crossings", ["stage.1.steps=12"], {"pressure": 5e6, "slip": 9e6 / 50e9, "normal_traction": 9e6}),
        ("r01_inclined_joint", ["stage.0.steps=24"], {"slip": 1e-3, "normal_traction": 2e6}),  # slips from step 20
    ],
    ids=["with fluid", "dry"],
)
def test_multigrid_finds_what_a_factorisation_finds(scene, overrides, natural, shared_tmp):
    def ran(name):
        settings = ["output.pictures=false", f"method.rock_solver={name}", *overrides]
        run(load(f"meshes/{scene}/scene.toml", settings), shared_tmp / name)
        MPI.COMM_WORLD.barrier()
        return read_history(shared_tmp / name / "history.h5")

    direct = ran("direct")
    multigrid = ran("multigrid")
    assert "multigrid" in (shared_tmp / "multigrid" / "log.txt").read_text(encoding="utf-8")
    assert direct["step/slipping"].max() > 0
    found = [name for name in direct if name.startswith("probe/") and name.split("/")[2] in natural]
    assert found
    for name in found:
        size = max(np.abs(direct[name]).max(), natural[name.split("/")[2]])
        assert np.abs(multigrid[name] - direct[name]).max() <= 1e-8 * size, name
    more = multigrid["step/krylov"].sum() - direct["step/krylov"].sum()
    assert 0 < more <= FEW * multigrid["step/newton"].sum()


def test_parts_that_jump_are_the_same_on_any_number_of_ranks(comm):
    """A part that ranks share is one."""

    def count(on):
        operators = prepare(load("meshes/crossings/scene.toml"), on).operators
        parts = parts_of(operators.blocks, operators.layout, operators.scales.length / 5.0, np.zeros(0, dtype=np.int64))
        begin, _, values = (
            parts.jumps.getValuesCSR()
        )  # which joint has which pressure of an X depends on the order of nodes
        moved = on.allreduce(float((values[: begin[operators.layout.solid_count]] ** 2).sum()))
        found = (parts.jumps.getSize()[1], parts.intact.getSize()[1], moved)
        destroy(parts.jumps, parts.intact, parts.strips)
        return found

    found = count(comm)
    assert found == pytest.approx(count(MPI.COMM_SELF), rel=1e-12) and found[0] > 0


@pytest.mark.serial
def test_scene_or_cost_decides():
    """Multigrid takes less time from where MUMPS factors on in the plane, sooner in space; and where factors do not fit."""
    options = PETSc.Options()
    key, much = "monolithic_pc_type", 1e12
    for unknowns, solver, given, memory, chosen in [
        (400_000, "auto", {}, much, "fieldsplit"),
        (410_000, "auto", {}, much, "shell"),
        (600_000, "auto", {key: "asm"}, much, "asm"),
        (600_000, "direct", {}, 0.0, "fieldsplit"),
        (600_000, "multipoles", {}, much, "shell"),  # of the mesh of an event
        (100_000, "auto", {}, rock_cost.direct(100_000).bytes, "fieldsplit"),
        (100_000, "auto", {}, 0.99 * rock_cost.direct(100_000).bytes, "shell"),
        (0, "multigrid", {}, much, "shell"),
        (0, "auto", {}, much, "fieldsplit"),
    ]:
        rock = rock_cost.RockChoice.of(Method(rock_solver=solver), unknowns, memory)
        defaults.set_defaults(given, rock)
        assert options[key] == chosen
    assert list(defaults.MULTIGRID) == ["monolithic", "solid"]
    choices = [rock_cost.RockChoice.of(Method(), n, dim=3) for n in (10_000, 100_000)]
    assert [choice.by_multigrid for choice in choices] == [False, True]
    whole = rock_cost.RockChoice.of(Method(coupling="whole-lu"), 10**9)
    assert not whole.by_multigrid and "whole-lu" in whole.why


@pytest.mark.parametrize(
    "name, given, by_multigrid",
    [
        ("5_2", [], False),
        ("5_2", ["method.rock_solver=multigrid"], True),
        ("5_3", ["method.coupling=auto"], True),
    ],
)
def test_rigid_rock_has_no_grids(name, given, by_multigrid, comm):
    """The unknowns of a million rigid blocks are no reason for multigrid, which a scene may still ask for."""
    found = rock_cost.rock_choice(load(f"meshes/report_{name}/scene.toml", given), comm, 3_000_000)
    assert found.by_multigrid == by_multigrid and found.unknowns == 3_000_000


def test_memory_at_hand_is_that_of_the_machine_its_group_and_its_shell(comm):
    """Ranks of one machine share it."""
    there = rock_cost.memory_at_hand(comm)
    total = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    assert 0.0 < there <= total and comm.allgather(there) == [there] * comm.size
    assert there == pytest.approx(rock_cost.memory_at_hand(MPI.COMM_SELF) - rock_cost.PROGRAM * (comm.size - 1))
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (total // 2, before[1]))
    try:
        assert rock_cost.memory_at_hand(MPI.COMM_SELF) <= total // 2
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


@pytest.mark.serial
def test_a_factorisation_of_the_whole_is_no_multigrid():
    with pytest.raises(InputError, match='"multigrid": contradicts coupling = "whole-lu"; use'):
        load("meshes/crossings/scene.toml", ["method.rock_solver=multigrid", "method.coupling=whole-lu"])


@pytest.mark.serial
def test_a_step_that_multigrid_does_not_solve_is_solved_by_a_factorisation(tmp_path):
    few = ["petsc.monolithic_ksp_max_it=1", "petsc.monolithic_ksp_rtol=1e-12", "method.rock_solver=multigrid"]
    settings = ["output.pictures=false", "stage.1.steps=2"]
    ends = []
    for name, more in (("direct", []), ("multigrid", few)):
        run(load("meshes/crossings/scene.toml", [*settings, *more]), tmp_path / name)
        ends.append(read_history(tmp_path / name / "history.h5"))
    found = [name for name in ends[0] if name.startswith("probe/") and name.endswith("/pressure")]
    assert found and all(np.abs(ends[1][name] - ends[0][name]).max() < 1e-8 * 5e6 for name in found)


@pytest.mark.serial
def test_a_factorisation_without_room_is_not_begun(tmp_path, monkeypatch):
    """The failure says what was tried, what would come next, and why it did not; and calls no matrix singular."""
    monkeypatch.setattr("fracflow.solve.rock_cost.memory_at_hand", lambda comm: 1e6)
    few = ["petsc.monolithic_ksp_max_it=1", "petsc.monolithic_intact_pc_type=none", "method.rock_solver=multigrid"]
    with pytest.raises(SolveError) as caught:
        run(load("meshes/crossings/scene.toml", ["output.pictures=false", *few]), tmp_path)
    said = str(caught.value)
    assert re.search(r"monolithic: .* left .* 1 iterations preconditioned by multigrid do not suffice", said)
    assert re.search(r"LU of the whole, .* needs about 0\.13\d GB, and 0\.001 GB are at hand", said)
    assert "singular" not in said
