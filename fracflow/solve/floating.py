"""Blocks of rock that nothing holds: rigid motions of the blocks that no closed joint, support, tie or term resists.

A block is rock that no joint cuts. Its motions are translations and a turn about its middle, times its size. A joint section
that carries resists the jump between the motions of its two blocks. The remaining null space floats.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from fracflow._petsc import MPI, PETSc
from fracflow.elements import facet
from fracflow.mesh.blocks import Blocks
from fracflow.mesh.data import Floats, Ints, is_unmeshed
from fracflow.mesh.graph import components
from fracflow.model import unbounded
from fracflow.model.layout import add_blocks, local_rows
from fracflow.model.loads import Loads
from fracflow.model.operators import Operators
from fracflow.model.properties import on_joints
from fracflow.model.state import Sections

if TYPE_CHECKING:
    from scipy import sparse

NOTHING = 1e-9
"""Relative stiffness that counts as zero. Each support or joint has unit stiffness and each block its own size, so a block
that is held has a stiffness of (h/L)^2 or more."""


DENSE = 600  # motions up to which all eigenvectors are as fast
SHIFT = 1e-11  # far below the stiffness that counts as zero, far above round-off
FIRST = 8  # vectors
INVERSE_ITERATIONS = 4


Rows = tuple[Ints, Floats]
"""Motions that are resisted, a row each: k motions of blocks (n, k), and by how much each counts (n, k)."""


@dataclass(frozen=True)
class Frames:
    """Where the blocks turn and how large they are: middle (p, 2), size (p,)."""

    middle: Floats
    size: Floats

    @staticmethod
    def of(boxes: Floats) -> Frames:
        """The frames of boxes (p, 2, 2), lowest and highest corner."""
        size = 0.5 * np.linalg.norm(boxes[:, 1] - boxes[:, 0], axis=1)
        return Frames(boxes.mean(axis=1), np.where(size > 0.0, size, 1.0))

    def moved(self, piece: Ints, points: Floats, direction: Floats) -> Floats:
        """Displacement (n, 3) along unit ``direction`` (n, 2) at points (n, 2), by each motion of their block (n,)."""
        arm = (points - self.middle[piece]) / self.size[piece, None]
        turn = arm[:, 0] * direction[:, 1] - arm[:, 1] * direction[:, 0]
        return np.concatenate([direction, turn[:, None]], axis=1)


def null_motions(stiffness: sparse.spmatrix | Floats) -> Floats:
    """Orthonormal columns (m, k) that span the null space of a symmetric, semidefinite ``stiffness`` (m, m).

    A large one stays sparse: inverse iteration on ever more vectors at once, until one of them is resisted.
    """
    own, vectors = np.sqrt(stiffness.diagonal()), None
    scale = np.where(own > 0.0, 1.0 / np.where(own > 0.0, own, 1.0), 1.0)
    if len(own) > DENSE:
        from scipy import sparse  # imports much

        scaled = sparse.diags(scale) @ sparse.csc_matrix(stiffness) @ sparse.diags(scale)
        vectors = _sparse_null(scaled.tocsc())
    if vectors is None:
        dense = stiffness if isinstance(stiffness, np.ndarray) else stiffness.toarray()
        values, vectors = np.linalg.eigh(scale[:, None] * dense * scale)
        vectors = vectors[:, values <= NOTHING]
    return np.linalg.qr(vectors * scale[:, None])[0]


def _summed(rows: Ints, cols: Ints, values: Floats, shape: tuple[int, int]) -> Any:
    """The matrix of these entries, sparse where it has more than ``DENSE`` columns; entries of one place are summed."""
    if shape[1] > DENSE:
        from scipy import sparse

        return sparse.csr_matrix((values, (rows, cols)), shape=shape)
    total = np.zeros(shape)
    np.add.at(total, (rows, cols), values)
    return total


def _total(stiffness: Any, comm: MPI.Comm) -> Any:
    """The sum (m, m) of what ranks have, bit for bit the same on all of them. Collective."""
    if not isinstance(stiffness, np.ndarray):
        return sum(comm.allgather(stiffness))  # with the blocks beside its own joints, each
    total = np.zeros_like(stiffness)
    comm.Reduce(np.ascontiguousarray(stiffness), total, MPI.SUM, root=0)
    comm.Bcast(total, root=0)
    return total


def _sparse_null(scaled: sparse.csc_matrix) -> Floats | None:
    """The same of a matrix with unit diagonal, or None where too much floats for it to pay."""
    from scipy import sparse
    from scipy.sparse.linalg import splu

    count = scaled.shape[0]
    inverse, generator = splu(scaled + SHIFT * sparse.identity(count, format="csc")), np.random.default_rng(0)
    tried = FIRST
    while tried <= count // 4:
        basis = generator.standard_normal((count, tried))
        for _ in range(INVERSE_ITERATIONS):
            basis = np.linalg.qr(inverse.solve(basis))[0]
        values, mixed = np.linalg.eigh(basis.T @ (scaled @ basis))
        if values[-1] > NOTHING:
            return np.asarray(basis @ mixed[:, values <= NOTHING])
        tried *= 4
    return None


class Floating:
    """Finds floating blocks, for the sections that carry; keeps the last result."""

    def __init__(self, operators: Operators, loads: Loads) -> None:
        """Locate the sections. Collective."""
        self.operators, self.loads = operators, loads
        blocks, block = operators.blocks, operators.blocks.solid
        self.frames = Frames.of(block.piece_box)
        self.count = len(block.piece_box)
        self.natural = operators.joints.natural
        joints = blocks.joints
        self.sides = np.stack([block.piece[joints.bottom[:, 0]], block.piece[joints.top[:, 0]]], axis=1)
        apart = self.sides[:, 0] != self.sides[:, 1]  # walls of one block hold nothing that floats
        self.holds = np.repeat(apart, len(self.natural))[:, None]
        ends = block.points[joints.bottom]
        self.frame = facet.frame(ends)[0]
        self.places = on_joints(ends, self.natural).reshape(-1, 2)
        unmeshed = is_unmeshed(block.cells)
        self.around = np.flatnonzero(unbounded.is_around(blocks)) if unmeshed else None  # the rock that nothing moves
        self.beside = unbounded.held_pieces(blocks) if unmeshed else None
        self._carried: np.ndarray | None = None
        self._asked: tuple[Sections, bool] | None = None
        self.motions = np.zeros((3 * self.count, 0))

    def find(self, sections: Sections, is_filled: bool, without: np.ndarray | None = None) -> Floats:
        """Motions (3 p, k) of the blocks that float at these sections, orthonormal. Collective.

        is_filled  an incompressible fluid keeps the walls of every joint apart, and together
        without    (s, 2) what sections are taken not to carry, along and across, whatever their status
        """
        if without is None and self._asked is not None and self._asked[0] is sections and self._asked[1] == is_filled:
            return self.motions
        self._asked = (sections, is_filled) if without is None else None
        tangent = sections.tangent
        carried = np.any(tangent != 0.0, axis=1)  # (s, 2): along, across
        carried[:, -1] |= is_filled
        carried &= self.holds if without is None else self.holds & ~without
        same = self._carried is not None and np.array_equal(carried, self._carried)
        if not self.operators.layout.comm.allreduce(int(not same)):
            return self.motions
        self._carried = carried
        self.motions = self._motions(carried)
        return self.motions

    def _motions(self, carried: np.ndarray) -> Floats:
        """Blocks across joints that carry in all directions move as one; floating motions are found among these groups."""
        comm = self.operators.layout.comm
        points = len(self.natural)
        firm = carried.reshape(-1, points * 2).all(axis=1) & (points > 1)
        pairs = np.concatenate(comm.allgather(np.unique(self.sides[firm], axis=0)))
        group = components(pairs[:, 0], pairs[:, 1], self.count)
        groups = int(group.max(initial=-1)) + 1
        blocks, boxes = self.operators.blocks, np.empty((groups, 2, 2))
        boxes[:, 0], boxes[:, 1] = np.inf, -np.inf
        np.minimum.at(boxes[:, 0], group, blocks.solid.piece_box[:, 0])
        np.maximum.at(boxes[:, 1], group, blocks.solid.piece_box[:, 1])
        frames = Frames.of(boxes)
        parts = (
            [_around_rows(group[self.around])]
            if self.around is not None
            else [_support_rows(blocks, self.loads, frames, group), _tie_rows(blocks, frames, group)]
        )
        parts.append(self._joint_rows(carried & ~np.repeat(firm, points)[:, None], frames, group))
        stiffness = _terms_stiffness(self.operators, frames, group)
        for motion, value in parts:
            row = np.repeat(np.arange(len(motion)), motion.shape[1])
            matrix = _summed(row, motion.ravel(), value.ravel(), (len(motion), 3 * groups))
            stiffness = stiffness + matrix.T @ matrix
        return self._of_blocks(null_motions(_total(stiffness, comm)), frames, group)

    def _joint_rows(self, carried: np.ndarray, frames: Frames, group: Ints) -> Rows:
        section, component = np.nonzero(carried)
        number = section // len(self.natural)
        direction, place = self.frame[number, component], self.places[section]
        bottom, top = group[self.sides[number]].T
        value = np.concatenate([-frames.moved(bottom, place, direction), frames.moved(top, place, direction)], axis=1)
        return np.concatenate([_motions_of(bottom), _motions_of(top)], axis=1), value

    def _of_blocks(self, motions: Floats, frames: Frames, group: Ints) -> Floats:
        """Motions of groups (3 g, k) as those of their blocks (3 p, k)."""
        turn = motions[3 * group + 2] / frames.size[group, None]
        arm = self.frames.middle - frames.middle[group]
        x = motions[3 * group] - arm[:, 1:] * turn
        y = motions[3 * group + 1] + arm[:, :1] * turn
        each = np.stack([x, y, turn * self.frames.size[:, None]], axis=1).reshape(3 * self.count, -1)
        return np.linalg.qr(each)[0] if each.shape[1] else each

    def net_force(self, balance: PETSc.Vec) -> Floats:
        """Net force on each block, and its moment over the block's size: (p, 3) of a solid balance. Collective."""
        block, comm = self.operators.blocks.solid, self.operators.layout.comm
        start, local = block.unknown_starts[comm.rank], balance.getArray(readonly=True)
        force = np.zeros((self.count, 3))
        for numbers, piece, points, axis in _places(self.operators.blocks):
            if axis < 2:
                direction = np.broadcast_to(np.eye(2)[axis], points.shape)
                share = self.frames.moved(piece, points, direction)
                if self.beside is not None:  # the wall beside these is held, and takes what they take
                    there = self.beside[(numbers - start) // 2]
                    back = local[numbers - start, None] * self.frames.moved(there, points, direction)
                    np.add.at(force, there, back)
            else:
                share = np.zeros((len(piece), 3))
                share[:, 2] = 1.0 / self.frames.size[piece]
            np.add.at(force, piece, -local[numbers - start, None] * share)
        return np.asarray(comm.allreduce(force))


def _places(blocks: Blocks) -> list[tuple[Ints, Ints, Floats, int]]:
    """This rank's unknowns: numbers, the block and the place of each, and its axis; 2 is a turn."""
    block, rank = blocks.solid, blocks.comm.rank
    first, last = block.unknown_starts[rank : rank + 2]
    found = []
    body_piece = np.zeros(len(block.body_rock), dtype=np.int64)
    here = block.body >= 0
    body_piece[block.body[here]] = block.piece[here]
    for axis in range(2):
        number = block.unknown[: block.owned, axis]
        mine = np.flatnonzero((number >= first) & (number < last))
        _, once = np.unique(number[mine], return_index=True)  # tied nodes share a number
        mine = mine[once]
        found.append((number[mine], block.piece[mine], block.points[mine], axis))
    for axis in range(3):
        number = block.body_unknown[:, axis]
        mine = np.flatnonzero((number >= first) & (number < last))
        found.append((number[mine], body_piece[mine], block.body_center[mine], axis))
    return found


def _terms_stiffness(operators: Operators, frames: Frames, group: Ints) -> Any:
    """This rank's part of R' K R (3 g, 3 g) of all terms, R what the motions move, each K of unit size. Collective."""
    blocks, count = operators.blocks, 3 * len(frames.size)
    none = np.zeros(0, dtype=np.int64)
    total = _summed(none, none, np.zeros(0), (count, count))
    terms = [term.stiffness for term in operators.terms if term.stiffness is not None]
    if not terms:
        return total
    unknowns = (operators.layout.solid_count, int(operators.layout.solid_starts[-1]))
    motions = PETSc.Mat().createAIJ((unknowns, (None, count)), nnz=3, comm=blocks.comm)
    for numbers, motion, value in _moved_unknowns(blocks, frames, group):
        add_blocks(motions, numbers[:, None], motion, value[:, None])
    motions.assemble()
    for matrix in terms:
        product, size = matrix.PtAP(motions), matrix.norm(PETSc.NormType.INFINITY)
        rows, first = local_rows(product), product.getOwnershipRange()[0]
        if size > 0.0:
            total += _summed(rows.rows + first, rows.cols, rows.values / size, total.shape)
        product.destroy()
    motions.destroy()
    return total


def _moved_unknowns(blocks: Blocks, frames: Frames, group: Ints) -> Iterator[tuple[Ints, Ints, Floats]]:
    """This rank's unknowns: numbers (n,), the motions (n, 3) of their groups, and by how much each moves them (n, 3)."""
    for numbers, piece, points, axis in _places(blocks):
        owner = group[piece]
        if axis < 2:
            value = frames.moved(owner, points, np.broadcast_to(np.eye(2)[axis], (len(owner), 2)))
        else:
            value = np.broadcast_to([0.0, 0.0, 1.0], (len(owner), 3))
        yield numbers, _motions_of(owner), value


def _motions_of(groups: Ints) -> Ints:
    """Numbers (n, 3) of the motions of groups (n,)."""
    return 3 * groups[:, None] + np.arange(3)


def _around_rows(groups: Ints) -> Rows:
    """Rows of all motions of the rock around fractures that is not meshed."""
    motions = _motions_of(np.unique(groups)).reshape(-1, 1)
    return motions, np.ones(motions.shape)


def _support_rows(blocks: Blocks, loads: Loads, frames: Frames, group: Ints) -> Rows:
    """Rows of the motions that supports hold."""
    number, motion, value = (np.concatenate(each) for each in zip(*_moved_unknowns(blocks, frames, group), strict=True))
    chosen = np.isin(number, loads.held + int(blocks.solid.unknown_starts[blocks.comm.rank]))
    return motion[chosen], value[chosen]


def _tie_rows(blocks: Blocks, frames: Frames, group: Ints) -> Rows:
    """Rows of the motions that ties hold: nodes that share an unknown move alike. On rank 0; collective."""
    block, comm = blocks.solid, blocks.comm
    nothing = np.zeros((0, 6), dtype=np.int64), np.zeros((0, 6))
    if not len(block.unused):
        return nothing
    nodes = np.unique(block.side_facets)
    nodes = nodes[block.body[nodes] < 0]
    parts = comm.gather((block.node_ids[nodes], block.unknown[nodes], block.piece[nodes], block.points[nodes]))
    if parts is None:
        return nothing
    ids, unknown, piece, points = (np.concatenate(each) for each in zip(*parts, strict=True))
    _, once = np.unique(ids, return_index=True)
    unknown, owner, points = unknown[once], group[piece[once]], points[once]
    motions, values = [], []
    for axis in range(2):
        _, first, member = np.unique(unknown[:, axis], return_index=True, return_inverse=True)
        other = np.flatnonzero(first[member] != np.arange(len(member)))
        both, direction = (other, first[member[other]]), np.broadcast_to(np.eye(2)[axis], (len(other), 2))
        motions.append(np.hstack([_motions_of(owner[nodes]) for nodes in both]))
        there, here = (frames.moved(owner[nodes], points[nodes], direction) for nodes in both)
        values.append(np.hstack([there, -here]))
    return np.concatenate(motions), np.concatenate(values)
