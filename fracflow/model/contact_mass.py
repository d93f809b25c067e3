"""The mass matrix with the inertia of fracture walls, along their normal, carried by nodes further in: P' M P + C.

P takes the motion of a wall along its normal from the nodes inside; C keeps the first moments of the blocks. P P = P, and
P leaves translations as they are, so the total mass of every block stays.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fracflow._petsc import PETSc, destroy
from fracflow.elements import solid
from fracflow.laws import JOINT_LAWS
from fracflow.mesh.contact_nodes import averaged, balanced, contact_nodes_of, tied_whole
from fracflow.mesh.data import Bools, Floats, Ints, SplitMesh
from fracflow.mesh.distribute import pieces_of_rock
from fracflow.model.joints import Joints, Massless
from fracflow.model.layout import add_blocks, create_matrix
from fracflow.model.loads import Loads
from fracflow.model.operators import Operators
from fracflow.model.solid import by_shape
from fracflow.scene.scene import Scene

SOME = 1e-9  # of a mass: what counts as lost


def redistributes(scene: Scene) -> bool:
    """Whether a scene moves the mass of its fracture walls inward."""
    return scene.has_dynamics and scene.method.contact == "redistributed"


def redistributed(ops: Operators, scene: Scene, loads: Loads, mesh: SplitMesh | None) -> Operators:
    """The operators with the mass of the walls moved inward, in place of the previous mass; or unchanged.

    ``mesh`` is on rank 0. Collective.
    """
    block, comm = ops.blocks.solid, ops.layout.comm
    own = block.node_ids[: block.owned]
    unknown = ops.blocks.gather(own, block.unknown[: block.owned], ops.blocks.sizes.nodes)
    is_held = np.isin(np.arange(ops.layout.solid_count), loads.held)
    held, damped = (comm.gather(flags, root=0) or [] for flags in (is_held, _damped(ops)))
    entries, added = None, None
    if mesh is not None and unknown is not None:
        entries, added = _entries(mesh, scene, unknown, np.concatenate(held), np.concatenate(damped))
    count = comm.bcast(0 if entries is None else len(entries[0]), root=0)
    if not count:
        return ops
    inward, kept = _square(ops), _square(ops)
    first, last = inward.getOwnershipRange()
    rows = np.arange(first, last)[:, None]
    add_blocks(inward, rows, rows, np.ones((len(rows), 1, 1)))
    add_blocks(kept, rows, rows, np.zeros((len(rows), 1, 1)))
    if entries is not None and added is not None:
        add_blocks(inward, *entries)
        add_blocks(kept, *added)
    inward.assemble()
    kept.assemble()
    mass = ops.mass.PtAP(inward)
    mass.axpy(1.0, kept, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
    destroy(kept, ops.mass)
    joints = replace(ops.joints, massless=massless(ops.joints, inward))
    return replace(ops, mass=mass, inward=inward, joints=joints)


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


def _damped(ops: Operators) -> Bools:
    if ops.damping is None:
        return np.zeros(ops.layout.solid_count, dtype=bool)
    diagonal = ops.damping.getDiagonal()
    flags = diagonal.getArray() != 0.0
    diagonal.destroy()
    return flags


Entries = tuple[Ints, Ints, Floats]


def _entries(mesh: SplitMesh, scene: Scene, unknown: Ints, held: Bools, damped: Bools) -> tuple[Entries, Entries]:
    """Blocks of P - 1 and of C: rows (n, 2), columns (n, 2), values (n, 2, 2) by numbers of unknowns."""
    laws = [JOINT_LAWS[scene.fracture_named(name).law].opens for name in mesh.fractures]
    opens = np.array(laws, dtype=bool)[mesh.joint_fracture]
    able = (unknown >= 0).all(axis=1)
    free = able & ~damped[unknown].any(axis=1)  # -1, of rigid bodies, whose mass stays, takes the last entry
    mass, piece = _nodal_mass(mesh, scene), pieces_of_rock(mesh)[0]
    walls = tied_whole(contact_nodes_of(mesh, opens, free, held[unknown]), unknown)
    walls, added = balanced(mesh, walls, mass, piece, able)
    walls = averaged(walls, unknown)
    rows, normal = unknown[walls.nodes], walls.normal
    given, taking = rows[walls.wall], normal[walls.wall] * walls.share[:, None, None]
    own, links = (rows, rows, -normal), (given, unknown[walls.inner], taking)
    inward = tuple(np.concatenate(parts) for parts in zip(own, links, strict=True))
    chosen = np.flatnonzero(added.any(axis=(1, 2)))
    numbers = unknown[chosen]
    return (inward[0], inward[1], inward[2]), (numbers, numbers, added[chosen])


def _nodal_mass(mesh: SplitMesh, scene: Scene) -> Floats:
    """Row sums of the mass matrix (n,)."""
    density = np.array([scene.rock[name].density or 0.0 for name in mesh.rocks])[mesh.cell_rock]
    result = np.zeros(len(mesh.points))
    for alike, nodes in by_shape(mesh.cells):
        np.add.at(result, nodes, solid.mass_lumped(mesh.points[nodes], density[alike]))
    return result
