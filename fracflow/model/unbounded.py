"""Unbounded rock: its operators on the walls of the fractures, which are all that is left of it.

At each node of a fracture the first wall is held, and the displacements of the others are those beside it. So the jumps of all
fractures that meet there add up to none, and that at a tip is none. K_s is dense and symmetric. It is positive but for rigid
motions of blocks that fractures cut out. The rock has no mass.
"""

from __future__ import annotations

import numpy as np

from fracflow._petsc import PETSc
from fracflow.elements import dislocation
from fracflow.mesh.blocks import Blocks
from fracflow.mesh.data import Bools, Floats, Ints
from fracflow.model.joints import Joints, section_places, tractions_of
from fracflow.model.layout import add_transposed, create_matrix, matrix_of
from fracflow.model.properties import initial_stress
from fracflow.scene.scene import Scene

ROUND_OFF = 1e-9  # of the square of its size: the area between walls that meet


def held_walls(blocks: Blocks) -> Ints:
    """Numbers (n,) of the unknowns of the first wall at each node, of all ranks, ascending. Collective."""
    parts = blocks.comm.allgather(blocks.solid.unknown[_first(blocks)].ravel())
    return np.asarray(np.sort(np.concatenate(parts)))


def _first(blocks: Blocks) -> Ints:
    """Own nodes (n,) that are the first copies, which keep the numbers of their nodes."""
    block = blocks.solid
    return np.flatnonzero(block.node_ids[: block.owned] == block.origin[: block.owned])


def held_pieces(blocks: Blocks) -> Ints:
    """The piece of rock (n,) that the first copy of each local node lies on. Collective."""
    block, first = blocks.solid, _first(blocks)
    parts = blocks.comm.allgather((block.origin[first], block.piece[first]))
    origin, piece = (np.concatenate(part) for part in zip(*parts, strict=True))
    order = np.argsort(origin)
    return np.asarray(piece[order][np.searchsorted(origin[order], block.origin)])


def is_around(blocks: Blocks) -> Bools:
    """Which pieces of rock (p,) are around fractures, and not cut out by them: of these walls run clockwise. Collective."""
    block = blocks.solid
    area, low = np.zeros(len(block.piece_box)), block.piece_box.mean(axis=1)
    number = block.piece[block.cells[:, 0]]
    start, end = (block.points[block.cells[:, k]] - low[number] for k in (0, 1))
    np.add.at(area, number, 0.5 * (start[:, 0] * end[:, 1] - start[:, 1] * end[:, 0]))
    size = np.ptp(block.piece_box, axis=1).max(axis=1) ** 2
    return np.asarray(blocks.comm.allreduce(area) <= ROUND_OFF * size)


def of_energy(scene: Scene) -> float:
    """-E'/(4 pi) of the rock [stress]."""
    (rock,) = scene.rock.values()
    return -rock.plane_strain_modulus / (4.0 * float(np.pi))


def stiffness(blocks: Blocks, scene: Scene) -> PETSc.Mat:
    """(2.39) K_s on the unknowns, without entries for held walls [force/length per thickness]. Collective.

    Jumps are linear along a joint, and S u are the differences of those at its ends. K_s = -E'/(4 pi) S' A S, with the means A
    of ``dislocation.energies``, and what tips add to them. The caller destroys it.
    """
    from scipy import sparse  # imports much

    block, comm = blocks.solid, blocks.comm
    faces = np.stack([blocks.joints.bottom, blocks.joints.top], axis=1)  # (joint, face, end)
    parts = comm.allgather((blocks.joints.ids, block.points[blocks.joints.bottom], block.unknown[faces]))
    ids, ends, walls = (np.concatenate(part) for part in zip(*parts, strict=True))
    order = np.argsort(ids)
    ends, walls = ends[order], walls[order]

    first, last, total = (int(block.unknown_starts[k]) for k in (comm.rank, comm.rank + 1, -1))
    sign = np.broadcast_to(np.array([[1.0, -1.0], [-1.0, 1.0]])[:, :, None], walls.shape[1:])
    rows = np.broadcast_to(2 * np.arange(len(ends))[:, None, None, None] + np.arange(2), walls.shape)
    of_all = np.broadcast_to(sign, walls.shape).ravel(), (rows.ravel(), walls.ravel())
    changes = sparse.csr_matrix(of_all, shape=(2 * len(ends), total))
    free = np.setdiff1d(np.arange(total), held_walls(blocks))
    mine = free[(free >= first) & (free < last)]

    here = changes[:, mine]
    touching = np.unique(here.nonzero()[0] // 2)
    means = dislocation.energies(ends, touching, dislocation.at_tips(ends))
    pairs = np.empty((len(touching), 2, len(ends), 2))
    for i, j, part in ((0, 0, 0), (1, 1, 1), (0, 1, 2), (1, 0, 2)):
        pairs[:, i, :, j] = means[..., part]
    pairs *= of_energy(scene)
    chosen = (2 * touching[:, None] + np.arange(2)).ravel()
    values = here[chosen].T @ (changes[:, free].T @ pairs.reshape(len(chosen), 2 * len(ends)).T).T

    width = np.zeros(last - first, dtype=np.int64)
    width[mine - first] = len(free)
    csr = np.concatenate([[0], np.cumsum(width)]), np.tile(free, len(mine)), values.ravel()
    return matrix_of(((last - first, total), (last - first, total)), csr, comm)


def mass(blocks: Blocks) -> PETSc.Mat:
    """M of (2.38): none. The caller destroys it. Collective."""
    here, total = int(np.diff(blocks.solid.unknown_starts)[blocks.comm.rank]), int(blocks.solid.unknown_starts[-1])
    matrix = create_matrix(((here, total), (here, total)), 1, blocks.comm)
    diagonal = matrix.createVecLeft()
    matrix.setDiagonal(diagonal)
    diagonal.destroy()
    return matrix


def stress_force(blocks: Blocks, joints: Joints, stress: Floats) -> PETSc.Vec:
    """Force on the unknowns of a stress (3, 3) far away, or of one at each section (s, 3, 3) [force per thickness].

    The caller destroys it. Collective.
    """
    result = joints.jump.createVecRight()
    traction = tractions_of(blocks, np.broadcast_to(stress, (len(joints.weights), 3, 3)), joints.points)
    add_transposed(joints.jump, (joints.weights[:, None] * traction).ravel(), result)
    return result


def initial_stress_force(blocks: Blocks, scene: Scene, joints: Joints) -> PETSc.Vec:
    """F_s(sigma_0) of (4.4b) on the unknowns: what the joints' total tractions balance. The caller destroys it. Collective."""
    result = stress_force(blocks, joints, initial_stress(scene, section_places(blocks, joints.natural)))
    result.scale(-1.0)
    return result
