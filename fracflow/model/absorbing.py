"""Sides that absorb waves, and the waves that come in there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fracflow._petsc import MPI, PETSc
from fracflow.elements import dashpot, facet
from fracflow.errors import InputError
from fracflow.mesh.blocks import Blocks
from fracflow.mesh.data import Floats, Ints
from fracflow.model.layout import add_blocks, create_matrix
from fracflow.model.properties import outward, side_facets
from fracflow.model.solid import nodal_force, nodal_layout, node_unknowns, projected, rock_values
from fracflow.scene.scene import Absorbing, Scene
from fracflow.scene.time_table import Around
from fracflow.scene.values import TimeTable

SAME = 1e-9  # relative difference of two speeds, or of a delay to the time across the side, that counts as none


@dataclass(frozen=True)
class Facets:
    """This rank's facets (n,) of absorbing sides: nodes (n, k), outward normal, and what their own rock is like.

    size  (n, k) length or area that each node stands for
    """

    nodes: Ints
    size: Floats
    normal: Floats
    lam: Floats
    shear: Floats
    density: Floats

    def speed(self, kind: str) -> Floats:
        """c_p or c_s [length/time]."""
        speed: Floats = np.sqrt((self.lam + 2.0 * self.shear if kind == "p" else self.shear) / self.density)
        return speed

    @property
    def impedance(self) -> Floats:
        """C of each node of the facets (n, k, dim, dim) [force time/length per thickness]."""
        of_p, of_s = self.density * self.speed("p"), self.density * self.speed("s")
        return dashpot.impedance_blocks(self.size, self.normal, of_p, of_s)


def facets_of(blocks: Blocks, scene: Scene, absorbing: Absorbing) -> Facets:
    """The facets of an entry [[absorbing]]. Raises InputError, on every rank. Collective."""
    known = blocks.solid.sides
    for name in absorbing.on:
        if name not in known:
            raise InputError(f'absorbing: on = "{name}": no such side (the mesh has: {", ".join(known) or "none"})')
    facets = np.concatenate([side_facets(blocks, name) for name in absorbing.on])
    nodes, cells = blocks.solid.side_facets[facets], blocks.solid.side_cell[facets]
    if blocks.comm.allreduce(int((blocks.solid.body[nodes] >= 0).any())):
        raise InputError(f"absorbing: on = {list(absorbing.on)}: lies on a rigid rock, in which no wave travels")
    corners = blocks.solid.points[nodes]
    lam, shear = dashpot.lame(
        rock_values(blocks, scene, "youngs_modulus")[cells], rock_values(blocks, scene, "poissons_ratio")[cells]
    )
    size, normal = facet.nodal_sizes(corners), outward(blocks, facets)
    return Facets(nodes, size, normal, lam, shear, rock_values(blocks, scene, "density")[cells])


def describe(blocks: Blocks, scene: Scene) -> tuple[str, ...]:
    """What the log should tell of absorbing sides: how much of a wave they send back. Collective."""
    lines = []
    for absorbing in scene.absorbing if scene.has_dynamics else ():
        facets = facets_of(blocks, scene, absorbing)
        lines += _leaves_by(blocks, absorbing)
        ratios = np.round(facets.lam / (2.0 * (facets.lam + facets.shear)), 9)
        everywhere = np.unique(np.concatenate(blocks.comm.allgather(ratios)))
        for ratio in everywhere[[0, -1]] if len(everywhere) > 1 else everywhere:
            for told in dashpot.reflections(float(ratio)):
                lines.append(f"absorbing {', '.join(absorbing.on)}: of {told} (Poisson's ratio {ratio:.4g})")
    return tuple(lines)


def _leaves_by(blocks: Blocks, absorbing: Absorbing) -> list[str]:
    """What the log should tell of sides by which the wave that they bring leaves. Collective."""
    if absorbing.wave is None or absorbing.wave.direction is None:
        return []
    lines = []
    for name in absorbing.on:
        towards = outward(blocks, side_facets(blocks, name)) @ np.array(absorbing.wave.direction)
        if blocks.comm.allreduce(float(towards.min(initial=np.inf)), op=MPI.MIN) > SAME:
            lines.append(
                f"absorbing {name}: the wave leaves by this side, which takes its energy off work_incident; to see it as"
                " radiated give the side an [[absorbing]] of its own, without the wave"
            )
    return lines


def damping(blocks: Blocks, scene: Scene, expand: PETSc.Mat | None) -> PETSc.Mat | None:
    """C of all absorbing sides on the unknowns, lumped; None where there are none, or no inertia. Collective.

    A block of dim x dim at each node [force time/length per thickness]: diagonal where sides lie along the axes. The
    caller destroys it.
    """
    if not scene.absorbing or not scene.has_dynamics:
        return None
    matrix = create_matrix((nodal_layout(blocks), nodal_layout(blocks)), blocks.sizes.dim, blocks.comm)
    for absorbing in scene.absorbing:
        facets = facets_of(blocks, scene, absorbing)
        values = facets.impedance
        for corner in range(values.shape[1]):
            numbers = node_unknowns(blocks, facets.nodes[:, corner])
            add_blocks(matrix, numbers, numbers, values[:, corner])
    matrix.assemble()
    return projected(matrix, expand)


def resting_unknowns(blocks: Blocks, scene: Scene) -> tuple[Ints, Floats]:
    """Unknowns (n,) of this rank's part of the absorbing sides that are held where there is no inertia, and places (n, dim).

    Raises InputError, on every rank. Collective.
    """
    nodes = [np.zeros(0, dtype=np.int64)]
    for absorbing in scene.absorbing:
        facets = facets_of(blocks, scene, absorbing)
        if absorbing.without_inertia == "held":
            nodes.append(facets.nodes.ravel())
    found, dim = np.unique(np.concatenate(nodes)), blocks.sizes.dim
    return blocks.solid.unknown[found, :dim].ravel(), np.repeat(blocks.solid.points[found], dim, axis=0)


@dataclass(frozen=True)
class Wave:
    """A plane wave that comes in at the nodes (n, k) of facets: force (n, k, dim) and power (n, k) of a unit of velocity.

    velocity  particle velocity where the wave arrives first
    delay     (n, k) how much later it arrives [time]
    """

    blocks: Blocks
    expand: PETSc.Mat | None
    nodes: Ints
    force: Floats
    work: Floats
    delay: Floats
    velocity: TimeTable

    def _at(self, time: float, around: Around) -> Floats:
        return self.velocity.around((time - self.delay).ravel(), *around).reshape(self.delay.shape)

    def add_force(self, time: float, around: Around, result: PETSc.Vec) -> None:
        """Add the forces at the end of a step to ``result``. Collective."""
        here = nodal_force(self.blocks, self.nodes, self.force * self._at(time, around)[..., None], self.expand)
        result.axpy(1.0, here)
        here.destroy()

    def power(self, time: float, around: Around) -> float:
        """Power that it brings into the rock [energy/time per thickness]. Collective."""
        return float(self.blocks.comm.allreduce(float(np.sum(self.work * self._at(time, around) ** 2))))


def waves_of(blocks: Blocks, scene: Scene, expand: PETSc.Mat | None) -> tuple[Wave, ...]:
    """The waves of all absorbing sides. Raises InputError, on every rank. Collective."""
    if not scene.has_dynamics:
        return ()
    return tuple(_wave(blocks, scene, each, expand) for each in scene.absorbing if each.wave is not None)


def _wave(blocks: Blocks, scene: Scene, absorbing: Absorbing, expand: PETSc.Mat | None) -> Wave:
    """(Joyner and Chen 1975) In the rock without anything else the sides would carry C v + sigma n of the wave alone."""
    facets, wave, comm = facets_of(blocks, scene, absorbing), absorbing.wave, blocks.comm
    assert wave is not None
    length = facets.size.sum(axis=1)
    if wave.direction is None:
        inward = comm.allreduce(-(facets.normal * length[:, None]).sum(axis=0))
        total = comm.allreduce(float(length.sum()))
        if np.linalg.norm(inward) < (1.0 - SAME) * total:
            raise InputError(
                f"absorbing: on = {list(absorbing.on)}: is not one straight side: give wave.direction, the way the wave goes"
            )
    else:
        inward = np.array(wave.direction)
    direction = inward / np.linalg.norm(inward)
    motion = direction if wave.kind == "p" else np.array([-direction[1], direction[0]])
    speed = facets.speed(wave.kind)
    traction = dashpot.wave_traction(facets.normal, direction, motion, facets.lam, facets.shear, speed)
    force = np.einsum("nkij,j->nki", facets.impedance, motion) + facets.size[:, :, None] * traction[:, None]
    along = blocks.solid.points[facets.nodes] @ direction
    first = comm.allreduce(float(along.min(initial=np.inf)), op=MPI.MIN)
    last = comm.allreduce(float(along.max(initial=-np.inf)), op=MPI.MAX)
    slow = comm.allreduce(float(speed.min(initial=np.inf)), op=MPI.MIN)
    fast = comm.allreduce(float(speed.max(initial=0.0)), op=MPI.MAX)
    size = comm.allreduce(float(length.sum()))
    delay = (along - first) / speed[:, None]
    if last - first <= SAME * size:
        delay = np.zeros_like(delay)
    elif fast > (1.0 + SAME) * slow:
        raise InputError(
            f"absorbing: on = {list(absorbing.on)}: lies on rocks with waves of {slow:.6g} and {fast:.6g}: a wave comes in"
            " at an angle on one rock only; give each side its own, or leave wave.direction out"
        )
    work = facets.size * (traction @ motion)[:, None]
    return Wave(blocks, expand, facets.nodes, force, work, delay, wave.velocity)
