"""Unknowns that are prescribed: each rank knows of its own, which any rank may have found, and of those that it sees."""

import tracemalloc
from dataclasses import fields

import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.advance.initial_state import equilibrium_state
from fracflow.integrators import Newmark
from fracflow.model.dirichlet import prescribe
from fracflow.reduction.prepare import prepare
from fracflow.scene.scene import load
from fracflow.solve.jacobian import JoinedMatrix
from fracflow.solve.problem import StepProblem
from fracflow.solve.request import StepRequest, StepRule

COMM = MPI.COMM_WORLD
OWN, GHOSTS = 50_000, 1000


def _place(time, places, around):
    return places[:, 0]


def test_no_rank_sees_what_others_hold():
    """Memory is that of a rank's own, and of the ghosts of the next, on any number of ranks."""
    starts = OWN * np.arange(COMM.size + 1)
    numbers = starts[COMM.rank] + np.arange(-GHOSTS if COMM.rank else 0, OWN)
    places, before = np.full((len(numbers), 2), float(COMM.rank)), starts[[COMM.rank]] + 3
    tracemalloc.start()
    held, taken = prescribe(starts, COMM, (numbers, places), before, _place)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 120 * OWN
    assert np.array_equal(held.numbers, np.delete(np.arange(OWN), 3))
    assert np.array_equal(taken, starts[COMM.rank] + np.arange(OWN))


def test_of_ranks_that_find_an_unknown_the_first_says_where_it_is():
    starts = 10 * np.arange(COMM.size + 1)
    numbers = np.arange(starts[-1])  # each rank finds all of them
    held, _ = prescribe(starts, COMM, (numbers, np.full((len(numbers), 2), COMM.rank + 1.0)), starts[:0], _place)
    assert len(held.numbers) == 10 and (held.value(0.0) == 1.0).all()


HELD = ["support=[{on=['rock'], components=['x']}, {on=['west', 'east']}]", "fracture.A.pressure='1 MPa'"]
"""More than half of the displacements, and all pressures of a fracture that crosses others."""


@pytest.fixture(scope="module")
def model():
    return prepare(load("meshes/crossings/scene.toml", HELD), COMM)


def _held(model):
    """Joined numbers of this rank's unknowns that are held, and of all ranks'."""
    loads, layout = model.loads, model.operators.layout
    own = layout.start + np.unique(np.concatenate([loads.held, layout.solid_count + loads.given_pressures]))
    return own, np.concatenate(COMM.allgather(own))


def test_loads_keep_nothing_of_other_ranks(model):
    loads, total = model.loads, model.operators.layout.total
    kept = [part.numbers for part in (*loads.supports, *loads.pressures)]
    kept += [each for name in fields(loads) if isinstance(each := getattr(loads, name.name), np.ndarray)]
    own, everywhere = _held(model)
    assert total > len(everywhere) > total / 2
    assert sum(map(len, kept)) == len(own)


def test_a_jacobian_knows_of_the_columns_that_it_has_and_no_others(model):
    """Rows and columns that are held, on any rank, are those of 1."""
    ops, layout = model.operators, model.operators.layout
    own, everywhere = _held(model)
    problem = StepProblem(
        ops,
        equilibrium_state(model),
        StepRequest(1e-3, 1e-3, {"pumping": 1e-5}, model.loads),
        StepRule(Newmark().alphas(1e-3)),
    )
    problem.evaluate()
    matrix = JoinedMatrix(ops, model.loads)
    matrix.fill(problem.alphas, problem.sections.tangent, problem.conduction, problem.flow_scale())
    starts, columns, values = matrix.matrix.getValuesCSR()
    rows = layout.start + np.repeat(np.arange(len(starts) - 1), np.diff(starts))
    is_held, here = (
        np.isin(rows, own) | np.isin(columns, everywhere),
        slice(layout.start, layout.start + len(starts) - 1),
    )
    assert np.array_equal(values[is_held], (rows == columns)[is_held])
    joined = [
        layout.flow_numbers(ops.blocks.joints.flow),
        *(layout.solid_numbers(each.unknowns) for each in ops.joints.groups),
    ]
    seen = np.unique(np.concatenate([np.arange(here.start, here.stop), columns, *map(np.ravel, joined)]))
    assert np.array_equal(matrix.fixed, np.intersect1d(everywhere, seen))
    others = np.setdiff1d(matrix.fixed, own)
    assert COMM.allreduce(len(others)) > 0 or COMM.size == 1
    matrix.destroy()
    problem.destroy()


@pytest.mark.parametrize("is_given", [True, False])
def test_every_rank_knows_of_a_limit_where_a_pressure_is_given(is_given):
    """The well is at an end of B; the outlet is of A."""
    settings = ["well.injection.maximum_pressure='2 MPa'", *["fracture.B.pressure='1 MPa'"][:is_given]]
    (limit,) = prepare(load("meshes/crossings/scene.toml", settings), COMM).loads.limits
    assert limit.is_given == is_given
