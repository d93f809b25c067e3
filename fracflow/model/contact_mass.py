"""The mass matrix with the inertia of fracture walls, along their normal, carried by nodes further in: P' M P + C.

P takes the motion of a wall along its normal from the nodes inside; C keeps the first moments of the blocks. P P = P, and
P leaves translations as they are, so the total mass of every block stays.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fracflow._petsc import PETSc, destroy
from fracflow.elements import solid
from fracflow.laws import JOINT_LAWS
from fracflow.mesh.contact_nodes import ContactNodes, averaged, balanced, contact_nodes_of, moments_of, tied_whole
from fracflow.mesh.data import Bools, Floats, Ints, SplitMesh
from fracflow.mesh.slabs import Order
from fracflow.model.joints import Joints, Massless
from fracflow.model.layout import add_blocks, create_matrix
from fracflow.model.loads import Loads
from fracflow.model.operators import Operators
from fracflow.model.solid import by_shape, rock_values, summed_at_nodes
from fracflow.scene.scene import Scene

SOME = 1e-9  # of a mass: what counts as lost
Entries = tuple[Ints, Ints, Floats]
"""Blocks of a matrix: rows (n, 2), columns (n, 2), values (n, 2, 2)."""


def redistributes(scene: Scene) -> bool:
    """Whether a scene moves the mass of its fracture walls inward."""
    return scene.has_dynamics and scene.method.contact == "redistributed"


def redistributed(ops: Operators, scene: Scene, loads: Loads, mesh: SplitMesh | None) -> Operators:
    """The operators with the mass of the walls moved inward, in place of the previous mass; or unchanged.

    ``mesh`` is on rank 0, which has the cells at joints and sides, and finds the walls. Each rank balances the blocks at
    its own nodes. Collective.
    """
    comm, own = ops.layout.comm, _own_nodes(ops, scene)
    here = own.ids < (count := comm.bcast(0 if mesh is None else len(mesh.points), root=0))
    near = Order(comm, own.ids[here], count)  # nodes on near cells come first
    unknown, mass, piece = (near.whole(values[here]) for values in (own.unknown, own.mass, own.piece))
    held, damped = (near.whole(_is_marked(ops, each, own.unknown[here])) for each in (loads.held, _damped(ops)))
    walls, moments, is_wall = None, None, None
    if mesh is not None and unknown is not None and mass is not None and piece is not None:
        assert held is not None and damped is not None
        walls = _walls(mesh, scene, unknown, held, damped)
        moments = moments_of(mesh.points, walls, mass, piece, len(ops.blocks.solid.piece_rock))
        is_wall = np.zeros(near.total, dtype=bool)
        is_wall[walls.nodes] = True
    moments = comm.bcast(moments, root=0)
    inside = (own.unknown >= 0).all(axis=1) & (own.piece >= 0)
    marked = np.zeros(near.count, dtype=bool)
    near.hand_out(is_wall, 0, near.total, marked)
    inside[here] &= ~marked
    added, fits = balanced(comm, own.points[inside], own.mass[inside], own.piece[inside], moments)
    if walls is not None and unknown is not None and piece is not None:
        walls = averaged(walls.only(fits[piece[walls.nodes]]), unknown)
    if not comm.bcast(0 if walls is None else len(walls.nodes), root=0):
        return ops
    changed = added.any(axis=(1, 2))
    carried = None if walls is None or unknown is None else _carried(walls, unknown)
    return _moved_inward(ops, carried, own.unknown[inside][changed], added[changed])


def _moved_inward(ops: Operators, carried: Entries | None, numbers: Ints, added: Floats) -> Operators:
    """The operators with P' M P + C, by blocks of P - 1 on rank 0 and the blocks (n, 2, 2) of C at this rank's nodes.

    Collective.
    """
    inward, kept = _square(ops), _square(ops)
    first, last = inward.getOwnershipRange()
    rows = np.arange(first, last)[:, None]
    add_blocks(inward, rows, rows, np.ones((len(rows), 1, 1)))
    add_blocks(kept, rows, rows, np.zeros((len(rows), 1, 1)))
    if carried is not None:
        add_blocks(inward, *carried)
    add_blocks(kept, numbers, numbers, added)
    inward.assemble()
    kept.assemble()
    mass = ops.mass.PtAP(inward)
    mass.axpy(1.0, kept, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
    destroy(kept, ops.mass)
    joints = replace(ops.joints, massless=massless(ops.joints, inward))
    return replace(ops, mass=mass, inward=inward, joints=joints)


@dataclass(frozen=True)
class _Nodes:
    """Nodes of this rank: numbers (n,), points (n, 2), unknowns (n, 2), masses (n,), and blocks (n,) of rock."""

    ids: Ints
    points: Floats
    unknown: Ints
    mass: Floats
    piece: Ints


def _own_nodes(ops: Operators, scene: Scene) -> _Nodes:
    """Those that this rank owns. Collective."""
    block = ops.blocks.solid
    density, mass = rock_values(ops.blocks, scene, "density"), np.zeros((len(block.points), 1))
    for alike, nodes in by_shape(block.cells):
        np.add.at(mass[:, 0], nodes, solid.mass_lumped(block.points[nodes], density[alike]))
    mass = summed_at_nodes(ops.blocks, np.arange(len(mass)), mass)[:, 0]
    own = slice(0, block.owned)
    return _Nodes(block.node_ids[own], block.points[own], block.unknown[own], mass[own], block.piece[own])


def _is_marked(ops: Operators, marked: Ints, unknown: Ints) -> Bools:
    """Which unknowns (n, 2) of nodes, -1 for none, are ``marked`` by the ranks that have them: local numbers. Collective."""
    numbers = np.where(unknown < 0, -1, ops.layout.solid_numbers(unknown))
    return np.isin(numbers, ops.layout.marked(marked, marked[:0], (numbers,)))


def massless(joints: Joints, inward: PETSc.Mat) -> Massless:
    """Where walls have no mass of their own along their normal. Collective."""
    diagonal = inward.getDiagonal()
    diagonal.setArray(1.0 - diagonal.getArray())
    lost = joints.moved(diagonal) > SOME
    diagonal.destroy()
    lost[:, :-1] = False  # along an inclined wall each unknown loses a part of its mass, but none does along it
    return Massless(lost, joints.jump.matMult(inward))


def follow(ops: Operators, motion: PETSc.Vec) -> None:
    """Let the walls' velocity or acceleration along their normal be that of their mass. In place. Collective.

    Without mass the integrator would keep their values of the first instant, with another sign in each step.
    """
    if ops.inward is not None:
        moved = motion.duplicate()
        ops.inward.mult(motion, moved)
        moved.copy(motion)
        moved.destroy()


def _square(ops: Operators) -> PETSc.Mat:
    size = (ops.layout.solid_count, int(ops.layout.solid_starts[-1]))
    return create_matrix((size, size), 8, ops.layout.comm)


def _damped(ops: Operators) -> Ints:
    """Local numbers (m,) of the displacements that sides damp."""
    if ops.damping is None:
        return np.zeros(0, dtype=np.int64)
    diagonal = ops.damping.getDiagonal()
    found = np.flatnonzero(diagonal.getArray(readonly=True))
    diagonal.destroy()
    return found


def _walls(mesh: SplitMesh, scene: Scene, unknown: Ints, held: Bools, damped: Bools) -> ContactNodes:
    """The walls of a mesh whose nodes have unknowns (n, 2), some of which are held and some damped (n, 2)."""
    laws = [JOINT_LAWS[scene.fracture_named(name).law].opens for name in mesh.fractures]
    opens = np.array(laws, dtype=bool)[mesh.joint_fracture]
    free = (unknown >= 0).all(axis=1) & ~damped.any(axis=1)
    return tied_whole(contact_nodes_of(mesh, opens, free, held), unknown)


def _carried(walls: ContactNodes, unknown: Ints) -> Entries:
    """Blocks of P - 1, by numbers of unknowns."""
    rows, normal = unknown[walls.nodes], walls.normal
    given, taking = rows[walls.wall], normal[walls.wall] * walls.share[:, None, None]
    own, links = (rows, rows, -normal), (given, unknown[walls.inner], taking)
    blocks = tuple(np.concatenate(parts) for parts in zip(own, links, strict=True))
    return blocks[0], blocks[1], blocks[2]
