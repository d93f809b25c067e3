"""LU by LAPACK of the free unknowns: held ones are as given, no pivot means no finite result, runs agree with MUMPS."""

import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from crossed import CROSSED
from figures_verification.runs import solve
from figures_work_precision.problem import counts

from fracflow._petsc import MPI, PETSc
from fracflow.solve import linear
from fracflow.solve.factors.free_block import FreeBlock, factor_by_lapack, is_full

pytestmark = pytest.mark.serial
SCENE = "output.pictures = false" + CROSSED.replace("0.05, size_at_tips = 0.0125", "0.2")
MESHED = 'method.rock_solver = "multigrid"\nsupport = [{on = ["south", "north", "east", "west"]}]\n'
HELD = [1, 4, 5]
ENDS = """
import sys
import fracflow
from fracflow.advance import stage

def refuse(*_):
    raise TypeError("unforeseen")

stage.utilisation = refuse
fracflow.run(fracflow.load(sys.argv[1]), sys.argv[2])
"""


def matrix_of(values):
    """A matrix as FreeBlock sees it, with rows and columns HELD those of the identity."""
    count = len(values)
    held = np.isin(np.arange(count), HELD)
    values = np.where(held[:, None] | held, np.eye(count), values)
    rows, columns = np.nonzero(values)
    starts = np.concatenate([[0], np.cumsum(np.bincount(rows, minlength=count))]).astype(PETSc.IntType)
    csr = starts, columns.astype(PETSc.IntType), values[rows, columns]
    matrix = PETSc.Mat().createAIJ((count, count), csr=csr, comm=MPI.COMM_SELF)
    layout = SimpleNamespace(comm=MPI.COMM_SELF, total=count)
    return SimpleNamespace(matrix=matrix, layout=layout, stood=(None, 1.0, None), held=lambda _: held, values=values)


def solver_of(matrix):
    solver = PETSc.KSP().create(comm=MPI.COMM_SELF)
    solver.setType("preonly")
    solver.setOperators(matrix.matrix)
    factor_by_lapack(solver, matrix)
    return solver


def test_it_solves_for_free_unknowns_as_the_matrix_changes():
    drawn = np.random.default_rng(3).normal(size=(2, 12, 12))
    drawn[:, [7, 9, 11], [0, 2, 6]] = 0.0  # entries that only the factors have
    matrix = matrix_of(drawn[0])
    assert is_full(matrix) and not is_full(matrix_of(np.triu(np.tril(drawn[0], 1), -1)))
    solver, given, found = solver_of(matrix), *matrix.matrix.createVecs()
    given.setArray(np.arange(1.0, 13.0))
    for values in (matrix.values, np.where(matrix.values != 0.0, drawn[1], 0.0)):
        values = np.where(np.isin(np.arange(12), HELD)[:, None], np.eye(12), values)
        rows, columns = np.nonzero(matrix.values)
        for row, column in zip(rows, columns, strict=True):
            matrix.matrix.setValue(row, column, values[row, column])
        matrix.matrix.assemble()
        solver.setOperators(matrix.matrix)
        solver.solve(given, found)
        assert found.getArray() == pytest.approx(np.linalg.solve(values, given.getArray()), rel=1e-9)
    solver.destroy()


def test_without_a_pivot_nothing_is_finite():
    matrix = matrix_of(np.ones((6, 6)))
    solver, given, found = solver_of(matrix), *matrix.matrix.createVecs()
    given.set(1.0)
    solver.solve(given, found)
    assert np.isinf(np.delete(found.getArray(), HELD)).all() and (found.getArray()[HELD] == 1.0).all()
    assert isinstance(solver.getPC().getPythonContext(), FreeBlock)
    solver.destroy()


def test_a_solver_that_broke_keeps_its_factors():
    matrix = matrix_of(np.eye(6) + 0.1)
    solver = solver_of(matrix)
    solver.setOptionsPrefix("whole-lu_")
    linear.renew(solver, matrix)
    assert solver.getPC().getType() == "python"
    assert isinstance(solver.getPC().getPythonContext(), FreeBlock)
    solver.destroy()


def test_a_run_agrees_with_mumps(monkeypatch):
    chosen = []
    PETSc.Log.begin()
    before = counts()["factorisations"]
    monkeypatch.setattr(linear, "factor_by_lapack", lambda *given: (chosen.append(1), factor_by_lapack(*given)))
    ours = solve(SCENE)
    assert chosen, "unmeshed rock without unknown pressures takes it"
    chosen.clear()
    made, before = counts()["factorisations"] - before, counts()["factorisations"]
    by_mumps = solve(SCENE, 'petsc.whole-lu_pc_factor_mat_solver_type="mumps"')
    assert not chosen, "who names a factorisation has it"
    assert made == counts()["factorisations"] - before == ours.history["step/factorisations"].sum() > 0
    for name in ("slip", "opening"):
        one, other = (run.fractures[-1].point[name] for run in (ours, by_mumps))
        assert one == pytest.approx(other, rel=1e-9, abs=1e-9 * np.abs(other).max()) and np.abs(other).max() > 0.0


@pytest.mark.parametrize("more", ["", MESHED])
def test_an_unforeseen_error_ends_python_in_order(tmp_path, more):
    """PETSc may keep a solver until Python has ended; its context, LAPACK's or multigrid's, is gone then."""
    text = SCENE.replace('domain = "unbounded"', "domain = [-5, -5, 5, 5]") if more else SCENE
    (tmp_path / "scene.toml").write_text(more + text)
    words = [sys.executable, "-c", ENDS, str(tmp_path / "scene.toml"), str(tmp_path / "run")]
    ended = subprocess.run(words, check=False, capture_output=True, text=True, timeout=100)
    assert (ended.returncode, ended.stderr.splitlines()[-1]) == (1, "TypeError: unforeseen")
