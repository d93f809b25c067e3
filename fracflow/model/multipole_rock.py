"""Unbounded rock of many joints: entries of K_s (2.39) where walls are near each other, and series where they are far.

Each rank has the entries of its own rows, and sums what the far cells do to its own walls. Every rank knows the places of all
joints while these are made, and the moments of all cells while they are applied. Both grow as the number of joints.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from fracflow._petsc import MPI, PETSc, destroy, timed
from fracflow.elements import dislocation
from fracflow.elements.cells import CellPairs, Cells, divided, pairs_of
from fracflow.elements.multipoles import FarJumps, Hats
from fracflow.errors import InputError
from fracflow.mesh.blocks import Blocks
from fracflow.mesh.data import Floats, Ints
from fracflow.model.layout import matrix_of
from fracflow.model.unbounded import of_energy
from fracflow.remarks import note
from fracflow.scene.method import MULTIPOLES_FROM
from fracflow.scene.scene import Scene

if TYPE_CHECKING:
    from scipy import sparse

SERIES_ERROR = 1e-10  # of a block of K_s: what its series leaves out
TANGENT_ERROR = 1e-5  # the same in a Jacobian: with 1e-4 to 1e-8 Newton's method takes as many iterations
FAULTY = 1e-8  # of a product: an error that series cannot have but by a fault
SAMPLES = 4  # walls at which the error of a product is measured
MOST_DENSE = 5000  # joints whose entries are all stored: 1e8 of them


@dataclass(frozen=True)
class _Walls:
    """All walls of all ranks that are not held, in the order of their numbers in the split mesh.

    hats     their jumps, with the cell of each
    unknown  (h,) number of the first of both unknowns
    """

    hats: Hats
    unknown: Ints
    cells: Cells
    pairs: CellPairs


class FarRock:
    """The share of far walls in K_s; ``error`` is that of a product, as it was measured at some walls [1]."""

    def __init__(self, comm: MPI.Comm, jumps: FarJumps, rough: FarJumps, places: Ints, factor: float) -> None:
        """Take the series of balances and the shorter ones of Jacobians.

        places  (h,) of the first unknowns of this rank's walls
        factor  -E'/(4 pi) [stress]
        """
        self._comm, self._jumps, self._rough, self._places = comm, jumps, rough, places
        self.factor, self.error = factor, np.inf

    @property
    def notes(self) -> tuple[str, ...]:
        """A line on how the rock is solved, which is a warning where series err by more than they should."""
        line = f"unmeshed rock: joints far from each other act by series, which err by {self.error:.1g} of the largest force"
        return (note(line),) if self.error <= FAULTY else (f'{line}: use method.rock_solver = "direct"',)

    @timed("FracFarRock")
    def force(self, moved: Floats) -> Floats:
        """Forces (n,) on this rank's unknowns, of displacements (n,) [force per thickness]. Collective."""
        return self._product(self._jumps, moved)

    @timed("FracFarTangent")
    def tangent_force(self, moved: Floats) -> Floats:
        """Forces (n,) as in ``force``, to ``TANGENT_ERROR``: for solvers of Newton's method. Collective."""
        return self._product(self._rough, moved)

    def _product(self, jumps: FarJumps, moved: Floats) -> Floats:
        moments = jumps.leaf_moments(moved[self._places] + 1j * moved[self._places + 1])
        self._comm.Allreduce(MPI.IN_PLACE, moments)
        found, result = self.factor * jumps.forces(moments), np.zeros(len(moved))
        result[self._places], result[self._places + 1] = found.real, found.imag
        return result


def by_multipoles(scene: Scene, joints: int) -> bool:
    """Whether the rock of so many joints has series in place of far entries. Raises InputError where it would have to."""
    method = scene.method
    if not scene.is_unbounded or method.rock_solver == "multipoles":
        return scene.is_unbounded
    if method.rock_solver == "auto" and method.coupling not in ("fixed-point", "condensed"):
        return joints > MULTIPOLES_FROM
    if joints > MOST_DENSE:
        key, value = ("coupling", method.coupling) if method.rock_solver == "auto" else ("rock_solver", "direct")
        raise InputError(
            f'method.{key} = "{value}": {joints} joints, each of which acts on all others, are more than {MOST_DENSE}:'
            ' take "auto", or raise geometry.size_at_fractures'
        )
    return False


def stiffness(blocks: Blocks, scene: Scene) -> tuple[PETSc.Mat, FarRock]:
    """Entries of K_s for walls near each other, and the rest of it. The caller destroys the entries. Collective."""
    walls, comm = _walls(blocks), blocks.comm
    first, last, total = (int(blocks.solid.unknown_starts[k]) for k in (comm.rank, comm.rank + 1, -1))
    own = np.flatnonzero((walls.unknown >= first) & (walls.unknown < last))
    rows = walls.unknown[own] - first
    factor, size = of_energy(scene), (last - first, total)
    entries = _interleaved(_near(walls, own), rows, walls.unknown, size)
    near = matrix_of((size, size), (entries.indptr, entries.indices, factor * entries.data), comm)
    here = _some(walls.hats, own)
    sharp, rough = (FarJumps(walls.cells, walls.pairs, here, error) for error in (SERIES_ERROR, TANGENT_ERROR))
    far = FarRock(comm, sharp, rough, rows, factor)
    far.error = _error(walls, own, rows, near, far)
    return near, far


def _error(walls: _Walls, own: Ints, rows: Ints, near: PETSc.Mat, far: FarRock) -> float:
    """Largest error of a product with displacements at random, at some walls, over its largest entry. Collective."""
    hats, comm, count = walls.hats, near.getComm().tompi4py(), len(walls.unknown)
    all_moved = np.random.default_rng(0).standard_normal((count, 2)) @ [1, 1j]
    moved, force = near.createVecs()
    for place, part in enumerate((all_moved[own].real, all_moved[own].imag)):
        moved.getArray()[rows + place] = part
    near.mult(moved, force)
    found = force.getArray() + far.force(moved.getArray(readonly=True))
    destroy(moved, force)
    grows, worst, tips = np.zeros(len(hats.ends), dtype=complex), 0.0, dislocation.at_tips(hats.ends)
    np.add.at(grows, hats.segment, hats.sign * all_moved[hats.hat])
    asked = np.unique(np.linspace(0, count - 1, SAMPLES).astype(np.int64))
    _, here, _ = np.intersect1d(own, asked, return_indices=True)
    for wall in here:
        wanted = 0j
        for entry in np.flatnonzero(hats.hat == own[wall]):
            segment = np.full(len(hats.ends), hats.segment[entry])
            xx, yy, xy = dislocation.pair_means(hats.ends, segment, np.arange(len(hats.ends)), tips).T
            pulled = xx @ grows.real + xy @ grows.imag + 1j * (xy @ grows.real + yy @ grows.imag)
            wanted += far.factor * hats.sign[entry] * pulled
        worst = max(worst, abs(wanted - found[rows[wall]] - 1j * found[rows[wall] + 1]))
    worst, largest = (comm.allreduce(each, op=MPI.MAX) for each in (worst, np.abs(found).max(initial=0.0)))
    return float(worst / largest) if largest > 0.0 else 0.0


def _walls(blocks: Blocks) -> _Walls:
    """The walls of all ranks, and cells around them. Collective."""
    block, comm = blocks.solid, blocks.comm
    faces = np.stack([blocks.joints.bottom, blocks.joints.top], axis=1)  # (joint, face, end)
    here = blocks.joints.ids, block.points[blocks.joints.bottom], block.node_ids[faces]
    parts = comm.allgather((*here, block.origin[faces], block.unknown[faces, 0]))
    ids, ends, nodes, origins, unknown = (np.concatenate(part) for part in zip(*parts, strict=True))
    order = np.argsort(ids)
    ends, nodes, origins, unknown = ends[order], nodes[order], origins[order], unknown[order]
    free = nodes != origins
    segment = np.nonzero(free)[0]
    sign = np.broadcast_to([[1.0, -1.0], [-1.0, 1.0]], nodes.shape)[free]
    _, once, hat = np.unique(nodes[free], return_index=True, return_inverse=True)
    order = np.argsort(hat, kind="stable")
    hat, segment, sign = hat[order], segment[order], sign[order]
    at = np.broadcast_to(ends[:, None], (*nodes.shape, 2))[free][once]
    reach, box = np.stack([at, at], axis=1), np.sort(ends, axis=1)[segment]
    np.minimum.at(reach[:, 0], hat, box[:, 0])
    np.maximum.at(reach[:, 1], hat, box[:, 1])
    cells = divided(at, reach)
    return _Walls(Hats(hat, segment, sign, cells.leaf, ends), unknown[free][once], cells, pairs_of(cells))


def _some(hats: Hats, chosen: Ints) -> Hats:
    """Some of the hats, numbered from 0."""
    number = np.full(len(hats.leaf), -1)
    number[chosen] = np.arange(len(chosen))
    hat = number[hats.hat]
    is_one = hat >= 0
    return Hats(hat[is_one], hats.segment[is_one], hats.sign[is_one], hats.leaf[chosen], hats.ends)


def _near(walls: _Walls, own: Ints) -> tuple[Any, Ints, Ints]:
    """S' A S of ``dislocation.energies`` for pairs of own and near walls: values (m, 3) as xx, yy, xy, rows, and columns."""
    from scipy import sparse  # imports much

    hats, count, joints = walls.hats, len(walls.unknown), len(walls.hats.ends)
    pairs, cells = walls.pairs.near, len(walls.cells.centre)
    beside = _of_ones(pairs[:, 0], pairs[:, 1], (cells, cells))
    holds = _of_ones(np.arange(count), hats.leaf, (count, cells))
    grows = sparse.csr_matrix((hats.sign, (hats.segment, hats.hat)), shape=(joints, count))
    touch = _of_ones(hats.segment, hats.leaf[hats.hat], (joints, cells))
    wanted = (holds[own] @ beside @ holds.T).tocoo()
    here = _some(hats, own)
    needed = (_of_ones(here.segment, here.leaf[here.hat], touch.shape) @ beside @ touch.T).tocoo()
    low, high = np.minimum(needed.row, needed.col), np.maximum(needed.row, needed.col)
    low, high = np.divmod(np.unique(low.astype(np.int64) * joints + high), joints)
    ends, step, tips = hats.ends, dislocation.CHUNK, dislocation.at_tips(hats.ends)
    means = [
        dislocation.pair_means(ends, low[i : i + step], high[i : i + step], tips) for i in range(0, len(low), step)
    ]
    means = np.concatenate([np.zeros((0, 3)), *means])
    apart, values = low != high, np.empty((wanted.nnz, 3))
    at = wanted.row.astype(np.int64) * count + wanted.col
    for part in range(3):
        of_pairs = np.concatenate([means[:, part], means[apart, part]])
        each = sparse.csr_matrix(
            (of_pairs, (np.concatenate([low, high[apart]]), np.concatenate([high, low[apart]]))), shape=(joints, joints)
        )
        values[:, part] = _values_at(grows[:, own].T @ each @ grows, at)
    return values, wanted.row, wanted.col


def _of_ones(rows: Ints, cols: Ints, shape: tuple[int, int]) -> sparse.csr_matrix:
    """The matrix with ones there."""
    from scipy import sparse

    return sparse.csr_matrix((np.ones(len(rows), dtype=np.int8), (rows, cols)), shape=shape).astype(bool)


def _values_at(matrix: sparse.csr_matrix, at: Ints) -> Floats:
    """Entries (m,) of a matrix at row * columns + column; nothing where there is none."""
    found = matrix.tocoo()
    keys = found.row.astype(np.int64) * matrix.shape[1] + found.col
    order = np.argsort(keys, kind="stable")
    place = np.searchsorted(keys[order], at)
    place[place == len(keys)] = 0
    there = order[place] if len(keys) else place
    return np.where(keys[there] == at, found.data[there], 0.0) if len(keys) else np.zeros(len(at))


def _interleaved(
    near: tuple[Floats, Ints, Ints], rows: Ints, unknown: Ints, size: tuple[int, int]
) -> sparse.csr_matrix:
    """The same on this rank's unknowns and those of all, both components of each wall."""
    from scipy import sparse

    values, row, col = near
    data = values[:, [0, 2, 2, 1]].ravel()
    of_rows = (rows[row][:, None] + [0, 0, 1, 1]).ravel()
    of_cols = (unknown[col][:, None] + [0, 1, 0, 1]).ravel()
    found = sparse.csr_matrix((data, (of_rows, of_cols)), shape=size)
    found.sort_indices()
    return found
