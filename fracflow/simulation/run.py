"""(Fig. 7) The loop: stages, steps, signals, and where a run goes on after it was stopped."""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from fracflow._petsc import MPI, timed
from fracflow._version import __version__
from fracflow.advance.initial_state import equilibrium_state, refuse_imbalance
from fracflow.advance.instability import LimitPoint
from fracflow.advance.stage import first_substep, refuse_moved, run_stage
from fracflow.advance.step import Step, Stepping, stepper_of
from fracflow.diagnostics import Number
from fracflow.errors import DiskError, InputError, Interrupted, OtherRock, ReductionInvalid, SolveError, is_alone
from fracflow.mesh.agreement import on_root
from fracflow.mesh.plane.near import near_ones
from fracflow.mesh.store import load_mesh
from fracflow.model.setup import Model
from fracflow.model.state import StepReport
from fracflow.output.checkpoint import check_stage, open_arrays, read_notes, restore_prestress, restore_state, restoring
from fracflow.output.folder import check_own
from fracflow.output.history import read_history, read_units
from fracflow.output.status import ENDED, FAILED, STOPPED, Status, last_line
from fracflow.reduction.apply import planned
from fracflow.reduction.far_sides import watch_sides
from fracflow.reduction.locked_mesh import watch_locked
from fracflow.reduction.prepare import prepare
from fracflow.reduction.sliced import Kept, Whole, kept_mesh
from fracflow.remarks import counted, marked, note, parted
from fracflow.scene.advice import advice
from fracflow.scene.boundary import Stage
from fracflow.scene.scene import Scene, load
from fracflow.simulation.files import EVENT_MESH
from fracflow.simulation.notices import watches_spurious
from fracflow.simulation.observer import Observer, observer_of
from fracflow.simulation.recorder import Recorder
from fracflow.simulation.rocks import Rocks
from fracflow.simulation.signals import RunRequest, SignalWatch
from fracflow.simulation.totals import Totals
from fracflow.solve.options import set_defaults
from fracflow.solve.rock_cost import rock_choice
from fracflow.storage.sealed import AGAIN

OnStep = Callable[[Step], None]
Show = Callable[[list[Number]], None]
Say = Callable[[str], None]


def run(
    scene: Scene,
    folder: str | Path,
    comm: MPI.Comm = MPI.COMM_WORLD,
    progress: Observer | OnStep | None = None,
    show: Show | None = None,
    say: Say | None = None,
) -> Totals:
    """Run a scene and leave its run folder; what an earlier run left there is replaced. Collective.

    show      is given the pre-run checks before the first step, on rank 0
    say       is given lines to be read before it: near misses and warnings on what was set up
    progress is given each step. An ``Observer`` is given rejected trials, checkpoints and numbers of joint ends too

    Where a part that the plan left out turns out to matter, the run begins anew with it. The steps of the first try are
    removed, and ``progress`` is called for those of both. Raises InputError, SolveError, DiskError and Interrupted, on every
    rank.
    """
    undone: dict[str, str] = {}
    while True:
        mesh = kept_mesh(comm, Path(folder) / "mesh.h5") if undone else None
        callbacks = (show, say) if not undone else (None, None)
        try:
            return _go(_begun(scene, folder, comm, undone, mesh, *callbacks), progress)
        except ReductionInvalid as needed:
            undone = {**undone, **needed.undone}


@dataclass(frozen=True)
class _Begun:
    """A run that is ready to go on from a step; ``clock`` is when it was begun [s]."""

    rocks: Rocks
    recorder: Recorder
    step: Step
    clock: float
    folder: str | Path


def _begun(
    scene: Scene,
    folder: str | Path,
    comm: MPI.Comm,
    undone: Mapping[str, str],
    mesh: Kept | None = None,
    show: Show | None = None,
    say: Say | None = None,
) -> _Begun:
    """A new run on a ``mesh``, without reductions undone by an earlier try. Raises ReductionInvalid too. Collective."""
    began = clock.perf_counter()
    model = prepare(scene, comm, mesh, undone=undone)
    refuse_imbalance(model)
    model, facts = planned(model, undone)
    state = equilibrium_state(model)
    recorder = Recorder(model, facts, Path(folder), comm)
    for part, when in undone.items():
        recorder.totals.undone[part] = when
        recorder.log(f"plan: {part}: undone at {when}: the run has begun anew with it")
    if show is not None and recorder.files is not None:
        show(recorder.files.card)
    whole = model.whole or model
    notes = whole.mesh.notes if whole.mesh is not None else ()
    if say is not None:
        for line in (*near_ones(notes), *parted(whole.placed.notes)[0]):
            say(line)
    sizes = model.operators.blocks.sizes
    cells = "rock without cells" if model.scene.is_unbounded else f"{sizes.cells} cells"
    recorder.log(
        f"fracflow {__version__}, {counted(comm.size, 'rank')}: {cells}, {sizes.nodes} nodes, {sizes.joints} joints"
        f" ({sizes.cut_joints} cut by ranks), {sizes.flow_nodes} flow nodes; set up in {clock.perf_counter() - began:.2f} s"
    )
    for line in (*advice(scene), *notes, *whole.placed.notes):
        recorder.log(marked(line))
    if watches_spurious(scene):
        recorder.log(
            note(f'method.storage = "{scene.method.storage}": non-transposed coupling: spurious power is watched')
        )
    step = Step(state, 0, 0.0, StepReport(), {"fresh": 1.0})
    recorder.record(step)
    recorder.save(step)
    return _Begun(Rocks(model), recorder, step, began, folder)


def resume(
    folder: str | Path, comm: MPI.Comm = MPI.COMM_WORLD, progress: Observer | OnStep | None = None, trust: bool = False
) -> Totals:
    """Go on with a run that was stopped, on any number of ranks. Collective.

    A run that was stopped before its first checkpoint begins again, with ``trust`` where its .geo needs that; one that
    has ended stays as it is. Raises InputError, SolveError, DiskError and Interrupted, on every rank.
    """
    began, folder = clock.perf_counter(), Path(folder)
    on_root(comm, lambda: require_run(folder))
    scene, saved = load(folder / "scene.toml", trust=trust), folder / "checkpoint.h5"
    undone: dict[str, str] = {}
    mesh: Kept | None
    ready: _Begun | None
    if comm.bcast(on_root(comm, lambda: has_checkpoint(folder)), root=0):
        notes = comm.bcast(on_root(comm, lambda: read_notes(saved)), root=0)
        with restoring(saved):
            totals = Totals.of(notes["totals"])
        if notes["finished"]:
            return totals
        on_root(comm, lambda: refuse_other_units(scene, folder))
        arrays = on_root(comm, lambda: open_arrays(saved))
        is_as_before = notes["ranks"] == comm.size
        mesh = began_on = kept_mesh(comm, folder / "mesh.h5", notes["seals"].get("mesh", ""))
        event_seal = notes["seals"].get("event_mesh", "")
        is_meshed = notes.get("meshed", bool(event_seal))  # earlier versions never left the mesh of an event
        event_mesh = on_root(comm, lambda: load_mesh(folder / EVENT_MESH, event_seal) if is_meshed else None)
        last_on = Whole.of(event_mesh, comm) if is_meshed else began_on
        cell_rank = on_root(comm, lambda: last_on.partition(arrays) if is_as_before else None)
        first_rank = None if is_meshed else cell_rank
        model = prepare(scene, comm, mesh, first_rank, begins=False, undone=notes["totals"]["undone"])
        refuse_imbalance(model)
        model, facts = planned(model, notes["totals"]["undone"], first_rank)
        meshed = None
        if is_meshed:
            from fracflow.reduction.event_mesh import with_event_mesh

            meshed = with_event_mesh(model, comm, event_mesh, cell_rank)
        rocks = Rocks(model, meshed, event_seal, is_meshed)
        model = rocks.now
        with restoring(saved):
            check_stage(notes, [stage.kind for stage in scene.stage])
            refuse_moved(scene, notes["stage"], notes["progress"], notes["time"])
            if event_seal:
                restore_prestress(model.operators, arrays)
            state = restore_state(model.operators, arrays, notes)
        step = Step(state, notes["stage"], 0.0, StepReport(), notes["progress"])
        recorder = Recorder(model, facts, folder, comm, notes)
        done = recorder.totals.steps
        recorder.log(note(f"resumed after {done} steps, at time {state.time:.6g}, on {counted(comm.size, 'rank')}"))
        undone, ready = notes["totals"]["undone"], _Begun(rocks, recorder, step, began, folder)
    else:
        # the folder alone suffices: the mesh file may have moved or changed
        path = folder / "mesh.h5"
        is_there = comm.bcast(on_root(comm, path.exists), root=0)
        mesh, ready = kept_mesh(comm, path) if is_there else None, None
    while True:
        try:
            return _go(ready or _begun(scene, folder, comm, undone, mesh), progress)
        except ReductionInvalid as needed:
            undone, ready = {**undone, **needed.undone}, None


def has_ended(folder: Path) -> bool:
    """Whether the run in a folder came to the end of its last stage. Raises InputError for an unreadable checkpoint."""
    saved = folder / "checkpoint.h5"
    return saved.exists() and bool(read_notes(saved)["finished"])


def has_checkpoint(folder: Path) -> bool:
    """Whether a run can go on. Raises InputError where it could not begin again without loss: its checkpoint was taken away."""
    if (folder / "checkpoint.h5").exists():
        return True
    if (folder / "history.h5").exists() and len(read_history(folder / "history.h5").get("time", ())) > 1:
        lost = folder / "checkpoint.h5"
        raise InputError(f"{lost}: no such file, although history.h5 has steps; put it back, or {AGAIN}")
    return False


def refuse_other_units(scene: Scene, folder: Path) -> None:
    """Raise InputError where a scene has other units than its run began with: the state and the mesh are numbers in those."""
    kept = read_units(folder / "history.h5")
    began, now = (
        ", ".join(filter(None, (names.get(part) for part in ("length", "force", "time")))) or "none"
        for names in (kept, scene.unit_names)
    )
    if kept and began != now:
        raise InputError(
            f"scene.toml: units: the run began in {began}, and has {now} now: put units back,"
            " or begin a new run: fracflow run"
        )


def require_run(folder: Path) -> None:
    """Raise InputError where a folder has no scene to go on with."""
    check_own(folder)
    if not (folder / "scene.toml").is_file():
        raise InputError(f"{folder}: holds no run of fracflow that could go on; name the folder of one")


def of_stage(stage: Stage, error: SolveError, scene: Scene | None = None) -> SolveError:
    """The same error with the name of its stage, and units of the ``scene`` for its times."""
    head = f"stage {stage.title}: "
    if str(error).startswith(head):
        return error
    kind = type(error)
    said = str(error) if scene is None else scene.with_time_units(str(error))
    found = kind.__new__(kind, f"{head}{said}")  # which may take more to be made than a message
    found.__dict__.update(error.__dict__)
    found.__cause__ = error
    return found


def _go(begun: _Begun, progress: Observer | OnStep | None) -> Totals:
    """From a step to the end of the last stage. Collective."""
    rocks, recorder, step = begun.rocks, begun.recorder, begun.step
    observer = observer_of(progress)
    recorder.report_saved(observer.saved)
    try:
        recorder.check()
        step, failure = _stepped(rocks.now, recorder, step, observer)
        while isinstance(failure, OtherRock):
            scene = rocks.now.scene
            try:
                step = rocks.change(recorder, step, failure)
            except (InputError, SolveError) as error:  # the state before is on disk
                failure = of_stage(scene.stage[step.stage], SolveError(f"an event needs a mesh: {error}"), scene)
                recorder.log(f"stopped: {failure}")
                recorder.last(step)
                break
            step, failure = _stepped(rocks.now, recorder, step, observer, is_on_record=False)
        recorder.end()
        recorder.log_slip_at_crossings()
        word = ENDED if failure is None else STOPPED if isinstance(failure, Interrupted) else FAILED
        line = "" if failure is None else last_line(failure, begun.folder)
        recorder.finish(clock.perf_counter() - begun.clock, Status(word, line))
        if failure is None:  # last of all: after a kill before it the run can be resumed
            recorder.save(step, finished=True)
        recorder.check()
    finally:
        recorder.close()
    if failure is not None:
        raise failure
    return recorder.totals


def _stepped(
    model: Model, recorder: Recorder, step: Step, observer: Observer, is_on_record: bool = True
) -> tuple[Step, SolveError | Interrupted | DiskError | OtherRock | None]:
    """All steps of a model, by solvers of its own; as ``_steps``. Collective."""
    layout, far = model.operators.layout, model.operators.far
    rock = rock_choice(model.scene, layout.comm, int(layout.solid_starts[-1]), far is not None)
    set_defaults(model.scene.petsc, rock, layout.comm.size)
    if rock.by_multigrid:
        recorder.log(note(f"{rock.why}: multigrid in the place of a factorisation of the rock"))
    stepping = Stepping(model, recorder.log)
    try:
        step, failure = _steps(stepping, recorder, step, observer, is_on_record)
    finally:
        if not is_alone():
            stepping.destroy()
    if not isinstance(failure, (Interrupted, OtherRock)):
        recorder.last(step)  # fields of the rock take memory, which solvers have given back by now
        if failure is not None:
            recorder.save(step)
    return step, failure


def is_moving(scene: Scene, step: Step) -> bool:
    """Whether the last step of a stage has left a state in motion."""
    is_last = not step.progress or "fresh" not in step.progress
    return is_last and (scene.stage[step.stage].kind == "dynamic" or bool((step.progress or {}).get("moves")))


def _steps_of(stage: Stage) -> Callable[..., Iterator[Step]]:
    """The way to make the steps of a kind of stage, imported when the first one begins: start-up is most of a small run."""
    if stage.kind == "auto":
        from fracflow.advance.auto import run_auto

        return run_auto
    if stage.kind == "equilibrate":
        from fracflow.advance.equilibrate import equilibrate

        return equilibrate
    return run_stage


@timed("FracSteps", "Steps")
def _steps(
    stepping: Stepping, recorder: Recorder, step: Step, observer: Observer, is_on_record: bool
) -> tuple[Step, SolveError | Interrupted | DiskError | OtherRock | None]:
    """Make and record all remaining steps; return the last one, and the cause of an early end. Collective.

    Where the run goes on in the other rock, the step returned takes no time and is not on record. Its progress is that of the
    last one: a run that is killed meanwhile makes the rejected trials again, and counts them.
    """
    scene, comm, state = stepping.model.scene, recorder.comm, step.state
    observer.follow(stepping.work.trial)
    failure: SolveError | Interrupted | DiskError | None = None
    going_on = step.progress or {}
    with SignalWatch(comm, scene.output.checkpoint_every, scene.output.checkpoint_seconds) as watch:
        try:
            if not is_on_record:
                recorder.record(step)
                recorder.save(step)
                observer(step)
            for number, stage in list(enumerate(scene.stage))[step.stage :]:
                if not going_on or "fresh" in going_on:
                    recorder.log(f"stage {number} ({stage.title}) from time {state.time:.6g}")
                    moves = stage.kind == "auto" and is_moving(scene, step)
                    stepper = stepper_of(scene, stage, "dynamic" if moves else "")
                    entered = stepping.enter(state, stepper, first_substep(stepping, stage, stepper, state.time))
                    state.destroy()
                    state = replace(entered, stage_start=None)  # of the stage before
                    going_on = {**(step.progress or {}), "moving": 1.0} if moves else {}
                try:
                    for made in _steps_of(stage)(stepping, state, number, recorder.log, going_on):
                        if made.trial is not None:
                            observer.trial(made.trial.time, made.trial.length, made.trial.why)
                            continue
                        step = made
                        recorder.totals.spend(stepping.work)
                        recorder.record(step)
                        watch_locked(stepping.model, step.state)
                        watch_sides(stepping.model, step.state)
                        if recorder.slipping_and_open is not None:
                            observer.sections(*recorder.slipping_and_open)
                        observer(step)
                        state.destroy()
                        state = step.state
                        asked = watch.request(recorder.totals.steps, must_stop=recorder.lost is not None)
                        if asked is RunRequest.STOP:
                            recorder.check()
                        if asked is not RunRequest.GO_ON:
                            recorder.save(step)
                            recorder.last(step, whole=asked is RunRequest.STOP)
                        if asked is RunRequest.STOP:
                            done = f"after {recorder.totals.steps} steps"
                            raise Interrupted(f"stopped at time {scene.time_text(state.time)}, {done}")
                except LimitPoint as limit:
                    if not any(after.kind in ("dynamic", "auto") for after in scene.stage[number + 1 : number + 2]):
                        raise
                    recorder.totals.give_up(limit)
                    after = f"handed over to stage {scene.stage[number + 1].title}"
                    recorder.log(note(f"stage {stage.title}: {limit.message}; {after}"))
                going_on = {}
        except ReductionInvalid:
            for each in {id(state): state, id(step.state): step.state}.values():
                each.destroy()
            raise
        except OtherRock as needed:
            spent = StepReport(rejected=needed.trials, wasted=needed.newton)
            before = step.progress if step.stage == number else {"fresh": 1.0}
            return Step(state, number, 0.0, spent, before, "quasi-static"), needed
        except (SolveError, Interrupted, DiskError) as error:  # raised on every rank: what follows stays collective
            failure = error
            if isinstance(error, SolveError):
                recorder.totals.give_up(error)
                failure = of_stage(stage, error, scene)
            recorder.log(f"stopped: {failure}")
    recorder.totals.spend(stepping.work)
    return (step if isinstance(failure, Interrupted) else replace(step, state=state)), failure
