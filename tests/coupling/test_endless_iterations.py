"""An iteration that can only go on for ever is given up, and stale factors are no reason to try another linear solver."""

from types import SimpleNamespace

import numpy as np
import pytest

from fracflow._petsc import MPI, PETSc
from fracflow.errors import SolveError
from fracflow.model.state import Work
from fracflow.scene.scene import load
from fracflow.simulation.run import run
from fracflow.solve.globalisation import Repetition
from fracflow.solve.linear import KeptFactors, solves_both
from fracflow.solve.newton import REPEATS, Newton

pytestmark = pytest.mark.serial
LEAST = 1e-11


def _first(residuals):
    """After how many residuals they are seen to repeat; None if never."""
    seen = Repetition(LEAST)
    return next((n for n, each in enumerate(residuals, 1) if seen.see(*each)), None)


@pytest.mark.parametrize("period", [2, 3])
def test_residuals_that_come_back_are_seen_after_two_periods(period):
    cycle = [(10.0**-n, 1e-9) for n in range(period)]
    assert _first([(1.0, 1.0), (0.7, 0.3), *cycle, *cycle, *cycle]) == 2 + 2 * period
    slightly_off = [(size * (1.0 + 5e-3), flow) for size, flow in cycle]
    assert _first([*cycle, *slightly_off]) is None


def test_residuals_that_fall_or_stand_still_do_not_repeat():
    assert _first((0.5**n, 0.9**n) for n in range(30)) is None
    assert _first([(1e-3, 1e-6)] * 30) is None
    assert _first([(1e-3, LEAST), (1e-3, 0.1 * LEAST)] * 15) is None  # below the accuracy all are alike
    both = [(1e-3, 1e-6), (1e-3, 2e-6)]
    assert _first(both * 2) == 4  # of the flow alone


def test_a_new_beginning_forgets():
    seen, cycle = Repetition(LEAST), [(1.0, 1.0), (2.0, 1.0)]
    assert [seen.see(*each) for each in [*cycle, cycle[0]]] == [False] * 3
    seen.begin()
    assert [seen.see(*each) for each in [cycle[1], *cycle]] == [False] * 3


def test_factors_of_an_earlier_matrix_do_not_condemn_the_solver():
    """FGMRES with them leaves much of a changed matrix; with its own factors the solver leaves nothing, and is not changed."""
    count = 40
    drawn = np.random.default_rng(1).normal(size=(2, count, count))
    first, second = (np.eye(count) * count + 10.0 * each for each in drawn)
    matrix = PETSc.Mat().createAIJ((count, count), nnz=count, comm=MPI.COMM_SELF)

    def fill(values):
        matrix.setValues(range(count), range(count), values)
        matrix.assemble()

    fill(first)
    solver = PETSc.KSP().create(comm=MPI.COMM_SELF)
    solver.setType("preonly")
    solver.getPC().setType("lu")
    given = matrix.createVecLeft()
    given.setArray(np.arange(1.0, count + 1.0))
    layout = SimpleNamespace(total=count, solid_count=30)
    of_scene = SimpleNamespace(matrix=matrix, layout=layout, fills=1)
    factors = KeptFactors(solver, of_scene)
    factors.changed(must=True)
    solver.setOperators(matrix, factors.factored)
    assert solves_both(solver, given, layout.solid_count)
    fill(-second)
    of_scene.fills = 2
    assert not solves_both(solver, given, layout.solid_count)
    newton = SimpleNamespace(factors=factors, solver=solver, balance=given, matrix=of_scene)
    problem = SimpleNamespace(work=Work())
    assert Newton.solves_both(newton, problem)
    assert problem.work.factorisations == 1


def test_an_iteration_that_repeats_ends_once_a_search_has_not_helped(tmp_path, monkeypatch):
    """A balance that cannot be reached, and residuals that are said to repeat."""
    monkeypatch.setattr(Repetition, "see", lambda *_: True)
    scene = load("meshes/report_5_3/scene.toml", ["accuracy.residual=1e-30", "accuracy.max_iterations=40"])
    with pytest.raises(SolveError, match=REPEATS):
        run(scene, tmp_path / "out")
