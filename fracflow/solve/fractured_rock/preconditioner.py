"""A preconditioner of rock that slides and opens along fractures, of few iterations whatever the joints do.

A displacement is one that the walls of a fracture share, and a jump across it. The shared one feels no joint: one cycle of
multigrid solves for it, as in intact rock. Short jumps are solved for exactly in strips along the fractures, long ones on a
coarse grid that the fractures cut; both with all pressures. Each part corrects what the one before has left (multiplicative
Schwarz; Smith, Bjorstad and Gropp 1996). Only the two small systems change with the joints.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from fracflow._petsc import PETSc, destroy
from fracflow.solve.fractured_rock.coarse_jumps import coarse_jumps
from fracflow.solve.fractured_rock.shared import Shared
from fracflow.solve.fractured_rock.subspaces import grown, intact, strips, walls
from fracflow.solve.jacobian import JoinedMatrix, node_size

LAYERS = 2  # of cells on either side of a fracture in its strip
COARSE = 10.0  # mean joints in a cell of the coarse grid
SHIFT = 1e-8  # of the diagonal of coarse jumps, which may depend on each other in small blocks of rock
PARTS = ("intact", "jumps", "strips")


class FracturedRock:
    """PETSc's context of the preconditioner: ``setUp`` and ``apply`` are called by its PC.

    Solvers of the parts have the prefixes -PREFIX_intact_, -PREFIX_jumps_ and -PREFIX_strips_.
    """

    def __init__(self, matrix: JoinedMatrix, prefix: str) -> None:
        """Find the parts, which last for the run. Collective."""
        self.matrix, operators = matrix, matrix.operators
        blocks, layout = operators.blocks, operators.layout
        block = blocks.solid
        nodes = Shared(layout.comm, block.owned, blocks.sizes.nodes, block.node_global)
        wall = walls(blocks, nodes)
        self.shared = intact(blocks, layout, wall)
        self.coarse = coarse_jumps(blocks, layout, nodes, wall >= 0.0, COARSE * operators.scales.length, matrix.fixed)
        self.strips = strips(blocks, layout, grown(blocks, nodes, wall >= 0.0, LAYERS))
        nodes.destroy()
        self.left, self.step = layout.joined_vector(), layout.joined_vector()
        self.solvers = {part: PETSc.KSP().create(comm=layout.comm) for part in PARTS}
        for part, solver in self.solvers.items():
            solver.setOptionsPrefix(f"{prefix}_{part}_")
            solver.setFromOptions()
        self.systems: dict[str, PETSc.Mat] = {}
        self.vectors: dict[str, tuple[PETSc.Vec, PETSc.Vec]] = {}
        self.scatter: PETSc.Scatter | None = None
        self._alphas: Any = None

    def setUp(self, _: PETSc.PC) -> None:
        """Take the present joints into the small systems, and the rock anew where the time step differs. Collective."""
        whole = self.matrix.matrix
        if self._alphas != self.matrix.alphas:
            self._alphas = self.matrix.alphas
            self._set("intact", whole.PtAP(self.shared, self.systems.get("intact")))
        self._set("jumps", whole.PtAP(self.coarse, self.systems.get("jumps")))
        self._set("strips", whole.createSubMatrix(self.strips, self.strips, self.systems.get("strips")))

    def _set(self, part: str, system: PETSc.Mat) -> None:
        if part == "jumps":
            _shift(system)
        elif part == "intact":
            _fill_empty(system, self.shared)
            system.setBlockSize(node_size(self.matrix.operators))
        if part not in self.systems:
            self.systems[part], self.vectors[part] = system, system.createVecs()
            if part == "strips":
                self.scatter = PETSc.Scatter().create(self.left, self.strips, self.vectors[part][1], None)
        self.solvers[part].setOperators(system)

    def apply(self, _: PETSc.PC, given: PETSc.Vec, result: PETSc.Vec) -> None:
        """Correct by the intact rock, by coarse jumps, and by the strips. Collective."""
        result.set(0.0)
        for part, moved in (("intact", self.shared), ("jumps", self.coarse), ("strips", None)):
            if part == "intact":
                given.copy(self.left)
            else:
                self.matrix.matrix.mult(result, self.left)
                self.left.aypx(-1.0, given)
            found, right = self.vectors[part]
            if moved is None:
                assert self.scatter is not None
                self.scatter.scatter(self.left, right)
                self.solvers[part].solve(right, found)
                self.scatter.scatter(
                    found, result, addv=PETSc.InsertMode.ADD_VALUES, mode=PETSc.ScatterMode.REVERSE
                )
            else:
                moved.multTranspose(self.left, right)
                self.solvers[part].solve(right, found)
                moved.multAdd(found, result, result)

    def destroy(self, _: PETSc.PC) -> None:
        """Free all. Collective."""
        destroy(self.shared, self.coarse, self.strips, self.left, self.step, self.scatter)
        destroy(*self.solvers.values(), *self.systems.values(), *(v for pair in self.vectors.values() for v in pair))


def _shift(system: PETSc.Mat) -> None:
    """Lengthen the diagonal a little. Collective."""
    diagonal = system.getDiagonal()
    diagonal.scale(1.0 + SHIFT)
    system.setDiagonal(diagonal)
    diagonal.destroy()


def _fill_empty(system: PETSc.Mat, moved: PETSc.Mat) -> None:
    """Put 1 on the diagonal of displacements that move no unknown. Collective."""
    ones, count = moved.createVecLeft(), moved.createVecRight()
    ones.set(1.0)
    moved.multTranspose(ones, count)
    empty = np.flatnonzero(count.getArray(readonly=True) == 0.0) + count.getOwnershipRange()[0]
    system.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
    for number in empty:
        system.setValue(int(number), int(number), 1.0)
    system.assemble()
    destroy(ones, count)
