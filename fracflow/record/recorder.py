"""What a run puts on record: history, events, fields, plan, log and checkpoints."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from fracflow import __version__
from fracflow._petsc import MPI
from fracflow.assembly.energy import ENTRIES, spurious_share
from fracflow.assembly.flow import is_transposed
from fracflow.begin.setup import Model, on_root
from fracflow.card import as_lines, scene_card
from fracflow.card import as_records as card_records
from fracflow.mesh.data import Floats
from fracflow.mesh.locate import FracturePlace
from fracflow.mesh.store import save_mesh
from fracflow.output import EventLog, FieldWriter, FractureNodes, HistoryFile, RunFolder, sampling
from fracflow.output.chatter import Chatter
from fracflow.output.checkpoint import Arrays, gather_state, restoring, write_checkpoint
from fracflow.output.probes import probe_record
from fracflow.output.rock import rock_fields
from fracflow.output.status import RUNNING, Status, write_status
from fracflow.plan import Decision, Facts, as_records, decide, factorisations
from fracflow.plan import as_lines as plan_lines
from fracflow.record.before import Before, scene_seal
from fracflow.record.catalogue import catalogue_of, instant
from fracflow.record.totals import Totals
from fracflow.scene import Scene
from fracflow.state import State
from fracflow.steps.step import Step

KINDS = {"steady": 0, "quasi-static": 1, "dynamic": 2, "equilibrate": 3, "auto": 1}  # auto begins without inertia
TOLD_AGAIN = 0.5  # relative change of the predicted contraction from which on it is told again
TOLD_FROM = 0.1  # smaller factors are all the same

FOLD = 1.5
"""Growth of an aperture by what flows in through it, in a step of backward Euler, d - d0 = c d^3: none is greater. For
more, c d0^2 > 4/27, walls are only stopped by their own stiffness, at a solution far away; for less there are both."""
WIDENS = 2.0  # and again where an aperture grew by as much more
STRAINED = 0.1  # p/E: a tenth is no small strain
SPURIOUS = 1e-3  # share of the largest entry of the books from which the log warns of the spurious one


def watches_spurious(scene: Scene) -> bool:
    """Whether pressure force and film storage are not transposed, so that the books have a spurious entry."""
    return scene.has_flow and not is_transposed(scene.method.storage)


class Recorder:
    """Writes the run folder on rank 0; its calls are collective, for they gather."""

    def __init__(self, model: Model, folder: Path, comm: MPI.Comm, notes: Mapping[str, Any] | None = None) -> None:
        """Open the files; those of an earlier run are cut back to where its checkpoint with ``notes`` stood. Collective."""
        self.model, self.comm = model, comm
        self.sampler = sampling.make_sampler(model.operators, model.scene, model.placed.probes)
        self.totals, self._goes_on = Totals(**notes["totals"]) if notes else Totals(), notes is not None
        self.files: Files | None = on_root(comm, lambda: Files(model, folder, notes))

    def log(self, line: str) -> None:
        """A line for log.txt."""
        if self.files is not None:
            self.files.folder.log(line)

    def record(self, step: Step) -> None:
        """Put a state on record. Collective."""
        snapshot, self.totals.injected = sampling.take(self.sampler, step.state), step.state.injected
        if self._goes_on:  # the first step may show that the history was made with another scene
            on_root(self.comm, lambda: self._append(step, snapshot))
            self._goes_on = False
        else:
            self._append(step, snapshot)
        self._watch_spurious(step)
        self._watch_pressure(step)
        self._watch_widening(step)
        if self._wants_fields(self.totals.steps):
            self._fields(step, self.totals.steps)
        self.totals.add(step.report)
        self._tell_coupling(step)

    def _append(self, step: Step, snapshot: sampling.Snapshot | None) -> None:
        if self.files is None or snapshot is None:
            return
        margin = float(snapshot.column("margin").min(initial=np.inf))
        if margin < self.totals.narrowest:
            self.totals.narrowest, self.totals.narrow_time = margin, step.state.time
        self.files.append(step, snapshot, margin)
        self.totals.least = max(self.totals.least, snapshot.least[0])
        self.totals.least_flow = max(self.totals.least_flow, snapshot.least[1])

    def _tell_coupling(self, step: Step) -> None:
        """A line where the contraction of the fixed point is another than it was, and where it first gave up."""
        totals, report, scene = self.totals, step.report, self.model.scene
        stage = f"stage {scene.stage[step.stage].title}"
        if report.handed_over and not totals.handed_over:
            self.log(f"{stage}: {report.handed_over}; handed over to the monolithic solver, as are later steps like it")
        totals.handed_over += bool(report.handed_over)
        told, factor = totals.told_factor, report.predicted
        if np.isnan(factor):
            return
        if np.isnan(told) or (max(factor, told) >= TOLD_FROM and not abs(factor - told) <= TOLD_AGAIN * told):
            totals.told_factor = factor
            time = f"time {step.state.time:.6g} {scene.unit_system.time}".rstrip()
            measured = (
                f"the last cycle, {scene.method.fixed_point}, by {report.measured:.3g} (measured)"
                if np.isfinite(report.measured)
                else "fewer than two cycles were made, so that none is measured"
            )
            self.log(
                f"{stage}, {time}: a plain cycle of the fixed point multiplies the error by {factor:.3g} (predicted);"
                f" {measured}"
            )

    def _watch_spurious(self, step: Step) -> None:
        share, totals = spurious_share(step.state.energy), self.totals
        if share > totals.spurious:
            if totals.spurious <= SPURIOUS < share:
                self.log(
                    f'time {step.state.time:.6g}: spurious work of method.storage = "{self.model.scene.method.storage}" is'
                    f" {share:.1e} of the largest entry of the energy books, above {SPURIOUS:g}: see energy/spurious;"
                    ' method.storage = "lumped" has none'
                )
            totals.spurious, totals.spurious_time = share, step.state.time

    def _watch_pressure(self, step: Step) -> None:
        """A line, once, where a pressure would strain the rock by over ``STRAINED``: a rate through next to nothing."""
        stiff = [rock.youngs_modulus for rock in self.model.scene.rock.values() if rock.youngs_modulus is not None]
        drive, totals, wells = step.state.drive, self.totals, self.model.scene.well
        if totals.strained or not stiff or drive <= STRAINED * min(stiff):
            return
        totals.strained = 1
        rates = ", ".join(well.name for well in wells if well.flow_rate is not None)
        self._doubt(
            f"time {step.state.time:.6g}: a pressure of {drive:.3g} above that at rest strains rock of E = {min(stiff):.3g} by"
            f" over {STRAINED:g}, where neither strains nor joints are those of the model: what follows means nothing;"
            + (
                f" give a maximum_pressure to {rates}, or a minimum_hydraulic_aperture to fractures too narrow for its rate"
                if rates
                else " lower the pressures that wells and fractures prescribe"
            )
        )

    def _watch_widening(self, step: Step) -> None:
        """A line where an aperture grew in a step by more than can be foretold, and again where by far more."""
        grown, totals = step.report.widening, self.totals
        if grown <= WIDENS * totals.widening:
            return
        totals.widening = grown
        self._doubt(
            f"time {step.state.time:.6g}: an aperture of {step.report.widest} grew {grown:.3g} times as wide in one step."
            f" Above {FOLD:g} such a step has two solutions and may be at the wrong one: take smaller time_steps until nothing"
            " changes, or give accuracy.tolerance"
        )

    def _doubt(self, line: str) -> None:
        """A line of the log that the end of the run repeats."""
        self.log(line)
        self.totals.doubts.append(line)

    def last(self, step: Step, whole: bool = True) -> None:
        """Write the fields of the last state on record, unless they were; those of an earlier such state go. Collective.

        ``whole`` with those of the rock, which at a large mesh take longer than a checkpoint
        """
        index = self.totals.steps - 1
        is_extra = not self._wants_fields(index)
        if is_extra:
            self._fields(step, index, whole)
        if self.files is not None:
            self.files.drop_extra(index if is_extra else None)

    def _wants_fields(self, index: int) -> bool:
        every = self.model.scene.output.fields_every
        return index == 0 or bool(every and index % every == 0)

    def _fields(self, step: Step, index: int, whole: bool = True) -> None:
        ends = sampling.all_ends(self.sampler, step.state)
        motion = sampling.all_motion(self.sampler, step.state) if whole else None
        if self.files is not None and ends is not None:
            self.files.fields(index, step.state, ends, motion)

    def save(self, step: Step, finished: bool = False) -> None:
        """Write the checkpoint, if the run can go on from this step. Collective."""
        if step.progress is None:
            return
        arrays = gather_state(self.model.operators, step.state)
        if self.files is not None and arrays is not None:
            self.files.save(
                step, arrays, {"totals": asdict(self.totals), "finished": finished, "ranks": self.comm.size}
            )

    def finish(self, seconds: float, status: Status) -> None:
        """Write plan.json, the last lines of the log, and how the run ended."""
        for line in self.totals.last_words(watches_spurious(self.model.scene), seconds):
            self.log(line)
        if self.files is not None:
            done = factorisations(self.totals.newton, self.totals.factorisations)
            self.files.write_plan([*self.files.decisions, done])
            write_status(self.files.folder, status)

    def close(self) -> None:
        """Close the files, whatever happened."""
        if self.files is not None:
            self.files.history.close()
            catalogue = self.files.catalogue
            self.files.events.close(catalogue.unfinished() if catalogue is not None else None)
            self.files.folder.close()


class Files:
    """The open files of a run folder; rank 0 only."""

    def __init__(self, model: Model, folder: Path, notes: Mapping[str, Any] | None = None) -> None:
        """Make the folder and open history, events and fields, or go on with those there. Raises InputError."""
        assert model.mesh is not None
        self.scene, self.mesh, self.placed = model.scene, model.mesh, model.placed
        before = None if notes is None else Before(folder, notes)  # before anything is cut back
        self.folder = RunFolder(folder, resume=notes is not None)
        write_status(self.folder, Status(RUNNING))
        self.card = scene_card(model.stated, model.stated_mesh, (model.whole or model).placed.wells)
        self.decisions = decide((model.facts or Facts(model.scene)).with_card(self.card))
        if before is None or not before.mesh:
            self.mesh_seal = save_mesh(model.stated_mesh, self.folder / "mesh.h5")
        else:
            self.mesh_seal = before.mesh
        if notes is None:
            self.folder.write_text("scene.toml", model.stated.dump_toml(folder.resolve()))
            self.write_plan(self.decisions)
            self.folder.log("\n".join((*as_lines(self.card), *plan_lines(self.decisions))))
        else:
            self.folder.cut_back(notes["totals"]["steps"], notes["log_bytes"], model.scene.output.fields_every)
        system = model.scene.unit_system
        probes = {name: list(map(float, p.point)) for name, p in model.placed.probes.items()}
        wells = {name: self.mesh.points[self.mesh.flow_origin[n]].tolist() for name, n in model.placed.wells.items()}
        units = {part: str(getattr(system, part)) for part in ("length", "force", "time")}
        about = {"title": model.scene.title, "units": units, "probes": probes, "wells": wells, "fracflow": __version__}
        path = self.folder / "history.h5"
        old = (before.rows, before.attrs) if before is not None else None
        self.history = HistoryFile(path, about) if old is None else HistoryFile.after(path, *old)
        self.scene_seal = scene_seal(self.folder.path)
        for line in before.told if before is not None else ():
            self.folder.log(f"note: {line}")
            warnings.warn(line, stacklevel=2)
        fracture, flow, self.inverse = sampling.node_table(self.mesh)
        points = self.mesh.points[self.mesh.flow_origin[flow]]
        on = {probe.name: probe.on or getattr(probe.at, "fracture", None) for probe in model.scene.probe}
        places = {name: p for name, p in model.placed.probes.items() if isinstance(p, FracturePlace)}
        nearest = {name: self.mesh.fractures[self.mesh.joint_fracture[p.joints[0]]] for name, p in places.items()}
        named = {(on[name] or nearest[name], p.flow): name for name, p in places.items()}
        self.events = EventLog(
            self.folder / "events.csv",
            FractureNodes(
                [self.mesh.fractures[f] for f in fracture],
                self.mesh.flow_origin[flow],
                points[:, 0],
                points[:, 1],
                [named.get((self.mesh.fractures[f], int(n)), "") for f, n in zip(fracture, flow, strict=True)],
            ),
        )
        self.chatter = Chatter(self.events.nodes.fracture)
        with restoring(folder / "checkpoint.h5"):
            self.catalogue = catalogue_of(model.scene, self.mesh, self.inverse, notes)
        if notes is not None:
            with restoring(folder / "checkpoint.h5"):
                self.events.remember(notes["events"])
        self.count = len(flow)
        self.extra: int | None = None
        self.time: float | None = notes["time"] if notes is not None else None  # of the last state on record
        resumes = notes is not None
        self.rock = FieldWriter(
            self.folder.path, "rock", self.mesh.points, self.mesh.cells, {"rocks": list(self.mesh.rocks)}, resumes
        )
        ends = self.mesh.points[self.mesh.joint_bottom].reshape(-1, 2)
        lines = np.arange(len(ends)).reshape(-1, 2)
        self.fractures = FieldWriter(
            self.folder.path, "fractures", ends, lines, {"fractures": list(self.mesh.fractures)}, resumes
        )

    def write_plan(self, decisions: list[Decision]) -> None:
        """Write plan.json: what is modelled and left out, and the scene card."""
        self.folder.write_plan({"decisions": as_records(decisions), "card": card_records(self.card)})

    def save(self, step: Step, arrays: Arrays, about: Mapping[str, Any]) -> None:
        """Write the checkpoint: the state, where the run is, and where its files are."""
        state = step.state
        here = {"stage": step.stage, "progress": step.progress, "log_bytes": self.folder.log_bytes()}
        notes = {"time": state.time, "controls": dict(state.controls), "energy": dict(state.energy)}
        notes |= {"limited": list(state.limited), "last_step": state.memory.time_step}
        notes |= {"through": dict(state.memory.through)}
        notes |= {"drive": state.drive, "power": state.power, "injected": state.injected}
        notes |= {"incident": state.forces.incident, "around": list(state.around)}
        memory = {"events": self.events.memory(), "fracflow": __version__}
        memory |= {"catalogue": self.catalogue.memory() if self.catalogue is not None else {}}
        seals = {"seals": {"mesh": self.mesh_seal, "history": self.history.seal, "scene": self.scene_seal}}
        write_checkpoint(self.folder / "checkpoint.h5", arrays, {**notes, **here, **memory, **about, **seals})

    def append(self, step: Step, snapshot: sampling.Snapshot, margin: float) -> None:
        """One row of history and the events up to it."""
        state, report = step.state, step.report
        # a step that is cut where a status changes ends with the change; else it came somewhere in the step
        began = state.time if self.time is None or report.located else self.time
        self.time = state.time
        record: dict[str, Any] = {
            "time": state.time,
            "step/dt": step.dt,
            "step/stage": step.stage,
            "step/kind": KINDS[step.regime or self.scene.stage[step.stage].kind],
            "step/newton": report.newton,
            "step/krylov": report.krylov,
            "step/coupling": report.cycles,
            "step/factorisations": report.factorisations,
            "step/predicted_factor": report.predicted,
            "step/measured_factor": report.measured,
            "step/handed_over": int(bool(report.handed_over)),
            "step/solid_residual": report.solid_residual,
            "step/round_off": report.round_off,
            "step/flow_residual": report.flow_residual,
            "step/slipping": int(snapshot.column("sliding").sum()),
            "step/open": int(snapshot.column("open").sum()),
            "step/slip_margin": margin,
            "step/minimum_aperture": snapshot.least[0],
            "step/minimum_aperture_flow": snapshot.least[1],
            "step/digits": report.digits,
            "step/located": report.located,
            "step/rejected": report.rejected,
            "step/wasted": report.wasted,
            "step/widening": report.widening,
        }
        record |= {f"step/control/{name}": value for name, value in state.controls.items()}
        record |= {f"energy/{name}": state.energy[name] for name in ENTRIES}
        self.history.append(record | probe_record(self.scene, self.mesh, self.placed.probes, snapshot))

        def brought(name: str, any_of: bool = False) -> Any:
            return sampling.at_nodes(snapshot, name, self.inverse, self.count, any_of)

        # A tip has no jump: what its law does with a stress past its strength is no slip.
        parts = np.bincount(self.inverse, (self.mesh.joint_bottom != self.mesh.joint_top).ravel(), self.count) > 0.0
        is_open = parts & brought("open", True).astype(bool)
        if told := self.chatter.update(step.stage, is_open):
            self.folder.log(
                f"time {state.time:.6g}: stage {self.scene.stage[step.stage].title}: {told}: {self._advice()}"
            )
        self.events.update(
            state.time,
            parts & brought("sliding", True).astype(bool),
            is_open,
            brought("plastic_slip"),
            brought("slip_rate"),
            began,
        )

        if self.catalogue is not None:
            moves = step.regime == "dynamic" or (self.catalogue.is_moving and step.dt == 0.0)  # a step at rest ends it
            if event := self.catalogue.update(instant(state, snapshot, began), moves):
                self.events.add(event)

    def _advice(self) -> str:
        if self.scene.method.contact == "lumped" and not self.scene.has_flow:
            return 'method.contact = "redistributed" takes the mass from the walls, else take a smaller time_step'
        return 'take a smaller time_step, or method.stepper = "generalised-alpha" with rho_infinity = 0, which damps it'

    def drop_extra(self, index: int | None) -> None:
        """Take fields away that are out of turn, but for those of a step ``index``, which come next to be taken away."""
        if self.extra is not None and self.extra != index:
            self.rock.drop(self.extra)
            self.fractures.drop(self.extra)
        self.extra = index

    def fields(self, index: int, state: State, ends: Floats, motion: Floats | None) -> None:
        """Fields of fractures and, where there is its ``motion``, of the rock for ParaView."""
        if motion is not None:
            point_data, cell_data = rock_fields(self.mesh, self.scene, motion, state.energy["kinetic"] != 0.0)
            self.rock.write(index, state.time, point_data, cell_data)
        skip = ("margin",) + (() if self.scene.has_flow else ("pressure", "flow_rate"))
        values = {name: ends[:, :, n].ravel() for n, name in enumerate(sampling.COLUMNS) if name not in skip}
        if self.scene.has_flow and self.scene.fluid is not None and self.scene.fluid.specific_weight:
            values["head"] = values["pressure"] / self.scene.fluid.specific_weight
        if not self.scene.has_flow and np.isnan(values["aperture"]).all():
            del values["aperture"]
        self.fractures.write(index, state.time, values, {"fracture": self.mesh.joint_fracture})
