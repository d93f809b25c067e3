"""The rock: stiffness, mass and initial-stress forces as PETSc operators on the displacement unknowns."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

import numpy as np

from fracflow._petsc import PETSc, destroy
from fracflow.elements import solid
from fracflow.elements.shape import is_folded
from fracflow.errors import InputError
from fracflow.laws.elastic import STIFFNESS, shear_modulus
from fracflow.mesh.agreement import on_each
from fracflow.mesh.blocks import Blocks, petsc_ints
from fracflow.mesh.data import Floats, Ints
from fracflow.mesh.facets import spot
from fracflow.model.layout import add_blocks, create_matrix, create_vector
from fracflow.model.properties import body_force, initial_stress
from fracflow.remarks import counted
from fracflow.scene.scene import Scene

TURNS = {2: ((0, 1),), 3: ((1, 2), (2, 0), (0, 1))}  # planes in which a body turns, by dimension
CHUNK = 16384  # cells whose element matrices fit a processor's cache: two to three times faster than all at once


def by_shape(cells: Ints) -> Iterator[tuple[Ints, Ints]]:
    """Those of cells (m, k) with equal numbers of nodes, a chunk at a time: numbers (n,), nodes without padding (n, w)."""
    count = (cells >= 0).sum(axis=1)
    for width in np.unique(count):
        alike = np.flatnonzero(count == width)
        for first in range(0, len(alike), CHUNK):
            chosen = alike[first : first + CHUNK]
            yield chosen, cells[chosen, :width]


def node_unknowns(blocks: Blocks, nodes: Ints) -> Ints:
    """Numbers (..., dim) of nodal displacement components in the vector of all nodes, rigid bodies expanded."""
    dim = blocks.sizes.dim
    return blocks.solid.node_global[nodes][..., None] * dim + np.arange(dim)


def nodal_layout(blocks: Blocks) -> tuple[int, int]:
    """Local and global size of the vector of all nodal displacements."""
    return blocks.solid.owned * blocks.sizes.dim, blocks.sizes.nodes * blocks.sizes.dim


def expansion(blocks: Blocks) -> PETSc.Mat | None:
    """Nodal displacements from the unknowns, u = E q: a rigid body moves by translations and turns, tied nodes as one.

    None where no rock is rigid and nothing tied: then both are the same vector. The caller destroys it. Collective.
    """
    block, dim = blocks.solid, blocks.sizes.dim
    if not len(block.body_rock) and not len(block.unused):
        return None
    unknowns = int(np.diff(block.unknown_starts)[blocks.comm.rank]), int(block.unknown_starts[-1])
    matrix = create_matrix((nodal_layout(blocks), unknowns), block.body_unknown.shape[1], blocks.comm)
    own = np.arange(block.owned)
    free = own[block.body[own] < 0]
    rows = node_unknowns(blocks, free)
    add_blocks(matrix, rows.reshape(-1, 1), block.unknown[free].reshape(-1, 1), np.ones((rows.size, 1, 1)))
    on_body = own[block.body[own] >= 0]
    body = block.body[on_body]
    arm = block.points[on_body] - block.body_center[body]
    values = np.zeros((len(on_body), dim, block.body_unknown.shape[1]))
    values[:, np.arange(dim), np.arange(dim)] = 1.0
    for turn, (i, j) in enumerate(TURNS[dim], start=dim):
        values[:, i, turn] = -arm[:, j]
        values[:, j, turn] = arm[:, i]
    add_blocks(matrix, node_unknowns(blocks, on_body), block.body_unknown[body], values)
    matrix.assemble()
    return matrix


def assembled(blocks: Blocks, chosen: Ints, kernel: Callable[[Ints, Ints], Floats], width: int) -> PETSc.Mat:
    """Matrices (n, k dim, k dim) of chosen local cells on all nodes, by numbers (n,) and nodes (n, k). Collective.

    width  entries of a row that there is room for; the caller destroys the result
    """
    dim = blocks.sizes.dim
    matrix = create_matrix((nodal_layout(blocks), nodal_layout(blocks)), width, blocks.comm)
    for group, nodes in by_shape(blocks.solid.cells[chosen]):
        numbers = node_unknowns(blocks, nodes).reshape(len(nodes), nodes.shape[1] * dim)
        add_blocks(matrix, numbers, numbers, kernel(chosen[group], nodes))
    matrix.assemble()
    result = matrix.copy()  # which has no room that is left
    matrix.destroy()
    return result


def assembled_at_nodes(blocks: Blocks, parts: Iterable[tuple[Ints, Floats]], expand: PETSc.Mat | None) -> PETSc.Mat:
    """Blocks (n, k, dim, dim) at nodes (n, k), summed on the unknowns. The caller destroys it. Collective."""
    matrix = create_matrix((nodal_layout(blocks), nodal_layout(blocks)), blocks.sizes.dim, blocks.comm)
    for nodes, values in parts:
        for corner in range(nodes.shape[1]):
            numbers = node_unknowns(blocks, nodes[:, corner])
            add_blocks(matrix, numbers, numbers, values[:, corner])
    matrix.assemble()
    return projected(matrix, expand)


def projected(matrix: PETSc.Mat, expand: PETSc.Mat | None) -> PETSc.Mat:
    """A matrix of all nodes on the unknowns, E' A E; the first is destroyed. Collective."""
    if expand is None:
        return matrix
    projected = matrix.PtAP(expand)
    matrix.destroy()
    return projected


def rock_values(blocks: Blocks, scene: Scene, key: str) -> Floats:
    """A property of the rock (m,) in each local cell; 0 where the scene leaves it out."""
    table = np.array([getattr(scene.rock[name], key) or 0.0 for name in blocks.solid.rocks])
    return table[blocks.solid.cell_rock]


def deformable(blocks: Blocks, scene: Scene) -> Ints:
    """Local cells (n,) of rock that deforms."""
    rigid = np.array([scene.rock[name].rigid for name in blocks.solid.rocks], dtype=bool)
    return np.flatnonzero(~rigid[blocks.solid.cell_rock])


def elasticity(blocks: Blocks, scene: Scene) -> Floats:
    """Moduli (m, v, v) of each local cell, in the plane of plane strain [stress]; 1 in rigid rock, where they are not used."""
    rigid = np.array([scene.rock[name].rigid for name in blocks.solid.rocks], dtype=bool)[blocks.solid.cell_rock]
    return STIFFNESS[blocks.sizes.dim](
        np.where(rigid, 1.0, rock_values(blocks, scene, "youngs_modulus")),
        np.where(rigid, 0.0, rock_values(blocks, scene, "poissons_ratio")),
    )


def refuse_unsound(blocks: Blocks) -> None:
    """Raise InputError, on every rank, where a cell of any is folded, or a node of the mesh is on no cell. Collective.

    Element matrices raise it on the rank of the cell alone.
    """
    comm = blocks.comm
    on_each(comm, lambda: _refuse_folded(blocks))
    lost = blocks.sizes.nodes - comm.allreduce(blocks.solid.owned)
    if lost:
        raise InputError(f"mesh: {counted(lost, 'node')} that no cell has; leave them out")


def _refuse_folded(blocks: Blocks) -> None:
    points = blocks.solid.points
    for _, nodes in by_shape(blocks.solid.cells):
        is_bad = is_folded(points[nodes])
        if is_bad.any():
            where = spot(points, nodes[np.argmax(is_bad)])
            how = "counter-clockwise around it" if points.shape[1] == 2 else "in Gmsh's order"
            raise InputError(f"mesh: the cell at {where} is flat, folded or not convex, or its nodes do not run {how}")


def stiffness(blocks: Blocks, scene: Scene, expand: PETSc.Mat | None) -> PETSc.Mat:
    """K_s of (2.39) on the unknowns [force/length per thickness]. The caller destroys it. Collective."""
    return projected(stiffness_of(blocks, deformable(blocks, scene), elasticity(blocks, scene)), expand)


def stiffness_of(blocks: Blocks, cells: Ints, moduli: Floats) -> PETSc.Mat:
    """(2.39) Stiffness of some local cells on all nodes, of moduli (m, v, v) of each cell. The caller destroys it.

    Collective.
    """
    points = blocks.solid.points
    room = {2: 20, 3: 90}[blocks.sizes.dim]
    return assembled(blocks, cells, lambda here, nodes: solid.stiffness(points[nodes], moduli[here]), room)


def mass(blocks: Blocks, scene: Scene, expand: PETSc.Mat | None) -> PETSc.Mat:
    """M of (2.38), lumped or consistent as the scene says [mass per thickness]. The caller destroys it. Collective."""
    density = rock_values(blocks, scene, "density")
    points, dim = blocks.solid.points, blocks.sizes.dim

    def kernel(cells: Ints, nodes: Ints) -> Floats:
        return np.kron(solid.mass_consistent(points[nodes], density[cells]), np.eye(dim))

    if scene.method.mass != "lumped":
        return projected(assembled(blocks, np.arange(len(blocks.solid.cells)), kernel, 20), expand)
    matrix = create_matrix((nodal_layout(blocks), nodal_layout(blocks)), 1, blocks.comm)
    for cells, nodes in by_shape(blocks.solid.cells):
        numbers = node_unknowns(blocks, nodes).reshape(-1, 1)
        nodal = np.repeat(solid.mass_lumped(points[nodes], density[cells]), dim, axis=1)
        add_blocks(matrix, numbers, numbers, nodal.reshape(-1, 1, 1))
    matrix.assemble()
    return projected(matrix, expand)


def nodal_force(blocks: Blocks, nodes: Ints, force: Floats, expand: PETSc.Mat | None) -> PETSc.Vec:
    """Forces (..., dim) at local nodes, summed and brought to the unknowns. The caller destroys it. Collective."""
    vector = create_vector(nodal_layout(blocks), blocks.comm)
    vector.setValues(petsc_ints(node_unknowns(blocks, nodes).ravel()), force.ravel(), addv=PETSc.InsertMode.ADD)
    vector.assemble()
    if expand is None:
        return vector
    reduced = expand.createVecRight()
    expand.multTranspose(vector, reduced)
    vector.destroy()
    return reduced


def initial_stress_force(blocks: Blocks, scene: Scene, expand: PETSc.Mat | None) -> PETSc.Vec:
    """F_s(sigma_0) of (4.4b) on the unknowns [force per thickness]. The caller destroys it. Collective."""
    dim = blocks.sizes.dim
    nodes_all, forces = [np.zeros(0, dtype=np.int64)], [np.zeros((0, dim))]
    cells = deformable(blocks, scene)
    for _, nodes in by_shape(blocks.solid.cells[cells]):
        points = blocks.solid.points[nodes]
        sigma = initial_stress(scene, solid.stiffness_points(points))
        nodes_all.append(nodes.ravel())
        forces.append(solid.initial_stress_force(points, solid.voigt(sigma[..., :dim, :dim])).reshape(-1, dim))
    return nodal_force(blocks, np.concatenate(nodes_all), np.concatenate(forces), expand)


def body_forces(blocks: Blocks, scene: Scene, expand: PETSc.Mat | None) -> PETSc.Vec:
    """Nodal forces of [body_force] on the unknowns [force per thickness]. The caller destroys it. Collective."""
    return forces_in_rocks(blocks, np.array([body_force(scene, name) for name in blocks.solid.rocks]), expand)


def forces_in_rocks(blocks: Blocks, each: Floats, expand: PETSc.Mat | None) -> PETSc.Vec:
    """Nodal forces of a body force in each rock (rocks, dim) [stress/length]. The caller destroys it. Collective."""
    dim = blocks.sizes.dim
    nodes_all, forces = [np.zeros(0, dtype=np.int64)], [np.zeros((0, dim))]
    for cells, nodes in by_shape(blocks.solid.cells):
        nodes_all.append(nodes.ravel())
        force = each[blocks.solid.cell_rock[cells]]
        forces.append(solid.body_force(blocks.solid.points[nodes], force).reshape(-1, dim))
    return nodal_force(blocks, np.concatenate(nodes_all), np.concatenate(forces), expand)


def summed_at_nodes(blocks: Blocks, nodes: Ints, values: Floats) -> Floats:
    """Sums (n, k) at this rank's nodes of what all ranks give theirs, ``values`` (m, k) at ``nodes`` (m,). Collective."""
    block, width = blocks.solid, values.shape[1]
    numbers = petsc_ints(block.node_global[:, None] * width + np.arange(width))
    local = PETSc.Vec().createSeq(numbers.size)
    whole = PETSc.Vec().createMPI((block.owned * width, blocks.sizes.nodes * width), comm=blocks.comm)
    whole.setValues(numbers[nodes].ravel(), values.ravel(), addv=PETSc.InsertMode.ADD)
    whole.assemble()
    wanted = PETSc.IS().createGeneral(numbers.ravel(), comm=PETSc.COMM_SELF)
    scatter = PETSc.Scatter().create(whole, wanted, local, None)
    scatter.scatter(whole, local)
    found: Floats = local.getArray().reshape(-1, width).copy()
    destroy(whole, wanted, local, scatter)
    return found


def impedance_beside(blocks: Blocks, scene: Scene) -> Floats:
    """1/(1/Z + 1/Z') of the walls of each joint (j,), Z = rho c_s: G/(2 c_s) between equal rocks. Collective.

    At a node Z is the mean of the cells around it; a rigid wall sends no wave off, and two of them none at all: 0
    [stress time/length].
    """
    joints, nodes = blocks.joints, blocks.solid.cells
    names = ("youngs_modulus", "poissons_ratio", "density")
    modulus, ratio, density = (rock_values(blocks, scene, name) for name in names)
    impedance = np.sqrt(density * shear_modulus(modulus, ratio))
    corner = (nodes >= 0) & np.isin(np.arange(len(nodes)), deformable(blocks, scene))[:, None]
    each = np.broadcast_to(impedance[:, None], nodes.shape)[corner]
    total, count = summed_at_nodes(blocks, nodes[corner], np.column_stack([each, np.ones(len(each))])).T
    yields = np.zeros(len(total))  # 1/Z
    np.divide(count, total, out=yields, where=total > 0.0)
    both = yields[joints.bottom].mean(axis=1) + yields[joints.top].mean(axis=1)
    return np.divide(1.0, both, out=np.zeros(len(both)), where=both > 0.0)
