"""Nodes of contact: walls of fractures that may open and close, whose inertia along their normal nodes further in carry.

A wall node that bounces on its joint with a mass of its own makes energy in steps that are longer than the bounce. So that
mass moves along the normal by the mean of the nodes inside the rock beside it (Khenous, Laborde and Renard 2008; Dabaghi,
Petrov, Pousin and Renard 2014). A shift of a block's centre of mass is corrected over the block.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fracflow._petsc import MPI
from fracflow.mesh.data import Bools, Floats, Ints, SplitMesh
from fracflow.mesh.facets import half_facets

# Faces that turn by more than 30 degrees at a node have no common normal: it keeps its mass. Without that rule corners kept
# opening and closing in Newton's iterations, and found no status that stays.
CORNER = np.tan(np.radians(15.0)) ** 2
CLEAN = 1e-12  # of a projector: as good as 0 or 1
MOST_MOVED = 0.5  # of a node's mass: a block that would need more to keep its centre of mass is too thin
MOMENT_ROUND_OFF = 1e-9


@dataclass(frozen=True)
class ContactNodes:
    """Wall nodes, and who moves their mass.

    nodes   (c,)       split nodes
    normal  (c, 2, 2)  projector on the normal, the direction in which they lose their mass
    wall    (l,)       row of ``nodes`` of each link
    inner   (l,)       the node of a link that takes part of the mass over
    share   (l,)       which part; those of a wall node sum to 1
    """

    nodes: Ints
    normal: Floats
    wall: Ints
    inner: Ints
    share: Floats

    def only(self, chosen: Bools) -> ContactNodes:
        """Those of some nodes (c,)."""
        kept, number = chosen[self.wall], np.cumsum(chosen) - 1
        links = number[self.wall[kept]], self.inner[kept], self.share[kept]
        return ContactNodes(self.nodes[chosen], self.normal[chosen], *links)


def contact_nodes_of(mesh: SplitMesh, opens: Bools, able: Bools, held: Bools) -> ContactNodes:
    """The walls of joints that may open (f,), among nodes that are ``able`` (n,) to move each on its own; not corners.

    held  (n, 2) components that are prescribed: they keep their mass, and so does a normal that is not free of them
    """
    nodes, normal = _normals(mesh, opens & (mesh.joint_bottom != mesh.joint_top).any(axis=1))
    normal = _free(normal, held[nodes])
    moves = able[nodes] & normal.any(axis=(1, 2))
    nodes, normal = nodes[moves], normal[moves]
    on_wall = np.zeros(len(mesh.points), dtype=bool)
    for faces in (mesh.joint_bottom[opens], mesh.joint_top[opens]):
        on_wall[faces[mesh.joint_bottom[opens] != mesh.joint_top[opens]]] = True
    row = np.full(len(mesh.points) + 1, -1, dtype=np.int64)
    row[nodes] = np.arange(len(nodes))
    wall, inner = _links(row, able & ~on_wall, half_facets(mesh.cells, 2).nodes)
    lonely = np.bincount(wall, minlength=len(nodes)) == 0  # in a corner all that edges lead to may be walls
    row[nodes[~lonely]] = -1
    cell, corner = np.nonzero((row[mesh.cells] >= 0) & (mesh.cells >= 0))
    mates = np.stack([np.repeat(mesh.cells[cell, corner], mesh.cells.shape[1]), mesh.cells[cell].ravel()], axis=1)
    more = _links(row, able & ~on_wall, mates[mates[:, 1] >= 0])
    wall, inner = np.concatenate([wall, more[0]]), np.concatenate([inner, more[1]])
    count = np.bincount(wall, minlength=len(nodes))
    return ContactNodes(nodes, normal, wall, inner, 1.0 / count[wall]).only(count > 0)


def _normals(mesh: SplitMesh, opens: Bools) -> tuple[Ints, Floats]:
    """Nodes of the walls, and the projector on the normals of the faces that meet there."""
    faces = np.concatenate([mesh.joint_bottom[opens], mesh.joint_top[opens]])
    along = mesh.points[faces[:, 1]] - mesh.points[faces[:, 0]]
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    each = across[:, :, None] * across[:, None, :] / np.linalg.norm(across, axis=1)[:, None, None]
    split = np.tile((mesh.joint_bottom[opens] != mesh.joint_top[opens]).ravel(), 2)  # a tip has one node, and no walls
    nodes, place = np.unique(faces.ravel()[split], return_inverse=True)
    summed = np.zeros((len(nodes), 2, 2))
    np.add.at(summed, place.ravel(), np.repeat(each, 2, axis=0)[split])
    size, axes = np.linalg.eigh(summed)
    normal = axes[:, :, -1, None] * axes[:, None, :, -1]
    normal[size[:, 0] > CORNER * size[:, 1]] = 0.0
    for clean in (0.0, 1.0):
        normal[np.abs(normal - clean) < CLEAN] = clean
    return nodes, normal


def _free(normal: Floats, held: Bools) -> Floats:
    """The directions without their held components (c, 2)."""
    result = normal.copy()
    for part in (0, 1):
        only = held[:, 1 - part]  # what is left is the other component, if it is one of the directions
        unit = np.zeros((2, 2))
        unit[part, part] = 1.0
        result[only] = np.where((normal[only, part, part] == 1.0)[:, None, None], unit, 0.0)
    result[held.all(axis=1)] = 0.0
    return result


def _links(row: Ints, inside: Bools, pairs: Ints) -> tuple[Ints, Ints]:
    """Rows and inner nodes of pairs (m, 2) of a wall node and one inside, each once."""
    both = np.concatenate([pairs, pairs[:, ::-1]])
    both = np.unique(both[(row[both[:, 0]] >= 0) & inside[both[:, 1]]], axis=0)
    return row[both[:, 0]], both[:, 1]


@dataclass(frozen=True)
class Moments:
    """First moments that the walls of each block move inward, for every pair of directions.

    moved  (p, 2, 2, 2)  sums [mass length]
    size   (p,)          of the largest part
    """

    moved: Floats
    size: Floats


def moments_of(points: Floats, walls: ContactNodes, mass: Floats, piece: Ints, count: int) -> Moments:
    """The moments of walls in so many blocks, by the points, masses and blocks of all nodes (n,) that they name."""
    shift = np.zeros((len(walls.nodes), 2))
    np.add.at(shift, walls.wall, walls.share[:, None] * points[walls.inner])
    shift -= points[walls.nodes]
    each = mass[walls.nodes][:, None, None, None] * shift[:, :, None, None] * walls.normal[:, None]
    moved, size = np.zeros((count, 2, 2, 2)), np.zeros(count)
    np.add.at(moved, piece[walls.nodes], each)
    np.maximum.at(size, piece[walls.nodes], np.abs(each).max(axis=(1, 2, 3), initial=0.0))
    return Moments(moved, size)


def balanced(comm: MPI.Comm, points: Floats, mass: Floats, piece: Ints, moments: Moments) -> tuple[Floats, Bools]:
    """Masses (n, 2, 2) that nodes inside the blocks gain to keep first moments, and the blocks (p,) that can.

    points (n, 2), mass (n,) and piece (n,) are those of this rank's nodes inside; ``moments`` are the same on all ranks.

    Of each block the total mass and the first moment stay, for every pair of directions. Nodes inside a block gain or lose
    in proportion to their distance from its centre; a block too thin for that keeps the mass of its walls. Collective.
    """
    count = len(moments.size)

    def summed(values: Floats, operation: MPI.Op = MPI.SUM) -> Floats:
        comm.Allreduce(MPI.IN_PLACE, values, op=operation)
        return values

    sums = summed(np.stack([np.bincount(piece, mass * x, count) for x in (np.ones(len(mass)), *points.T)], axis=1))
    center = sums[:, 1:] / np.where(sums[:, :1] > 0.0, sums[:, :1], 1.0)
    arm = points - center[piece]
    spread, most = np.zeros((count, 2, 2)), np.zeros(count)
    np.add.at(spread, piece, mass[:, None, None] * arm[:, :, None] * arm[:, None, :])
    spread = summed(spread)
    slope = -np.einsum("pkl,plab->pkab", np.linalg.pinv(spread, rcond=MOMENT_ROUND_OFF, hermitian=True), moments.moved)
    lost = np.abs(np.einsum("pkl,plab->pkab", spread, slope) + moments.moved).max(axis=(1, 2, 3), initial=0.0)
    change = np.einsum("ik,ikab->iab", arm, slope[piece])
    np.maximum.at(most, piece, np.abs(np.linalg.eigvalsh(change)).max(axis=1, initial=0.0))
    fits = (lost <= MOMENT_ROUND_OFF * moments.size) & (summed(most, MPI.MAX) <= MOST_MOVED)
    return mass[:, None, None] * change * fits[piece][:, None, None], fits


def tied_whole(walls: ContactNodes, unknown: Ints) -> ContactNodes:
    """Those that share their unknowns (n, 2) with other walls at most, and both of them with the same."""
    _, place, copies = np.unique(unknown[walls.nodes], axis=0, return_inverse=True, return_counts=True)
    every = np.bincount(unknown[unknown >= 0], minlength=1)
    return walls.only((every[unknown[walls.nodes]] == copies[place.ravel()][:, None]).all(axis=1))


def averaged(walls: ContactNodes, unknown: Ints) -> ContactNodes:
    """The same where tied walls share unknowns (n, 2): each of the copies counts for its part."""
    _, place, copies = np.unique(unknown[walls.nodes], axis=0, return_inverse=True, return_counts=True)
    return replace(walls, normal=walls.normal / copies[place.ravel()][:, None, None])
