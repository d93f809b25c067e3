"""A preconditioner of rock that slides and opens along fractures, of few iterations whatever the joints do.

A displacement is one that the walls of a fracture share, and a jump across it. The shared one feels no joint: one cycle of
multigrid solves for it, as in intact rock. Long jumps are solved for on a coarse grid that the fractures cut, with pressures as
coarse. Short ones are solved for exactly in strips along the fractures, with all pressures. Each part corrects what the one
before has left (multiplicative Schwarz; Smith, Bjorstad and Gropp 1996). Only the two small systems change with the joints.

The strips come last, and leave nothing in their own rows. All later residuals are of rock outside them. Its rows are of like
size, however small or large those of the flow are.
"""

from __future__ import annotations

from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from fracflow._petsc import MPI, PETSc, destroy, timed
from fracflow.errors import Unsolved
from fracflow.mesh.blocks import Blocks
from fracflow.mesh.data import Bools, Floats, Ints
from fracflow.mesh.shared import Shared
from fracflow.model.layout import Layout, rows_of
from fracflow.solve.fractured_rock.coarse_jumps import coarse_jumps, grid_sizes
from fracflow.solve.fractured_rock.small_system import SmallSystem
from fracflow.solve.fractured_rock.subspaces import grown, intact, strips, walls

LAYERS = 2  # of cells on either side of a fracture in its strip
COARSE = 14.0**2  # nodes of the mesh in a cell of the coarse grid, in the plane and in space
SHIFT = 1e-8
"""Of the pivots of coarse jumps. Displacements may depend on each other in small blocks of rock, and pressures along a fracture
that is parallel to the grid."""


class Filled(Protocol):
    """A matrix of all unknowns that is filled again and again.

    matrix  as the joints are now
    """

    matrix: PETSc.Mat

    def standing(self) -> AbstractContextManager[PETSc.Mat]:
        """The matrix without the joints, as long as that is needed; ``matrix`` may be that meanwhile. Collective."""

    @property
    def stood(self) -> Any:
        """By which that was filled: it is the same where this is."""

    @property
    def alphas(self) -> Any:
        """Those of the last filling: its rock is the same where they are."""


@dataclass(frozen=True)
class Parts:
    """Parts of the unknowns of a step.

    intact  E: from displacements that walls share
    jumps   W: from displacements and pressures of long wavelength
    strips  unknowns near fractures

    are_pressures  those of long wavelength that this rank has (n,)
    """

    intact: PETSc.Mat
    jumps: PETSc.Mat
    are_pressures: Bools
    strips: PETSc.IS


@timed("FracRockParts")
def parts_of(blocks: Blocks, layout: Layout, length: float, held: Ints) -> Parts:
    """The parts, for joints of a mean ``length`` and with held unknowns (h,). The caller destroys them. Collective."""
    nodes = Shared(layout.comm, blocks.solid.owned, blocks.sizes.nodes, blocks.solid.node_global)
    wall = walls(blocks, nodes)
    is_wall, along = wall >= 0.0, COARSE ** (1.0 / blocks.sizes.dim)
    jumps = coarse_jumps(blocks, layout, nodes, is_wall, grid_sizes(blocks, is_wall, length, along), held)
    parts = Parts(
        intact(blocks, layout, wall),
        jumps,
        _are_pressures(jumps, layout.solid_count),
        strips(blocks, layout, grown(blocks, nodes, is_wall, LAYERS)),
    )
    nodes.destroy()
    return parts


class FracturedRock:
    """PETSc's context of the preconditioner: ``setUp``, ``apply`` and ``destroy`` are called by its PC.

    Solvers of the parts have the prefixes -PREFIX_intact_, -PREFIX_jumps_ and -PREFIX_strips_.
    """

    def __init__(self, parts: Parts, filled: Filled, prefix: str, node: int) -> None:
        """Make the solvers. ``parts`` are destroyed with this; a node has ``node`` unknowns, or 1. Collective."""
        self.parts, self.filled, self.node = parts, filled, node
        self.left = filled.matrix.createVecLeft()
        self.systems: dict[str, PETSc.Mat] = {}
        self.vectors: dict[str, tuple[PETSc.Vec, PETSc.Vec]] = {}
        self.comm = filled.matrix.getComm().tompi4py()
        self.cycle = PETSc.KSP().create(comm=self.comm)
        self.cycle.setOptionsPrefix(f"{prefix}_intact_")
        self.cycle.setFromOptions()
        # two ranks, which factor at the same time
        ranks = {"jumps": self.comm.size - 1, "strips": max(self.comm.size - 2, 0)}
        self.small = {part: SmallSystem(self.comm, f"{prefix}_{part}_", rank) for part, rank in ranks.items()}
        self.without: PETSc.Mat | None = None  # W' A_0 W but for what lies within the strips
        self.beside: PETSc.Mat | None = None
        self.change: PETSc.Mat | None = None
        self.near: PETSc.Scatter | None = None
        self._alphas: Any = None
        self._stood: Any = None  # by which the small systems were made

    @timed("FracRockSetUp")
    def setUp(self, _: PETSc.PC) -> None:
        """Take the present joints into the small systems, and the rock anew where the time step differs.

        Raises Unsolved, on every rank. Collective.
        """
        whole, parts, systems = self.filled.matrix, self.parts, self.systems
        is_other = "intact" not in systems or self._alphas != self.filled.alphas
        if is_other or self._stood != self.filled.stood:
            self._alphas, self._stood = self.filled.alphas, self.filled.stood
            with self.filled.standing() as stands:
                if is_other:
                    self._renew_intact(stands)
                self._renew_standing(stands)
        systems["strips"] = whole.createSubMatrix(parts.strips, parts.strips, systems["strips"])
        self._add_joints()
        for part, small in self.small.items():
            small.take(systems[part])
        self._agree([small.factor() for small in self.small.values()])
        for part in systems.keys() - self.vectors.keys():
            self.vectors[part] = systems[part].createVecs()
        if self.near is None:
            self.near = PETSc.Scatter().create(self.left, parts.strips, self.vectors["strips"][1], None)

    def _agree(self, errors: list[PETSc.Error | None]) -> None:
        """Raise Unsolved, on every rank, where factors of any rank broke. Collective."""
        here = max((error.ierr for error in errors if error is not None), default=0)
        if code := self.comm.allreduce(here, op=MPI.MAX):
            raise Unsolved(f"multigrid: a small system has no factors (PETSc's error {code})")

    def _renew_intact(self, stands: PETSc.Mat) -> None:
        """E' A_0 E, in hypre's own format where hypre solves for it: it would keep a copy in that format beside. Collective."""
        solver, systems = self.cycle, self.systems
        if "intact" in systems:
            solver.reset()
            systems.pop("intact").destroy()
        made = stands.PtAP(self.parts.intact)
        diagonal = made.getDiagonal()  # of rock alone: where there is none, the row is empty
        _fill_empty(made, diagonal.getArray().copy())
        diagonal.destroy()
        if solver.getPC().getType() == "hypre":
            systems["intact"] = made.convert("hypre", PETSc.Mat())
            made.destroy()
        else:
            systems["intact"] = made
        systems["intact"].setBlockSize(self.node)
        solver.setOperators(systems["intact"])

    def _renew_standing(self, stands: PETSc.Mat) -> None:
        """W' A_0 W - W_s' A_0s W_s, with A_0 as it stands without the joints, and s the strips. Collective."""
        parts, systems = self.parts, self.systems
        self.beside = self.beside or rows_of(parts.jumps, parts.strips)
        systems["strips"] = stands.createSubMatrix(parts.strips, parts.strips, systems.get("strips"))
        self.change = systems["strips"].PtAP(self.beside, self.change)
        destroy(self.without)
        self.without = stands.PtAP(parts.jumps)
        self.without.axpy(-1.0, self.change, PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN)

    def _add_joints(self) -> None:
        """W' A W = W' A_0 W + W_s' (A - A_0)_s W_s: what depends on joints lies within the strips. Collective."""
        systems = self.systems
        assert self.without is not None
        self.change = systems["strips"].PtAP(self.beside, self.change)
        if "jumps" not in systems:
            systems["jumps"] = self.without.duplicate()
        self.without.copy(systems["jumps"])  # which has entries of empty rows beside
        systems["jumps"].axpy(1.0, self.change, PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN)
        _fill_empty(systems["jumps"], _largest_in_rows(systems["jumps"]))
        _shift(systems["jumps"], self.parts.are_pressures)

    @timed("FracRockApply")
    def apply(self, _: PETSc.PC, given: PETSc.Vec, result: PETSc.Vec) -> None:
        """Correct by the intact rock, by coarse jumps, and by the strips. Collective."""
        assert self.near is not None
        result.set(0.0)
        given.copy(self.left)
        moves = ("intact", self.parts.intact, self.cycle), ("jumps", self.parts.jumps, self.small["jumps"])
        for part, moved, solver in moves:
            found, right = self.vectors[part]
            moved.multTranspose(self.left, right)
            solver.solve(right, found)
            moved.multAdd(found, result, result)
            self.filled.matrix.mult(result, self.left)
            self.left.aypx(-1.0, given)
        found, right = self.vectors["strips"]
        self.near.scatter(self.left, right)
        self.small["strips"].solve(right, found)
        self.near.scatter(found, result, addv=PETSc.InsertMode.ADD_VALUES, mode=PETSc.ScatterMode.REVERSE)

    def destroy(self, _: PETSc.PC) -> None:
        """Free all. Collective."""
        destroy(self.parts.intact, self.parts.jumps, self.parts.strips, self.left, self.near)
        destroy(self.beside, self.without, self.change)
        destroy(
            self.cycle,
            *self.small.values(),
            *self.systems.values(),
            *(v for pair in self.vectors.values() for v in pair),
        )


def _are_pressures(jumps: PETSc.Mat, middle: int) -> Bools:
    """Which of this rank's coarse unknowns are pressures (n,). Collective."""
    is_flow, moved = jumps.createVecLeft(), jumps.createVecRight()
    is_flow.getArray()[middle:] = 1.0
    jumps.multTranspose(is_flow, moved)
    result: Bools = moved.getArray(readonly=True) > 0.0
    destroy(is_flow, moved)
    return result


def _shift(system: PETSc.Mat, are_pressures: Bools) -> None:
    """Make each pivot a little larger than those before leave it. Collective.

    A pressure has little on the diagonal where the fluid hardly flows. Its pivot is the compliance of the rock that it opens,
    |a_pu a_up / a_uu| summed over displacements u: round-off of that exceeds any share of a_pp.
    """
    diagonal = system.getDiagonal()
    pivots, compliance = np.abs(diagonal.getArray()), diagonal.duplicate()
    starts, columns, values = system.getValuesCSR()
    rows = np.repeat(np.arange(len(pivots)), np.diff(starts))
    of_rock = ~are_pressures[rows] & (pivots[rows] > 0.0)
    compliance.set(0.0)
    compliance.setValues(columns[of_rock], np.abs(values[of_rock]) / pivots[rows[of_rock]], PETSc.InsertMode.ADD)
    compliance.assemble()
    pivots += np.where(are_pressures, _largest_in_rows(system) * compliance.getArray(readonly=True), 0.0)
    diagonal.getArray()[:] += np.copysign(SHIFT * pivots, diagonal.getArray(readonly=True))
    system.setDiagonal(diagonal)
    destroy(diagonal, compliance)


def _largest_in_rows(system: PETSc.Mat) -> Floats:
    """Largest size of an entry in each of this rank's rows (n,). Not collective."""
    indptr, _, values = system.getValuesCSR()
    size, has = np.zeros(len(indptr) - 1), np.diff(indptr) > 0
    size[has] = np.maximum.reduceat(np.abs(values), indptr[:-1][has]) if has.any() else 0.0
    return size


def _fill_empty(system: PETSc.Mat, size: Floats) -> None:
    """Put 1 on the diagonal of empty rows, by the ``size`` (n,) of each row's entries. Collective.

    They belong to displacements of held unknowns, and to pressures between parts of a hat that meet in no joint.
    """
    system.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
    round_off = 10.0 * np.finfo(float).eps * system.getComm().tompi4py().allreduce(size.max(initial=0.0), op=MPI.MAX)
    start = system.getOwnershipRange()[0]
    for number in start + np.flatnonzero(size <= round_off):
        system.setValue(int(number), int(number), 1.0)
    system.assemble()
