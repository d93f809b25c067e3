"""Explicit steps in one sweep: as by single steps, by PETSc as by compiled loops, on all ranks, and to the bit after a stop."""

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.advance import explicit
from fracflow.output import read_history
from fracflow.scene.scene import load
from fracflow.simulation.run import resume, run
from fracflow.solve.leapfrog import rock

# triangles beside squares; supports that move and that do not, loads that change and that do not, sides with springs
SCENE = """
title = "all that acts in explicit steps without a fluid"
[rock.rock]
youngs_modulus = 40e9
poissons_ratio = 0.25
density = 2700
[rock.soft]
youngs_modulus = 20e9
poissons_ratio = 0.2
density = 2500
[mesh]
file = "mixed.msh"
[initial_stress]
xx = -30e6
yy = -30e6
xy = 16e6
unbalanced = "carried"
[[absorbing]]
on = ["west", "south"]
[[absorbing]]
on = ["east"]
wave = {kind = "s", velocity = [[0, 0], [0.02, 0.1], [0.05, 0.0]]}
[[load]]
on = ["north"]
traction = [[[0, 0], [0.02, 1e6], [0.05, 0]], 0]
[[load]]
on = ["north"]
traction = "initial-stress"
[[support]]
on = ["north"]
components = ["y"]
displacement = {y = [[0, 0], [0.03, 1e-3]]}
[fracture.fault]
law = "slip-weakening"
normal_stiffness = 500e9
shear_stiffness = 500e9
aperture = 1e-3
friction_coefficient = 0.6
dynamic_friction_coefficient = 0.4
slip_weakening_distance = 0.01
[fracture.fault.initial_shear_traction]
along = [0, 300, 310, 490, 500, 800]
value = [16e6, 16e6, 19e6, 19e6, 16e6, 16e6]
[method]
stepper = "explicit"
[output]
pictures = false
[[probe]]
name = "right"
at = [1250, 500]
on = "fault"
[[probe]]
name = "above"
at = [1000, 740]
[[stage]]
kind = "dynamic"
time_step = 12e-3
end = 0.09
"""
SIZES = {"acceleration": 100.0, "opening": 1e-3, "slip_rate": 1.0, "velocity": 1.0}


def write_mesh(path):
    """Squares of 50 m below the fault, triangles above, all but those on lines of the scene out of their places."""
    across, up, side = 40, 20, 50.0
    x, y = (each.ravel() for each in np.meshgrid(np.arange(across + 1) * side, np.arange(up + 1) * side))
    is_free = (x > 0) & (x < side * across) & (y > 0) & (y < side * up) & (y != 500.0)
    shift = 0.15 * side * np.random.default_rng(1).uniform(-1.0, 1.0, (2, len(x))) * is_free

    def at(i, j):
        return j * (across + 1) + i + 1

    cells = []
    for j in range(up):
        for i in range(across):
            a, b, c, d = at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)
            cells += [(3, 1, (a, b, c, d))] if j < up // 2 else [(2, 2, (a, b, c)), (2, 2, (a, c, d))]
    cells += [(1, 3, (at(i, 10), at(i + 1, 10))) for i in range(12, 28)]
    for number, row in ((4, 0), (5, up)):
        cells += [(1, number, (at(i, row), at(i + 1, row))) for i in range(across)]
    for number, column in ((6, 0), (7, across)):
        cells += [(1, number, (at(column, j), at(column, j + 1))) for j in range(up)]
    names = ["rock", "soft", "fault", "south", "north", "west", "east"]
    lines = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat", "$PhysicalNames", str(len(names))]
    lines += [f'{2 if n < 2 else 1} {n + 1} "{name}"' for n, name in enumerate(names)]
    lines += ["$EndPhysicalNames", "$Nodes", str(len(x))]
    lines += [f"{n + 1} {p:.17g} {q:.17g} 0" for n, (p, q) in enumerate(zip(x + shift[0], y + shift[1], strict=True))]
    lines += ["$EndNodes", "$Elements", str(len(cells))]
    lines += [f"{n + 1} {k} 2 {group} {group} " + " ".join(map(str, c)) for n, (k, group, c) in enumerate(cells)]
    path.write_text("\n".join([*lines, "$EndElements", ""]))


@pytest.fixture
def scene(shared_tmp):
    """The scene, and its run by this rank alone."""
    if MPI.COMM_WORLD.rank == 0:
        write_mesh(shared_tmp / "mixed.msh")
        (shared_tmp / "scene.toml").write_text(SCENE)
    MPI.COMM_WORLD.barrier()
    return shared_tmp / "scene.toml"


def assert_alike(one, other, within):
    """Histories in two folders, over the largest value of the kind; accelerations over a typical one."""
    one, other = (read_history(folder / "history.h5") for folder in (one, other))
    largest = max(np.abs(values).max() for name, values in one.items() if name.startswith("energy/"))
    for name, values in one.items():
        if name.startswith("energy/"):
            assert np.abs(values - other[name]).max() <= within * largest, name
        if name.startswith("probe/"):
            kind = name.rsplit("/", 1)[-1]
            size = max(np.nanmax(np.abs(one[key]), initial=0.0) for key in one if key.endswith(kind))
            assert np.nanmax(np.abs(values - other[name]), initial=0.0) <= within * max(size, SIZES.get(kind, 0.0)), (
                name
            )


@pytest.mark.serial
def test_as_by_single_steps_and_without_a_compiler(scene, tmp_path, monkeypatch):
    totals = run(load(scene), tmp_path / "sweep", MPI.COMM_SELF)
    history = read_history(tmp_path / "sweep/history.h5")
    energy = {name: np.abs(values).max() for name, values in history.items() if name.startswith("energy/")}
    largest = max(energy.values())
    assert totals.steps > 6 and energy["energy/residual"] < 1e-10 * largest
    for name in ("kinetic", "radiated", "damping", "work_incident", "work_boundaries", "friction"):
        assert energy[f"energy/{name}"] > 1e-6 * largest, name  # all of them act
    monkeypatch.setattr(rock, "library", lambda: None)
    run(load(scene), tmp_path / "petsc", MPI.COMM_SELF)
    assert_alike(tmp_path / "sweep", tmp_path / "petsc", 1e-12)
    monkeypatch.setattr(explicit, "takes", lambda operators: False)
    run(load(scene), tmp_path / "single", MPI.COMM_SELF)
    assert_alike(tmp_path / "sweep", tmp_path / "single", 1e-11)


def test_ranks_agree(scene, shared_tmp):
    comm = MPI.COMM_WORLD
    run(load(scene), shared_tmp / "all", comm)
    if comm.rank == 0:
        run(load(scene), shared_tmp / "one", MPI.COMM_SELF)
        assert_alike(shared_tmp / "one", shared_tmp / "all", 1e-12)
    comm.barrier()


@pytest.mark.serial
def test_goes_on_to_the_bit(scene, tmp_path):
    run(load(scene), tmp_path / "whole", MPI.COMM_SELF)

    def stop(step):
        if step.state.time > 0.05:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(load(scene, ["output.checkpoint_every=1"]), tmp_path / "parts", MPI.COMM_SELF, progress=stop)
    resume(tmp_path / "parts", MPI.COMM_SELF)
    whole, parts = (read_history(tmp_path / name / "history.h5") for name in ("whole", "parts"))
    for name, values in whole.items():
        assert np.array_equal(values, parts[name], equal_nan=True), name
