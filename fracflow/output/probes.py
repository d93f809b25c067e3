"""Values of probes of a state that rank 0 has gathered, and fields."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fracflow.elements import solid
from fracflow.mesh.blocks import SolidBlock
from fracflow.mesh.data import Floats, Ints, SplitMesh, is_unmeshed
from fracflow.mesh.locate import FracturePlace, RockPlace
from fracflow.model import stress as rock
from fracflow.model.probes import ProbePlace, available
from fracflow.model.state import State
from fracflow.output.history import AT_LIMIT, SHUT
from fracflow.output.sampling import Columns, Snapshot
from fracflow.output.unmeshed import AtPoint, with_far
from fracflow.scene.quantities import component_names, one_less, quantities
from fracflow.scene.scene import Scene

Data = dict[str, NDArray[Any]]
NO_PRESSURE = 1e-9  # of a pressure: a change that is less is none


def measured(scene: Scene, mesh: SplitMesh, places: Mapping[str, ProbePlace]) -> dict[str, Sequence[str]]:
    """Names of the quantities of each probe: those that it names, else all defaults at its place."""
    return {p.name: p.quantities or available(scene, mesh, places[p.name], default=True) for p in scene.probe}


def probe_record(
    scene: Scene,
    mesh: SplitMesh,
    places: Mapping[str, ProbePlace],
    names: Mapping[str, Sequence[str]],
    snapshot: Snapshot,
) -> dict[str, Any]:
    """History entries ``probe/NAME/QUANTITY`` of all probes, of the names of their quantities.

    On a fracture ``displacement``, velocity and acceleration are those of the top face, the left of the trace. Quantities of
    joints are means over those that end there. Between two nodes all values are interpolated from the two ends of the joint,
    those of each wall along that wall. In the rock, strain and stress are means by area over the cells around the
    node, with sigma_0 of the node itself. Inside a cell all values are interpolated from its corners by their shape functions,
    except sigma_0, which is that of the point.
    """
    record: dict[str, Any] = {}
    rows = quantities("node", "wall", "cell")
    motion = np.array([snapshot.nodes[node] for node in sorted(snapshot.nodes)]) if is_unmeshed(mesh.cells) else None
    for probe, wanted in names.items():
        place = places[probe]
        at: OnFracture | InRock | AtPoint
        if motion is not None:
            at = AtPoint(place, scene, mesh, motion, snapshot.far)
            sampled, columns = np.zeros(0), Columns((), 0)
            if isinstance(place, FracturePlace):
                sampled, columns = snapshot.at_place(place), snapshot.columns
        elif isinstance(place, FracturePlace):
            at, sampled, columns = OnFracture(place, snapshot), snapshot.at_place(place), snapshot.columns
        else:
            at, sampled, columns = InRock(scene, mesh, place, snapshot), np.zeros(0), Columns((), 0)
        for name in wanted:
            is_sampled = name in columns
            value = columns.of(sampled, name) if is_sampled else rows[name].formula(at)
            record[f"probe/{probe}/{name}"] = one_less(value)
    return record


def well_record(
    scene: Scene, state: State, snapshot: Snapshot, at_rest: Mapping[str, float], limited: Collection[str] = ()
) -> dict[str, float]:
    """History entries ``well/NAME/QUANTITY`` of wells, and ``volume/QUANTITY`` of the fluid in the whole network.

    at_rest  name -> initial pressure of each well [stress]
    limited  wells with a limit of their pressure
    """
    volumes, record = state.volumes, dict[str, float]()
    depth, rows = scene.flow_depth, quantities("well")
    for name, (pressure, entering) in snapshot.wells.items():
        rate = volumes.rates.get(name, entering * depth)
        limit = SHUT if name in state.wells_shut else AT_LIMIT if name in state.wells_at_limit else 0
        at = AtWell(pressure, rate, volumes.wells.get(name, 0.0), at_rest[name], limit)
        for key, row in rows.items():
            if key != "well/limit" or name in limited:
                record[f"well/{name}/{key.removeprefix('well/')}"] = row.formula(at)
    return record | {key: row.formula(state) for key, row in quantities("network").items()}


@dataclass(frozen=True)
class AtWell:
    """Values at a well: pressures now and initially [stress], rate and volume over the whole depth, its ``limit``."""

    pressure: float
    rate: float
    volume: float
    at_rest: float
    limit: int = 0

    @property
    def injectivity(self) -> float:
        """Rate over the rise of pressure; NaN where there is none."""
        above = self.pressure - self.at_rest
        is_none = abs(above) <= NO_PRESSURE * max(abs(self.pressure), abs(self.at_rest))
        return float("nan") if is_none else self.rate / above


class OnFracture:
    """Motion (dim,) of the walls at a probe: of the top one, and the displacement of the bottom one."""

    def __init__(self, place: FracturePlace, snapshot: Snapshot) -> None:
        self._place, self._snapshot = place, snapshot

    @cached_property
    def _top(self) -> Floats:
        return _combined(self._place, self._snapshot, 1)

    @property
    def displacement(self) -> Floats:
        """(dim,) of the top wall [length]."""
        return np.asarray(self._top[0])

    @property
    def velocity(self) -> Floats:
        """(dim,) of the top wall [length/time]."""
        return np.asarray(self._top[1])

    @property
    def acceleration(self) -> Floats:
        """(dim,) of the top wall [length/time^2]."""
        return np.asarray(self._top[2])

    @cached_property
    def bottom(self) -> Floats:
        """(dim,) displacement of the bottom wall [length]."""
        return np.asarray(_combined(self._place, self._snapshot, 0)[0])


def _combined(place: FracturePlace, snapshot: Snapshot, wall: int) -> Floats:
    """Motion (3, dim) of one wall at a place, 0 the bottom and 1 the top, interpolated between two nodes of that wall."""
    if not place.within:
        return snapshot.nodes[place.nodes[wall]]
    return np.tensordot(place.shares, [snapshot.nodes[end.nodes[wall]] for end in place.within], 1)


@dataclass(frozen=True)
class Cells:
    """Cells of the rock and the motion of their nodes; values (m, ...) of cells are computed at first use.

    numbers  (m,) of the cells in the mesh
    points   (n, 2) coordinates of nodes [length]
    corners  (m, k) nodes of the cells among these, -1 pads
    motion   (n, 3, 2) displacement, velocity and acceleration of the nodes
    moves    whether there is inertia: without, kinetic energy is zero, as in the energy balance
    far      (3,) stress that loads add far away, whose strain the motion has not [stress]
    """

    scene: Scene
    mesh: SplitMesh | SolidBlock
    numbers: Ints
    points: Floats
    corners: Ints
    motion: Floats
    moves: bool = True
    far: Floats = field(default_factory=lambda: np.zeros(3))

    @cached_property
    def _moved(self) -> Floats:
        return with_far(self.scene, self.far, self.points, self.motion[:, 0])

    @cached_property
    def strain(self) -> Floats:
        """Strain (m, 4) at the centres."""
        return rock.strain(self.points, self.corners, self._moved)

    @cached_property
    def _deforms(self) -> Ints:
        return np.flatnonzero(rock.deforms(self.mesh, self.scene)[self.numbers])

    @property
    def _moduli(self) -> tuple[Floats, Floats]:
        return rock.elastic_moduli(self.mesh, self.scene, self.numbers[self._deforms])

    @cached_property
    def stress_change(self) -> Floats:
        """Stress (m, 4) that the strain adds; zero in rigid rock."""
        result = np.zeros((len(self.numbers), 4))
        result[self._deforms] = rock.stress_change(self.strain[self._deforms], *self._moduli)
        return result

    @property
    def stress(self) -> Floats:
        """Total stress (m, 4) at the centres; zero in rigid rock."""
        able, result = self._deforms, self.stress_change.copy()
        result[able] += rock.initial_components(self.scene, rock.centres(self.points, self.corners[able]))
        return result

    @property
    def strain_energy(self) -> Floats:
        """Energy (m,) stored since the start per volume; zero in rigid rock."""
        able, result = self._deforms, np.zeros(len(self.numbers))
        result[able] = rock.strain_energy_density(
            self.scene, self.points, self.corners[able], self._moved, self._moduli
        )
        return result

    @property
    def kinetic_energy(self) -> Floats:
        """Kinetic energy (m,) per volume."""
        if not self.moves:
            return np.zeros(len(self.numbers))
        density = rock.properties(self.mesh, self.scene, "density", self.numbers)
        return rock.kinetic_energy_density(self.scene, self.points, self.corners, self.motion[:, 1], density)


class InRock:
    """Motion (2,) and values (...) of the rock at a probe in it."""

    def __init__(self, scene: Scene, mesh: SplitMesh, place: RockPlace, snapshot: Snapshot) -> None:
        self._scene, self._mesh, self._place, self._snapshot = scene, mesh, place, snapshot
        moved = np.stack([snapshot.nodes[part.node] for part in place.within or (place,)], axis=1)
        self.displacement, self.velocity, self.acceleration = map(self._combined, moved)

    def _combined(self, values: Any) -> Floats:
        """Values at a node, or those at the corners of a cell brought to a point in it."""
        return np.array(self._place.shares) @ np.array(values) if self._place.within else values[0]

    @cached_property
    def _around(self) -> list[tuple[Cells, Floats]]:
        """Cells that deform around each node, and their shares by area."""
        return [self._cells(part) for part in self._place.within or (self._place,)]

    def _cells(self, place: RockPlace) -> tuple[Cells, Floats]:
        able = rock.deforms(self._mesh, self._scene)[place.cells]
        cells, corners = place.cells[able], place.corners[able]
        nodes, inverse = np.unique(corners[corners >= 0], return_inverse=True)
        local = np.full(corners.shape, -1)
        local[corners >= 0] = inverse
        points, motion = self._mesh.points[nodes], np.array([self._snapshot.nodes[int(node)] for node in nodes])
        area = rock.per_cell(local, lambda _, corner: solid.area(points[corner]))
        found = Cells(self._scene, self._mesh, cells, points, local, motion, far=self._snapshot.far)
        return found, area / area.sum()

    def __getattr__(self, name: str) -> Floats:
        """Strain (4,), and other values of ``Cells``, as means over the cells around."""
        return self._combined([shares @ getattr(cells, name) for cells, shares in self._around])

    @property
    def stress(self) -> Floats:
        """Total stress (4,), with the initial one at the point itself."""
        initial: Floats = rock.initial_components(self._scene, self._place.point)
        return self.stress_change + initial


def fracture_fields(columns: Columns, table: Floats) -> Data:
    """Point data of fractures from a table (joints, 2, width) of all joint ends; components along them are scalars."""
    found: Data = {}
    for row in columns.rows:
        values = columns.of(table, row.name)
        values = values.reshape(values.shape[0] * 2, *values.shape[2:])
        if row.kind == "shear":
            found |= dict(zip(component_names(row.name, row.kind, values.shape[1]), values.T, strict=True))
        else:
            found[row.name] = values
    return found
