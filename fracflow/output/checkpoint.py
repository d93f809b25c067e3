"""checkpoint.h5: a state in original order, from which a run goes on with any number of ranks."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, NonNegativeInt, TypeAdapter, ValidationError
from typing_extensions import TypedDict

from fracflow._petsc import MPI, PETSc
from fracflow.errors import InputError
from fracflow.laws.base import zero_history
from fracflow.mesh.blocks import Blocks
from fracflow.mesh.data import Ints
from fracflow.model.operators import Operators
from fracflow.model.state import FluidVolumes, Forces, Motion, PreviousStep, SectionHistory, Sections, State
from fracflow.storage.sealed import AGAIN, read_sealed, write_sealed

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
MEMORY = "mean_velocity"
ANCHOR = "anchor"
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


def write_checkpoint(path: Path, arrays: Mapping[str, NDArray[Any]], notes: Mapping[str, Any]) -> None:
    """Write arrays (...) and their seal to a temporary file, flush it, and replace the last checkpoint. Rank 0 only."""
    write_sealed(path, arrays, {"notes": json.dumps(notes, ensure_ascii=False)})


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


def spread(comm: MPI.Comm, arrays: Arrays | None) -> Arrays:
    """The arrays of rank 0 on every rank. Collective."""
    shapes = comm.bcast(None if arrays is None else [(k, v.dtype.str, v.shape) for k, v in arrays.items()], root=0)
    found = {name: np.empty(shape, kind) for name, kind, shape in shapes} if arrays is None else arrays
    for name, _, _ in shapes:
        comm.Bcast(found[name], root=0)
    return found


def gather_state(operators: Operators, state: State) -> Arrays | None:
    """The arrays of a state in original order, and the rank of each cell, on rank 0. Collective."""
    blocks = operators.blocks
    places, total = _solid_places(blocks)
    used = places >= 0
    arrays: dict[str, NDArray[Any] | None] = {}
    for name, part in SOLID.items():
        local = getattr(getattr(state, part), name).getArray(readonly=True)
        arrays[name] = blocks.gather(places[used], local[used], total)
    for name, part in FLOW.items() if operators.flow is not None else ():
        local = getattr(getattr(state, part) if part else state, name).getArray(readonly=True)
        arrays[name] = blocks.gather(blocks.flow.ids, local.copy(), blocks.sizes.flow_nodes)
    if state.previous_step.velocity is not None:
        local = state.previous_step.velocity.getArray(readonly=True)
        arrays[MEMORY] = blocks.gather(places[used], local[used], total)
    anchor = {} if state.forces.anchor is None else {ANCHOR: state.forces.anchor}
    for name, vector in {**state.forces.of_terms, **anchor}.items():
        arrays[name] = blocks.gather(places[used], vector.getArray(readonly=True)[used], total)
    for name, rate in zip(RATES, (state.uptake, state.previous_step.uptake), strict=True):
        if rate is not None:
            arrays[name] = blocks.gather(blocks.flow.ids, rate.getArray().copy(), blocks.sizes.flow_nodes)
    joints, points = blocks.joints.ids, operators.joints.points
    at_sections = {
        f"sections/{f.name}": getattr(state.sections, f.name) for f in fields(Sections) if f.name != "history"
    }
    for name, values in {**at_sections, "friction": state.friction}.items():
        rows = values.reshape(len(joints), points, *values.shape[1:])
        arrays[name] = blocks.gather(joints, rows, blocks.sizes.joints)
    for number, (group, past) in enumerate(zip(operators.joints.laws, state.sections.history, strict=True)):
        for name, values in past.items():
            whole = np.zeros((len(joints) * points, *values.shape[1:]))
            whole[group.sections] = values
            rows = whole.reshape(len(joints), points, *values.shape[1:])
            arrays[f"past/{number}/{name}"] = blocks.gather(joints, rows, blocks.sizes.joints)
    for name, values in state.memory.items():
        arrays[f"memory/{name}"] = blocks.gather(joints, values, blocks.sizes.joints)
    rank = np.full(len(blocks.solid.cell_ids), blocks.comm.rank)
    arrays["cell_rank"] = blocks.gather(blocks.solid.cell_ids, rank, blocks.sizes.cells)
    return None if blocks.comm.rank else {name: values for name, values in arrays.items() if values is not None}


def restore_state(operators: Operators, arrays: Arrays, notes: Mapping[str, Any]) -> State:
    """The saved state, distributed over the present ranks. Raises InputError for that of another mesh. Collective."""
    blocks, layout = operators.blocks, operators.layout
    places, total = _solid_places(blocks)
    _check_shapes(arrays, operators, total, notes["last_step"] > 0.0)

    def solid(name: str) -> PETSc.Vec:
        vector = layout.solid_vector()
        vector.setArray(np.where(places >= 0, arrays[name][places], 0.0))
        return vector

    def flow(name: str) -> PETSc.Vec:
        vector = layout.flow_vector()
        if operators.flow is not None:
            vector.setArray(arrays[name][blocks.flow.ids])
        return vector

    def saved(name: str) -> PETSc.Vec | None:
        return flow(name) if name in arrays else None

    def at_sections(name: str) -> NDArray[Any]:
        values = arrays[name][blocks.joints.ids]
        return values.reshape(-1, *values.shape[2:])

    past: SectionHistory = tuple(
        {name: at_sections(f"past/{number}/{name}")[group.sections] for name in group.law.history}
        for number, group in enumerate(operators.joints.laws)
    )
    parts = {f.name: at_sections(f"sections/{f.name}") for f in fields(Sections) if f.name != "history"}
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
            {name: solid(name) for name in _names_of_terms(operators, arrays)},
            notes.get("powers") or dict.fromkeys(_names_of_terms(operators, arrays), notes.get("incident", 0.0)),
            solid(ANCHOR) if ANCHOR in arrays else None,
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
        memory={
            term.name: term.restored(arrays[f"memory/{term.name}"], blocks.joints.ids)
            for term in operators.terms
            if term.has_memory
        },
        adjacent_steps=tuple(notes.get("around", (0.0, 0.0))),
    )


def _names_of_terms(operators: Operators, arrays: Arrays) -> list[str]:
    """The terms with stored forces."""
    return [term.name for term in operators.terms if term.name in arrays]


def _check_shapes(arrays: Arrays, operators: Operators, unknowns: int, remembers: bool) -> None:
    sizes, joint = operators.blocks.sizes, (operators.blocks.sizes.joints, operators.joints.points)
    flow = FLOW if operators.flow is not None else ()
    shapes: dict[str, tuple[int, ...]] = {name: (unknowns,) for name in SOLID}
    shapes |= {name: (sizes.flow_nodes,) for name in flow}
    shapes |= {MEMORY: (unknowns,)} if remembers else {}
    shapes |= {name: (sizes.flow_nodes,) for name in RATES if name in arrays}
    kept = (*_names_of_terms(operators, arrays), *([ANCHOR] if ANCHOR in arrays else []))
    shapes |= {name: (unknowns,) for name in kept}
    parts = {
        f.name: (*joint, *(sizes.dim,) * DIMENSIONS.get(f.name, 0)) for f in fields(Sections) if f.name != "history"
    }
    shapes |= {f"sections/{name}": shape for name, shape in parts.items()} | {"friction": joint}
    for number, group in enumerate(operators.joints.laws):
        past = zero_history(group.law.history, 1, sizes.dim)
        shapes |= {f"past/{number}/{name}": (*joint, *past[name].shape[1:]) for name in group.law.history}
    for name in (f"memory/{term.name}" for term in operators.terms if term.has_memory):
        shapes[name] = (sizes.joints, 2, *(arrays[name].shape[2:3] if name in arrays else ()))
    for name, shape in shapes.items():
        found = arrays[name].shape if name in arrays else (0,)
        if found != shape:
            rows = f"{found[0] if found else 0} rows, not {shape[0]}"
            raise InputError(
                f"checkpoint.h5: {_NO_CHECKPOINT} of this mesh ({name} has"
                f" {rows if found[:1] != shape[:1] else f'the shape {found}, not {shape}'}); {AGAIN}"
            )
        wanted = "b" if name in ("sections/is_sliding", "sections/is_open") else "f"
        if name in arrays and arrays[name].dtype.kind != wanted:
            raise InputError(f"checkpoint.h5: {_NO_CHECKPOINT} ({name} is of type {arrays[name].dtype}); {AGAIN}")
        is_wrong = np.isnan if name in ENDLESS else lambda values: ~np.isfinite(values)
        if name in arrays and np.any(is_wrong(arrays[name])):
            raise InputError(f"checkpoint.h5: {_NO_CHECKPOINT} ({name} has values that are no finite numbers); {AGAIN}")


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
