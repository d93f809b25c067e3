"""From the cells of all ranks to rank 0: sums, and the rows of a file by slabs."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from fracflow._petsc import MPI
from fracflow.mesh.blocks import Blocks
from fracflow.mesh.data import CellSums, Ints, SplitMesh
from fracflow.mesh.plane.quality import cell_areas, is_blunt
from fracflow.mesh.slabs import Distributed, Order


def with_sums_of_cells(mesh: SplitMesh | None, blocks: Blocks) -> SplitMesh | None:
    """The mesh of near cells, on rank 0, with what it must know of all. Collective."""
    comm, solid = blocks.comm, blocks.solid
    near = comm.bcast(0 if mesh is None else len(mesh.points), root=0)
    own = solid.node_ids[: solid.owned]
    here = np.flatnonzero(own < near)
    piece = Order(comm, own[here], near).whole(solid.piece[here])
    area, count = np.abs(cell_areas(solid.points, solid.cells)), len(solid.piece_rock)
    sums = np.concatenate([
        np.bincount(solid.piece[solid.cells[:, 0]], area, count), np.bincount(solid.cell_rock, area, len(solid.rocks)),
        [float(np.count_nonzero(is_blunt(solid.points, solid.cells)))],
    ])  # fmt: skip
    comm.Allreduce(MPI.IN_PLACE, sums, MPI.SUM)
    has_rock = np.zeros((len(solid.rocks), count), dtype=bool)
    has_rock[solid.cell_rock, solid.piece[solid.cells[:, 0]]] = True
    comm.Allreduce(MPI.IN_PLACE, has_rock, MPI.LOR)
    if mesh is None or piece is None:
        return None
    cells = blocks.sizes.cells
    found = CellSums(cells, piece, sums[:count], solid.piece_rock, has_rock, sums[count:-1], float(sums[-1]) / cells)
    return replace(mesh, sums=found)


def with_all_cells(mesh: SplitMesh | None, blocks: Blocks) -> SplitMesh | None:
    """The mesh of near cells, on rank 0, with the cells and nodes of all ranks; None elsewhere.

    A mesh that has them is given back. Collective.
    """
    if not blocks.comm.bcast(mesh is not None and mesh.sums is not None, root=0):
        return mesh
    parts: dict[str, Any] = {name: part.order.whole(part.values) for name, part in sliced_parts(blocks).items()}
    return None if mesh is None else replace(mesh, **parts, sums=None)


def sliced_parts(blocks: Blocks) -> dict[str, Distributed]:
    """The parts SLICED of a saved mesh, from the cells and own nodes of all ranks."""
    solid, sizes = blocks.solid, blocks.sizes
    own = slice(0, solid.owned)
    nodes = Order(blocks.comm, solid.node_ids[own], sizes.nodes)
    cells = Order(blocks.comm, solid.cell_ids, sizes.cells)
    return {
        "points": nodes.of(solid.points[own]),
        "origin": nodes.of(solid.origin[own]),
        "cells": cells.of(_Numbered(solid.cells, np.append(solid.node_ids, -1))),
        "cell_rock": cells.of(solid.cell_rock),
    }


class _Numbered:
    """Cells by the numbers that their nodes have in the mesh, found for the rows that are asked for."""

    def __init__(self, cells: Ints, numbers: Ints) -> None:
        self._cells, self._numbers = cells, numbers

    def __getitem__(self, rows: Ints | slice) -> Ints:
        """Those of some cells (k, c)."""
        return self._numbers[self._cells[rows]]

    @property
    def dtype(self) -> np.dtype[np.int64]:
        """Of the numbers."""
        return self._numbers.dtype

    @property
    def shape(self) -> tuple[int, ...]:
        """That of all rows."""
        return self._cells.shape
