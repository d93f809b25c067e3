"""Cells on either side of joints that a mesh has no more: each rank asks those that have the cells."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fracflow.mesh.blocks import Blocks
from fracflow.mesh.data import Ints, SplitMesh
from fracflow.mesh.slabs import Order
from fracflow.mesh.slices.directory import Directory, Route
from fracflow.mesh.split import groups


@dataclass(frozen=True)
class CellsBeside:
    """The two cells of some joints of this rank, and the cells of this rank that are asked for.

    joints  (k,) the joints, by their places on this rank
    groups  at least as many as there are groups of fractures that hang together, as of ``split.groups``
    group   (k,) that of each joint
    cells   (m,) places of the cells
    """

    joints: Ints
    groups: int
    group: Ints
    cells: Ints
    _route: Route

    @classmethod
    def of(cls, mesh: SplitMesh | None, blocks: Blocks, chosen: Ints, others: Blocks) -> CellsBeside:
        """Those of joints of the fractures ``chosen`` (f,), among the cells of ``others``, which have the same numbers.

        mesh  of the joints, on rank 0

        Collective.
        """
        comm, joints, solid = blocks.comm, blocks.joints, others.solid
        cells = np.empty((len(joints.ids), 2), dtype=np.int64)
        total = blocks.sizes.joints
        Order(comm, joints.ids, total).hand_out(None if mesh is None else mesh.joint_cells, 0, total, cells)
        here = np.flatnonzero(np.isin(joints.fracture, chosen))
        group: Ints = comm.bcast(None if mesh is None else groups(mesh), root=0)
        of_cells = Directory(comm, others.sizes.cells)
        rank = np.empty(of_cells.last - of_cells.first, dtype=np.int64)
        of_cells.put(rank, solid.cell_ids, np.full(len(solid.cell_ids), comm.rank))
        asked = cells[here].ravel()
        route = Route(comm, of_cells.look_up(rank, asked))
        of_joints = group[joints.fracture[here]]
        return cls(here, len(group), of_joints, np.searchsorted(solid.cell_ids, route.send(asked)), route)

    def back(self, values: NDArray[Any]) -> NDArray[Any]:
        """Values (k, 2, ...) below and above each joint, for those (m, ...) of the cells of this rank. Collective."""
        return self._route.back(values).reshape(len(self.joints), 2, *values.shape[1:])
