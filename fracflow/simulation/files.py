"""The files of a run folder that a run writes: opened once, gone on with after a stop."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from contextlib import nullcontext
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fracflow._version import __version__
from fracflow.advance.step import Step
from fracflow.diagnostics import as_lines, pre_run_checks
from fracflow.diagnostics import as_records as card_records
from fracflow.mesh.locate import FracturePlace
from fracflow.mesh.store import mesh_root, save_mesh
from fracflow.model.properties import initial_pressure
from fracflow.model.setup import Model
from fracflow.output import EventLog, FieldWriter, FractureNodes, HistoryFile, RunFolder, sampling
from fracflow.output.catalogue import catalogue_of, instant
from fracflow.output.checkpoint import open_arrays, restoring, write_checkpoint
from fracflow.output.events import Chatter
from fracflow.output.fields import exchange, undo_exchange
from fracflow.output.history import read_rows
from fracflow.output.probes import measured, probe_record, well_record
from fracflow.output.profiles import ProfileFile
from fracflow.output.rock import ShownRock
from fracflow.output.status import RUNNING, Status, write_status
from fracflow.output.vtkhdf import VtkHdf
from fracflow.reduction import Decision, ReductionInput, as_records, decide
from fracflow.reduction import as_lines as plan_lines
from fracflow.remarks import marked, note
from fracflow.scene.quantities import quantities
from fracflow.storage.files import read_bytes
from fracflow.storage.sealed import AGAIN, Slabs, digest, whole

EVENT_MESH = "event_mesh.h5"
UNMESHED = "rock_before"  # fields of the rock without a mesh, while an event has it meshed
OF_EVENTS = "rock_of_events"  # fields of the rock on the mesh of events, while no event needs it
Notes = Mapping[str, Any] | None  # of a checkpoint; None for a new run
EVENTS = "events"  # arrays of a checkpoint with what is known of them
UNSEALED = "an earlier version left no seals here: damage to its files would not have been seen; from now on it is"
EDITED = "scene.toml is not as it was at the last checkpoint: the run goes on with the scene as it is now"


class Before:
    """The files beside a checkpoint with ``notes``.

    rows, attrs  of history.h5, up to the checkpoint
    mesh         root of the seal of mesh.h5, empty without one
    notes        lines for the user
    """

    def __init__(self, folder: Path, notes: Mapping[str, Any]) -> None:
        """Read them. Raises InputError for a changed file."""
        seals = notes["seals"]
        self.rows, self.attrs = read_rows(folder / "history.h5", notes["totals"]["steps"], seals.get("history", ""))
        self.mesh = mesh_root(folder / "mesh.h5")
        self.notes = [] if seals else [f"{folder}: {UNSEALED}"]
        if seals.get("scene", "") not in ("", scene_seal(folder)):
            self.notes.append(f"{folder}: {EDITED}")


def _aside(is_meshed: bool) -> tuple[str, str]:
    """Names of the families of fields that are set aside, and taken again, as the rock is meshed or its mesh is left."""
    return (UNMESHED, OF_EVENTS) if is_meshed else (OF_EVENTS, UNMESHED)


def _events_in(path: Path) -> dict[str, NDArray[Any]]:
    """The arrays of events in a checkpoint, by name; none in that of an earlier version. Raises InputError."""
    file, names = open_arrays(path), ("rows", "nodes")
    return {name: file.array(f"{EVENTS}/{name}") for name in names if f"{EVENTS}/{name}" in file.layout}


def scene_seal(folder: Path) -> str:
    """Digest of the scene of a run folder, in hexadecimal digits. Raises InputError where there is none."""
    return digest(read_bytes(folder / "scene.toml", AGAIN)).hex()


class Files:
    """The open files of a run folder; rank 0 only."""

    def __init__(self, model: Model, facts: ReductionInput, folder: Path, notes: Notes, rock: ShownRock) -> None:
        """Make the folder and open history, events and fields, or go on with those there. Raises InputError.

        rock  points and cells that the fields show, and beside them the parts of the mesh that rank 0 has not
        """
        assert model.mesh is not None
        self.scene, self.mesh, self.placed = model.scene, model.mesh, model.placed
        self.measured = measured(model.scene, model.mesh, model.placed.probes)
        before = None if notes is None else Before(folder, notes)  # before anything is cut back
        scene = (model.bounded or model.stated).dump_toml(folder.resolve())
        self.folder = RunFolder(folder, resume=notes is not None, scene=scene)
        try:
            self._open(model, facts, notes, scene, before, rock.beside)
            self._open_fields(notes is not None, rock)
        except BaseException:
            self.folder.close()
            raise

    def _open(
        self,
        model: Model,
        facts: ReductionInput,
        notes: Notes,
        scene: str,
        before: Before | None,
        parts: Mapping[str, Slabs],
    ) -> None:
        write_status(self.folder, Status(RUNNING))
        self.card = pre_run_checks(model.stated, model.stated_mesh, (model.whole or model).placed.wells)
        self.decisions = decide(facts.with_card(self.card))
        known = before.mesh if before is not None else ""
        self.mesh_seal = known or save_mesh(model.stated_mesh, self.folder / "mesh.h5", parts)
        if notes is None:
            self.folder.write_text("scene.toml", scene)
            self.write_plan(self.decisions)
            self.folder.log("\n".join((*as_lines(self.card), *plan_lines(self.decisions))))
        else:
            totals, every = notes["totals"], model.scene.output.fields_every
            self.folder.cut_back(totals["steps"], notes["log_bytes"], every, totals.get("event_fields", ()))
            if model.scene.is_unbounded or model.of_event:  # a kill before the next checkpoint left fields in exchange
                undo_exchange(self.folder.path, "rock", *_aside(not model.of_event))
        is_made = notes is not None and bool(notes["seals"].get("event_mesh"))
        self.event_seal = mesh_root(self.folder / EVENT_MESH) if is_made else ""
        self.is_meshed = model.of_event
        probes = {name: list(map(float, p.point)) for name, p in model.placed.probes.items()}
        wells = {name: self.mesh.points[self.mesh.flow_origin[n[0]]].tolist() for name, n in model.placed.wells.items()}
        units = model.scene.unit_names
        noise = model.operators.scales.energy_noise(int(model.operators.layout.solid_starts[-1]))
        about: dict[str, Any] = {"title": model.scene.title, "units": units, "probes": probes, "wells": wells}
        about |= {"fracflow": __version__, "energy_noise": noise}
        points = {name: self.mesh.points[self.mesh.flow_origin[list(n)]] for name, n in model.placed.wells.items()}
        self.at_rest = {name: float(initial_pressure(model.scene, each).mean()) for name, each in points.items()}
        file, begun = self.folder / "history.h5", before
        # a history that an earlier version began goes on as it is
        is_known = begun is None or not begun.rows or "volume/injected" in begun.rows
        self.has_wells = model.operators.flow is not None and bool(points) and is_known
        self.limited = {
            well.name
            for well in model.scene.well
            if (well.maximum_pressure is not None or well.minimum_pressure is not None)
            and (begun is None or not begun.rows or f"well/{well.name}/limit" in begun.rows)
        }
        self.history = HistoryFile.after(file, begun.rows, begun.attrs) if begun else HistoryFile(file, about)
        written = notes["totals"].get("profiles", {}) if notes is not None else {}
        self.profiles = ProfileFile(self.folder.path, written.get("rows", 0))
        self._warn([self.profiles.lost] if self.profiles.lost else [])
        self.scene_seal = scene_seal(self.folder.path)
        self._warn(before.notes if before is not None else [])
        fracture, flow, self.inverse = sampling.node_table(self.mesh)
        raw = self.mesh.origin[self.mesh.joint_bottom.ravel()[np.unique(self.inverse, return_index=True)[1]]]
        points = self.mesh.points[raw]
        on = {probe.name: probe.on or getattr(probe.at, "fracture", None) for probe in model.scene.probe}
        places = {name: p for name, p in model.placed.probes.items() if isinstance(p, FracturePlace)}
        nearest = {name: self.mesh.fractures[self.mesh.joint_fracture[p.joints[0]]] for name, p in places.items()}
        named = {(on[name] or nearest[name], p.flow): name for name, p in places.items()}
        self.events = EventLog(
            self.folder / "events.csv",
            FractureNodes(
                [self.mesh.fractures[f] for f in fracture],
                raw,
                points[:, 0],
                points[:, 1],
                [named.get((self.mesh.fractures[f], int(n)), "") for f, n in zip(fracture, flow, strict=True)],
            ),
            tangents=self.mesh.points.shape[1] - 1,
        )
        self.chatter = Chatter(self.events.nodes.fracture)
        with restoring(self.folder / "checkpoint.h5") if notes is not None else nullcontext():
            self.catalogue = catalogue_of(model.scene, self.mesh, self.inverse, notes)
            if notes is not None:
                self.events.remember({**notes["events"], **_events_in(self.folder / "checkpoint.h5")})
        self.count, self.is_ended = len(flow), False
        # a tip has no jump: what its law does with a stress past its strength is no slip
        is_apart = (self.mesh.joint_bottom != self.mesh.joint_top).ravel()
        self.parts = np.bincount(self.inverse, is_apart, self.count) > 0.0
        self.extra: int | None = None
        self.time: float | None = notes["time"] if notes is not None else None  # of the last state on record

    def _open_fields(self, resumes: bool, rock: ShownRock) -> None:
        path, names = self.folder.path, {"rocks": list(self.mesh.rocks)}
        self.rock = FieldWriter(path, "rock", rock.points, rock.cells, names, resumes)
        ends = self.mesh.points[self.mesh.joint_bottom].reshape(-1, 2)
        lines = np.arange(len(ends)).reshape(-1, 2)
        self.fractures = FieldWriter(path, "fractures", ends, lines, {"fractures": list(self.mesh.fractures)}, resumes)
        self.vtkhdf = VtkHdf(path, [self.rock, self.fractures]) if self.scene.output.vtkhdf else None
        for family in (self.rock, self.fractures):
            family.forget_mesh()
        self._warn([*self.rock.left_out, *self.fractures.left_out])

    def hand_over(self, model: Model, rock: ShownRock) -> None:
        """Go on with the model of the other rock, whose joints and flow nodes have the same numbers. Raises OSError.

        rock  points and cells that the fields show from now on; those of before are set aside
        """
        assert model.mesh is not None
        self.scene, self.mesh, self.placed, self.is_meshed = model.scene, model.mesh, model.placed, model.of_event
        if self.is_meshed and not self.event_seal:
            self.event_seal = save_mesh(model.mesh, self.folder / EVENT_MESH)
        exchange(self.folder.path, "rock", *_aside(self.is_meshed))
        self._open_fields(True, rock)

    def _warn(self, lines: list[str]) -> None:
        """Lines on a folder whose run is restarted, for log and terminal."""
        for line in lines:
            self.folder.log(note(line))
            warnings.warn(line, stacklevel=2)

    def write_plan(self, decisions: list[Decision]) -> None:
        """Write plan.json: the parts that are modelled or left out, and the pre-run checks."""
        self.folder.write_plan({"decisions": as_records(decisions), "card": card_records(self.card)})

    def save(self, step: Step, arrays: Mapping[str, Slabs], about: Mapping[str, Any]) -> None:
        """Write the checkpoint: the state, where the run is, and where its files are. Raises OSError."""
        self.folder.check(is_thorough=True)
        state = step.state
        here = {"stage": step.stage, "progress": step.progress, "log_bytes": self.folder.log_bytes()}
        notes = {"time": state.time, "controls": dict(state.controls), "energy": dict(state.energy)}
        notes |= {"limited": list(state.wells_at_limit), "shut": list(state.wells_shut)}
        notes |= {"last_step": state.previous_step.time_step}
        notes |= {"through": dict(state.previous_step.through)}
        notes |= {"drive": state.max_overpressure, "power": state.max_dissipation, "injected": state.injected}
        notes |= {"powers": dict(state.forces.powers), "left": dict(state.left), "around": list(state.adjacent_steps)}
        notes |= {"volumes": asdict(state.volumes)}
        events = self.events.memory()
        found = {**arrays, **{f"{EVENTS}/{name}": whole(events.pop(name)) for name in ("rows", "nodes")}}
        memory = {"events": events, "fracflow": __version__}
        memory |= {"catalogue": self.catalogue.memory() if self.catalogue is not None else {}}
        notes |= {"meshed": self.is_meshed}
        event = {"event_mesh": self.event_seal} if self.event_seal else {}
        seals = {"seals": {**event, "mesh": self.mesh_seal, "history": self.history.seal, "scene": self.scene_seal}}
        write_checkpoint(self.folder / "checkpoint.h5", found, {**notes, **here, **memory, **about, **seals})

    def append(self, step: Step, snapshot: sampling.Snapshot | None, kind: int) -> None:
        """One row of history and the events up to it; ``kind`` is that of ``step/kind``. Raises OSError."""
        assert snapshot is not None
        self.folder.check()
        state = step.state
        # a step that is cut where a status changes ends with the change; else the change is somewhere in the step
        began = state.time if self.time is None or step.report.located else self.time
        self.time = state.time
        at = Recorded(step, snapshot, kind)
        record = {row.name: row.formula(at) for row in quantities("run").values()}
        record |= {f"step/control/{name}": value for name, value in state.controls.items()}
        record |= {f"energy/{name}": value for name, value in state.energy.items()}
        record |= {f"volume/{name}": value for name, value in state.left.items()}
        wells = (snapshot, self.at_rest, self.limited)
        record |= well_record(self.scene, state, *wells) if self.has_wells else {}
        places = self.placed.probes
        self.history.append(record | probe_record(self.scene, self.mesh, places, self.measured, snapshot))

        to = self.inverse, self.count
        sliding, is_open = (self.parts & sampling.any_at_nodes(snapshot, name, *to) for name in ("sliding", "open"))
        if line := self.chatter.update(step.stage, is_open):
            when = f"time {self.scene.time_text(state.time)}: stage {self.scene.stage[step.stage].title}"
            self.folder.log(marked(f"{when}: {line}: {self._advice()}"))
        slip, rate = (sampling.at_nodes(snapshot, name, *to) for name in ("plastic_slip", "slip_rate"))
        self.events.update(state.time, sliding, is_open, slip, rate, began)
        if self.catalogue is not None:
            moves = step.regime == "dynamic" or (self.catalogue.is_moving and step.dt == 0.0)  # a step at rest ends it
            if event := self.catalogue.update(instant(state, snapshot, began), moves):
                self.events.add(event)

    def _advice(self) -> str:
        if self.scene.method.contact == "lumped" and not self.scene.has_flow:
            return 'method.contact = "redistributed" takes the mass from the walls, else take a smaller time_step'
        return 'take a smaller time_step, or method.stepper = "generalised-alpha" with rho_infinity = 0, which damps it'

    def end(self) -> None:
        """Close history and events. Raises OSError."""
        self.history.close()
        self.profiles.close()
        if not self.is_ended:
            self.events.close(self.catalogue.unfinished() if self.catalogue is not None else None)
            if self.vtkhdf is not None:
                self.vtkhdf.close()
        self.is_ended = True

    def drop_extra(self, index: int | None) -> None:
        """Remove extra fields, but keep those of a step ``index``, which are removed next."""
        if self.extra is not None and self.extra != index:
            self.rock.drop(self.extra)
            self.fractures.drop(self.extra)
            if self.vtkhdf is not None:
                self.vtkhdf.update(is_last=True)  # its data have gone
        self.extra = index

    def rock_fields(self, index: int, time: float, arrays: Mapping[str, Slabs]) -> None:
        """Fields of the rock for ParaView, whose fields of fractures follow. Raises OSError."""
        self.rock.write_stored(index, time, arrays)

    def fracture_fields(self, index: int, time: float, arrays: Mapping[str, Slabs]) -> None:
        """Fields of fractures at ends (joints * 2, ...) and joints (joints,). Raises OSError."""
        self.fractures.write_stored(index, time, arrays)
        if self.vtkhdf is not None:
            self.vtkhdf.update()


class Recorded(NamedTuple):
    """A step as formulas of the whole run take it; see ``scene.quantities``."""

    step: Step
    snapshot: sampling.Snapshot
    kind: int
