"""(Fig. 7) The loop: stages, steps, and what is put on record."""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fracflow import __version__
from fracflow._petsc import MPI
from fracflow.assembly.energy import ENTRIES
from fracflow.coupling.defaults import set_defaults
from fracflow.errors import SolveError
from fracflow.mesh.locate import FracturePlace
from fracflow.output import EventLog, FieldWriter, FractureNodes, HistoryFile, RunFolder, sampling
from fracflow.plan import as_records, decide, factorisations
from fracflow.run_equilibrate import equilibrate
from fracflow.run_setup import Model, prepare
from fracflow.run_start import rest
from fracflow.run_steps import Step, Stepping, run_stage, stepper_of
from fracflow.scene import Scene
from fracflow.state import State, StepReport

KINDS = {"steady": 0, "quasi-static": 1, "dynamic": 2, "equilibrate": 3}
NARROW = 1e-9  # a decision on a status nearer to its threshold than this is not settled by arithmetic

Progress = Callable[[int, float, State], None]


@dataclass
class Totals:
    """Counts over the run."""

    steps: int = 0
    newton: int = 0
    factorisations: int = 0
    narrowest: float = np.inf
    narrow_time: float = np.nan


class Recorder:
    """Writes the run folder on rank 0; its calls are collective, for they gather."""

    def __init__(self, model: Model, folder: Path, comm: MPI.Comm) -> None:
        """Open the files. Collective."""
        self.model, self.comm = model, comm
        self.nodes = sampling.probe_nodes(model.placed.probes)
        self.depth = model.scene.fluid.flow_depth if model.scene.fluid is not None else 1.0
        self.totals = Totals()
        self.files: Files | None = Files(model, folder) if comm.rank == 0 else None

    def log(self, line: str) -> None:
        """A line for log.txt."""
        if self.files is not None:
            self.files.folder.log(line)

    def record(self, step: Step, last: bool = False) -> None:
        """Put a state on record. Collective."""
        snapshot = sampling.take(self.model.operators, step.state, self.depth, self.nodes)
        every = self.model.scene.output.fields_every
        with_fields = self.totals.steps == 0 or last or bool(every and self.totals.steps % every == 0)
        displacement = sampling.all_displacements(self.model.operators, step.state) if with_fields else None
        if self.files is not None and snapshot is not None:
            margin = float(snapshot.column("margin").min(initial=np.inf))
            if margin < self.totals.narrowest:
                self.totals.narrowest, self.totals.narrow_time = margin, step.state.time
            if not last:
                self.files.append(step, snapshot, margin)
            if displacement is not None:
                self.files.fields(self.totals.steps, step.state.time, snapshot, displacement)
        if not last:
            self.totals.steps += 1
            self.totals.newton += step.report.newton
            self.totals.factorisations += step.report.factorisations

    def finish(self, seconds: float) -> None:
        """Write plan.json and the last lines of the log, and close the files."""
        totals = self.totals
        if totals.narrowest < NARROW:
            self.log(
                f"smallest slip margin {totals.narrowest:.1e} at time {totals.narrow_time:.6g}:"
                " what follows there is not settled by arithmetic"
            )
        self.log(
            f"{totals.steps} steps, {totals.newton} Newton iterations, {totals.factorisations} factorisations"
            f" in {seconds:.2f} s"
        )
        if self.files is not None:
            decisions = [*decide(self.model.scene), factorisations(self.totals.newton, self.totals.factorisations)]
            self.files.folder.write_plan(as_records(decisions))
            self.files.history.close()
            self.files.events.close()


class Files:
    """The open files of a run folder; rank 0 only."""

    def __init__(self, model: Model, folder: Path) -> None:
        """Make the folder and open history, events and fields."""
        assert model.mesh is not None
        self.scene, self.mesh, self.placed = model.scene, model.mesh, model.placed
        self.folder = RunFolder(folder)
        self.folder.write_text("scene.toml", model.scene.dump_toml(folder.resolve()))
        self.folder.write_plan(as_records(decide(model.scene)))
        system = model.scene.unit_system
        probes = {name: list(map(float, p.point)) for name, p in model.placed.probes.items()}
        wells = {name: self.mesh.points[self.mesh.flow_origin[n]].tolist() for name, n in model.placed.wells.items()}
        units = {part: str(getattr(system, part)) for part in ("length", "force", "time")}
        self.history = HistoryFile(
            self.folder / "history.h5",
            {"title": model.scene.title, "units": units, "probes": probes, "wells": wells, "fracflow": __version__},
        )
        fracture, flow, self.inverse = sampling.node_table(self.mesh)
        points = self.mesh.points[self.mesh.flow_origin[flow]]
        named = {p.flow: name for name, p in model.placed.probes.items() if isinstance(p, FracturePlace)}
        self.events = EventLog(
            self.folder / "events.csv",
            FractureNodes(
                [self.mesh.fractures[f] for f in fracture],
                self.mesh.flow_origin[flow],
                points[:, 0],
                points[:, 1],
                [named.get(int(n), "") for n in flow],
            ),
        )
        self.count = len(flow)
        self.rock = FieldWriter(
            self.folder.path, "rock", self.mesh.points, self.mesh.cells, {"rocks": list(self.mesh.rocks)}
        )
        ends = self.mesh.points[self.mesh.joint_bottom].reshape(-1, 2)
        lines = np.arange(len(ends)).reshape(-1, 2)
        self.fractures = FieldWriter(
            self.folder.path, "fractures", ends, lines, {"fractures": list(self.mesh.fractures)}
        )

    def append(self, step: Step, snapshot: sampling.Snapshot, margin: float) -> None:
        """One row of history and the events up to it."""
        state, report = step.state, step.report
        record: dict[str, Any] = {
            "time": state.time,
            "step/dt": step.dt,
            "step/stage": step.stage,
            "step/kind": KINDS[self.scene.stage[step.stage].kind],
            "step/newton": report.newton,
            "step/krylov": report.krylov,
            "step/coupling": report.cycles,
            "step/factorisations": report.factorisations,
            "step/solid_residual": report.solid_residual,
            "step/flow_residual": report.flow_residual,
            "step/slipping": int(snapshot.column("sliding").sum()),
            "step/open": int(snapshot.column("open").sum()),
            "step/slip_margin": margin,
        }
        record |= {f"step/control/{name}": value for name, value in state.controls.items()}
        record |= {f"energy/{name}": state.energy[name] for name in ENTRIES}
        self.history.append(record | sampling.probe_record(self.scene, self.placed.probes, snapshot))

        def brought(name: str, any_of: bool = False) -> Any:
            return sampling.at_nodes(snapshot, name, self.inverse, self.count, any_of)

        self.events.update(
            state.time,
            brought("sliding", True).astype(bool),
            brought("open", True).astype(bool),
            brought("plastic_slip"),
            brought("slip_rate"),
        )

    def fields(self, index: int, time: float, snapshot: sampling.Snapshot, displacement: Any) -> None:
        """Fields of rock and fractures for ParaView."""
        stress = sampling.rock_stress(self.mesh, self.scene, displacement)
        tensor = stress[:, [0, 2, 2, 1]].reshape(-1, 2, 2)
        self.rock.write(index, time, {"displacement": displacement}, {"stress": tensor, "rock": self.mesh.cell_rock})
        skip = ("margin",) + (() if self.scene.has_flow else ("pressure", "aperture", "flow_rate"))
        names = [name for name in sampling.COLUMNS if name not in skip]
        values = {name: snapshot.column(name).ravel() for name in names}
        self.fractures.write(index, time, values, {"fracture": self.mesh.joint_fracture})


def run(scene: Scene, folder: str | Path, comm: MPI.Comm = MPI.COMM_WORLD, progress: Progress | None = None) -> Totals:
    """Run a scene and leave its run folder. Raises InputError and SolveError, on every rank. Collective."""
    began = clock.perf_counter()
    set_defaults(scene.petsc)
    model = prepare(scene, comm)
    state = rest(model)
    recorder = Recorder(model, Path(folder), comm)
    sizes = model.operators.blocks.sizes
    recorder.log(
        f"fracflow {__version__}, {comm.size} ranks: {sizes.cells} cells, {sizes.nodes} nodes, {sizes.joints} joints"
        f" ({sizes.cut_joints} cut by ranks), {sizes.flow_nodes} flow nodes; set up in {clock.perf_counter() - began:.2f} s"
    )
    for line in model.placed.notes:
        recorder.log(line)
    stepping = Stepping(model)
    step = Step(state, 0, 0.0, StepReport(0, 0, 0, 0, 0.0, 0.0))
    recorder.record(step)
    failure: SolveError | None = None
    try:
        for number, stage in enumerate(scene.stage):
            recorder.log(f"stage {number} ({stage.name or stage.kind}) from time {state.time:.6g}")
            entered = stepping.enter(state, stepper_of(scene, stage))
            state.destroy()
            state = entered
            steps = equilibrate if stage.kind == "equilibrate" else run_stage
            for step in steps(stepping, state, number, recorder.log):
                recorder.record(step)
                if progress is not None:
                    progress(number, step.state.time, step.state)
                state.destroy()
                state = step.state
    except SolveError as error:  # raised on every rank: what follows stays collective
        failure = error
        recorder.log(f"stopped: {error}")
    recorder.record(Step(state, step.stage, step.dt, step.report), last=True)
    recorder.finish(clock.perf_counter() - began)
    stepping.destroy()
    if failure is not None:
        raise failure
    return recorder.totals
