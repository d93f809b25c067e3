"""The map of a run's report: mesh, fractures with their fields at some states, wells, probes and events, for the page."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fracflow.errors import InputError
from fracflow.mesh.cut_mesh import whole_mesh
from fracflow.mesh.data import SplitMesh
from fracflow.output.fields import list_steps, read_mesh, read_step
from fracflow.output.profiles import KEPT, read_profiles
from fracflow.output.reader import LARGEST, without_round_off
from fracflow.output.remarks import last_limit
from fracflow.run_report.data import RunReport, rounded
from fracflow.scene.units import LENGTH, STRESS
from fracflow.storage.files import steers

Floats = NDArray[np.float64]
Data = Mapping[str, NDArray[Any]]

MOST_VALUES = 600_000  # of the map, two bytes each
MOST_EDGES = 30_000  # of the mesh on the map
MOST_EVENTS = 5_000
MOST_FILES = 60  # of fields that are read


@dataclass(frozen=True)
class Frames:
    """Fields along the fractures at some states.

    times, steps  (k,)
    names         of the fractures
    ends          a slice of the nodes for each of them
    points        (m, 2) nodes in the order of each trace [length]
    along         (m,) their distance from its start [length]
    fields        name -> (k, m); nan where a state has none
    """

    times: Floats
    steps: NDArray[np.int64]
    names: list[str]
    ends: list[slice]
    points: Floats
    along: Floats
    fields: dict[str, Floats]

    @property
    def slips(self) -> Floats:
        """(m,) The largest slip of each node, or of another field where there is none."""
        first = self.fields.get("plastic_slip", next(iter(self.fields.values()), np.zeros((1, len(self.along)))))
        return np.nan_to_num(first).max(axis=0)

    def nearest(self, place: tuple[float, float]) -> str:
        """The name of the fracture that is nearest to a place (2,) [length]."""
        at = int(np.argmin(np.linalg.norm(self.points - np.array(place), axis=1)))
        return next(
            (name for name, rows in zip(self.names, self.ends, strict=True) if rows.start <= at < rows.stop), "–"
        )


def read_frames(run: RunReport) -> Frames | None:
    """Profiles, and fields of the fractures at other states, thinned to fit a page; None where there are none.

    Raises InputError for fields that do not fit their mesh.
    """
    folder = run.folder / "fields"
    if not (folder / "fractures_mesh.h5").is_file():
        return None
    points, cells, about = read_mesh(run.folder, "fractures")
    states, fracture = _states(run, len(cells))
    if not states or not len(cells) or cells.shape[1] != 2:
        return None
    names = _names(about, len(cells))
    if fracture.shape != (len(cells),) or fracture.min() < 0 or fracture.max() >= len(names):
        raise InputError(f"{folder}: the fractures of its pieces do not fit them; put back a copy of the files")
    rows, ends_of, parts, along = _traces(points[:, :2], cells, fracture, len(names))
    meeting = np.bincount(rows, minlength=len(along))  # ends at each node

    def at_nodes(values: Floats) -> Floats:
        """The largest of the ends that meet at each node: at a crossing they differ."""
        found = np.full(len(along), -np.inf)
        np.maximum.at(found, rows, values[ends_of])
        return found

    where = np.stack([np.bincount(rows, points[ends_of, i], len(along)) / meeting for i in range(2)], axis=1)
    if not np.isfinite(where).all() or np.abs(where).max(initial=0.0) > LARGEST:
        raise InputError(f"{folder}: points of the fractures are no numbers; put back a copy of the files")
    numbers = sorted(states)
    chosen = _spread([states[n][0] for n in numbers], max(2, MOST_VALUES // max(1, 3 * len(along))))
    numbers = [numbers[i] for i in chosen]
    fields = dict[str, Floats]()
    for name in KEPT:
        values = np.full((len(numbers), len(along)), np.nan)
        for k, number in enumerate(numbers):
            found = states[number][1].get(name, np.zeros(0))
            if found.shape == (len(points),):
                values[k] = at_nodes(without_round_off(found, where) if name == "plastic_slip" else found)
        if np.isfinite(values).any():
            fields[name] = values
    used = [i for i in range(len(names)) if parts[i].stop > parts[i].start]
    times = np.array([states[number][0] for number in numbers])
    return Frames(times, np.array(numbers), [names[i] for i in used], [parts[i] for i in used], where, along, fields)


def _states(run: RunReport, pieces: int) -> tuple[dict[int, tuple[float, Data]], NDArray[np.int64]]:
    """Time and fields of each state on disk by its number, and the fracture (pieces,) of each piece."""
    states: dict[int, tuple[float, Data]] = {}
    fracture = np.zeros(pieces, dtype=np.int64)
    steps = list_steps(run.folder, "fractures")
    for k in np.unique(np.linspace(0, len(steps) - 1, min(len(steps), MOST_FILES)).astype(int)).tolist():
        number, path = steps[k]
        found = run.attempt(partial(read_step, path), None)
        if found is not None:
            states[number] = (found[0], found[1])
            fracture = np.asarray(found[2].get("fracture", fracture), dtype=np.int64)
    profiles = run.attempt(lambda: read_profiles(run.folder), {})
    for row in range(len(profiles.get("time", ()))):
        values = {name: array[row] for name, array in profiles.items() if name not in ("time", "step")}
        states.setdefault(int(profiles["step"][row]), (float(profiles["time"][row]), values))
    return states, fracture


def _names(about: Mapping[str, Any], count: int) -> list[str]:
    """Names of the fractures in the mesh of the fields; ``count`` numbers where there are none."""
    try:
        names = json.loads(about.get("fractures", "[]"))
    except (TypeError, ValueError, RecursionError):
        names = []
    if isinstance(names, list) and names and all(isinstance(name, str) and not steers(name) for name in names):
        return names
    return [f"fracture {i + 1}" for i in range(count)]


def _traces(
    points: Floats, cells: NDArray[np.int64], fracture: NDArray[np.int64], count: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], list[slice], Floats]:
    """Nodes of each fracture in the order of its trace, ends of pieces that meet taken together.

    Gives for each end of a piece its row and its number, the rows of each fracture, and the distance of each row along it.
    """
    rows, numbers, ends, along = [], [], [], []
    start = 0
    size = float(np.ptp(points, axis=0).max(initial=0.0)) or 1.0
    for i in range(count):
        pieces = cells[fracture == i]
        mine = pieces.ravel()
        if not len(mine):
            ends.append(slice(start, start))
            continue
        # ends that meet are at one place, to what copies of a node may differ by
        _, place = np.unique(np.round(points[mine] / (1e-9 * size)), axis=0, return_inverse=True)
        order = _walk(place.reshape(-1, 2))
        rank = np.empty(len(order), dtype=np.int64)
        rank[order] = np.arange(len(order))
        where = np.zeros((len(order), 2))
        where[rank[place.ravel()]] = points[mine]
        lengths = np.linalg.norm(np.diff(where, axis=0), axis=1)
        rows.append(start + rank[place.ravel()])
        numbers.append(mine)
        along.append(np.concatenate([[0.0], np.cumsum(lengths)]))
        ends.append(slice(start, start + len(order)))
        start += len(order)
    return np.concatenate(rows), np.concatenate(numbers), ends, np.concatenate(along)


def _walk(pieces: NDArray[np.int64]) -> NDArray[np.int64]:
    """The places (m,) of one trace from its start to its end, along its pieces (n, 2); pieces not reached come last."""
    beside: dict[int, list[int]] = {}
    for a, b in pieces.tolist():
        beside.setdefault(a, []).append(b)
        beside.setdefault(b, []).append(a)
    first = set(pieces[:, 0].tolist())
    tips = [p for p in beside if len(beside[p]) == 1]
    tips.sort(key=lambda p: p not in first)
    order: list[int] = []
    seen: set[int] = set()
    for begin in [*tips, *beside]:
        at: int | None = begin
        while at is not None and at not in seen:
            seen.add(at)
            order.append(at)
            at = next((p for p in beside[at] if p not in seen), None)
    return np.array(order, dtype=np.int64)


def _spread(times: Sequence[float], most: int) -> list[int]:
    """Indices of at most so many states, half of them even in time and half in number, the first and last among them."""
    if len(times) <= most:
        return list(range(len(times)))
    half = max(1, most // 2)
    by_time = np.searchsorted(times, np.linspace(times[0], times[-1], half)).clip(0, len(times) - 1)
    by_number = np.linspace(0, len(times) - 1, max(2, most - half)).astype(int)
    return sorted({*by_time.tolist(), *by_number.tolist()})


def packed(values: ArrayLike, low: float, high: float) -> str:
    """Numbers as two bytes each between two limits, in base 64; no number is 65535."""
    array = np.asarray(values, dtype=float)
    share = np.clip((array - low) / ((high - low) or 1.0), 0.0, 1.0)
    whole = np.where(np.isfinite(array), np.round(np.nan_to_num(share) * 65534), 65535)
    return base64.b64encode(whole.astype("<u2").tobytes()).decode("ascii")


def map_record(run: RunReport, frames: Frames | None) -> dict[str, Any] | None:
    """The map for the page: mesh, fractures with their fields, wells, probes, events; None without mesh and fractures."""
    mesh = run.mesh
    edges = _edges(mesh) if mesh is not None and mesh.points.shape[1] == 2 else np.zeros((0, 2, 2))
    places = [edges.reshape(-1, 2), *([frames.points] if frames is not None else [])]
    everything = np.concatenate(places)
    if not len(everything):
        return None
    low, high = everything.min(axis=0), everything.max(axis=0)
    size = float((high - low).max()) or 1.0
    span = run.unit(LENGTH, [size])

    def at(points: ArrayLike) -> str:
        return packed(((np.asarray(points, dtype=float) - low) / size).ravel(), 0.0, 1.0)

    found: dict[str, Any] = {
        "extent": rounded((high - low) / size),
        "origin": rounded(low * span.factor),
        "size": size * span.factor,
        "unit": span.name,
        "edges": at(edges),
        "wells": [[name, *rounded((np.array(place) - low) / size)] for name, place in run.wells.items()],
        "probes": [[name, *rounded((np.array(place) - low) / size)] for name, place in run.probes.items()],
        "clock": run.clock.name,
        "limit": rounded((np.array(limit[1]) - low) / size) if (limit := last_limit(run.log)) is not None else [],
    }
    if frames is None:
        return found
    scaled = {}
    for name, table in frames.fields.items():
        dimension = STRESS if name == "pressure" else LENGTH
        unit = run.unit(dimension, table)
        finite = table[np.isfinite(table)]
        limits = float(finite.min()), float(finite.max())
        about = {
            "label": unit.label(name.replace("_", " ")),
            "low": limits[0] * unit.factor,
            "high": limits[1] * unit.factor,
        }
        scaled[name] = about | {"values": packed(table.ravel(), *limits)}
    slips = [event for event in run.events if event["kind"] == "slip"][:MOST_EVENTS]
    big = sorted(run.catalogue, key=lambda event: event["start"])[-MOST_EVENTS:]

    def when(time: float | None) -> float | None:
        return None if time is None else float(f"{time * run.clock.factor:.9g}")

    return found | {
        "fractures": [[name, rows.start, rows.stop] for name, rows in zip(frames.names, frames.ends, strict=True)],
        "points": at(frames.points),
        "along": rounded(frames.along * span.factor),
        "most": int(np.argmax([frames.slips[rows].max(initial=0.0) for rows in frames.ends])),
        "times": [when(time) for time in frames.times.tolist()],
        "steps": frames.steps.tolist(),
        "fields": scaled,
        "slips": [
            [*rounded((np.array([e["x"], e["y"]]) - low) / size), when(e["start"]), when(e["end"])] for e in slips
        ],
        "events": [
            [*rounded((np.array([e["x"], e["y"]]) - low) / size), when(e["start"]), e["magnitude"], e["fracture"]]
            for e in big
        ],
    }


def _edges(mesh: SplitMesh) -> Floats:
    """(k, 2, 2) ends of the edges of a plane mesh, or of its outline alone where they are many, as before its cells are cut."""
    count = mesh.children * len(mesh.uncut.cells)  # which is less than that of edges
    mesh = whole_mesh(mesh) if count <= MOST_EDGES else mesh.uncut
    cells = mesh.cells
    following = np.roll(cells, -1, axis=1)
    counts = (cells >= 0).sum(axis=1)
    following[np.arange(len(cells)), counts - 1] = cells[:, 0]
    pairs = np.sort(np.stack([cells[cells >= 0], following[cells >= 0]], axis=1), axis=1)
    edges, times = np.unique(mesh.origin[pairs] if len(mesh.origin) else pairs, axis=0, return_counts=True)
    chosen = edges if max(count, len(edges)) <= MOST_EDGES else edges[times == 1]
    return np.asarray(mesh.points[chosen[:MOST_EDGES]], dtype=float)
