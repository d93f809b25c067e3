"""The rock in an explicit step: forces of its cells, and the motion of its nodes.

Arrays hold two values a node, in an order of their own. ``w`` is 1/m, 0 where other things than a mass decide how an unknown
moves. Outer forces are e. A step takes f = e - K u; v += kick f/m; u += drift v. Velocities v are those at its middle.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple, Protocol

import numpy as np

from fracflow._petsc import PETSc, destroy
from fracflow.mesh.blocks import Blocks, owner_of
from fracflow.mesh.data import Bools, Floats, Ints
from fracflow.model.operators import Operators
from fracflow.model.solid import elasticity
from fracflow.scene.scene import Scene
from fracflow.solve.leapfrog.compiled import address, library
from fracflow.solve.leapfrog.local import in_blocks
from fracflow.solve.leapfrog.numbering import GhostWay, at_ghosts, late_nodes, order_of_sweep

PARALLEL = 1e-12  # of the diagonals: by so much the sides of a parallelogram may differ
COMPILED = ((2, 3), (2, 4))  # dimension and nodes of the cells that rock.c has; others go by their matrix
OF_SWEEP = (
    "node", "top", "of_three", "of_four", "oblique", "quiet", "triangles", "quads", "rock_three", "rock_four", "moduli", "x",
    "inverse", "e", "u", "v", "f",
)  # fmt: skip
LATE = ("triangles_late", "quads_late", "rock_three_late", "rock_four_late")
RANGE = 128  # nodes that move at once: their values stay in the fastest memory from their first cell on


class Sums(NamedTuple):
    """Sums of m v^2, of m a^2, and of u times given values; the largest |m a| and |u|. Masses m are the diagonal ones."""

    moving: float
    pushed: float
    work: float
    inertia: float
    displacement: float


class Rock(Protocol):
    """Motion and forces of the unknowns of this rank in an order of their own, which ``places`` gives; see above.

    places  (n,) where each local unknown is in u, v, a, f and e
    energy  strain energy of this rank's cells at the displacements of the last step [energy per thickness]
    """

    places: Ints
    u: Floats
    v: Floats
    a: Floats
    f: Floats
    e: Floats
    energy: float

    def hold(self, held: Bools, mass: Floats) -> None:
        """Take masses (n,) of the local unknowns; the held ones (n,) are not moved by forces."""
        ...

    def begin(self, vector: PETSc.Vec, values: Floats) -> None:
        """Read the local values of a vector into one of the arrays (n,)."""
        ...

    def keep(self, places: Ints) -> None:
        """Outer forces stay as they are, but at some places (k,): steps need not read those that are 0."""
        ...

    def start(self, dt: float) -> None:
        """From an instant to the middle of the next step: v += dt a/2, u += dt v."""
        ...

    def step(self, kick: float, drift: float) -> None:
        """One step of all unknowns. Collective."""
        ...

    def stop(self, vectors: Iterable[PETSc.Vec], values: Floats) -> Sums:
        """Set a = f/m where forces alone move a node, and write u, v and a into vectors; the sums, of ``values`` (n,)."""
        ...

    def sums(self, values: Floats) -> Sums:
        """This rank's, with ``values`` (n,) in the order of u."""
        ...

    def given(self) -> dict[str, int] | None:
        """Counts and addresses by their names in ``steps.c``; None where that has no loops."""
        ...

    def destroy(self) -> None:
        """Free what is PETSc's. Collective."""
        ...


def rock_of(operators: Operators, scene: Scene, springs: PETSc.Mat | None, plain: bool) -> Rock:
    """The rock of a scene by compiled loops where it is ``plain``, else by PETSc; ``springs`` is the K of terms. Collective."""
    comm, loops, block = operators.layout.comm, library(), operators.blocks.solid
    widths = np.unique((block.cells >= 0).sum(axis=1)).tolist()
    has_others = any((block.points.shape[1], width) not in COMPILED for width in widths)
    if not plain or comm.allreduce(int(loops is None or has_others)):
        return AssembledRock(operators, springs, plain)
    return Cells(operators, scene)


class Cells:
    """Forces cell by cell, without a matrix; each node moves right after its last cell, while it is in the fastest memory.

    On several ranks nodes of cells with ghosts come late. Their displacements travel, and forces on ghosts travel back, while
    this rank makes the sweep of all others.
    """

    def __init__(self, operators: Operators, scene: Scene) -> None:
        """Number nodes and cells. Collective."""
        blocks, loops = operators.blocks, library()
        assert loops is not None
        self._loops, self.energy = loops, 0.0
        block, count = blocks.solid, len(blocks.solid.points)
        cells = np.full((len(block.cells), 4), -1)
        cells[:, : block.cells.shape[1]] = block.cells
        late, beside = late_nodes(blocks, cells)
        order = order_of_sweep(cells, block.owned, late)
        place = np.empty(count, dtype=np.int64)
        place[order] = np.arange(count)
        self.owned, self._early = block.owned, block.owned - int(late.sum())
        self._order = np.ascontiguousarray(order[: block.owned], dtype=np.int32)
        self.places = (2 * place[: block.owned, None] + np.arange(2)).ravel()
        self._x = np.ascontiguousarray(block.points[order])
        self.u, self.v, self.a, self.f, self.e = (np.zeros(2 * count) for _ in range(5))
        self._w, self._mass = np.zeros(count), np.zeros(2 * block.owned)
        moduli = elasticity(blocks, scene)
        kinds, rock = np.unique(
            np.stack([moduli[:, 0, 0], moduli[:, 0, 1], moduli[:, 2, 2]], 1), axis=0, return_inverse=True
        )
        self._moduli, rock = np.ascontiguousarray(kinds), rock.ravel().astype(np.uint16)
        cells = np.where(cells >= 0, place[cells], -1)
        lowest = np.where(cells >= 0, cells, count).min(axis=1)
        swept, oblique = ~beside & (lowest < self._early), _oblique(self._x, cells)
        self._swept = self._sorted(cells, rock, lowest, oblique, swept)
        self._rest = self._sorted(cells, rock, lowest, oblique, ~swept)
        self._ranges()
        self._share(blocks, place)

    def _sorted(self, cells: Ints, rock: Ints, lowest: Ints, oblique: Bools, chosen: Bools) -> list[np.ndarray]:
        """Triangles, quadrilaterals and their rocks, by ranges of their lowest nodes; parallelograms first in a range."""
        found: list[np.ndarray] = []
        for width in (3, 4):
            here = np.flatnonzero(chosen & ((cells >= 0).sum(axis=1) == width))
            here = here[np.lexsort((lowest[here], oblique[here], lowest[here] // RANGE))]
            found += [np.ascontiguousarray(cells[here, :width], dtype=np.int32), np.ascontiguousarray(rock[here])]
        three, of_three, four, of_four = found
        return [three, four, of_three, of_four]

    def _ranges(self) -> None:
        node = np.append(np.arange(0, self._early, RANGE), self._early).astype(np.int32)
        top, starts = node[1:].copy(), []
        for cells in self._swept[:2]:
            first = np.searchsorted(cells.min(axis=1, initial=self.owned), node).astype(np.int32)
            highest = np.maximum.accumulate(np.concatenate([[0], cells.max(axis=1, initial=-1) + 1]))
            top = np.maximum(top, highest[first[1:]])
            starts.append(first)
        top = np.minimum(np.maximum.accumulate(top), self._early).astype(np.int32)
        four = self._swept[1]
        before = np.concatenate([[0], np.cumsum(~_oblique(self._x, four))])
        oblique = starts[1][:-1] + np.diff(before[starts[1]])
        self._sweep = [node, top, *starts, oblique.astype(np.int32)]
        self._starts = [address(each) for each in self._sweep]
        self._quiet = np.zeros(len(top), dtype=np.uint8)

    def _share(self, blocks: Blocks, place: Ints) -> None:
        """Make the way of ghost values between ranks."""
        self.way: GhostWay | None = None
        comm, block = blocks.comm, blocks.solid
        if comm.size == 1:
            return
        of_owner = at_ghosts(blocks, place[: block.owned].astype(float)).astype(np.int64)
        ghosts = block.node_global[block.owned :]
        numbers = of_owner + block.node_starts[owner_of(block.node_starts, ghosts)]
        wanted, own = (2 * numbers[:, None] + np.arange(2)).ravel(), 2 * block.owned
        u, force = ((each[:own], each[own:]) for each in (self.u, self.f))
        self.way = GhostWay(comm, wanted, u, force)

    def hold(self, held: Bools, mass: Floats) -> None:
        """Take masses (n,) of the local unknowns; nodes with held unknowns (n,) are not moved by forces."""
        at_nodes = np.where(held.reshape(-1, 2).any(axis=1), 0.0, 1.0 / np.maximum(mass.reshape(-1, 2)[:, 0], 1e-300))
        self._w[: self.owned] = at_nodes[self._order]
        self._mass[self.places] = mass
        # arrays stay where they are: finding their addresses anew would take a third of the calls' own time
        self._data = [*map(address, (*self._swept, self._moduli, self._x, self._w, self.e))]
        self._motion = [*map(address, (self.u, self.v, self.f))]

    def begin(self, vector: PETSc.Vec, values: Floats) -> None:
        """Read the local values of a vector into one of the arrays (n,)."""
        given = vector.getArray(readonly=True)
        self._loops.fracflow_take(self.owned, address(self._order), address(given), address(values))

    def keep(self, places: Ints) -> None:
        """Outer forces stay as they are, but at some places (k,): steps need not read those that are 0."""
        acts = self.e != 0.0
        acts[places] = True
        before = np.concatenate([[0], np.cumsum(acts.reshape(-1, 2).any(axis=1))])
        top = self._sweep[1]
        self._quiet[:] = before[top] == before[np.concatenate([[0], top[:-1]])]

    def start(self, dt: float) -> None:
        """From an instant to the middle of the next step: v += dt a/2, u += dt v."""
        self._loops.fracflow_start(self.owned, 0.5 * dt, dt, *map(address, (self.a, self.u, self.v)))

    def stop(self, vectors: Iterable[PETSc.Vec], values: Floats) -> Sums:
        """Set a = f/m where forces alone move a node, and write u, v and a into vectors; the sums, of ``values`` (n,)."""
        found, there = np.zeros(5), [each.getArray() for each in vectors]
        known = self._order, self._w, self.f, self._mass, values, self.u, self.v, self.a
        self._loops.fracflow_stop(self.owned, *map(address, (*known, *there, found)))
        return Sums(*found.tolist())

    def sums(self, values: Floats) -> Sums:
        """This rank's, with ``values`` (n,) in the order of u."""
        found = np.zeros(5)
        self._loops.fracflow_sums(self.owned, *map(address, (self._mass, self.v, self.a, values, self.u, found)))
        return Sums(*found.tolist())

    def step(self, kick: float, drift: float) -> None:
        """One step of all unknowns. Collective."""
        ranges, early, owned = len(self._sweep[1]), 2 * self._early, 2 * self.owned
        way = self.way
        if way is None:
            self.energy = 0.5 * self._swept_by(0, ranges, kick, drift)
            return
        self.f[early:owned], self.f[owned:] = self.e[early:owned], 0.0
        way.begin()
        twice = self._swept_by(0, ranges // 2, kick, drift)
        way.end()
        data = [*map(address, (*self._rest, self._moduli, self._x, self.u, self.f))]
        twice += self._loops.fracflow_cells(len(self._rest[0]), len(self._rest[1]), *data)
        way.begin_back()
        twice += self._swept_by(ranges // 2, ranges, kick, drift)
        way.end_back()
        self._loops.fracflow_move(self._early, self.owned, address(self._w), kick, drift, *self._motion)
        self.energy = 0.5 * twice

    def _swept_by(self, first: int, last: int, kick: float, drift: float) -> float:
        """Sweep through some ranges of nodes; twice the strain energy of their cells."""
        if first == last:
            return 0.0
        begun = int(self._sweep[1][first - 1]) if first else 0
        starts = [start + 4 * first for start in self._starts]  # of whole numbers of 4 bytes
        starts.append(address(self._quiet) + first)
        return float(self._loops.fracflow_sweep(last - first, begun, *starts, *self._data, kick, drift, *self._motion))

    def given(self) -> dict[str, int]:
        """Counts and addresses by their names in ``steps.c``."""
        arrays = dict(zip(OF_SWEEP, [*self._starts, address(self._quiet), *self._data, *self._motion], strict=True))
        arrays |= dict(zip(LATE, map(address, self._rest), strict=True))
        counts = {"early": self._early, "owned": self.owned, "whole": len(self._x)}
        counts |= {"threes": len(self._rest[0]), "fours": len(self._rest[1]), "ranges": len(self._sweep[1])}
        return counts | arrays | {"a_rock": address(self.a)}

    def destroy(self) -> None:
        """Free the way between ranks. Collective."""
        destroy(self.way)


def _oblique(points: Floats, cells: Ints) -> Bools:
    """Which cells (m,) of places (n, 2) are quadrilaterals, but no parallelograms."""
    found, here = np.zeros(len(cells), dtype=bool), np.flatnonzero(cells[:, 3] >= 0)
    i, j, k, last = (points[cells[here, corner]] for corner in range(4))
    across = np.abs(k - i).max(axis=1, initial=0.0) + np.abs(last - j).max(axis=1, initial=0.0)
    found[here] = np.abs((i - j) + (k - last)).max(axis=1, initial=0.0) > PARALLEL * across
    return found


class AssembledRock:
    """Forces by the matrix of the rock, and motion by NumPy: where nothing was compiled, and of rock that is not plain."""

    def __init__(self, operators: Operators, springs: PETSc.Mat | None, plain: bool) -> None:
        """Make the matrix, in blocks of nodes where it has such. Collective."""
        count, self.energy = operators.layout.solid_count, 0.0
        rock = operators.stiffness.copy()
        if springs is not None:
            rock.axpy(-1.0, springs, PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN)
        self._matrix = in_blocks(rock) if plain else rock
        self.places = np.arange(count)
        self._vectors = [operators.layout.solid_vector() for _ in range(2)]
        self.u, self._ku = (each.getArray() for each in self._vectors)
        self.v, self.a, self.f, self.e, self._w, self._mass = (np.zeros(count) for _ in range(6))

    def hold(self, held: Bools, mass: Floats) -> None:
        """Take masses (n,) of the local unknowns; those that are held (n,) are not moved by forces."""
        self._w = np.where(held, 0.0, 1.0 / np.maximum(mass, 1e-300))
        self._mass = mass

    def begin(self, vector: PETSc.Vec, values: Floats) -> None:
        """Read the local values of a vector into one of the arrays (n,)."""
        values[:] = vector.getArray(readonly=True)

    def keep(self, places: Ints) -> None:
        """Nothing for the places (k,): the matrix costs more."""

    def start(self, dt: float) -> None:
        """From an instant to the middle of the next step: v += dt a/2, u += dt v."""
        self.v += 0.5 * dt * self.a
        self.u += dt * self.v

    def stop(self, vectors: Iterable[PETSc.Vec], values: Floats) -> Sums:
        """Set a = f/m where forces alone move a node, and write u, v and a into vectors; the sums, of ``values`` (n,)."""
        np.copyto(self.a, self._w * self.f, where=self._w > 0.0)
        for vector, here in zip(vectors, (self.u, self.v, self.a), strict=True):
            vector.getArray()[:] = here
        return self.sums(values)

    def sums(self, values: Floats) -> Sums:
        """This rank's, with ``values`` (n,) in the order of u."""
        force = self._mass * self.a
        return Sums(
            float(self._mass @ self.v**2),
            float(force @ self.a),
            float(values @ self.u),
            float(np.abs(force).max(initial=0.0)),
            float(np.abs(self.u).max(initial=0.0)),
        )

    def step(self, kick: float, drift: float) -> None:
        """One step of all unknowns. Collective."""
        self._matrix.mult(*self._vectors)
        self.energy = 0.5 * float(self.u @ self._ku)
        np.subtract(self.e, self._ku, out=self.f)
        self.v += kick * self._w * self.f
        self.u += drift * self.v

    def given(self) -> dict[str, int] | None:
        """None: it has no loops."""
        return None

    def destroy(self) -> None:
        """Free the matrix. Collective."""
        destroy(self._matrix, *self._vectors)
