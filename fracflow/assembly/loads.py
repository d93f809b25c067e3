"""What acts from outside: supports, loads on sides, wells; each a constant pattern times a function of time."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from fracflow._petsc import PETSc
from fracflow.assembly.components import Closure
from fracflow.assembly.layout import Layout
from fracflow.assembly.prescribed import Prescribed, motion, own, prescribe, supported
from fracflow.assembly.properties import initial_pressure, initial_stress
from fracflow.assembly.solid import body_forces, by_shape, forces_in_rocks, nodal_force
from fracflow.elements import solid
from fracflow.errors import InputError
from fracflow.mesh.blocks import Blocks
from fracflow.mesh.data import Floats, Ints
from fracflow.profiles import Pressures
from fracflow.scene import Load, Scene
from fracflow.tables import TimeTable

TimeFunction = Callable[[float], float]


@dataclass(frozen=True)
class Pattern:
    """A vector times a function of time, times a load factor where one is named; of the initial stress, or of a well."""

    vector: PETSc.Vec
    value: TimeFunction
    control: str | None
    initial: bool = False
    well: str | None = None


@dataclass(frozen=True)
class Limit:
    """A pressure that a well's flow rate must not bring about: ``sign`` +1 if it is the highest, -1 if the lowest.

    node     joined number of the well's pressure
    local    its local number on the rank that owns it, empty elsewhere
    """

    well: str
    sign: float
    pressure: float
    node: int
    local: Ints = field(compare=False)


@dataclass(frozen=True, eq=False)
class Loads:
    """Everything prescribed; ``fixed_*`` are sorted joined numbers of prescribed unknowns, of all ranks. Equal to itself only.

    ``closures`` stand for the balance at a node of each part of the network that nothing drains, where nothing is stored.
    """

    supports: tuple[Prescribed, ...]
    forces: tuple[Pattern, ...]
    pressures: tuple[Prescribed, ...]
    wells: tuple[Pattern, ...]
    fixed_solid: Ints
    fixed_flow: Ints
    limits: tuple[Limit, ...] = ()
    closures: tuple[Closure, ...] = ()

    @property
    def given_pressures(self) -> Ints:
        """Local numbers of the flow nodes of this rank whose pressure is prescribed."""
        return np.concatenate([part.numbers for part in self.pressures] or [np.zeros(0, dtype=np.int64)])

    def at_limit(self, reached: Collection[Limit]) -> Loads:
        """The same with some wells kept at the pressure of a limit, in place of their flow rates."""
        names = {limit.well for limit in reached}
        kept = [Prescribed(limit.local, TimeTable.constant(limit.pressure)) for limit in reached]
        return replace(
            self,
            pressures=(*self.pressures, *kept),
            wells=tuple(pattern for pattern in self.wells if pattern.well not in names),
            fixed_flow=np.union1d(self.fixed_flow, np.array([limit.node for limit in reached], dtype=np.int64)),
        )

    def demanded(self, well: str, time: float, controls: Mapping[str, float]) -> float:
        """Flow rate that a well asks for, over the whole depth."""
        pattern = next(pattern for pattern in self.wells if pattern.well == well)
        return pattern.value(time) * (1.0 if pattern.control is None else controls[pattern.control])

    def force(self, time: float, controls: Mapping[str, float], result: PETSc.Vec) -> None:
        """``result`` = R(t) of (2.38)."""
        _sum(self.forces, time, controls, result)

    def initial_force(self, result: PETSc.Vec) -> None:
        """``result`` = the part of R that the initial stress of the cut-off rock makes."""
        _sum(tuple(pattern for pattern in self.forces if pattern.initial), 0.0, {}, result)

    def source(self, time: float, controls: Mapping[str, float], result: PETSc.Vec) -> None:
        """``result`` = Q(t) of (3.20), per unit thickness."""
        _sum(self.wells, time, controls, result)

    def release(self, vector: PETSc.Vec) -> None:
        """Set a vector on the solid unknowns to zero where supports hold."""
        local = vector.getArray()
        for part in self.supports:
            local[part.numbers] = 0.0

    def impose(self, time: float, displacement: PETSc.Vec, pressure: PETSc.Vec) -> None:
        """Write the prescribed values into both vectors."""
        for vector, parts in ((displacement, self.supports), (pressure, self.pressures)):
            local = vector.getArray()
            for part in parts:
                local[part.numbers] = part.value(time)


def _sum(patterns: tuple[Pattern, ...], time: float, controls: Mapping[str, float], result: PETSc.Vec) -> None:
    result.set(0.0)
    for pattern in patterns:
        factor = 1.0 if pattern.control is None else controls[pattern.control]
        result.axpy(factor * pattern.value(time), pattern.vector)


def side_facets(blocks: Blocks, name: str) -> Ints:
    """Local numbers of this rank's facets of a named side."""
    sides = blocks.solid.sides
    return np.flatnonzero(blocks.solid.side_of == sides.index(name)) if name in sides else np.zeros(0, dtype=np.int64)


def outward(blocks: Blocks, facets: Ints) -> Floats:
    """Outward unit normals (s, 2) of boundary facets."""
    points = blocks.solid.points
    ends = points[blocks.solid.side_facets[facets]]
    along = ends[:, 1] - ends[:, 0]
    normal = np.stack([along[:, 1], -along[:, 0]], axis=1) / np.linalg.norm(along, axis=1)[:, None]
    nodes = blocks.solid.cells[blocks.solid.side_cell[facets]]
    inside = np.where(nodes[..., None] >= 0, points[nodes], np.nan)
    away = ends.mean(axis=1) - np.nanmean(inside, axis=1) if len(facets) else ends.mean(axis=1)
    return normal * np.sign(np.einsum("si,si->s", normal, away))[:, None]


def _side_force(blocks: Blocks, facets: Ints, traction: Floats, expand: PETSc.Mat | None) -> PETSc.Vec:
    nodes = blocks.solid.side_facets[facets]
    return nodal_force(blocks, nodes, solid.traction_force(blocks.solid.points[nodes], traction), expand)


def _rock_area(blocks: Blocks, rock: int) -> float:
    cells = blocks.solid.cells[blocks.solid.cell_rock == rock]
    return float(blocks.comm.allreduce(sum(solid.area(blocks.solid.points[n]).sum() for _, n in by_shape(cells))))


def _force_patterns(blocks: Blocks, load: Load, expand: PETSc.Mat | None) -> list[Pattern]:
    patterns = []
    for name in load.on:
        rock = blocks.solid.rocks.index(name)
        for axis, value in enumerate(load.force or ()):
            each = np.zeros((len(blocks.solid.rocks), 2))
            each[rock, axis] = 1.0 / _rock_area(blocks, rock)
            patterns.append(Pattern(forces_in_rocks(blocks, each, expand), value, load.control))
    return patterns


def _load_patterns(blocks: Blocks, scene: Scene, load: Load, expand: PETSc.Mat | None) -> list[Pattern]:
    if load.force is not None:
        return _force_patterns(blocks, load, expand)
    names = [load.on] if isinstance(load.on, str) else list(load.on)
    known = blocks.solid.sides
    for name in names:
        if name not in known:
            raise InputError(f'load: on = "{name}": no such side (the mesh has: {", ".join(known) or "none"})')
    facets = np.concatenate([side_facets(blocks, name) for name in names])
    normal = outward(blocks, facets)
    if load.pressure is not None:
        return [Pattern(_side_force(blocks, facets, -normal, expand), load.pressure, load.control)]
    if load.traction == "initial-stress":
        at_nodes = initial_stress(scene, blocks.solid.points[blocks.solid.side_facets[facets]])[..., :2, :2]
        traction = np.einsum("saij,sj->sai", at_nodes, normal)
        return [Pattern(_side_force(blocks, facets, traction, expand), lambda time: 1.0, load.control, True)]
    assert load.traction is not None and not isinstance(load.traction, str)
    patterns = []
    for axis, value in enumerate(load.traction):
        unit = np.zeros((len(facets), 2))
        unit[:, axis] = 1.0
        patterns.append(Pattern(_side_force(blocks, facets, unit, expand), value, load.control))
    return patterns


def _swapped(pressure: Pressures) -> Callable[[float, Floats], Any]:
    return lambda time, along: pressure(along, time)


def _well_pressure(
    blocks: Blocks, scene: Scene, layout: Layout, node: int, given: TimeTable | str, held: Ints
) -> tuple[Prescribed, Ints]:
    """The pressure kept at a well; "initial" is p0 there."""
    local = own(layout.flow_starts, blocks.comm.rank, np.array([node]))
    if isinstance(given, TimeTable):
        return Prescribed(local, given), np.union1d(held, [node])
    initial = initial_pressure(scene, blocks.flow.points[local])
    return Prescribed(local, lambda time: initial), np.union1d(held, [node])


def assemble_loads(
    blocks: Blocks,
    scene: Scene,
    layout: Layout,
    expand: PETSc.Mat | None,
    points: Mapping[str, Ints],
    well_nodes: Mapping[str, int],
) -> Loads:
    """Patterns of all loads.

    points      name -> split nodes of a named point
    well_nodes  name of a well -> PETSc number of its flow node
    Collective. Raises InputError, on every rank, for names the mesh does not have.
    """
    comm, starts = blocks.comm, blocks.solid.unknown_starts
    taken = blocks.solid.unused
    supports = [Prescribed(own(starts, comm.rank, taken), lambda time: 0.0)]
    for support in scene.support:
        for name in support.on:
            for part, found in supported(blocks, support, name, points).items():
                here, taken = prescribe(starts, comm, found, taken, motion(support, part))
                supports.append(here)
    forces = [pattern for load in scene.load for pattern in _load_patterns(blocks, scene, load, expand)]
    if scene.body_force is not None:
        forces.append(Pattern(body_forces(blocks, scene, expand), lambda time: 1.0, None, True))

    pressures, wells, limits = [], [], []
    held = np.zeros(0, dtype=np.int64)
    depth = scene.fluid.flow_depth if scene.fluid is not None else 1.0
    for well in scene.well if scene.has_flow else ():
        node = well_nodes[well.name]
        if well.pressure is not None:
            here, held = _well_pressure(blocks, scene, layout, node, well.pressure, held)
            pressures.append(here)
        else:
            vector = layout.flow_vector()
            vector.setValue(node, 1.0 / depth if comm.rank == 0 else 0.0, addv=PETSc.InsertMode.ADD)
            vector.assemble()
            assert well.flow_rate is not None
            wells.append(Pattern(vector, well.flow_rate, well.control, well=well.name))
            local = own(layout.flow_starts, comm.rank, np.array([node]))
            joined = int(layout.flow_numbers(np.array([node]))[0])
            for sign, limit in ((1.0, well.maximum_pressure), (-1.0, well.minimum_pressure)):
                if limit is not None:
                    limits.append(Limit(well.name, sign, limit, joined, local))
    for name, table in scene.fracture.items() if scene.has_flow else ():
        if table.pressure is not None:
            chosen = np.flatnonzero([scene.is_of(fracture, name) for fracture in blocks.joints.fractures])
            ends = np.isin(blocks.joints.fracture, chosen)
            found = (blocks.joints.flow[ends].ravel(), blocks.joints.along[ends].ravel())
            here, held = prescribe(layout.flow_starts, comm, found, held, _swapped(table.pressure))
            pressures.append(here)
    return Loads(
        tuple(supports),
        tuple(forces),
        tuple(pressures),
        tuple(wells),
        layout.solid_numbers(taken.astype(np.int64)),
        layout.flow_numbers(held),
        tuple(limits),
    )
