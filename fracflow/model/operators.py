"""All constant operators of a scene, made once."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from fracflow._petsc import PETSc
from fracflow.mesh.blocks import Blocks
from fracflow.mesh.data import Floats, Ints
from fracflow.model.flow import Flow, assemble_flow
from fracflow.model.joints import Joints, assemble_joints
from fracflow.model.layout import Layout, layout_of
from fracflow.model.properties import along_fractures, initial_stress
from fracflow.model.solid import expansion, initial_stress_force, mass, stiffness, summed_at_nodes
from fracflow.model.steep_weakening import refuse_steep_start
from fracflow.model.terms.term import Term
from fracflow.scene.scene import Scene

if TYPE_CHECKING:
    from fracflow.model.multipole_rock import FarRock


@dataclass(frozen=True)
class Scales:
    """Natural sizes that make both balances O(1): force and displacement of a node, pressure, length.

    stiffness  largest diagonal entry of K_s [force/length per thickness]
    """

    force: float
    displacement: float
    pressure: float
    length: float
    stiffness: float

    def energy_noise(self, unknowns: int) -> float:
        """Round-off of a work of initial forces on displacements, summed over so many unknowns [energy per thickness]."""
        return float(np.finfo(float).eps) * self.force * self.displacement * unknowns


@dataclass(frozen=True)
class Operators:
    """M, K_s, F_s(sigma_0), the joints with G, and the network with B and K_F; ``expand`` is E where rock is rigid.

    ``terms`` are boundary conditions and the like; ``stiffness`` has K of theirs in it, ``damping`` is the sum of their C,
    None where none has one. ``inward`` is P of ``contact_mass``, which ``mass`` has in it; None where every node carries its
    own mass. Where far joints act by multipoles, ``stiffness`` has entries of near walls alone, and ``far`` is the rest of K_s.
    """

    blocks: Blocks
    layout: Layout
    expand: PETSc.Mat | None
    stiffness: PETSc.Mat
    mass: PETSc.Mat
    prestress: PETSc.Vec
    joints: Joints
    flow: Flow | None
    scales: Scales
    damping: PETSc.Mat | None = None
    inward: PETSc.Mat | None = None
    terms: tuple[Term, ...] = ()
    far: FarRock | None = None

    def rock_force(self, moved: PETSc.Vec, force: PETSc.Vec, before: PETSc.Vec | None = None) -> None:
        """K_s u, in ``force``, added to what was there ``before`` where that is given. Collective."""
        if before is None:
            self.stiffness.mult(moved, force)
        else:
            self.stiffness.multAdd(moved, before, force)
        if self.far is not None:
            force.getArray()[:] += self.far.force(moved.getArray(readonly=True))

    @property
    def network(self) -> Flow:
        """The network of a scene that has one."""
        assert self.flow is not None
        return self.flow

    @cached_property
    def sections_by_fracture(self) -> tuple[Ints, Ints, Ints]:
        """This rank's sections (s,) in the order of fractures, fractures (f,) that have any, and their first places there."""
        fracture = np.repeat(self.blocks.joints.fracture, self.joints.points)
        order = np.argsort(fracture, kind="stable")
        return order, *np.unique(fracture[order], return_index=True)

    def nodal(self, unknowns: PETSc.Vec) -> PETSc.Vec:
        """Nodal values of a vector of solid unknowns: u = E q. The caller destroys the result. Collective."""
        if self.expand is None:
            return unknowns.copy()
        result = self.expand.createVecLeft()
        self.expand.mult(unknowns, result)
        return result

    def at_nodes(self, unknowns: PETSc.Vec) -> Floats:
        """The same (n, dim) at all nodes of this rank, its ghosts too. Collective."""
        solids, dim = self.blocks.solid, self.blocks.sizes.dim
        nodal = self.nodal(unknowns)
        local = nodal.getArray(readonly=True).reshape(-1, dim)[: solids.owned].copy()
        nodal.destroy()
        return summed_at_nodes(self.blocks, np.arange(solids.owned), local)

    def gathered(self, unknowns: PETSc.Vec) -> Floats | None:
        """The same of all nodes (n, dim), on rank 0. Collective."""
        solids, sizes = self.blocks.solid, self.blocks.sizes
        nodal = self.nodal(unknowns)
        local = nodal.getArray(readonly=True).reshape(-1, sizes.dim)[: solids.owned].copy()
        nodal.destroy()
        return self.blocks.gather(solids.node_ids[: solids.owned], local, sizes.nodes)


def natural_scales(blocks: Blocks, scene: Scene, joints: Joints, stiff: PETSc.Mat) -> Scales:
    """Scales from the data: the largest initial stress or joint law stress k_n0 d0, the mean joint length. Collective."""
    comm = blocks.comm
    total, count = comm.allreduce(joints.weights.sum()), comm.allreduce(len(joints.weights))
    length = float(total / count) if count else 1.0
    candidates = [float(np.abs(joints.initial).max(initial=0.0))]
    stiffness_scale = float(along_fractures(blocks, scene, "normal_stiffness", np.array([-1.0, 1.0])).max(initial=0.0))
    candidates.append(float(np.abs(initial_stress(scene, blocks.solid.points)[..., :2, :2]).max(initial=0.0)))
    stress = max(comm.allgather(max(candidates)))
    diagonal = stiff.getDiagonal()
    rock = float(diagonal.max()[1]) if diagonal.getSize() else 0.0
    stiffness_scale = max(max(comm.allgather(stiffness_scale)) * length, rock)
    diagonal.destroy()
    stress = stress if stress > 0.0 else max(stiffness_scale, 1.0) * 1e-3 / length
    force = stress * length
    return Scales(force, force / stiffness_scale if stiffness_scale > 0.0 else 1.0, stress, length, rock)


def assemble(blocks: Blocks, scene: Scene) -> Operators:
    """Make every operator, of the rock and the network alone. Collective."""
    expand = expansion(blocks)
    joints = assemble_joints(blocks, scene, expand)
    if not scene.equilibrates:
        refuse_steep_start(blocks, joints)
    far = None
    if scene.is_unbounded:
        from fracflow.model import multipole_rock, unbounded  # few scenes need them

        if multipole_rock.by_multipoles(scene, blocks.sizes.joints):
            stiff, far = multipole_rock.stiffness(blocks, scene)
        else:
            stiff = unbounded.stiffness(blocks, scene)
        weight = unbounded.mass(blocks)
        prestress = unbounded.initial_stress_force(blocks, scene, joints)
    else:
        stiff, weight = stiffness(blocks, scene, expand), mass(blocks, scene, expand)
        prestress = initial_stress_force(blocks, scene, expand)
    return Operators(
        blocks,
        layout_of(blocks, scene.has_flow),
        expand,
        stiff,
        weight,
        prestress,
        joints,
        assemble_flow(blocks, scene, expand) if scene.has_flow else None,
        natural_scales(blocks, scene, joints, stiff),
        far=far,
    )
