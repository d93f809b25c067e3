"""Matrices whose rows have columns of other ranks."""

import numpy as np

from fracflow.model.layout import add_blocks, create_matrix


def test_rows_at_a_cut_have_the_room_of_others(comm):
    each, entries = 10, 8
    sizes = each, each * comm.size
    matrix = create_matrix((sizes, sizes), entries, comm)
    first, beside = each * comm.rank, each * ((comm.rank + 1) % comm.size)
    row, cols = np.array([[first]]), beside + np.arange(entries)[None, :]
    add_blocks(matrix, row, cols, np.ones((1, 1, entries)))
    matrix.assemble()
    assert matrix.getInfo()["mallocs"] == 0.0  # each of which copies the matrix
    assert matrix.getInfo()["nz_used"] == comm.size * entries
    matrix.destroy()
