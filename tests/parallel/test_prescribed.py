"""Unknowns that a support prescribes: each rank looks at its own, which any rank may have found."""

import tracemalloc

import numpy as np

from fracflow._petsc import MPI
from fracflow.model.dirichlet import of_all_ranks, prescribe

COMM = MPI.COMM_WORLD
OWN, GHOSTS = 50_000, 1000


def _place(time, places, around):
    return places[:, 0]


def test_no_rank_sees_what_others_hold():
    """Memory is that of a rank's own, and of the ghosts of the next, on any number of ranks."""
    starts = OWN * np.arange(COMM.size + 1)
    numbers = starts[COMM.rank] + np.arange(-GHOSTS if COMM.rank else 0, OWN)
    places, before = np.full((len(numbers), 2), float(COMM.rank)), starts[:-1] + 3
    tracemalloc.start()
    held, taken = prescribe(starts, COMM, (numbers, places), before, _place)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 120 * OWN
    assert np.array_equal(held.numbers, np.delete(np.arange(OWN), 3))
    assert np.array_equal(of_all_ranks(starts, COMM, taken), np.arange(starts[-1]))


def test_of_ranks_that_find_an_unknown_the_first_says_where_it_is():
    starts = 10 * np.arange(COMM.size + 1)
    numbers = np.arange(starts[-1])  # each rank finds all of them
    held, _ = prescribe(starts, COMM, (numbers, np.full((len(numbers), 2), COMM.rank + 1.0)), starts[:0], _place)
    assert len(held.numbers) == 10 and (held.value(0.0) == 1.0).all()
