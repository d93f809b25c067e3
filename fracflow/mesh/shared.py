"""Values that belong to numbers several ranks hold: nodes, unknowns, cells of a grid."""

from __future__ import annotations

import numpy as np

from fracflow._petsc import MPI, PETSc
from fracflow.mesh.blocks import petsc_ints
from fracflow.mesh.data import Floats, Ints


class Shared:
    """One value for each of ``total`` numbers, ``own`` of them kept on this rank; this rank uses those of ``numbers`` (k,)."""

    def __init__(self, comm: MPI.Comm, own: int, total: int, numbers: Ints) -> None:
        """Find the way between the two. Collective."""
        self._all = PETSc.Vec().createMPI((own, total), comm=comm)
        self._here = PETSc.Vec().createSeq(len(numbers), comm=PETSc.COMM_SELF)
        chosen = PETSc.IS().createGeneral(petsc_ints(numbers), comm=PETSc.COMM_SELF)
        self._scatter = PETSc.Scatter().create(self._all, chosen, self._here, None)
        chosen.destroy()

    def largest(self, values: Floats) -> Floats:
        """The largest (k,) of the values (k,) that ranks have for each number. Collective."""
        return self._merged(values, float("-inf"), PETSc.InsertMode.MAX_VALUES)

    def summed(self, values: Floats) -> Floats:
        """The sum (k,) of the values (k,) that ranks have for each number. Collective."""
        return self._merged(values, 0.0, PETSc.InsertMode.ADD_VALUES)

    def of_owners(self, values: Floats) -> Floats:
        """The values (k,) of this rank's numbers, from the values (own,) that each rank has for those it keeps. Collective."""
        self._all.setArray(values)
        return self._fetch()

    def _merged(self, values: Floats, nothing: float, way: PETSc.InsertMode) -> Floats:
        self._all.set(nothing)
        self._here.setArray(values)
        self._scatter.scatter(self._here, self._all, addv=way, mode=PETSc.ScatterMode.REVERSE)
        return self._fetch()

    def _fetch(self) -> Floats:
        self._scatter.scatter(self._all, self._here)
        return self._here.getArray().copy()

    def destroy(self) -> None:
        """Free vectors and scatter. Collective."""
        for each in (self._scatter, self._all, self._here):
            each.destroy()


def lowest_joined(comm: MPI.Comm, own: int, total: int, numbers: Ints, piece: Ints) -> Ints:
    """The lowest number (k,) that each of ``numbers`` (k,) is joined with, on any rank. Collective.

    own    numbers of ``total`` that this rank keeps
    piece  (k,) which piece each is in: this rank joins the numbers of one

    Ranks take the lowest of each number that any has, until none finds a lower one. A component that crosses ranks so many
    times takes as many rounds.
    """

    def lowest(values: Floats) -> Floats:
        result = np.full(int(piece.max(initial=-1)) + 1, np.inf)
        np.minimum.at(result, piece, values)
        return result[piece]

    shared, now = Shared(comm, own, total, numbers), lowest(numbers.astype(float))
    is_lower = True
    while is_lower:
        found, now = now, lowest(-shared.largest(-now))
        is_lower = comm.allreduce(bool((now < found).any()), op=MPI.LOR)
    shared.destroy()
    return now.astype(np.int64)
