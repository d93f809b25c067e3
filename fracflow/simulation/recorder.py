"""The record of a run: history, events, fields, plan, log and checkpoints."""

from __future__ import annotations

import errno
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import asdict
from pathlib import Path

from fracflow._petsc import MPI, timed
from fracflow.advance.step import Step
from fracflow.errors import DiskError
from fracflow.mesh.agreement import on_root
from fracflow.mesh.slabs import on_rank_0
from fracflow.model.setup import Model
from fracflow.output import sampling
from fracflow.output.checkpoint import prestress_array, state_arrays
from fracflow.output.drawing.axes import shown
from fracflow.output.probes import fracture_fields
from fracflow.output.profiles import Timetable, intervals
from fracflow.output.rock import fracture_slabs, rock_slabs, shown_rock
from fracflow.output.slip_at_crossings import crossing_lines
from fracflow.output.status import FAILED, Status, write_status
from fracflow.reduction import Decision, ReductionInput, factorisations, mesh_of_events
from fracflow.reduction.sliced import kept_parts
from fracflow.scene.quantities import REGIMES
from fracflow.scene.units import STRESS
from fracflow.simulation.files import Files, Notes
from fracflow.simulation.notices import Notices, watches_spurious
from fracflow.simulation.totals import Totals
from fracflow.storage.sealed import Slabs

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
        parts = kept_parts(self.model)

        def work() -> Files:
            with shown_rock(blocks, mesh, parts) as rock:
                assert rock is not None
                return Files(self.model, facts, self._folder, notes, rock)

        if self.comm.rank:
            with shown_rock(blocks, mesh, parts):
                pass
        return on_root(self.comm, work)

    def hand_over(self, model: Model, time: float, why: str, frozen: float) -> None:
        """Go on with the model of the other rock: on the mesh that an event asked for, or without one again. Collective.

        frozen  the largest traction on the fractures that the change of rock leaves [stress]
        """
        self.model, sizes, made = model, model.operators.blocks.sizes, self.totals.meshed
        if model.of_event:
            first = {"when": model.scene.time_text(time), "why": why, "cells": sizes.cells, "nodes": sizes.nodes}
            most = max(frozen, made.get("frozen", 0.0))
            self.totals.meshed = {**(made or first), "times": made.get("times", bool(made)) + 1, "frozen": most}
        self.sampler = sampling.make_sampler(model.operators, model.scene, model.placed.probes, model.placed.wells)
        self._notices = Notices(model, self.totals, self.log)
        with shown_rock(model.operators.blocks, model.mesh) as rock:
            if rock is not None:
                self._write(lambda files: files.hand_over(model, rock))
        self._write(lambda files: files.write_plan([*files.decisions, *self._meshed()]))

    def _meshed(self) -> list[Decision]:
        """The record of the mesh that an event was given, if one was."""
        made = dict(self.totals.meshed)
        frozen = shown(STRESS, made.pop("frozen", 0.0), self.model.scene.unit_names, 3)
        return [mesh_of_events(**made, frozen=frozen)] if made else []

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
            self.slipping_and_open = int(snapshot.flag("sliding").sum()), int(snapshot.flag("open").sum())
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

    @timed("FracOutput", "Output")
    def keep_fields(self, step: Step) -> None:
        """Write the fields of the last state on record, which stay, as an event leaves its mesh. Collective."""
        index = self.totals.steps - 1
        if not self._wants_fields(index):
            self.totals.event_fields.append(index)
            self._fields(sampling.StateSampler(self.sampler, step.state), index)

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
        none: AbstractContextManager[Mapping[str, Slabs] | None] = nullcontext({})
        time = sample.state.time
        with rock_slabs(sample, self.model.mesh) if whole else none as rock:
            if rock:
                self._write(lambda files: files.rock_fields(index, time, rock))
        with fracture_slabs(sample) as fractures:
            if fractures is not None:
                self._write(lambda files: files.fracture_fields(index, time, fractures))

    @timed("FracOutput", "Output")
    def save(self, step: Step, finished: bool = False) -> None:
        """Write the checkpoint, if the run can go on from this step. Collective."""
        if step.progress is None:
            return
        about = {"totals": asdict(self.totals), "finished": finished, "ranks": self.comm.size}
        found = state_arrays(self.model.operators, step.state)
        if self.totals.meshed:
            found |= prestress_array(self.model.operators)
        with on_rank_0(self.comm, found) as arrays:
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
        found = on_root(self.comm, lambda: crossing_lines(f.events.rows(), f.mesh, units) if (f := self.files) else [])
        for line in found or ():
            self.log(line)

    def finish(self, seconds: float, status: Status) -> None:
        """Write plan.json, the last lines of the log, and the status of the run."""
        for line in self.totals.summary(watches_spurious(self.model.scene), seconds):
            self.log(line)
        if (files := self.files) is not None:
            done = factorisations(self.totals.counts["newton"], self.totals.counts["factorisations"])
            self._write(lambda files: files.write_plan([*files.decisions, *self._meshed(), done]))
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
