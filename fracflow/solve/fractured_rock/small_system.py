"""A small system, whose rows all ranks have: solved by all of them, or by one where its factorisation is one rank's own."""

from __future__ import annotations

from fracflow._petsc import MPI, PETSc, destroy

ON_ONE_RANK = ("umfpack",)  # factorisations that know no other ranks


class SmallSystem:
    """A solver with the options of a prefix, and the way to its rank where it is on one."""

    def __init__(self, comm: MPI.Comm, prefix: str, rank: int) -> None:
        """Read the options; ``rank`` is the one that solves where one does. Collective."""
        self.comm, self.is_mine = comm, comm.rank == rank
        self.solver = PETSc.KSP().create(comm=comm)
        self._read(prefix)
        self.is_alone = comm.size > 1 and self.solver.getPC().getFactorSolverType() in ON_ONE_RANK
        if self.is_alone:
            self.solver.destroy()
            self.solver = PETSc.KSP().create(comm=PETSc.COMM_SELF)
            self._read(prefix)
        self._gathered: list[PETSc.Mat] | None = None
        self._there: PETSc.Scatter | None = None
        self._vectors: tuple[PETSc.Vec, ...] = ()

    def _read(self, prefix: str) -> None:
        self.solver.setOptionsPrefix(prefix)
        self.solver.setFromOptions()

    def take(self, system: PETSc.Mat) -> None:
        """Take the matrix as it is now, to one rank where that solves for it. Collective."""
        if not self.is_alone:
            self.solver.setOperators(system)
            return
        count = system.getSize()[0] if self.is_mine else 0
        every = PETSc.IS().createStride(count, 0, 1, comm=PETSc.COMM_SELF)
        self._gathered = system.createSubMatrices([every], [every], self._gathered)
        if self._there is None:
            right, own = system.createVecLeft(), PETSc.Vec().createSeq(count)
            self._there = PETSc.Scatter().create(right, every, own, None)
            self._vectors = own, own.duplicate()
            right.destroy()
        every.destroy()

    def factor(self) -> PETSc.Error | None:
        """Factor what this rank alone solves for; the error of a factorisation that broke. Not collective."""
        if self.is_alone and self.is_mine:
            assert self._gathered is not None
            self.solver.setOperators(self._gathered[0])
            try:
                self.solver.setUp()
            except PETSc.Error as error:
                return error
        return None

    def solve(self, right: PETSc.Vec, found: PETSc.Vec) -> None:
        """Solve for a right side. Collective."""
        if not self.is_alone:
            self.solver.solve(right, found)
            return
        assert self._there is not None
        own, answer = self._vectors
        self._there.scatter(right, own)
        if self.is_mine:
            self.solver.solve(own, answer)
        self._there.scatter(answer, found, mode=PETSc.ScatterMode.REVERSE)

    def destroy(self) -> None:
        """Free all. Collective."""
        destroy(self.solver, self._there, *self._vectors, *(self._gathered or ()))
