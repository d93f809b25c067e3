"""Sizes of the cells of all ranks, each of which has those of its own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fracflow._petsc import MPI
from fracflow.mesh.blocks import SolidBlock
from fracflow.mesh.data import Floats, Ints, SplitMesh
from fracflow.mesh.plane.quality import cell_areas


@dataclass(frozen=True)
class RockCells:
    """Cells of this rank, and reductions over those of all, which are collective.

    rocks   their names
    number  (m,) in the mesh
    rock    (m,) index into the rocks
    size    (m,) mean edge [length]
    area    (m,) [length**2]
    middle  (m, dim) mean of the corners [length]
    """

    comm: MPI.Comm
    rocks: tuple[str, ...]
    number: Ints
    rock: Ints
    size: Floats
    area: Floats
    middle: Floats

    @classmethod
    def of(cls, mesh: SplitMesh | SolidBlock, number: Ints | None = None, comm: MPI.Comm = MPI.COMM_SELF) -> RockCells:
        """Those of a mesh, or of the block of this rank with their numbers (m,)."""
        counts = np.maximum(np.sum(mesh.cells >= 0, axis=1), 1)
        corners = mesh.points[np.where(mesh.cells >= 0, mesh.cells, mesh.cells[:, :1])]
        edges = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
        padding = (corners.shape[1] - counts)[:, None] * corners[:, 0]  # which is the first corner again
        return cls(
            comm,
            mesh.rocks,
            np.arange(len(mesh.cells)) if number is None else number,
            mesh.cell_rock,
            np.asarray(edges.sum(axis=1) / counts),
            cell_areas(mesh.points, mesh.cells),
            np.asarray((corners.sum(axis=1) - padding) / counts[:, None]),
        )

    def used(self) -> Ints:
        """Which rocks have cells (r,), ascending. Collective."""
        return np.flatnonzero(self.comm.allreduce(np.bincount(self.rock, minlength=len(self.rocks))))

    def largest(self, scale: Floats) -> tuple[float, int, Floats]:
        """Size, rock and middle (dim,) of the cell with the largest size over the ``scale`` (r,) of its rock. Collective.

        Of several it is the first one of the mesh.
        """
        found = (-1.0, 0, 0.0, 0, np.zeros(2))
        if len(self.size):
            share = self.size / scale[self.rock]
            worst = np.flatnonzero(share == share.max())
            at = int(worst[np.argmin(self.number[worst])])
            found = (float(share[at]), -int(self.number[at]), float(self.size[at]), int(self.rock[at]), self.middle[at])
        _, _, size, rock, middle = max(self.comm.allgather(found), key=lambda each: each[:2])
        return size, rock, middle

    def exceeded_in(self, share: float) -> float:
        """The size that cells in a ``share`` of the area have or exceed. Collective.

        Bisection over the bits of the number, which order numbers that are not negative.
        """
        order = np.argsort(self.size)
        sizes, below = self.size[order], np.append(0.0, np.cumsum(self.area[order]))
        asked = (1.0 - share) * self.comm.allreduce(float(below[-1]))
        low, high = -1, int(np.array(self.comm.allreduce(sizes.max(initial=0.0), op=MPI.MAX)).view(np.int64))
        while high - low > 1:
            middle = (low + high) // 2
            upto = np.searchsorted(sizes, np.array(middle).view(np.float64), side="right")
            low, high = (low, middle) if self.comm.allreduce(float(below[upto])) >= asked else (middle, high)
        return float(np.array(high).view(np.float64))
