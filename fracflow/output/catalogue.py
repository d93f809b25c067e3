"""Events of a stage auto as a catalogue: slip between onset and the return to rest, and the energy that it released."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fracflow.mesh.data import Floats, Ints, SplitMesh
from fracflow.model.state import State
from fracflow.output.sampling import Snapshot
from fracflow.scene.quantities import magnitude, one_less, with_components
from fracflow.scene.scene import Scene

SLIPPED = 1e-9  # of the largest slip of an event: less counts as none
RUPTURED = 1e-2  # of the largest slip of an event: less is creep meanwhile, not of its rupture
ALIKE = 1e-6  # slip rates of sections that mirror each other differ by less
RELEASED = ("friction", "radiated", "damping", "dropped", "scheme")
"""Entries of the energy balance in which the energy released by an event ends, except the share of the fluid."""


@dataclass(frozen=True)
class FaultEnds:
    """The joint ends (n,) of all fractures: their nodes, and the factors of slip in moment and energy.

    place    row of each end in the table of fracture nodes
    length   that an end stands for; 0 at tips, which have no slip [length]
    modulus  shear modulus of the rock beside, two rocks in series; inf where both are rigid [stress]
    depth    to which an event reaches, for its magnitude; None leaves it out [length]
    to_si    factor from the scene's unit of moment to N m; None without units
    """

    place: NDArray[np.int64]
    length: Floats
    modulus: Floats
    depth: float | None = None
    to_si: float | None = None

    def magnitude(self, moment: float) -> float | None:
        """(Hanks and Kanamori 1979) 2/3 (log10 M_0 - 9.05) of a moment per thickness [force length/length]."""
        if self.depth is None or self.to_si is None or not 0.0 < moment < math.inf:
            return None
        return 2.0 / 3.0 * (math.log10(moment * self.depth * self.to_si) - 9.05)


@dataclass(frozen=True)
class Instant:
    """Input of the catalogue from a recorded state: plastic slip, shear traction, slip rate (n, dim-1), sliding flags (n,).

    energy    running totals of the energy balance
    injected  net volume that wells have brought since the start of the run [length^3]
    began     earliest time at which its sliding sections may have begun, ``time`` if not given [time]
    """

    time: float
    slip: Floats
    traction: Floats
    rate: Floats
    sliding: NDArray[np.bool_]
    energy: Mapping[str, float]
    injected: float
    began: float | None = None


class Catalogue:
    """Makes a row of each event, from its last state without inertia before it to the first one after it."""

    def __init__(self, ends: FaultEnds) -> None:
        """Begin without an event."""
        self.ends, self.is_moving = ends, False
        self.before: dict[str, Any] = {}
        self.now: Instant | None = None
        self.first, self.start, self.end, self.peak = -1, math.nan, math.nan, np.zeros(len(ends.length))

    def update(self, now: Instant, moves: bool) -> dict[str, Any] | None:
        """Take up a state, reached with inertia if it ``moves``; return the event that it ends, without its place."""
        row = self.row(now) if self.is_moving and not moves and self.first >= 0 else None
        if moves:
            sliding = np.flatnonzero(now.sliding & (self.ends.length > 0.0))
            if len(sliding):
                self.end = math.nan
                if self.first < 0:
                    self.first = _fastest(sliding, now.rate)
                    self.start = now.time if now.began is None else now.began
            elif math.isnan(self.end):
                self.end = now.time
            self.peak = np.fmax(self.peak, magnitude(now.rate))
        else:
            self.before = {"slip": one_less(now.slip).tolist(), "traction": one_less(now.traction).tolist()}
            self.before |= {"energy": dict(now.energy), "injected": now.injected}
            self.first, self.start, self.end, self.peak = -1, math.nan, math.nan, np.zeros_like(self.peak)
        self.is_moving, self.now = moves, now
        return row

    def unfinished(self) -> dict[str, Any] | None:
        """The row of an event under way as it was last seen, without an end."""
        if self.now is None or not self.is_moving or self.first < 0:
            return None
        return self.row(self.now) | {"end": None}

    def row(self, now: Instant) -> dict[str, Any]:
        """The event under way as it is at a state; ``end`` is when the last section stuck, ``place`` where it began.

        Moment and energy are those of all sections. Number, length, mean slip, stress drop and rate are those of the rupture.
        """
        length, before = self.ends.length, self.before
        slip, traction = (np.reshape(before[name], now.slip.shape) for name in ("slip", "traction"))
        change = np.where(length[:, None] > 0.0, now.slip - slip, 0.0)
        size = magnitude(change)
        slipped, ruptured = (size > share * size.max(initial=0.0) for share in (SLIPPED, RUPTURED))
        whole = float(length[ruptured].sum())
        along = change / np.where(size > 0.0, size, 1.0)[:, None]
        drop = ((traction - now.traction) * along).sum(axis=1)
        moment = float((length * np.where(slipped, self.ends.modulus * size, 0.0)).sum())
        since = {name: now.energy[name] - value for name, value in before["energy"].items()}
        released = sum(since.get(name, 0.0) for name in RELEASED)
        return {
            "place": int(self.ends.place[self.first]),
            "start": self.start,
            "end": now.time if math.isnan(self.end) else self.end,
            **with_components("slip", change[size.argmax()]),
            "peak_slip_rate": float(self.peak[ruptured].max(initial=0.0)),
            "sections": int(ruptured.sum()),
            "length": whole,
            "mean_slip": float((length * size)[ruptured].sum() / whole) if whole > 0.0 else 0.0,
            "stress_drop": float((length * drop)[ruptured].sum() / whole) if whole > 0.0 else 0.0,
            "moment": moment if math.isfinite(moment) else None,
            "magnitude": self.ends.magnitude(moment),
            "radiated": since["radiated"],
            "dissipated": since["friction"],
            "dropped": since["dropped"],
            "unclosed": abs(since["residual"]) / released if released > 0.0 else None,
            "injected": before["injected"],
        }

    def memory(self) -> dict[str, Any]:
        """Its data for a checkpoint, as plain numbers and lists."""
        about = {"is_moving": self.is_moving, "before": self.before, "peak": self.peak.tolist()}
        return about | {"first": self.first, "start": self.start, "end": self.end}

    def remember(self, memory: Mapping[str, Any]) -> None:
        """Go on from what ``memory`` gave."""
        self.is_moving, self.before, self.first = memory["is_moving"], memory["before"], memory["first"]
        self.start, self.end, self.peak = memory["start"], memory["end"], np.array(memory["peak"])


def _fastest(sliding: Ints, rate: Floats) -> int:
    """The section of those sliding that is fastest, the first of those that are as fast but for round-off."""
    speed = magnitude(rate)[sliding]
    return int(sliding[np.argmax(speed >= (1.0 - ALIKE) * speed.max())])


def catalogue_of(scene: Scene, mesh: SplitMesh, place: Ints, notes: Mapping[str, Any] | None) -> Catalogue | None:
    """The catalogue of a scene with a stage auto, new or from a checkpoint's ``notes``; ``place`` (joints * 2,) as below."""
    if all(stage.kind != "auto" for stage in scene.stage):
        return None
    catalogue = Catalogue(fault_ends(scene, mesh, place))
    if notes is not None and notes["catalogue"]:  # empty where a stage auto was added to the scene
        catalogue.remember(notes["catalogue"])
    return catalogue


def fault_ends(scene: Scene, mesh: SplitMesh, place: Ints) -> FaultEnds:
    """The joint ends (joints * 2,) of a mesh; ``place`` is the row of each in the table of fracture nodes."""
    length = np.linalg.norm(np.diff(mesh.points[mesh.joint_bottom], axis=1)[:, 0], axis=-1)
    parts = mesh.joint_bottom != mesh.joint_top
    modulus = np.array([scene.rock[name].shear_modulus for name in mesh.rocks])[mesh.cell_rock[mesh.joint_cells]]
    with np.errstate(divide="ignore"):  # between two rigid walls it is infinite
        both: Floats = 2.0 / (1.0 / modulus).sum(axis=1) if len(modulus) else np.zeros(0)
    return FaultEnds(
        place,
        (0.5 * length[:, None] * parts).ravel(),
        np.repeat(both, 2),
        scene.output.event_length,
        None if scene.units == "none" else scene.unit_system.to_si("force*length"),
    )


def instant(state: State, snapshot: Snapshot, began: float) -> Instant:
    """The instant of a recorded state, for the catalogue; ``began`` as ``Instant`` has it."""
    slip, traction, rate = (
        values.reshape(-1, values.shape[2])
        for values in map(snapshot.column, ("plastic_slip", "shear_traction", "slip_rate"))
    )
    sliding = snapshot.flag("sliding").ravel()
    return Instant(state.time, slip, traction, rate, sliding, state.energy, state.injected, began)
