"""The record of a step: probes, fracture nodes and rock, gathered on rank 0 in original order."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from fracflow._petsc import MPI, gathered, sum_over_ranks
from fracflow.mesh.data import Bools, Floats, Ints, SplitMesh, is_unmeshed
from fracflow.mesh.locate import FracturePlace, RockPlace
from fracflow.model.flow import Conduction
from fracflow.model.operators import Operators
from fracflow.model.properties import along_fractures
from fracflow.model.solid import summed_at_nodes
from fracflow.model.state import Sections, State
from fracflow.model.terms.term import TermStep
from fracflow.output.profiles import KEPT
from fracflow.output.unmeshed import far_stress
from fracflow.scene.quantities import OutputQuantity, quantities
from fracflow.scene.scene import Scene

FLAGS = {"sliding": 1, "open": 2}
"""Flags of all joint ends that events and counts need at every step, and what they add to one number of an end."""
EVERY_STEP = ("plastic_slip", "slip_rate")
"""The values beside them that events need, and the traction before an event and after it, of which there is a catalogue."""


class Columns:
    """Quantities of the joint ends side by side in one array (j, 2, width)."""

    def __init__(self, names: Iterable[str], dim: int) -> None:
        rows = quantities("section", "flow")
        self.rows: tuple[OutputQuantity, ...] = tuple(rows[name] for name in names)
        starts = np.cumsum([0, *(row.width(dim) for row in self.rows)]).tolist()
        self.width = int(starts[-1])
        places = [starts[n] if row.kind == "scalar" else slice(*starts[n : n + 2]) for n, row in enumerate(self.rows)]
        self._places: dict[str, int | slice] = {row.name: place for row, place in zip(self.rows, places, strict=True)}

    def fill(self, at: JointEnds) -> Floats:
        """The values of this rank's joint ends (j, 2, width). Collective."""
        table = np.empty((*at.aperture_given.shape, self.width))
        for row in self.rows:
            table[:, :, self._places[row.name]] = row.formula(at)
        return table

    def of(self, table: Floats, name: str) -> Floats:
        """One quantity out of (..., width): (...), or with the components of a vector behind."""
        part: Floats = table[..., self._places[name]]
        return part

    def __contains__(self, name: str) -> bool:
        return name in self._places


@dataclass(frozen=True)
class Sampler:
    """The recorded values of this rank.

    aperture  (j, 2) initial aperture at the joint ends, NaN where none is given [length]
    nodes     (n,) owned nodes whose motion probes need
    probed    (k,) joints that end at probes
    always    columns that events need at every step at all joint ends, beside ``FLAGS``
    columns   these, and those that probes need; the same on all ranks
    fields    columns of the fields of fractures
    profiles  those of them that profiles keep
    wells     name -> flow nodes (n,) of this rank, their local numbers; none without flow
    """

    operators: Operators
    scene: Scene
    aperture: Floats
    nodes: Ints
    probed: Ints
    always: Columns
    columns: Columns
    fields: Columns
    profiles: Columns
    wells: Mapping[str, Ints] = field(default_factory=dict)


def make_sampler(
    operators: Operators,
    scene: Scene,
    places: Mapping[str, FracturePlace | RockPlace],
    wells: Mapping[str, tuple[int, ...]] | None = None,
) -> Sampler:
    """Find the nodes and joints of the probes, and the flow nodes of the wells, on this rank."""
    blocks, dim = operators.blocks, operators.blocks.sizes.dim
    on_fractures = [place for place in places.values() if isinstance(place, FracturePlace)]
    joints = np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *(place.joints for place in on_fractures)]))
    rows = quantities("section", "flow").values()
    there = {row.name: row for row in rows if _is_anywhere(row, scene, blocks.joints.fractures)}
    default = [name for name, row in there.items() if row.default]
    asked = {q for p in scene.probe if isinstance(places[p.name], FracturePlace) for q in p.quantities or default}
    always = (*EVERY_STEP, *(("shear_traction",) if any(stage.kind == "auto" for stage in scene.stage) else ()))
    is_everywhere = bool(places) and is_unmeshed(blocks.solid.cells)  # each jump moves all of the rock
    return Sampler(
        operators,
        scene,
        along_fractures(blocks, scene, "aperture", np.array([-1.0, 1.0])),
        np.flatnonzero(is_everywhere | np.isin(blocks.solid.node_ids[: blocks.solid.owned], _nodes(places))),
        np.flatnonzero(np.isin(blocks.joints.ids, joints)),
        Columns(always, dim),
        Columns((*always, *(name for name in there if name in asked and name not in always)), dim),
        Columns((name for name, row in there.items() if row.field), dim),
        Columns((name for name, row in there.items() if row.field and name.startswith(KEPT)), dim),
        {
            name: np.flatnonzero(np.isin(blocks.flow.ids, nodes))
            for name, nodes in (wells or {}).items()
            if operators.flow is not None
        },
    )


def _is_anywhere(row: OutputQuantity, scene: Scene, fractures: Sequence[str]) -> bool:
    """Whether a fracture of the scene has a quantity."""
    tables = [[scene.fracture_named(name)] for name in fractures] or [[]]
    return not all(row.missing(scene, here) for here in tables)


def _nodes(places: Mapping[str, FracturePlace | RockPlace]) -> Ints:
    """Split nodes that the places need: faces of a fracture; a node of the rock with the corners of its cells."""
    parts = [
        np.array(p.stands_on) if isinstance(p, FracturePlace) else np.append(p.corners.ravel(), p.node)
        for p in places.values()
    ]
    return np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *parts]))


class JointEnds:
    """A state at this rank's joint ends, as formulas of the homes "section" and "flow" take it; see ``scene.quantities``.

    Arrays (j, 2, ...) are computed at first use. Collective.
    """

    def __init__(self, sampler: Sampler, state: State) -> None:
        self._operators, self._scene, self._state = sampler.operators, sampler.scene, state
        self.aperture_given = sampler.aperture

    def _ends(self, values: Floats) -> Floats:
        """Values of sections (s, ...) at the ends of joints; of the one-point rule the same at both."""
        points = self._operators.joints.points
        rows = values.reshape(len(self.aperture_given), points, *values.shape[1:])
        return rows[:, :: points - 1] if points > 1 else np.repeat(rows, 2, axis=1)

    @cached_property
    def sections(self) -> Sections:
        """Response of the laws."""
        found = self._state.sections
        ends: dict[str, Any] = {
            f.name: self._ends(getattr(found, f.name)) for f in fields(found) if f.name != "history"
        }
        return replace(found, **ends)

    @cached_property
    def rate(self) -> Floats:
        """Rate of the strain (j, 2, dim) [length/time]."""
        return self._ends(self._operators.joints.strain(self._state.motion.velocity))

    @property
    def friction(self) -> Floats:
        """Dissipation by friction (j, 2) [energy/area]."""
        return self._ends(self._state.friction)

    def history(self, name: str) -> Floats:
        """A history variable of joint laws, (j, 2) or (j, 2, dim-1); NaN where the law has none of that name."""
        return self._ends(self._operators.joints.history(self._state.sections.history, name))

    @cached_property
    def _openings(self) -> Floats | None:
        return self._operators.joints.openings(self._state.sections.strain)

    @cached_property
    def network(self) -> Conduction | None:
        """Conduction of the network; None where there is no flow."""
        flow, state = self._operators.flow, self._state
        if flow is None:
            return None
        walls = self._operators.joints.walls(state.sections, flow.law)
        return flow.conduct(state.motion.displacement, state.pressure, walls, TermStep(state.memory))

    @property
    def _through(self) -> Floats:
        """Flow from the first to the second end of each joint (j,) [volume rate per thickness]; NaN without flow."""
        if self.network is None:
            return np.full(len(self.aperture_given), np.nan)
        return self.network.conductance * (self.network.pressure[:, 0] - self.network.pressure[:, 1])

    @property
    def aperture(self) -> Floats:
        """(3.1b) d0 + opening (j, 2); NaN where no aperture is given [length]."""
        flow = self._operators.flow
        if flow is None:
            return self.aperture_given + self.sections.strain[..., -1]
        return flow.apertures(self._state.motion.displacement, self._openings)

    @property
    def pressure(self) -> Floats:
        """Pressure (j, 2) of the fluid; NaN without flow [stress]."""
        if self.network is None or self._operators.flow is None:
            return np.full(self.aperture_given.shape, np.nan)
        return self.network.pressure + self._operators.flow.resting_end

    @property
    def flow_rate(self) -> Floats:
        """Flow (j, 2) along the joint, over the whole depth; NaN without flow [volume rate]."""
        return np.repeat(self._through[:, None] * self._scene.flow_depth, 2, axis=1)

    @property
    def specific_weight(self) -> float:
        """That of the fluid; NaN where none is given [force/volume]."""
        return (self._scene.fluid.specific_weight if self._scene.fluid is not None else None) or np.nan

    def at_least(self) -> tuple[int, float]:
        """Number of joint ends that conduct by their minimum aperture, and the most that flows through one. Collective."""
        flow, comm = self._operators.flow, self._operators.blocks.comm
        if flow is None:
            return 0, 0.0
        ends = flow.at_least(self._state.motion.displacement, self._openings)
        through = np.abs(self._through)[ends.any(axis=1)]
        most = comm.allreduce(float(through.max(initial=0.0)), op=MPI.MAX) * self._scene.flow_depth
        return comm.allreduce(int(ends.sum())), most


@dataclass(frozen=True)
class Snapshot:
    """A state on rank 0.

    ends    (joints, 2, 1 + width of ``always``) in original order, the sum of ``FLAGS`` first
    margin  smallest distance of a status from its threshold
    probed  joint -> (2, width of ``columns``) at the joints that end at probes
    nodes   node -> (3, dim) its displacement, velocity and acceleration
    least   number of joint ends that conduct by their minimum aperture, and the most that flows through one
    wells   name -> pressure of a well, the mean over its nodes [stress], and what enters there [volume rate per thickness]
    far     (3,) stress that loads add far away, xx, yy, xy [stress]
    """

    always: Columns
    columns: Columns
    ends: Floats
    probed: Mapping[int, Floats]
    nodes: Mapping[int, Floats]
    margin: float
    least: tuple[int, float] = (0, 0.0)
    wells: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    far: Floats = field(default_factory=lambda: np.zeros(3))

    def column(self, name: str) -> Floats:
        """A vector along fractures of every step at all joint ends (joints, 2, dim - 1)."""
        return self.always.of(self.ends[..., 1:], name)

    def flag(self, name: str) -> Bools:
        """One of ``FLAGS`` at all joint ends (joints, 2)."""
        return np.asarray((self.ends[..., 0].astype(np.int8) & FLAGS[name]) > 0)

    def at_place(self, place: FracturePlace) -> Floats:
        """All ``columns`` (width,) at a place: means over its (k,) joint ends, or interpolated between two."""
        rows = [self.probed[joint][end] for joint, end in zip(place.joints.tolist(), place.ends.tolist(), strict=True)]
        # of few short rows np.mean takes eight times as long, for each probe and step
        mean: Floats = np.array(place.shares) @ np.array(rows) if place.within else sum(rows[1:], rows[0]) / len(rows)
        return mean


class StateSampler:
    """A state to be put on record: what is computed at joint ends for one file serves the others. Calls are collective."""

    def __init__(self, sampler: Sampler, state: State) -> None:
        self.sampler, self.state, self.ends = sampler, state, JointEnds(sampler, state)

    def snapshot(self) -> Snapshot | None:
        """Gather the values for probes and events; None off rank 0."""
        sampler, blocks = self.sampler, self.sampler.operators.blocks
        table = sampler.columns.fill(self.ends)
        sections = self.ends.sections
        sums = FLAGS["sliding"] * sections.is_sliding + FLAGS["open"] * sections.is_open
        watched = np.concatenate([sums[..., None], table[:, :, : sampler.always.width]], axis=2)
        ends = blocks.gather(blocks.joints.ids, watched, blocks.sizes.joints)
        here = (
            blocks.joints.ids[sampler.probed],
            table[sampler.probed],
            blocks.solid.node_ids[sampler.nodes],
            self._motion(sampler.nodes),
            float(sections.margin.min(initial=np.inf)),
        )
        least, wells = self.ends.at_least(), self._at_wells()
        parts = gathered(here, blocks.comm)
        if parts is None or ends is None:
            return None
        joints = {int(n): v for numbers, rows, *_ in parts for n, v in zip(numbers, rows, strict=True)}
        nodes = {int(n): v for _, _, numbers, rows, _ in parts for n, v in zip(numbers, rows, strict=True)}
        margin = float(np.min([part[-1] for part in parts]))
        far = far_stress(sampler.scene, self.state.time, self.state.controls)
        return Snapshot(sampler.always, sampler.columns, ends, joints, nodes, margin, least, wells, far)

    def _at_wells(self) -> dict[str, tuple[float, float]]:
        """Mean pressure of each well, and what enters at its nodes."""
        wells, state = self.sampler.wells, self.state
        if not wells:
            return {}
        pressure, source = (vector.getArray(readonly=True) for vector in (state.pressure, state.forces.source))
        here = np.array([[len(n), pressure[n].sum(), source[n].sum()] for n in wells.values()])
        count, total, entering = sum_over_ranks(here, self.sampler.operators.blocks.comm).T
        return dict(zip(wells, zip((total / count).tolist(), entering.tolist(), strict=True), strict=True))

    def fields(self, columns: Columns) -> Floats | None:
        """Columns (joints, 2, width) at all joint ends on rank 0, original order."""
        blocks = self.sampler.operators.blocks
        return blocks.gather(blocks.joints.ids, columns.fill(self.ends), blocks.sizes.joints)

    def motion(self) -> Floats | None:
        """Displacement, velocity and acceleration (n, 3, dim) of all split nodes on rank 0, original order."""
        blocks = self.sampler.operators.blocks
        local = self._motion(np.arange(blocks.solid.owned))
        return blocks.gather(blocks.solid.node_ids[: blocks.solid.owned], local, blocks.sizes.nodes)

    def motion_here(self) -> Floats:
        """Displacement, velocity and acceleration (n, 3, dim) at this rank's nodes, its ghosts too."""
        blocks = self.sampler.operators.blocks
        owned, rows = self._motion(np.arange(blocks.solid.owned)), np.arange(blocks.solid.owned)
        if blocks.comm.size == 1:
            return owned
        flat = owned.reshape(len(rows), math.prod(owned.shape[1:]))  # a rank may have no nodes
        found = summed_at_nodes(blocks, rows, flat).reshape(-1, *owned.shape[1:])
        found[: len(rows)] = owned
        return found

    def _motion(self, rows: Ints) -> Floats:
        """Displacement, velocity and acceleration (n, 3, dim) at owned nodes."""
        operators, motion = self.sampler.operators, self.state.motion
        values = []
        for vector in (motion.displacement, motion.velocity, motion.acceleration):
            nodal = operators.nodal(vector) if operators.expand is not None else vector
            values.append(nodal.getArray(readonly=True).reshape(-1, operators.blocks.sizes.dim)[rows])
            if nodal is not vector:
                nodal.destroy()
        return np.stack(values, axis=1)


def node_table(mesh: SplitMesh) -> tuple[Ints, Ints, Ints]:
    """Pairs (fracture, flow node), and for each joint end (joints * 2,) the pair it belongs to."""
    pairs = np.stack([np.repeat(mesh.joint_fracture, 2), mesh.joint_flow.ravel()], axis=1)
    unique, inverse = (
        np.unique(pairs, axis=0, return_inverse=True) if len(pairs) else (pairs, np.zeros(0, dtype=np.int64))
    )
    return unique[:, 0], unique[:, 1], inverse.ravel()


def at_nodes(snapshot: Snapshot, name: str, inverse: Ints, count: int) -> Floats:
    """Means (count, dim-1) at fracture nodes of a vector of joint ends (joints, 2, dim-1); ``inverse`` (joints * 2,)."""
    parts = np.moveaxis(snapshot.column(name), -1, 0)
    total = np.stack([np.bincount(inverse, weights=part.ravel(), minlength=count) for part in parts], axis=1)
    mean: Floats = total / np.maximum(np.bincount(inverse, minlength=count), 1)[:, None]
    return mean


def any_at_nodes(snapshot: Snapshot, name: str, inverse: Ints, count: int) -> Bools:
    """Which fracture nodes (count,) have a joint end where a flag is set."""
    return np.bincount(inverse, weights=snapshot.flag(name).ravel(), minlength=count) > 0
