"""Factors that serve on after joints have changed lead to the same results, with fewer factorisations."""

import numpy as np
import pytest

from fracflow._petsc import MPI, PETSc
from fracflow.output import read_history
from fracflow.scene.scene import load
from fracflow.simulation.run import resume, run
from fracflow.solve import linear, options
from fracflow.solve.factors import unpivoted

ROCK = """
[output]
pictures = false
[rock.rock]
youngs_modulus = "10 GPa"
poissons_ratio = 0.25
density = 2500
[fracture.default]
normal_stiffness = "50 GPa/m"
shear_stiffness = "20 GPa/m"
aperture = "0.3 mm"
friction_angle_deg = 30
"""
INJECTION = f"""{ROCK}
[geometry]
domain = [[0, 0], [100, 0], [100, 100], [0, 100]]
size = 25
[[geometry.fracture]]
name = "main"
points = [[25, 50], [75, 50]]
[initial_stress]
xx = "-8 MPa"
yy = "-12 MPa"
[fluid]
viscosity = 1e-3
specific_weight = 9810
initial_pressure = "3 MPa"
[[support]]
on = ["east", "west", "north", "south"]
[[well]]
name = "in"
at = {{fracture = "main", end = "end"}}
flow_rate = {{time = [0, 800], value = [0, 4e-6]}}
[[well]]
name = "out"
at = {{fracture = "main", end = "start"}}
pressure = "3 MPa"
[[probe]]
name = "here"
at = [50, 50]
on = "main"
[[stage]]
kind = "quasi-static"
time_step = 100
steps = 8
"""
SLIDING = f"""{ROCK}
[geometry]
domain = [[0, 0], [10, 0], [10, 10], [0, 10]]
size = 5
[[geometry.fracture]]
name = "joint"
points = [[0, 5], [10, 5]]
[initial_stress]
yy = "-1 MPa"
[[support]]
on = ["south"]
[[load]]
on = "north"
traction = "initial-stress"
[[load]]
on = "north"
traction = [{{time = [0, 0.02], value = [0, 1e6]}}, 0]
[[probe]]
name = "here"
at = [5, 5]
on = "joint"
[[stage]]
kind = "dynamic"
time_step = 1e-3
steps = 40
"""


@pytest.fixture
def history(shared_tmp, comm):
    """Function (text, factors) -> history of a run, on all ranks. Collective."""

    def once(text, factors):
        file = shared_tmp / f"{factors}.toml"
        if comm.rank == 0:
            file.write_text(text)
        comm.barrier()
        folder = shared_tmp / factors
        run(load(file, [f'method.factors="{factors}"', 'method.coupling="whole-lu"']), folder, comm)
        return comm.bcast(read_history(folder / "history.h5") if comm.rank == 0 else None)

    return once


@pytest.mark.parametrize(("text", "moved"), [(INJECTION, "opening"), (SLIDING, "slip")], ids=["injection", "sliding"])
def test_kept_factors_change_nothing_but_the_work(history, monkeypatch, text, moved):
    new = history(text, "new")
    monkeypatch.setattr(linear, "LEAST_WORTH", 0.0)
    kept = history(text, "kept")
    found, sought = (each[f"probe/here/{moved}"] for each in (kept, new))
    assert np.abs(sought).max() > 1e-7
    if moved == "slip":
        assert new["step/slipping"].max() > 0
    np.testing.assert_allclose(found, sought, rtol=0.0, atol=1e-8 * np.abs(sought).max())
    made, before = (each["step/factorisations"].sum() for each in (kept, new))
    assert made < 0.7 * before
    assert kept["step/newton"].sum() <= 1.6 * new["step/newton"].sum()


def test_umfpack_changes_nothing_but_the_work(history, monkeypatch, comm):
    """On one rank with factors that are kept, on several with the whole matrix on each."""
    text = SLIDING.replace("steps = 40", "steps = 28")
    new = history(text, "new")
    monkeypatch.setattr(options, "SWIFT_FROM", 0)
    swift = history(text, "kept")
    found, sought = (each["probe/here/slip"] for each in (swift, new))
    assert np.abs(sought).max() > 1e-7
    np.testing.assert_allclose(found, sought, rtol=0.0, atol=1e-8 * np.abs(sought).max())
    made, before = (each["step/factorisations"].sum() for each in (swift, new))
    assert made < 0.7 * before if comm.size == 1 else made <= before


@pytest.mark.serial
@pytest.mark.parametrize("unpivoted_to", [None, 0, 2000], ids=["mumps", "umfpack", "without pivots"])
def test_a_resumed_run_makes_the_same_factors(tmp_path, monkeypatch, unpivoted_to):
    """Cut in the middle of slip: every number of the history to the last bit."""
    if unpivoted_to is None:
        monkeypatch.setattr(linear, "LEAST_WORTH", 0.0)
    else:
        monkeypatch.setattr(options, "SWIFT_FROM", 0)
        monkeypatch.setattr(unpivoted, "UNPIVOTED_TO", unpivoted_to)
    file, whole, cut = (tmp_path / name for name in ("scene.toml", "whole", "cut"))
    file.write_text(SLIDING.replace("steps = 40", "steps = 28"))
    scene = load(file, ['method.coupling="whole-lu"', "output.checkpoint_every=5"])
    run(scene, whole)

    def stop(step):
        if step.state.time > 0.0225:
            raise InterruptedError

    with pytest.raises(InterruptedError):
        run(scene, cut, progress=stop)
    resume(cut)
    sought, found = (read_history(folder / "history.h5") for folder in (whole, cut))
    assert "resumed after" in (cut / "log.txt").read_text()
    assert sought["step/slipping"].max() > 0
    assert sought["step/factorisations"].sum() < sought["step/newton"].sum()
    assert [
        k for k in sought if k != "step/factorisations" and not np.array_equal(sought[k], found[k], equal_nan=True)
    ] == []


@pytest.mark.serial
@pytest.mark.parametrize(("pivot", "package"), [(1.0, "petsc"), (1e-14, "umfpack"), (0.0, "umfpack")])
def test_factors_without_pivots_are_left_where_a_row_loses_digits(pivot, package):
    """And are tried anew in the next step."""
    matrix = PETSc.Mat().createAIJ((3, 3), nnz=3, comm=MPI.COMM_SELF)
    matrix.setValues(range(3), range(3), [pivot, 2.0, 0.0, 1.0, pivot, 3.0, 0.0, 1.0, 5.0])
    matrix.assemble()
    solver = PETSc.KSP().create(comm=MPI.COMM_SELF)
    solver.setType("preonly")
    solver.getPC().setType("lu")
    solver.getPC().setFactorSolverType("umfpack")
    factors = unpivoted.Unpivoted(solver, 3)
    for _ in range(2):
        factors.begin()
        assert solver.getPC().getFactorSolverType() == "petsc"
        factors.factor(matrix)
        assert solver.getPC().getFactorSolverType() == package
        assert unpivoted.worst_row(solver.getPC(), matrix) < 1e-14


@pytest.mark.serial
def test_factors_of_small_matrices_are_made_anew():
    scene = load_text(SLIDING)
    assert not linear.are_kept(scene, 1000)
    assert linear.are_kept(scene, 100_000)


def load_text(text):
    """A scene from its text."""
    import tomllib

    from fracflow.scene.scene import Scene

    return Scene.from_data(tomllib.loads(text))
