"""checkpoint.h5: a state in original order, from which a run goes on with any number of ranks."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import fields
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, NonNegativeInt, TypeAdapter, ValidationError
from typing_extensions import TypedDict

from fracflow._petsc import MPI, PETSc
from fracflow.errors import InputError
from fracflow.laws.base import zero_history
from fracflow.mesh.agreement import on_first, on_root
from fracflow.mesh.blocks import Blocks
from fracflow.mesh.data import Ints
from fracflow.mesh.slabs import Distributed, Order
from fracflow.model.operators import Operators
from fracflow.model.state import (
    FluidVolumes,
    Forces,
    Motion,
    PreviousStep,
    SectionHistory,
    Sections,
    StageStart,
    State,
)
from fracflow.model.terms.term import Term
from fracflow.storage.reader import Layout
from fracflow.storage.sealed import AGAIN, SealedFile, Slabs, piece_rows, read_sealed, slabs_of, write_slabs

Arrays = dict[str, NDArray[Any]]
SOLID = {
    "displacement": "motion",
    "velocity": "motion",
    "acceleration": "motion",
    "load": "forces",
    "support": "forces",
}
NOTES = (
    "time",
    "controls",
    "energy",
    "limited",
    "last_step",
    "drive",
    "power",
    "stage",
    "progress",
    "totals",
    "finished",
    "ranks",
    "log_bytes",
    "events",
)
_NO_CHECKPOINT = "is no checkpoint"
SHARED = 1 << 26  # bytes of a checkpoint: below, rank 0 reads it before other ranks have started to read
MEMORY = "mean_velocity"
ANCHOR = "anchor"
PRESTRESS = "prestress"
STAGE_START = ("stage_start/displacement", "stage_start/compressed")  # where an error chooses the steps of a stage
RATES = ("uptake", "mean_uptake")  # of a compressible fluid, where there are any
ENDLESS = ("sections/strength", "sections/margin", "sections/utilisation")  # inf where a joint never fails
DIMENSIONS = {"strain": 1, "traction": 1, "tangent": 2, "inelastic": 1, "blur": 1}  # of each section's value
FLOW = {"pressure": "", "conduction": "forces", "source": "forces"}


class SavedVolumes(TypedDict):
    """A ``FluidVolumes``."""

    __pydantic_config__ = ConfigDict(allow_inf_nan=False)  # type: ignore[misc]

    wells: dict[str, float]
    rates: dict[str, float]
    into: float
    out_of: float
    stored: float


class Notes(TypedDict, total=False):
    """The notes of a checkpoint beside its arrays; those named in NOTES must be there.

    seals  digests of what it belongs to: the roots of "mesh", the last row of "history", the text of "scene"
    meshed  whether the run is on the mesh of an event
    """

    __pydantic_config__ = ConfigDict(allow_inf_nan=False)  # type: ignore[misc]

    time: float
    controls: dict[str, float]
    energy: dict[str, float]
    limited: list[str]
    last_step: float
    drive: float
    power: float
    stage: NonNegativeInt
    progress: dict[str, float]
    totals: dict[str, Any]
    finished: bool
    ranks: NonNegativeInt
    log_bytes: NonNegativeInt
    events: dict[str, Any]
    injected: float
    around: tuple[float, float]
    powers: dict[str, float]
    left: dict[str, float]
    through: dict[str, float]
    volumes: SavedVolumes
    seals: dict[str, str]
    meshed: bool


def write_checkpoint(path: Path, arrays: Mapping[str, Slabs], notes: Mapping[str, Any]) -> None:
    """Write arrays and their seal to a temporary file, flush it, and replace the last checkpoint. Rank 0 only."""
    write_slabs(path, arrays, {"notes": json.dumps(notes, ensure_ascii=False)})


def read_notes(path: Path) -> dict[str, Any]:
    """The notes of a checkpoint beside its arrays, ``seals`` empty where it has none. Raises InputError as ``read_arrays``."""
    found = read_sealed(path, _NO_CHECKPOINT, names=())
    try:
        notes: dict[str, Any] = json.loads(str(found.notes["notes"]))
        for key in NOTES:
            notes[key]
        TypeAdapter(Notes).validate_python({key: value for key, value in notes.items() if key in Notes.__annotations__})
        limits = {"place_base": 1.0, "place_part": 1.0, "place_level": 1000.0}
        if not all(0.0 <= notes["progress"].get(name, 0.0) < limit for name, limit in limits.items()):
            raise ValueError("progress: no place in a step")
    except ValidationError as error:
        where = ".".join(map(str, error.errors()[0]["loc"]))
        raise InputError(f"{path}: {_NO_CHECKPOINT} ({where}: {error.errors()[0]['msg']}); {AGAIN}") from None
    except (KeyError, ValueError, TypeError, RecursionError) as error:
        raise InputError(f"{path}: {_NO_CHECKPOINT} ({error}); {AGAIN}") from error
    return {**notes, "seals": notes.get("seals", {}) if found.root else {}}


def read_arrays(path: Path) -> Arrays:
    """All arrays of a checkpoint, by their names. Raises InputError where they are not as they were sealed."""
    return read_sealed(path, _NO_CHECKPOINT).arrays


@contextmanager
def restoring(path: Path) -> Iterator[None]:
    """Give faults of a checkpoint, with seal or without, as an InputError that names it. Raises InputError."""
    try:
        yield
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError) as error:
        what = f"{type(error).__name__}: {error}"
        raise InputError(f"{path}: {_NO_CHECKPOINT} of this version ({what}); {AGAIN}") from error


def check_stage(notes: Mapping[str, Any], kinds: Sequence[str]) -> None:
    """Raise InputError for a checkpoint of a stage that the scene has not, or of another of its ``kinds``."""
    number, progress = notes["stage"], notes["progress"] or {}
    if number >= len(kinds):
        raise InputError(f"checkpoint.h5: {_NO_CHECKPOINT} of this scene (stage {number} of {len(kinds)}); {AGAIN}")
    is_amid = bool(progress) and not progress.keys() & {"fresh", "done", "moving"}
    if is_amid and ("least" in progress) != (kinds[number] == "auto"):
        raise InputError(
            f'scene.toml: stage.{number}.kind = "{kinds[number]}": the run was stopped amid this stage, of another kind;'
            " put its kind back and let a stage follow it, or begin a new run: fracflow run"
        )


def state_arrays(operators: Operators, state: State) -> dict[str, Distributed]:
    """The arrays of a state in original order, and the rank of each cell; the same names on all ranks."""
    blocks = operators.blocks
    orders, used = _orders(blocks)
    of_terms = {**state.forces.of_terms, **({} if state.forces.anchor is None else {ANCHOR: state.forces.anchor})}
    rates = zip(RATES, (state.uptake, state.previous_step.uptake), strict=True)
    solid = {name: getattr(getattr(state, part), name) for name, part in SOLID.items()}
    flow = {name: getattr(getattr(state, part) if part else state, name) for name, part in FLOW.items()}
    memory = {} if state.previous_step.velocity is None else {MEMORY: state.previous_step.velocity}
    found = {name: orders.solid.of(vector.getArray(readonly=True)[used]) for name, vector in solid.items()}
    if operators.flow is not None:
        found |= {name: orders.flow.of(vector.getArray(readonly=True)) for name, vector in flow.items()}
    for name, vector in (memory | of_terms).items():
        found[name] = orders.solid.of(vector.getArray(readonly=True)[used])
    found |= {name: orders.flow.of(rate.getArray(readonly=True)) for name, rate in rates if rate is not None}
    if state.stage_start is not None:
        moved, compressed = state.stage_start
        found[STAGE_START[0]] = orders.solid.of(moved[used])
        if compressed is not None:
            found[STAGE_START[1]] = orders.flow.of(compressed)
    joints, points = len(blocks.joints.ids), operators.joints.points
    at_sections = {
        f"sections/{f.name}": getattr(state.sections, f.name) for f in fields(Sections) if f.name != "history"
    }
    for name, values in {**at_sections, "friction": state.friction}.items():
        found[name] = orders.joints.of(values.reshape(joints, points, *values.shape[1:]))
    for number, (group, past) in enumerate(zip(operators.joints.laws, state.sections.history, strict=True)):
        for name, values in past.items():
            everywhere = np.zeros((joints * points, *values.shape[1:]))
            everywhere[group.sections] = values
            found[f"past/{number}/{name}"] = orders.joints.of(everywhere.reshape(joints, points, *values.shape[1:]))
    found |= {f"memory/{name}": orders.joints.of(values) for name, values in state.memory.items()}
    cells = Order(blocks.comm, blocks.solid.cell_ids, blocks.sizes.cells)
    return found | {"cell_rank": cells.of(np.full(cells.count, blocks.comm.rank))}


def prestress_array(operators: Operators) -> dict[str, Distributed]:
    """Forces of the initial stress in original order, with what was frozen as the rock was meshed."""
    orders, used = _orders(operators.blocks)
    return {PRESTRESS: orders.solid.of(operators.prestress.getArray(readonly=True)[used])}


def restore_prestress(operators: Operators, file: SealedFile | None) -> None:
    """Those of a ``file`` that rank 0 reads in the place of the initial ones. Raises InputError as below. Collective."""
    orders, used = _orders(operators.blocks)
    found = _SavedArrays(operators.blocks.comm, file)
    if found.layout.get(PRESTRESS, ("", ()))[1] != (orders.solid.total,):
        raise InputError(f"checkpoint.h5: {_NO_CHECKPOINT} of this mesh ({PRESTRESS}); {AGAIN}")
    operators.prestress.getArray()[used] = found.rows(PRESTRESS, orders.solid)


def open_arrays(path: Path) -> SealedFile:
    """The arrays of a checkpoint, to be read by slabs. Raises InputError as ``read_arrays``. Rank 0 only."""
    return SealedFile(path, _NO_CHECKPOINT)


def restore_state(operators: Operators, file: SealedFile | None, notes: Mapping[str, Any]) -> State:
    """The state in a ``file`` that rank 0 reads, distributed over the present ranks. Collective.

    Raises InputError on all ranks for that of another mesh, and for what is not as it was sealed.
    """
    blocks, layout = operators.blocks, operators.layout
    orders, used = _orders(blocks)
    found = _SavedArrays(blocks.comm, file)
    _check_shapes(found.layout, operators, orders.solid.total, notes["last_step"] > 0.0)

    def solid(name: str) -> PETSc.Vec:
        vector = layout.solid_vector()
        values = np.zeros(layout.solid_count)
        values[used] = found.rows(name, orders.solid)
        vector.setArray(values)
        return vector

    def flow(name: str) -> PETSc.Vec:
        vector = layout.flow_vector()
        if operators.flow is not None:
            vector.setArray(found.rows(name, orders.flow))
        return vector

    def stage_start() -> StageStart | None:
        if STAGE_START[0] not in found.layout:
            return None
        moved = np.zeros(layout.solid_count)
        moved[used] = found.rows(STAGE_START[0], orders.solid)
        compressed = found.rows(STAGE_START[1], orders.flow) if STAGE_START[1] in found.layout else None
        return StageStart(moved, compressed)

    def saved(name: str) -> PETSc.Vec | None:
        return flow(name) if name in found.layout else None

    def at_sections(name: str) -> NDArray[Any]:
        values = found.rows(name, orders.joints)
        return values.reshape(-1, *values.shape[2:])

    past: SectionHistory = tuple(
        {name: at_sections(f"past/{number}/{name}")[group.sections] for name in group.law.history}
        for number, group in enumerate(operators.joints.laws)
    )
    parts = {f.name: at_sections(f"sections/{f.name}") for f in fields(Sections) if f.name != "history"}
    names = _names_of_terms(operators, found.layout)
    return State(
        time=notes["time"],
        motion=Motion(solid("displacement"), solid("velocity"), solid("acceleration")),
        pressure=flow("pressure"),
        sections=Sections(history=past, **parts),
        forces=Forces(
            solid("load"),
            solid("support"),
            flow("conduction"),
            flow("source"),
            {name: solid(name) for name in names},
            notes.get("powers") or dict.fromkeys(names, notes.get("incident", 0.0)),
            solid(ANCHOR) if ANCHOR in found.layout else None,
        ),
        controls=notes["controls"],
        energy=notes["energy"],
        wells_at_limit=tuple(notes["limited"]),
        wells_shut=tuple(notes.get("shut", ())),
        friction=at_sections("friction"),
        previous_step=PreviousStep(notes["last_step"], solid(MEMORY), saved(RATES[1]), notes.get("through", {}))
        if notes["last_step"]
        else PreviousStep(),
        uptake=saved(RATES[0]),
        max_overpressure=notes["drive"],
        max_dissipation=notes["power"],
        injected=notes.get("injected", notes.get("totals", {}).get("injected", 0.0)),
        left=notes.get("left", {}),
        volumes=FluidVolumes(**notes.get("volumes", {})),
        memory={term.name: found.memory(term, orders.joints) for term in operators.terms if term.has_memory},
        adjacent_steps=tuple(notes.get("around", (0.0, 0.0))),
        stage_start=stage_start(),
    )


class _SavedArrays:
    """The arrays of a checkpoint for all ranks; each reads some slabs, one at a time. Calls are collective."""

    def __init__(self, comm: MPI.Comm, file: SealedFile | None) -> None:
        self._comm, self._file, self._readers = comm, file, 1
        self.layout: Layout = comm.bcast(None if file is None else file.layout, root=0)
        size = sum(np.dtype(kind).itemsize * math.prod(shape) for kind, shape in self.layout.values())
        if comm.size > 1 and size >= SHARED:
            self._share()

    def _share(self) -> None:
        """Let all ranks read the file, where all reach it. Collective."""
        path, root = self._comm.bcast(None if self._file is None else self._file.place, root=0)
        with suppress(InputError):  # the folder of another machine, say: rank 0 reads for all
            self._file = self._file or SealedFile(path, _NO_CHECKPOINT, ours=root)
        if self._comm.allreduce(self._file is not None, op=MPI.LAND):
            self._readers = self._comm.size

    def rows(self, name: str, order: Order) -> NDArray[Any]:
        """This rank's rows (n, ...). Raises InputError for values that no state has."""
        kind, shape = self.layout[name]
        values = np.zeros((order.count, *shape[1:]), kind)
        slabs = list(slabs_of(values.dtype, shape))
        for begin in range(0, len(slabs), self._readers):
            group = slabs[begin : begin + self._readers]
            slab = on_first(self._comm, len(group), partial(self._slab_of, name, group))
            for root, (first, last) in enumerate(group):
                order.hand_out(slab, first, last, values, root)
        return values

    def memory(self, term: Term, order: Order) -> NDArray[Any]:
        """The memory (j, 2, m) of a term. Raises ValueError, on all ranks, for that of another."""
        name = f"memory/{term.name}"
        found, fault, (kind, shape) = self.rows(name, order), "", self.layout[name]
        start = on_root(self._comm, partial(self._slab, name, 0, min(piece_rows(kind, shape), shape[0])))
        first = self._comm.bcast(None if start is None else start[:1], root=0)
        try:
            found = term.restored(found, first)
        except ValueError as error:
            fault = str(error)
        if fault := max(self._comm.allgather(fault)):
            raise ValueError(fault)
        return found

    def _slab_of(self, name: str, group: Sequence[tuple[int, int]]) -> NDArray[Any]:
        return self._slab(name, *group[self._comm.rank])

    def _slab(self, name: str, first: int, last: int) -> NDArray[Any]:
        assert self._file is not None
        rows = self._file.rows(name, first, last)
        if np.any(np.isnan(rows) if name in ENDLESS else ~np.isfinite(rows)):
            raise InputError(f"checkpoint.h5: {_NO_CHECKPOINT} ({name} has values that are no finite numbers); {AGAIN}")
        return rows


def _names_of_terms(operators: Operators, layout: Layout) -> list[str]:
    """The terms with stored forces."""
    return [term.name for term in operators.terms if term.name in layout]


def _check_shapes(layout: Layout, operators: Operators, unknowns: int, remembers: bool) -> None:
    sizes, joint = operators.blocks.sizes, (operators.blocks.sizes.joints, operators.joints.points)
    flow = FLOW if operators.flow is not None else ()
    shapes: dict[str, tuple[int, ...]] = {name: (unknowns,) for name in SOLID}
    shapes |= {name: (sizes.flow_nodes,) for name in flow}
    shapes |= {MEMORY: (unknowns,)} if remembers else {}
    shapes |= {name: (sizes.flow_nodes,) for name in RATES if name in layout}
    start = zip(STAGE_START, ((unknowns,), (sizes.flow_nodes,)), strict=True)
    shapes |= {name: shape for name, shape in start if name in layout}
    kept = (*_names_of_terms(operators, layout), *([ANCHOR] if ANCHOR in layout else []))
    shapes |= {name: (unknowns,) for name in kept}
    parts = {
        f.name: (*joint, *(sizes.dim,) * DIMENSIONS.get(f.name, 0)) for f in fields(Sections) if f.name != "history"
    }
    shapes |= {f"sections/{name}": shape for name, shape in parts.items()} | {"friction": joint}
    for number, group in enumerate(operators.joints.laws):
        past = zero_history(group.law.history, 1, sizes.dim)
        shapes |= {f"past/{number}/{name}": (*joint, *past[name].shape[1:]) for name in group.law.history}
    for name in (f"memory/{term.name}" for term in operators.terms if term.has_memory):
        shapes[name] = (sizes.joints, 2, *(layout[name][1][2:3] if name in layout else ()))
    for name, shape in shapes.items():
        kind, found = layout.get(name, ("", (0,)))
        if found != shape:
            rows = f"{found[0] if found else 0} rows, not {shape[0]}"
            raise InputError(
                f"checkpoint.h5: {_NO_CHECKPOINT} of this mesh ({name} has"
                f" {rows if found[:1] != shape[:1] else f'the shape {found}, not {shape}'}); {AGAIN}"
            )
        wanted = "b" if name in ("sections/is_sliding", "sections/is_open") else "f"
        if kind and np.dtype(kind).kind != wanted:
            raise InputError(f"checkpoint.h5: {_NO_CHECKPOINT} ({name} is of type {np.dtype(kind)}); {AGAIN}")


class _Orders(NamedTuple):
    """The order of displacement unknowns, flow nodes and joints."""

    solid: Order
    flow: Order
    joints: Order


def _orders(blocks: Blocks) -> tuple[_Orders, NDArray[np.bool_] | slice]:
    """In which order they are saved, and the displacement unknowns of this rank that a node or a body has."""
    places, total = _solid_places(blocks)
    used, comm, sizes = places >= 0, blocks.comm, blocks.sizes
    orders = _Orders(
        Order(comm, places[used], total),
        Order(comm, blocks.flow.ids, sizes.flow_nodes),
        Order(comm, blocks.joints.ids, sizes.joints),
    )
    return orders, slice(None) if used.all() else used


def _solid_places(blocks: Blocks) -> tuple[Ints, int]:
    """Original number of each displacement unknown of this rank, -1 for one that no node has; and how many there are.

    Unknowns of nodes count as node * dim + component, those of rigid bodies follow; tied nodes count as their lowest.
    """
    block, dim = blocks.solid, blocks.sizes.dim
    start, end = block.unknown_starts[blocks.comm.rank : blocks.comm.rank + 2]
    free = block.body < 0
    own = (block.node_ids[free, None] * dim + np.arange(dim)).ravel()
    of_bodies = blocks.sizes.nodes * dim + np.arange(block.body_unknown.size)
    numbers = np.concatenate([block.unknown[free].ravel(), block.body_unknown.ravel()])
    originals = np.concatenate([own, of_bodies])
    here = (numbers >= start) & (numbers < end)
    total = blocks.sizes.nodes * dim + block.body_unknown.size
    places = np.full(end - start, total, dtype=np.int64)
    np.minimum.at(places, numbers[here] - start, originals[here])
    return np.where(places == total, -1, places), total
