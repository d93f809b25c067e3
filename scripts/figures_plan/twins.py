"""A scene run twice, as it stands and with nothing left out, and how far the two histories are apart.

Values count by their change since the start, over the largest change of their kind: pressures over that of all
pressures, components of a vector or tensor over that of all of them, energies over that of all entries of the books. A
value that changes less than FLOOR of the largest one of its dimension counts as constant.

Without sides a run has no mesh, and the full one errs by its own: tips in meshed rock err by order 1. Where they are further
apart than the tolerance, the full run is made again on a mesh twice as fine, and the limit of both decides.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping
from itertools import count, pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fracflow._petsc import MPI
from fracflow.advance.step import Step
from fracflow.errors import InputError, SolveError
from fracflow.mesh.data import is_unmeshed
from fracflow.mesh.store import load_mesh
from fracflow.output import read_events, read_history
from fracflow.scene.quantities import row_of
from fracflow.scene.scene import Scene
from fracflow.scene.units import PLAIN
from fracflow.simulation.run import run

Floats = NDArray[np.float64]
TOLERANCE = 1e-2  # of a scene that states none, or a larger one
FLOOR = 1e-6
SAME = 1e-6  # of a step: records that are nearer in time are of the same instant
OF_EVENTS = {
    "slip": ("slip", "peak_slip_rate"),
    "open": ("slip", "peak_slip_rate"),
    "event": (
        "slip", "mean_slip", "peak_slip_rate", "length", "stress_drop", "moment", "radiated", "dissipated", "dropped",
        "injected",
    ),
}  # fmt: skip
"""Numbers of a row of events.csv besides start and end, by its kind."""
PARTS_OF = {
    "shear_traction": "traction", "normal_traction": "traction", "strength": "traction", "slip": "jump", "opening": "jump",
}  # fmt: skip
"""Components of joints that have names of their own: the vector that they are of. Strength bounds a traction: where the normal
traction hardly changes, its own change is an error of the mesh."""
DIMENSIONS = {
    "slip": "jump",
    "mean_slip": "jump",
    "peak_slip_rate": "slip_rate",
    "radiated": "energy",
    "dissipated": "energy",
}
"""Columns whose kind has another name."""


class Ran(NamedTuple):
    """Histories by key, rows of events, CPU seconds, and why the run ended early, "" where it did not.

    seconds     of this process and of those that it started, as for a mesh
    has_cells   whether the rock was meshed when the run began
    """

    history: dict[str, NDArray[Any]]
    events: list[dict[str, Any]]
    seconds: float
    failure: str
    has_cells: bool = True

    @property
    def end(self) -> float:
        """Time of the last record."""
        return float(self.history["time"][-1]) if self.history else 0.0


class TooLong(Exception):
    """A run has more records than its caller has patience for."""


class Gap(NamedTuple):
    """Largest difference over the largest value of its kind, and where it is."""

    error: float
    where: str = ""


class Twins(NamedTuple):
    """A scene with all in it and as the plan has it; the largest gaps of its "probes", "events" and "energy".

    coarse  worst error of the full run on the scene's own mesh, where the limit of its meshes decides; else None
    """

    full: Ran
    reduced: Ran
    tolerance: float
    gaps: dict[str, Gap]
    coarse: float | None = None

    @property
    def ratio(self) -> float:
        """Worst error over the tolerance; infinite where one run alone has failed."""
        if bool(self.full.failure) != bool(self.reduced.failure):
            return np.inf
        return max((gap.error for gap in self.gaps.values()), default=0.0) / self.tolerance

    @property
    def worst(self) -> str:
        """Where the error is largest, or which run failed."""
        for name, ran in (("reduced", self.reduced), ("full", self.full)):
            if self.ratio == np.inf and ran.failure:
                return f"{name} run failed: {ran.failure}"
        return max(self.gaps.values(), key=lambda gap: gap.error, default=Gap(0.0)).where


def full_of(scene: Scene) -> Scene:
    """The scene with nothing left out, and the method that it has but for kept factors, whichever ``model`` that came from."""
    data = scene.model_dump(exclude_none=True)
    data["method"].pop("factors")
    return Scene.from_data({**data, "model": "full"}, scene.folder / scene.source)


def twins(scene: Scene, *reduced: str, most: float = np.inf) -> Twins:
    """Run both; ``reduced`` are settings of the reduced run alone, for what the program does not choose by itself.

    Raises TooLong where the full run has more than ``most`` records.
    """
    data = scene.model_dump(exclude_none=True)
    for setting in reduced:
        table, _, value = setting.partition("=")
        part, key = table.split(".")
        data[part] = {**data.get(part, {}), key: value}
    tolerance = min(scene.accuracy.tolerance or TOLERANCE, TOLERANCE)
    other = Scene.from_data(data, scene.folder / scene.source) if reduced else scene
    full, less = once(full_of(scene), most), once(other)
    is_auto = any(stage.kind == "auto" for stage in scene.stage)
    found = Twins(full, less, tolerance, gaps(full, less, tolerance, is_auto))
    if less.has_cells or not 1.0 < found.ratio < np.inf:
        return found
    exact = limit(full, once(full_of(refined(scene))))
    own = Twins(exact, full, tolerance, gaps(exact, full, tolerance, is_auto, is_same_mesh=False))
    errors = gaps(exact, less, tolerance, is_auto)
    return found._replace(gaps=errors, coarse=own.ratio * tolerance)


def refinements(scene: Scene) -> list[float]:
    """Largest gaps between the run with all in it and that on cells half as long, and between that and the next.

    Their ratio is 2 where errors are of order 1, as ``limit`` takes it.
    """
    full = full_of(scene)
    levels = [once(each) for each in (full, refined(full), refined(refined(full)))]
    return [
        max(gap.error for gap in gaps(one, other, 0.0, is_auto=False, is_same_mesh=False).values())
        for one, other in pairwise(levels)
    ]


def limit(own: Ran, fine: Ran) -> Ran:
    """The limit of a run and of one with cells half as long, as errors of order 1 have it; the latter where times differ."""
    times = [ran.history.get("time", np.zeros(0)) for ran in (own, fine)]
    if len(times[0]) != len(times[1]) or not np.allclose(*times, rtol=SAME, atol=0.0):
        return fine
    kept = ("probe/", "energy/")
    history = {
        key: 2.0 * values - own.history[key] if key.startswith(kept) and values.dtype.kind == "f" else values
        for key, values in fine.history.items()
    }
    return fine._replace(history=history)


def refined(scene: Scene) -> Scene:
    """The scene with cells and joints half as long."""
    assert scene.geometry is not None
    geometry = scene.geometry.model_copy(update={"refine": scene.geometry.refine + 1})
    return scene.model_copy(update={"geometry": geometry})


def once(scene: Scene, most: float = np.inf) -> Ran:
    """Run a scene in a folder that is gone afterwards; raises TooLong at more than ``most`` records."""
    records = count(1)

    def watch(_: Step) -> None:
        if next(records) > most:
            raise TooLong

    with tempfile.TemporaryDirectory() as name:
        began, failure = cpu_seconds(), ""
        try:
            run(scene, Path(name) / "run", MPI.COMM_SELF, watch)
        except (SolveError, InputError) as error:
            failure = str(error).partition("\n")[0]
        seconds = cpu_seconds() - began
        if not (Path(name) / "run" / "history.h5").exists():
            return Ran({}, [], seconds, failure)
        history = read_history(Path(name) / "run" / "history.h5")
        has_cells = not is_unmeshed(load_mesh(Path(name) / "run" / "mesh.h5").cells)
        return Ran(history, read_events(Path(name) / "run" / "events.csv"), seconds, failure, has_cells)


def cpu_seconds() -> float:
    """CPU seconds of this process and of those that it has started and that have ended."""
    return sum(os.times()[:4])


def gaps(full: Ran, reduced: Ran, tolerance: float, is_auto: bool, is_same_mesh: bool = True) -> dict[str, Gap]:
    """Largest gap of probes (with controls), of events, and of energies; none where no step was made.

    Records of the same instants are compared as they are. One that the other run has not may take any value that the
    other has within the longer step of both there; where there is a stage auto, any record one within ``tolerance`` of the
    duration: an event that takes a second of days may begin a second later.
    """
    if not full.history or not reduced.history or len(full.history["time"]) < 2 or len(reduced.history["time"]) < 2:
        return {}
    sizes = largest(full, reduced)
    keys = [key for key in full.history if key.startswith(("probe/", "energy/", "step/control/"))]
    whole, less = (np.hstack([columns(ran.history, key) for key in keys]) for ran in (full, reduced))
    owners = [key for key in keys for _ in range(columns(full.history, key).shape[1])]
    scale = np.array([sizes.get(kind_of(key), 0.0) for key in owners])
    shift = tolerance * max(full.end, reduced.end) if is_auto else 0.0
    times = full.history["time"], reduced.history["time"]
    found = {"probes": Gap(0.0), "energy": Gap(0.0)}
    for at, values, others_at, others in ((times[0], whole, times[1], less), (times[1], less, times[0], whole)):
        apart = over(beyond(at, values, others_at, others, shift), scale)
        for name in found:
            of_it = np.array([(name == "energy") == key.startswith("energy/") for key in owners])
            row, column = np.unravel_index(np.where(of_it, apart, -1.0).argmax(), apart.shape)
            if of_it.any() and apart[row, column] > found[name].error:
                found[name] = Gap(float(apart[row, column]), f"{owners[column]} at {at[row]:.6g}")
    by_node = is_same_mesh and full.has_cells == reduced.has_cells
    return found | {"events": events_apart(full, reduced, sizes, by_node)}


def columns(history: Mapping[str, NDArray[Any]], key: str) -> Floats:
    """A history as (records, components); what is not there is none, and equal to none."""
    values = np.nan_to_num(history[key].astype(float), posinf=0.0, neginf=0.0)
    return values.reshape(len(values), -1)


def kind_of(key: str) -> str:
    """The measure that a key of the history is compared by."""
    name = key.rpartition("/")[2]
    return "energy" if key.startswith("energy/") else key if key.startswith("step/") else PARTS_OF.get(name, name)


def largest(full: Ran, reduced: Ran) -> dict[str, float]:
    """Largest change of each kind, at least FLOOR of the largest value of its dimension, in both runs."""
    change: dict[str, float] = {}
    value: dict[str, float] = {}
    of_kind: dict[str, str] = {}
    for ran in (full, reduced):
        for key in ran.history:
            kind, values = kind_of(key), columns(ran.history, key)
            change[kind] = max(change.get(kind, 0.0), float(np.abs(values - values[0]).max()))
            row = row_of(key)
            dimension = of_kind[kind] = kind if row is None or row.dimension == PLAIN else row.dimension
            value[dimension] = max(value.get(dimension, 0.0), float(np.abs(values).max()))
    return {kind: max(size, FLOOR * value[of_kind[kind]]) for kind, size in change.items()}


def over(difference: Floats, scale: Floats) -> Floats:
    """Shares of the scales; of what is zero throughout, none."""
    return np.divide(difference, scale, out=np.zeros_like(difference), where=scale > 0.0)


def beyond(at: Floats, values: Floats, others_at: Floats, others: Floats, shift: float) -> Floats:
    """How far values (n, m) are outside what the other history takes around the times ``at`` (n,)."""
    near = np.clip(np.searchsorted(others_at, at), 1, len(others_at) - 1)
    to_next = np.minimum(np.abs(others_at[near] - at), np.abs(others_at[near - 1] - at))
    step = np.maximum(np.diff(others_at)[near - 1], np.gradient(at) if len(at) > 1 else 0.0)
    width = np.maximum(np.where(to_next <= SAME * step, SAME * step, step), shift)
    ends = [between(others_at, others, moment) for moment in (at - width, at + width)]
    low, high = np.minimum(*ends), np.maximum(*ends)
    first, last = np.searchsorted(others_at, at - width), np.searchsorted(others_at, at + width, "right")
    for row in np.flatnonzero(last > first):
        inside = others[first[row] : last[row]]
        low[row], high[row] = np.minimum(low[row], inside.min(axis=0)), np.maximum(high[row], inside.max(axis=0))
    return np.maximum(np.maximum(low - values, values - high), 0.0)


def between(times: Floats, values: Floats, at: Floats) -> Floats:
    """Values (n, m) at other times, linear between records, constant beyond them."""
    right = np.clip(np.searchsorted(times, at, "right"), 1, len(times) - 1)
    length = times[right] - times[right - 1]
    share = np.divide(at - times[right - 1], length, out=np.ones_like(at), where=length > 0.0)
    share = np.clip(share, 0.0, 1.0)[:, None]
    return (1.0 - share) * values[right - 1] + share * values[right]


def events_apart(full: Ran, reduced: Ran, sizes: Mapping[str, float], by_node: bool) -> Gap:
    """Each row against the row of the same place that is most like it, or against none, which neither lasts nor slips.

    A place is a node. Where both runs have nodes of their own (not ``by_node``) it is a fracture, with its first start and
    last end. A section that reaches its strength at the end of a step slips in this one or from the next on, by round-off.
    """
    duration, found = max(full.end, reduced.end), Gap(0.0)
    most = {
        key: max([abs(row.get(key) or 0.0) for ran in (full, reduced) for row in ran.events], default=0.0)
        for key in dict.fromkeys(key for keys in OF_EVENTS.values() for key in keys)
    }
    for key in most:
        kind = DIMENSIONS.get(key, key)
        most[key] = max(most[key], FLOOR * sizes.get(kind, 0.0))
    most["dropped"] = most["radiated"] = most["dissipated"] = max(
        most[key] for key in ("dropped", "radiated", "dissipated")
    )
    tables = [by_place(ran, most, duration, by_node) for ran in (full, reduced)]
    for own, other in (tables, tables[::-1]):
        for place, rows in own.items():
            none = rows.copy()
            none[:, 1], none[:, 4:] = none[:, 0], 0.0
            apart = np.diagonal(unlike(rows, none))
            if place in other:
                apart = np.minimum(apart, unlike(rows, other[place]).min(axis=1))
            worst = int(apart.argmax())
            if apart[worst] > found.error:
                found = Gap(float(apart[worst]), f"{' '.join(map(str, place))} from {rows[worst, 0] * duration:.6g}")
    return found


def unlike(rows: Floats, others: Floats) -> Floats:
    """Largest difference (n, m) of each row from each other one; instants are known to the longer of the steps there."""
    apart = np.abs(rows[:, None] - others[None])
    steps = np.maximum(rows[:, None, 2:4], others[None, :, 2:4])
    return np.maximum(apart[..., 4:].max(axis=2), np.maximum(apart[..., :2] - steps, 0.0).max(axis=2))


def by_place(ran: Ran, most: Mapping[str, float], duration: float, by_node: bool) -> dict[Any, Floats]:
    """Rows (n, 4 + numbers) of each place, or of all events of a stage auto, as shares of the duration and of ``most``.

    They are start, end, the lengths of the steps that ended there, and what the event came to.
    """
    tables: dict[Any, list[list[float]]] = {}
    times = ran.history["time"]
    for row in ran.events:
        place = ("event",) if row["kind"] == "event" else (row["kind"], row["fracture"], row["node"] if by_node else "")
        instants = np.array([row["start"], ran.end if row["end"] is None else row["end"]])
        before = np.maximum(np.searchsorted(times, instants) - 1, 0)
        shares = [(row[key] or 0.0) / most[key] if most[key] else 0.0 for key in OF_EVENTS[row["kind"]]]
        about_time = np.concatenate([instants, np.maximum(instants - times[before], 0.0)]) / max(duration, 1e-300)
        tables.setdefault(place, []).append([*about_time.tolist(), *shares])
    found = {place: np.array(rows) for place, rows in tables.items()}
    return found if by_node else {place: rows if place == ("event",) else as_one(rows) for place, rows in found.items()}


def as_one(rows: Floats) -> Floats:
    """One row (1, n) of many: from the first start to the last end, and the longest steps. Slips are those of probes."""
    largest = rows.max(axis=0, keepdims=True)
    largest[:, 0], largest[:, 4:] = rows[:, 0].min(), 0.0
    return largest
