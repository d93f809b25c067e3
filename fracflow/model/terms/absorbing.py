"""Sides that absorb waves, and the waves that come in there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fracflow._petsc import MPI, PETSc
from fracflow.elements import dashpot, facet
from fracflow.errors import InputError
from fracflow.laws.elastic import lame_modulus, shear_modulus
from fracflow.mesh.blocks import Blocks
from fracflow.mesh.data import Floats, Ints
from fracflow.model.operators import Operators
from fracflow.model.properties import outward, side_facets
from fracflow.model.solid import assembled_at_nodes, nodal_force, rock_values
from fracflow.model.terms.term import Term
from fracflow.remarks import note
from fracflow.scene.scene import Scene
from fracflow.scene.terms import Absorbing
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
        """c_p or c_s (f,) of facets [length/time]."""
        return np.sqrt((self.lam + 2.0 * self.shear if kind == "p" else self.shear) / self.density)

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
    keys = ("youngs_modulus", "poissons_ratio", "density")
    modulus, ratio, density = (rock_values(blocks, scene, key)[cells] for key in keys)
    size, normal = facet.nodal_sizes(corners), outward(blocks, facets)
    return Facets(nodes, size, normal, lame_modulus(modulus, ratio), shear_modulus(modulus, ratio), density)


def _notes(blocks: Blocks, absorbing: Absorbing, facets: Facets) -> list[str]:
    """Lines of the log on an entry: the share of a wave that its sides reflect. Collective."""
    lines = _leaves_by(blocks, absorbing)
    ratios = np.unique(np.round(facets.lam / (2.0 * (facets.lam + facets.shear)), 9))
    everywhere = np.unique(np.concatenate(blocks.comm.allgather(ratios)))
    for ratio in everywhere[[0, -1]] if len(everywhere) > 1 else everywhere:
        for reflection in dashpot.reflections(float(ratio)):
            lines.append(note(f"absorbing {', '.join(absorbing.on)}: of {reflection} (Poisson's ratio {ratio:.4g})"))
    return lines


def _leaves_by(blocks: Blocks, absorbing: Absorbing) -> list[str]:
    """Lines for the log on sides through which the wave that enters there also leaves. Collective."""
    if absorbing.wave is None or absorbing.wave.direction is None:
        return []
    lines = []
    for name in absorbing.on:
        towards = outward(blocks, side_facets(blocks, name)) @ np.array(absorbing.wave.direction)
        if blocks.comm.allreduce(float(towards.min(initial=np.inf)), op=MPI.MIN) > SAME:
            lines.append(
                note(
                    f"absorbing {name}: the wave leaves by this side, which takes its energy off work_incident; to see it"
                    " as radiated give the side an [[absorbing]] of its own, without the wave"
                )
            )
    return lines


def _passes_by(blocks: Blocks, scene: Scene, absorbing: Absorbing, direction: Floats) -> list[str]:
    """A line for the log on sides without a wave that one of another entry runs along, or into the rock. Collective."""
    passed = []
    for name in (name for other in scene.absorbing if other.wave is None for name in other.on):
        towards = outward(blocks, side_facets(blocks, name)) @ direction
        if blocks.comm.allreduce(float(towards.min(initial=np.inf)), op=MPI.MIN) <= SAME:
            passed.append(name)
    if not passed:
        return []
    return [
        f"absorbing {', '.join(passed)}: the wave of {', '.join(absorbing.on)} runs along there, and is absorbed as it passes:"
        " it comes to the middle too weak. Name these sides in the [[absorbing]] of the wave, with wave.direction; or take, in"
        f" place of [[absorbing]], [[tie]] of two that face each other, or [[support]]{_lets_pass(absorbing, direction)}"
    ]


def _held_along(blocks: Blocks, scene: Scene, absorbing: Absorbing, direction: Floats) -> list[str]:
    """A line for the log on sides along a wave whose supports hold the motion of the wave itself. Collective."""
    assert absorbing.wave is not None
    motion = np.abs(direction if absorbing.wave.kind == "p" else direction[::-1])
    moving = {axis for axis, part in zip("xy", motion, strict=True) if part > SAME}
    held = []
    for support in scene.support:
        still = moving & {*support.components} - {*(support.displacement or {})}
        for name in support.on if still and support.displacement_gradient is None else ():
            facets = side_facets(blocks, name) if name in blocks.solid.sides else np.zeros(0, dtype=np.int64)
            slant = float(np.abs(outward(blocks, facets) @ direction).max(initial=0.0)) if len(facets) else 0.0
            here = blocks.comm.allreduce(len(facets))
            if blocks.comm.allreduce(slant, op=MPI.MAX) <= SAME and here:
                held.append(name)
    if not held:
        return []
    return [
        f"support {', '.join(dict.fromkeys(held))}: the wave of {', '.join(absorbing.on)} runs along there, and is held where"
        f" it moves rock along {' and '.join(sorted(moving))}: it comes in as another wave. Take [[tie]] of two sides that face"
        f" each other, or [[support]]{_lets_pass(absorbing, direction)}"
    ]


def _lets_pass(absorbing: Absorbing, direction: Floats) -> str:
    """The components by which a support along a plane wave leaves it as it is: those across its motion."""
    assert absorbing.wave is not None
    along = np.flatnonzero(np.abs(direction) > 1.0 - SAME)
    if not len(along):
        return ""
    axis, other = ("x", "y") if along[0] == 0 else ("y", "x")
    moves, held = (axis, other) if absorbing.wave.kind == "p" else (other, axis)
    return f' with components = ["{held}"], as this {absorbing.wave.kind.upper()} wave moves rock along {moves}'


def _passes_fractures(blocks: Blocks, absorbing: Absorbing, facets: Facets) -> list[str]:
    """A line for the log where a wave comes in along sides that fractures end on. Collective."""
    assert absorbing.wave is not None
    nodes = facets.nodes.ravel()
    parted = bool((blocks.solid.origin[nodes] != blocks.solid.node_ids[nodes]).any())
    if absorbing.wave.direction is None or not blocks.comm.allreduce(int(parted)):
        return []
    return [
        f"absorbing {', '.join(absorbing.on)}: a fracture ends there, and the wave comes in beyond it as if there were none:"
        " too strong behind a soft joint. Let the fracture end inside, or put these sides farther from what is measured"
    ]


class AbsorbingSides(Term):
    """All absorbing sides of a scene: dashpots, waves that come in, and nodes that stay without inertia."""

    name, entry = "absorbed", "radiated"

    def __init__(self, operators: Operators, scene: Scene) -> None:
        """Raises InputError, on every rank. Collective."""
        blocks, expand = operators.blocks, operators.expand
        self.sides = [(absorbing, facets_of(blocks, scene, absorbing)) for absorbing in scene.absorbing]
        self.blocks, self.waves, self._notes = blocks, tuple[IncidentWave, ...](), tuple[str, ...]()
        if not scene.has_dynamics:
            return
        given = ((facets.nodes, facets.impedance) for _, facets in self.sides)
        self.damping = assembled_at_nodes(blocks, given, expand)
        waves = [(absorbing, facets) for absorbing, facets in self.sides if absorbing.wave is not None]
        self.waves = tuple(_wave(blocks, absorbing, facets, expand) for absorbing, facets in waves)
        lines = [line for each in self.sides for line in _notes(blocks, *each)]
        for absorbing, facets in waves:
            lines += _passes_by(blocks, scene, absorbing, _direction(blocks.comm, absorbing, facets))
            lines += _held_along(blocks, scene, absorbing, _direction(blocks.comm, absorbing, facets))
            lines += _passes_fractures(blocks, absorbing, facets)
        self._notes = tuple(lines)

    @property
    def notes(self) -> tuple[str, ...]:
        """How much of a wave the sides send back."""
        return self._notes

    def held(self) -> tuple[Ints, Floats]:
        """Unknowns (n,) of this rank's part of the sides that are held without inertia, and their places (n, dim)."""
        nodes = [facets.nodes.ravel() for absorbing, facets in self.sides if absorbing.without_inertia == "held"]
        found = np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *nodes]))
        block, dim = self.blocks.solid, self.blocks.sizes.dim
        return block.unknown[found, :dim].ravel(), np.repeat(block.points[found], dim, axis=0)

    def incoming(self, time: float, around: Around, result: PETSc.Vec) -> float | None:
        """Add the forces of the waves at the end of a step to ``result``; their power. Collective."""
        if not self.waves:
            return None
        for wave in self.waves:
            wave.add_force(time, around, result)
        return sum(wave.power(time, around) for wave in self.waves)

    def energy(self, taken: float, brought: float) -> Mapping[str, float]:
        """Energy that the sides radiate, and work of incident waves."""
        return {"radiated": taken + brought, "work_incident": brought}


def absorbing_sides(operators: Operators, scene: Scene) -> tuple[AbsorbingSides, ...]:
    """The absorbing sides of a scene that has any. Raises InputError, on every rank. Collective."""
    return (AbsorbingSides(operators, scene),) if scene.absorbing else ()


@dataclass(frozen=True)
class IncidentWave:
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


def _direction(comm: MPI.Comm, absorbing: Absorbing, facets: Facets) -> Floats:
    """Unit vector (dim,) of the way of a wave. Raises InputError, on every rank. Collective."""
    assert absorbing.wave is not None
    if absorbing.wave.direction is not None:
        inward = np.array(absorbing.wave.direction)
        against = comm.allreduce(float((facets.normal @ inward).min(initial=np.inf)), op=MPI.MIN)
        if SAME < against < np.inf:
            turned = [float(-each) + 0.0 for each in absorbing.wave.direction]
            raise InputError(
                f"absorbing: on = {list(absorbing.on)}: wave.direction = {list(absorbing.wave.direction)} points out of the"
                f" rock there: no wave comes in; {turned} points in"
            )
    else:
        length = facets.size.sum(axis=1)
        inward = comm.allreduce(-(facets.normal * length[:, None]).sum(axis=0))
        total = comm.allreduce(float(length.sum()))
        if np.linalg.norm(inward) < (1.0 - SAME) * total:
            fault = f"absorbing: on = {list(absorbing.on)}: is not one straight side"
            raise InputError(f"{fault}: give wave.direction, the way the wave goes")
    found: Floats = inward / np.linalg.norm(inward)
    return found


def _wave(blocks: Blocks, absorbing: Absorbing, facets: Facets, expand: PETSc.Mat | None) -> IncidentWave:
    """(Joyner and Chen 1975) In the rock without anything else the sides would carry C v + sigma n of the wave alone."""
    wave, comm = absorbing.wave, blocks.comm
    assert wave is not None
    length = facets.size.sum(axis=1)
    direction = _direction(comm, absorbing, facets)
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
    return IncidentWave(blocks, expand, facets.nodes, force, work, delay, wave.velocity)
