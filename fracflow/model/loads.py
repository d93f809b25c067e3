"""(2.38), (3.7) Supports, loads on sides, wells: each a constant pattern times a function of time."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from fracflow._petsc import MPI, PETSc
from fracflow.elements import solid
from fracflow.errors import InputError
from fracflow.mesh.blocks import Blocks
from fracflow.mesh.data import Floats, Ints
from fracflow.model.dirichlet import PrescribedValues, motion, own, prescribe, supported
from fracflow.model.layout import Layout
from fracflow.model.operators import Operators
from fracflow.model.properties import initial_pressure, initial_stress, outward, side_facets
from fracflow.model.solid import body_forces, by_shape, forces_in_rocks, nodal_force
from fracflow.model.terms.term import held_without_inertia
from fracflow.model.unbounded import held_walls, stress_force
from fracflow.model.undrained import Closure, FaintParts, SummedBalances
from fracflow.scene.boundary import Load, Well
from fracflow.scene.profiles import Pressures
from fracflow.scene.scene import Scene
from fracflow.scene.time_table import AT_ONCE, Around, Rates
from fracflow.scene.values import TimeTable

TimeFunction = Callable[[float], float]
Controls = Mapping[str, float]


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

    node      joined number of the well's pressure
    local     its local number on the rank that owns it, empty elsewhere
    is_shut   of a limit that is reached: the pressure around the well is beyond it, and the well is shut
    is_given  the scene prescribes the pressure of that node
    """

    well: str
    sign: float
    pressure: float
    node: int
    local: Ints = field(compare=False)
    is_shut: bool = False
    is_given: bool = False


@dataclass(frozen=True, eq=False)
class Loads:
    """Everything prescribed. Each rank knows of its own unknowns alone. Equal to itself only.

    ``closures`` stand for the balance at a node of each part of the network that nothing drains, where nothing is stored.
    ``summed`` does so where less is stored than the round-off of what the part conducts. ``faint`` are all parts of that kind,
    those with a prescribed pressure too.
    Terms fix ``resting`` unknowns (local numbers) in steps without inertia, which ``at_rest`` marks. ``has_resting`` says
    whether there are any on any rank.
    """

    supports: tuple[PrescribedValues, ...]
    forces: tuple[Pattern, ...]
    pressures: tuple[PrescribedValues, ...]
    wells: tuple[Pattern, ...]
    limits: tuple[Limit, ...] = ()
    closures: tuple[Closure, ...] = ()
    summed: SummedBalances | None = None
    faint: FaintParts | None = None
    resting: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    has_resting: bool = False
    at_rest: bool = False

    @property
    def is_closed(self) -> bool:
        """Whether a row of its own stands for the balance of any flow node."""
        return bool(self.closures) or self.summed is not None

    @cached_property
    def held(self) -> Ints:
        """Local numbers (n,) of the solid unknowns of this rank that are prescribed, or stay where they are."""
        parts = [part.numbers for part in self.supports] + ([self.resting] if self.at_rest else [])
        return np.concatenate(parts) if parts else self.resting[:0]

    def standing(self) -> Loads:
        """The same for a stage without inertia: what terms hold stays where it is."""
        return replace(self, at_rest=True)

    @cached_property
    def given_pressures(self) -> Ints:
        """Local numbers (n,) of the flow nodes of this rank whose pressure is prescribed."""
        return np.concatenate([part.numbers for part in self.pressures] or [np.zeros(0, dtype=np.int64)])

    def at_limit(self, reached: Collection[Limit]) -> Loads:
        """The same with some wells kept at the pressure of a limit, or shut, in place of their flow rates."""
        open_wells = [limit for limit in reached if not limit.is_shut]
        names, shut = {limit.well for limit in open_wells}, {limit.well for limit in reached if limit.is_shut}
        kept = [PrescribedValues(limit.local, TimeTable.constant(limit.pressure), limit.well) for limit in open_wells]
        nothing = TimeTable.constant(0.0)
        return replace(
            self,
            pressures=(*self.pressures, *kept),
            wells=tuple(
                replace(pattern, value=nothing) if pattern.well in shut else pattern
                for pattern in self.wells
                if pattern.well not in names
            ),
        )

    def demanded(
        self, well: str, time: float, controls: Controls, around: Around = AT_ONCE, rates: Rates | None = None
    ) -> float:
        """Flow rate that a well demands, over the whole depth, as ``source`` samples it."""
        return _factor(next(each for each in self.wells if each.well == well), time, controls, around, rates)

    def force(
        self, time: float, controls: Controls, result: PETSc.Vec, around: Around = AT_ONCE, rates: Rates | None = None
    ) -> None:
        """``result`` = R(t) of (2.38), jumps and bends in time as ``TimeTable.around`` and ``bent`` say, or ``rates``."""
        _sum(self.forces, time, controls, result, around, rates)

    def factors(self, time: float, controls: Controls, around: Around = AT_ONCE) -> list[float]:
        """Factor of each of ``forces`` at a time; as above, without ``rates``."""
        return [_factor(pattern, time, controls, around) for pattern in self.forces]

    def initial_force(self, result: PETSc.Vec) -> None:
        """``result`` = the part of R that the initial stress of the cut-off rock makes."""
        _sum(tuple(pattern for pattern in self.forces if pattern.initial), 0.0, {}, result)

    def source(
        self, time: float, controls: Controls, result: PETSc.Vec, around: Around = AT_ONCE, rates: Rates | None = None
    ) -> None:
        """``result`` = Q(t) of (3.20), per unit thickness; as above."""
        _sum(self.wells, time, controls, result, around, rates)

    def integral(self, begin: float, end: float, controls: Controls) -> float:
        """Volume that the wells of given flow rates bring between two times, over the whole depth."""
        mean = Rates(now=1.0, share=0.0, begin=begin)
        return (end - begin) * sum(_factor(pattern, end, controls, AT_ONCE, mean) for pattern in self.wells)

    def release(self, vector: PETSc.Vec) -> None:
        """Set a vector on the solid unknowns to zero where they are held."""
        vector.getArray()[self.held] = 0.0

    def impose(
        self,
        time: float,
        displacement: PETSc.Vec,
        pressure: PETSc.Vec,
        around: Around = AT_ONCE,
        rates: Rates | None = None,
    ) -> None:
        """Write the prescribed values into both vectors, jumps as above; those of supports at once where there is inertia."""
        side = AT_ONCE if rates is None or rates.of_forces else around
        for part in self.supports:
            displacement.getArray()[part.numbers] = part.value(time, side)
        for part in self.pressures:
            pressure.getArray()[part.numbers] = part.value(time, around)


def _sum(
    patterns: tuple[Pattern, ...],
    time: float,
    controls: Controls,
    result: PETSc.Vec,
    around: Around = AT_ONCE,
    rates: Rates | None = None,
) -> None:
    result.set(0.0)
    for pattern in patterns:
        result.axpy(_factor(pattern, time, controls, around, rates), pattern.vector)


def _factor(pattern: Pattern, time: float, controls: Controls, around: Around, rates: Rates | None = None) -> float:
    return (rates or Rates(around=around)).of(pattern.value, time, pattern.control, controls, pattern.well)


def _side_force(blocks: Blocks, facets: Ints, traction: Floats, expand: PETSc.Mat | None) -> PETSc.Vec:
    nodes = blocks.solid.side_facets[facets]
    return nodal_force(blocks, nodes, solid.traction_force(blocks.solid.points[nodes], traction), expand)


def _force_patterns(blocks: Blocks, load: Load, expand: PETSc.Mat | None) -> list[Pattern]:
    patterns = []
    for name in load.on:
        rock, points = blocks.solid.rocks.index(name), blocks.solid.points
        cells = blocks.solid.cells[blocks.solid.cell_rock == rock]
        area = float(blocks.comm.allreduce(sum(solid.area(points[nodes]).sum() for _, nodes in by_shape(cells))))
        for axis, value in enumerate(load.force or ()):
            each = np.zeros((len(blocks.solid.rocks), 2))
            each[rock, axis] = 1.0 / area
            patterns.append(Pattern(forces_in_rocks(blocks, each, expand), value, load.control))
    return patterns


def _far_patterns(blocks: Blocks, operators: Operators, load: Load, stress: Mapping[str, TimeTable]) -> list[Pattern]:
    found = []
    for name, value in stress.items():
        unit, (row, column) = np.zeros((3, 3)), ("xy".index(part) for part in name)
        unit[row, column] = unit[column, row] = 1.0
        found.append(Pattern(stress_force(blocks, operators.joints, unit), value, load.control))
    return found


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
    units = (np.tile(unit, (len(facets), 1)) for unit in np.eye(2))
    forces = [_side_force(blocks, facets, unit, expand) for unit in units]
    return [Pattern(force, value, load.control) for force, value in zip(forces, load.traction, strict=True)]


def _is_any(comm: MPI.Comm, here: bool) -> bool:
    """Whether something is so on any rank. Collective."""
    return bool(comm.allreduce(here, op=MPI.LOR))


def _swapped(pressure: Pressures) -> Callable[..., Any]:
    return lambda time, along, around: pressure(along, time)


def _well_pressure(blocks: Blocks, scene: Scene, layout: Layout, nodes: Ints, well: Well) -> PrescribedValues:
    """The pressure kept at a well; "initial" is p0 there."""
    local = own(layout.flow_starts, blocks.comm.rank, nodes)
    if isinstance(well.pressure, TimeTable):
        return PrescribedValues(local, well.pressure, well.name)
    initial = initial_pressure(scene, blocks.flow.points[local])
    return PrescribedValues(local, lambda time, around=AT_ONCE: initial, well.name)


def assemble_loads(
    blocks: Blocks, scene: Scene, operators: Operators, points: Mapping[str, Ints], well_nodes: Mapping[str, Ints]
) -> Loads:
    """Patterns of all loads.

    points      name -> split nodes (n,) of a named point
    well_nodes  name of a well -> PETSc numbers (n,) of its flow nodes; one, where it has a flow rate
    Collective. Raises InputError, on every rank, for names the mesh does not have.
    """
    comm, starts, layout, expand = blocks.comm, blocks.solid.unknown_starts, operators.layout, operators.expand
    taken = held_walls(blocks) if scene.is_unbounded else blocks.solid.unused
    unmoved = own(starts, comm.rank, taken)
    supports, taken = [PrescribedValues(unmoved, TimeTable.constant(0.0))], unmoved + starts[comm.rank]
    for support in scene.support:
        for name in support.on:
            for part, found in supported(blocks, support, name, points).items():
                here, taken = prescribe(starts, comm, found, taken, motion(support, part))
                supports.append(here)
    held_by_terms = held_without_inertia(operators.terms)
    resting, _ = prescribe(starts, comm, held_by_terms, taken, lambda time, place, around: 0.0)
    forces = [
        pattern
        for load in scene.load
        for pattern in (
            _load_patterns(blocks, scene, load, expand)
            if load.stress is None
            else _far_patterns(blocks, operators, load, load.stress)
        )
    ]
    if scene.body_force is not None:
        forces.append(Pattern(body_forces(blocks, scene, expand), lambda time: 1.0, None, True))

    pressures, wells, limits = [], [], []
    held = np.zeros(0, dtype=np.int64)
    depth = scene.flow_depth
    for well in scene.well if scene.has_flow else ():
        if well.pressure is not None:
            pressures.append(_well_pressure(blocks, scene, layout, well_nodes[well.name], well))
            held = np.union1d(held, pressures[-1].numbers + layout.flow_starts[comm.rank])
        else:
            node, vector = int(well_nodes[well.name][0]), layout.flow_vector()
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
    own_held = held - layout.flow_starts[comm.rank]
    return Loads(
        tuple(supports),
        tuple(forces),
        tuple(pressures),
        tuple(wells),
        tuple(replace(each, is_given=_is_any(comm, bool(np.isin(each.local, own_held).any()))) for each in limits),
        resting=resting.numbers,
        has_resting=_is_any(comm, len(resting.numbers) > 0),
    )
