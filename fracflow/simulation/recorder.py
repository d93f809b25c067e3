"""The record of a run: history, events, fields, plan, log and checkpoints."""

from __future__ import annotations

import errno
import warnings
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fracflow._petsc import MPI, timed
from fracflow._version import __version__
from fracflow.advance.step import Step
from fracflow.diagnostics import as_lines, pre_run_checks
from fracflow.diagnostics import as_records as card_records
from fracflow.errors import DiskError
from fracflow.mesh.locate import FracturePlace
from fracflow.mesh.slabs import on_rank_0
from fracflow.mesh.store import mesh_root, save_mesh
from fracflow.model.properties import initial_pressure
from fracflow.model.setup import Model, on_root
from fracflow.model.state import State
from fracflow.output import EventLog, FieldWriter, FractureNodes, HistoryFile, RunFolder, sampling
from fracflow.output.catalogue import catalogue_of, instant
from fracflow.output.checkpoint import restoring, state_arrays, write_checkpoint
from fracflow.output.events import Chatter
from fracflow.output.history import read_rows
from fracflow.output.probes import fracture_fields, measured, probe_record, well_record
from fracflow.output.profiles import ProfileFile, Timetable, intervals
from fracflow.output.rock import rock_slabs, shown_rock
from fracflow.output.slip_at_crossings import crossing_lines
from fracflow.output.status import FAILED, RUNNING, Status, write_status
from fracflow.output.vtkhdf import VtkHdf
from fracflow.reduction import Decision, ReductionInput, as_records, decide, factorisations
from fracflow.reduction import as_lines as plan_lines
from fracflow.remarks import marked, note
from fracflow.scene.quantities import REGIMES, quantities
from fracflow.simulation.notices import Notices, watches_spurious
from fracflow.simulation.totals import Totals
from fracflow.storage.files import read_bytes
from fracflow.storage.sealed import AGAIN, Slabs, digest

Notes = Mapping[str, Any] | None  # of a checkpoint; None for a new run
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


def scene_seal(folder: Path) -> str:
    """Digest of the scene of a run folder, in hexadecimal digits. Raises InputError where there is none."""
    return digest(read_bytes(folder / "scene.toml", AGAIN)).hex()


KINDS = {name: number for number, name in enumerate(REGIMES)} | {"auto": REGIMES.index("quasi-static")}
"""Regime, or kind of a stage, -> number of ``step/kind``; a stage auto begins without inertia."""


class Recorder:
    """Writes the run folder on rank 0; its calls are collective, for they gather."""

    def __init__(self, model: Model, facts: ReductionInput, folder: Path, comm: MPI.Comm, notes: Notes = None) -> None:
        """Open the files; those of an earlier run are cut back to where its checkpoint with ``notes`` stood. Collective."""
        self.model, self.comm = model, comm
        self.sampler = sampling.make_sampler(model.operators, model.scene, model.placed.probes, model.placed.wells)
        self.totals, self._goes_on = Totals.of(notes["totals"]) if notes else Totals(), notes is not None
        self.lost: DiskError | None = None  # on rank 0, once something could not be written: nothing is from then on
        self.saved, self._folder = self.totals.steps, folder
        self.slipping_and_open: tuple[int, int] | None = None  # joint ends that slide and that are open, on rank 0
        self._report_saved: Callable[[int], None] | None = None
        self.profiles = Timetable(**self.totals.profiles)
        self._profiles = intervals(2 * model.operators.blocks.sizes.joints)
        self._notices = Notices(model, self.totals, self.log)
        self.files = self._opened(facts, notes)
        if comm.bcast(self.files is not None and bool(self.files.profiles.lost), root=0):
            self.profiles, self.totals.profiles = Timetable(), {}

    def _opened(self, facts: ReductionInput, notes: Notes) -> Files | None:
        """The files, on rank 0, which the others give points and cells meanwhile. Collective."""
        blocks, mesh = self.model.operators.blocks, self.model.mesh

        def work() -> Files:
            with shown_rock(blocks, mesh) as rock:
                assert rock is not None
                return Files(self.model, facts, self._folder, notes, rock)

        if self.comm.rank:
            with shown_rock(blocks, mesh):
                pass
        return on_root(self.comm, work)

    def log(self, line: str) -> None:
        """A line for log.txt."""
        if self.files is not None:
            self.files.folder.log(self.model.scene.with_time_units(line))

    def report_saved(self, report: Callable[[int], None] | None) -> None:
        """Report on rank 0 the number of steps before the last state on disk, now and at each later one."""
        self._report_saved = report
        if report is not None and self.files is not None and self.saved:
            report(self.saved)

    def check(self) -> None:
        """Raise DiskError on every rank where rank 0 could not write. Collective."""
        if (found := self.comm.bcast(self.lost, root=0)) is not None:
            raise DiskError(str(found))

    def _write(self, work: Callable[[Files], None]) -> None:
        """Do ``work`` on rank 0, if all before could be written; ranks agree on it in ``check``."""
        if self.files is None or self.lost is not None:
            return
        try:
            work(self.files)
        except OSError as error:
            self.lost = DiskError.of(error, self._folder, self._remedy(error.errno))

    @timed("FracOutput", "Output")
    def record(self, step: Step) -> None:
        """Put a state on record. Collective."""
        sample, scene = sampling.StateSampler(self.sampler, step.state), self.model.scene
        snapshot, kind = sample.snapshot(), KINDS[step.regime or scene.stage[step.stage].kind]
        if snapshot is not None:
            self.totals.observe(step.state.time, snapshot.margin, *snapshot.least)
        self.totals.injected = step.state.injected
        if self._goes_on:  # the first step may show that the history was made with another scene
            on_root(self.comm, lambda: self._write(lambda files: files.append(step, snapshot, kind)))
        else:
            self._write(lambda files: files.append(step, snapshot, kind))
        self._goes_on = False
        if snapshot is not None:
            self.slipping_and_open = int(snapshot.column("sliding").sum()), int(snapshot.column("open").sum())
        if self._wants_fields(self.totals.steps):
            self._fields(sample, self.totals.steps)
        self._profile(sample, kind)
        self.totals.add(step.report)
        self._notices.of(step)

    def _remedy(self, number: int | None) -> str:
        if number in (errno.ENOENT, errno.ESTALE):
            moved = "if it was moved, resume it where it is; else start the run again"
            return f"{self._folder} is not what it was: {moved}"
        if self.saved:
            kept = f"the last state on disk is that after {self.saved} steps"
            return f"{kept}: make room, or look at the disk, then go on with: fracflow resume {self._folder}"
        return "no state is on disk yet: make room, or look at the disk, then start the run again"

    @timed("FracOutput", "Output")
    def last(self, step: Step, whole: bool = True) -> None:
        """Write the fields of the last state on record, unless they were; those of an earlier such state go. Collective.

        ``whole`` with those of the rock, which at a large mesh take longer than a checkpoint
        """
        index = self.totals.steps - 1
        is_extra = not self._wants_fields(index)
        if is_extra:
            self._fields(sampling.StateSampler(self.sampler, step.state), index, whole)
        self._write(lambda files: files.drop_extra(index if is_extra else None))

    def _profile(self, sample: sampling.StateSampler, kind: int) -> None:
        """Write the profiles of a state where they are due. Collective."""
        time = sample.state.time
        if not self.model.operators.blocks.sizes.joints or not self.profiles.is_due(time, kind, self._profiles):
            return
        columns = self.sampler.profiles
        if (ends := sample.fields(columns)) is not None:
            values = fracture_fields(columns, ends)
            self._write(lambda files: files.profiles.append(time, self.totals.steps, values))
        self.profiles.add(time, kind)
        self.totals.profiles = asdict(self.profiles)

    def _wants_fields(self, index: int) -> bool:
        return index == 0 or bool((every := self.model.scene.output.fields_every) and index % every == 0)

    def _fields(self, sample: sampling.StateSampler, index: int, whole: bool = True) -> None:
        ends = sample.fields(self.sampler.fields)
        none: AbstractContextManager[Mapping[str, Slabs] | None] = nullcontext({})
        with rock_slabs(sample, self.model.mesh) if whole else none as rock:
            if ends is not None and rock is not None:
                values = fracture_fields(self.sampler.fields, ends)
                self._write(lambda files: files.fields(index, sample.state, values, rock))

    @timed("FracOutput", "Output")
    def save(self, step: Step, finished: bool = False) -> None:
        """Write the checkpoint, if the run can go on from this step. Collective."""
        if step.progress is None:
            return
        about = {"totals": asdict(self.totals), "finished": finished, "ranks": self.comm.size}
        with on_rank_0(self.comm, state_arrays(self.model.operators, step.state)) as arrays:
            if arrays is not None:
                self._write(lambda files: files.save(step, arrays, about))
        if (files := self.files) is not None:
            if self.lost is None:
                self.saved = self.totals.steps
                self.report_saved(self._report_saved)
            elif finished:
                self._write_lost(files)

    def log_slip_at_crossings(self) -> None:
        """Log where fractures that cross hand slip on to each other. Collective."""
        units = self.model.scene.unit_names
        found = on_root(self.comm, lambda: crossing_lines(f.events.rows, f.mesh, units) if (f := self.files) else [])
        for line in found or ():
            self.log(line)

    def finish(self, seconds: float, status: Status) -> None:
        """Write plan.json, the last lines of the log, and the status of the run."""
        for line in self.totals.summary(watches_spurious(self.model.scene), seconds):
            self.log(line)
        if (files := self.files) is not None:
            done = factorisations(self.totals.newton, self.totals.factorisations)
            self._write(lambda files: files.write_plan([*files.decisions, done]))
            self._write(lambda files: write_status(files.folder, status))
            self._write_lost(files)
            if files.folder.unlogged:
                self.totals.doubts.append(f"log.txt: {files.folder.unlogged} lines could not be written")

    def _write_lost(self, files: Files) -> None:
        if self.lost is not None:
            with suppress(OSError):
                files.folder.check(is_thorough=True)
                write_status(files.folder, Status(FAILED, str(self.lost)))

    def end(self) -> None:
        """Close the files that grow with the steps: nothing is recorded afterwards."""
        self._write(Files.end)

    def close(self) -> None:
        """Close the files, whatever happened."""
        self._write(Files.end)
        if (files := self.files) is not None:
            for file in (files.history, files.profiles):
                with suppress(OSError):
                    file.close()
            files.folder.close()


class Files:
    """The open files of a run folder; rank 0 only."""

    def __init__(
        self, model: Model, facts: ReductionInput, folder: Path, notes: Notes, rock: tuple[Slabs, Slabs]
    ) -> None:
        """Make the folder and open history, events and fields, or go on with those there. Raises InputError.

        rock  points and cells that the fields show
        """
        assert model.mesh is not None
        self.scene, self.mesh, self.placed = model.scene, model.mesh, model.placed
        self.measured = measured(model.scene, model.mesh, model.placed.probes)
        before = None if notes is None else Before(folder, notes)  # before anything is cut back
        scene = (model.bounded or model.stated).dump_toml(folder.resolve())
        self.folder = RunFolder(folder, resume=notes is not None, scene=scene)
        try:
            self._open(model, facts, notes, scene, before)
            self._open_fields(notes is not None, rock)
        except BaseException:
            self.folder.close()
            raise

    def _open(self, model: Model, facts: ReductionInput, notes: Notes, scene: str, before: Before | None) -> None:
        write_status(self.folder, Status(RUNNING))
        self.card = pre_run_checks(model.stated, model.stated_mesh, (model.whole or model).placed.wells)
        self.decisions = decide(facts.with_card(self.card))
        self.mesh_seal = (before.mesh if before else "") or save_mesh(model.stated_mesh, self.folder / "mesh.h5")
        if notes is None:
            self.folder.write_text("scene.toml", scene)
            self.write_plan(self.decisions)
            self.folder.log("\n".join((*as_lines(self.card), *plan_lines(self.decisions))))
        else:
            self.folder.cut_back(notes["totals"]["steps"], notes["log_bytes"], model.scene.output.fields_every)
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
                self.events.remember(notes["events"])
        self.count, self.is_ended = len(flow), False
        # a tip has no jump: what its law does with a stress past its strength is no slip
        is_apart = (self.mesh.joint_bottom != self.mesh.joint_top).ravel()
        self.parts = np.bincount(self.inverse, is_apart, self.count) > 0.0
        self.extra: int | None = None
        self.time: float | None = notes["time"] if notes is not None else None  # of the last state on record

    def _open_fields(self, resumes: bool, rock: tuple[Slabs, Slabs]) -> None:
        path, names = self.folder.path, {"rocks": list(self.mesh.rocks)}
        self.rock = FieldWriter(path, "rock", *rock, names, resumes)
        ends = self.mesh.points[self.mesh.joint_bottom].reshape(-1, 2)
        lines = np.arange(len(ends)).reshape(-1, 2)
        self.fractures = FieldWriter(path, "fractures", ends, lines, {"fractures": list(self.mesh.fractures)}, resumes)
        self.vtkhdf = VtkHdf(path, [self.rock, self.fractures]) if self.scene.output.vtkhdf else None
        self.rock.forget_mesh()
        self._warn([*self.rock.left_out, *self.fractures.left_out])

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
        memory = {"events": self.events.memory(), "fracflow": __version__}
        memory |= {"catalogue": self.catalogue.memory() if self.catalogue is not None else {}}
        seals = {"seals": {"mesh": self.mesh_seal, "history": self.history.seal, "scene": self.scene_seal}}
        write_checkpoint(self.folder / "checkpoint.h5", arrays, {**notes, **here, **memory, **about, **seals})

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

    def fields(self, index: int, state: State, values: Mapping[str, Any], rock: Mapping[str, Slabs]) -> None:
        """Fields of fractures at ends (joints, 2, k) and, unless there are none, of the rock for ParaView."""
        if rock:
            self.rock.write_stored(index, state.time, rock)
        self.fractures.write(index, state.time, values, {"fracture": self.mesh.joint_fracture})
        if self.vtkhdf is not None:
            self.vtkhdf.update()


class Recorded(NamedTuple):
    """A step as formulas of the whole run take it; see ``scene.quantities``."""

    step: Step
    snapshot: sampling.Snapshot
    kind: int
