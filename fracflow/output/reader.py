"""The data of the pictures, read from a run folder; every part may be missing but the history."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fracflow.errors import InputError
from fracflow.mesh.store import has_cells
from fracflow.output.drawing.axes import axis_of, shown
from fracflow.output.events import read_events
from fracflow.output.fields import list_steps, read_mesh, read_step, read_time
from fracflow.output.folder import check_own
from fracflow.output.history import read_attributes, read_history, read_table, read_units
from fracflow.output.plot_style import plain
from fracflow.output.remarks import last_limit
from fracflow.output.status import CUT_OFF, ENDED, FAILED, RUNNING, STOPPED, Status, read_status
from fracflow.scene.quantities import REGIMES, dimension_of
from fracflow.scene.units import ENERGY, LENGTH, STRESS, TIME, VELOCITY
from fracflow.storage.files import read_text, steers

Floats = NDArray[np.float64]
FieldProfile = tuple[Floats, Floats | None, Floats]

_DYNAMIC, _EQUILIBRATE = REGIMES.index("dynamic"), REGIMES.index("equilibrate")
SLIP_ROUND_OFF = 1e-15  # of the size of the domain
STRESS_ROUND_OFF = 1e-13  # of the largest stress: it is a difference of large ones, summed up over steps
LARGEST = 1e300  # of a number in a picture: axes take differences and margins


@dataclass(frozen=True)
class FractureFields:
    """Fracture fields at the start of the dynamics, and the last that were written.

    points    (n, 2)     node coordinates [length]
    cells     (m, 2)     nodes of each piece
    fracture  (m,)       index into ``names``
    before, after        point data; ``before`` empty if only one step was written
    begins, time         times of these two [time]
    step                 number of the state that ``after`` is of, counted from 0
    """

    points: Floats
    cells: NDArray[np.int64]
    fracture: NDArray[np.int64]
    names: list[str]
    before: dict[str, NDArray[Any]]
    after: dict[str, NDArray[Any]]
    begins: float = 0.0
    time: float = 0.0
    step: int = 0

    @property
    def segments(self) -> Floats:
        """(m, 2, 2) ends of the pieces."""
        return self.points[self.cells]

    @property
    def has_before(self) -> bool:
        """Whether two different steps are there."""
        return bool(self.before)

    def has(self, key: str) -> bool:
        """Whether the field was written as point data."""
        return key in self.after

    def on_segments(self, key: str) -> Floats:
        """(m,) mean over a piece's ends of the last scalar field; zero if it was not written."""
        if not self.has(key):
            return np.zeros(len(self.cells))
        return np.asarray(self.after[key].reshape(len(self.points), -1)[:, 0][self.cells].mean(axis=1))

    def profiles(self, key: str, most: int, by_size: bool = False) -> dict[str, FieldProfile]:
        """Name -> (distance along the trace, field before or None, field after) of at most so many fractures.

        They are those where the field changes most, or the longest where there is none before; ``by_size`` takes those
        where it is largest after.
        """
        found: dict[str, FieldProfile] = {}
        for i, name in enumerate(self.names):
            nodes = self._trace(self.cells[self.fracture == i])
            if len(nodes):
                steps = np.linalg.norm(np.diff(self.points[nodes], axis=0), axis=1)
                before = self.before[key][nodes] if key in self.before else None
                found[name] = (np.concatenate([[0.0], np.cumsum(steps)]), before, self.after[key][nodes])
        if len(found) <= most:
            return found
        sizes = {
            name: float(along[-1] if before is None and not by_size else _largest(after, None if by_size else before))
            for name, (along, before, after) in found.items()
        }
        first = sorted((name for name in found if sizes[name] > 0.0), key=lambda name: -sizes[name])[:most]
        return {name: found[name] for name in found if name in (first or list(found)[:most])}

    def _trace(self, pieces: NDArray[np.int64]) -> NDArray[np.int64]:
        """Nodes of one fracture in the order of its trace, by the coordinate along its longest extent.

        Pieces may have nodes of their own, several at one place; the direction is that of the first piece.
        """
        if not len(pieces):
            return np.array([], dtype=np.int64)
        following = dict(zip(pieces[:, 0].tolist(), pieces[:, 1].tolist(), strict=True))
        starts = sorted(set(following) - set(following.values()))
        if len(following) == len(pieces) and len(starts) == 1:
            order = [starts[0]]
            while order[-1] in following:
                order.append(following[order[-1]])
            return np.array(order)
        nodes = np.unique(pieces)
        centred = self.points[nodes] - self.points[nodes].mean(axis=0)
        axis = np.linalg.svd(centred, full_matrices=False)[2][0]
        ends = self.points[pieces[0]]
        along = centred @ axis * np.sign((ends[1] - ends[0]) @ axis)
        return np.asarray(nodes[np.argsort(along, kind="stable")])


MOMENT = 0.02  # of the time that histories span


@dataclass(frozen=True)
class Abscissa:
    """Some ``steps`` of a history as they are drawn: values (n,), and the label of their axis."""

    steps: slice
    values: Floats
    label: str


@dataclass(frozen=True)
class RunData:
    """Data of the pictures. ``start`` is the step that the dynamics begin from, or else the last one to find equilibrium.

    energy_noise  round-off of the entries of the energy balance [energy per thickness]
    limit         the last limit point of the log, in words and its place [length]; None where there is none
    is_meshed     whether the rock has a mesh from the start, and not a map
    """

    title: str
    units: dict[str, str]
    history: dict[str, NDArray[Any]]
    probes: dict[str, tuple[float, float]]
    wells: dict[str, tuple[float, float]]
    events: list[dict[str, Any]]
    rock: list[Floats] | None
    fractures: FractureFields | None
    start: int
    has_dynamics: bool
    status: Status
    energy_noise: float = 0.0
    limit: tuple[str, tuple[float, float]] | None = None
    is_meshed: bool = True

    @property
    def is_behind(self) -> bool:
        """Whether the histories continue after the last written fields."""
        return self.fractures is not None and self.fractures.step < len(self.history["time"]) - 1

    @property
    def was_unmeshed(self) -> bool:
        """Whether rock may have had no mesh until an event needed one."""
        return "energy/change_of_rock" in self.history

    def slipped_since(self) -> list[str]:
        """Names of the fractures that began to slip after the last fields that were written."""
        since = self.fractures.time if self.fractures is not None else -np.inf
        return sorted({e["fracture"] for e in self.events if e["kind"] == "slip" and e["start"] >= since})

    @property
    def account(self) -> str:
        """A line on the status of the run, and the times of its pictures."""
        reached = self.at(float(self.history["time"][-1]))
        words = {
            "": f"Histories to {reached}",
            RUNNING: f"Under way: histories to {reached}",
            ENDED: f"Ended at {reached}",
            STOPPED: f"Stopped at {reached}; fracflow resume goes on",
            FAILED: f"Failed after {reached}: no state beyond it was found",
            CUT_OFF: f"Cut off (killed): histories to {reached}; fracflow resume goes on",
        }
        line = words.get(self.status.word, words[""])
        if not self.is_behind or self.fractures is None:
            return line
        return f"{line}. Map and profiles are older: of {self.at(self.fractures.time)}, step {self.fractures.step}"

    def at(self, time: float) -> str:
        """A time in the unit that suits it; of a scene without units a plain number after the word."""
        text = shown(TIME, time, self.units, 6)
        return text if self.units.get("time") else f"time {text}"

    @property
    def settled(self) -> slice:
        """The steps from the last one at the time the run began: a search that takes no time comes before it."""
        time = self.history["time"]
        return slice(int(np.flatnonzero(time == time[0])[-1]) if np.ptp(time) > 0.0 else 0, None)

    def times(self, steps: slice) -> Abscissa:
        """Time, or the step's number if no time passes."""
        time = self.history["time"][steps]
        if not len(time) or np.ptp(time) == 0.0:
            return Abscissa(steps, self._numbers(steps), "step")
        scale = axis_of(TIME, [time], self.units)
        return Abscissa(steps, scale(time), scale.label("time"))

    def abscissa(self, steps: slice) -> Abscissa:
        """The same, and the step's number where half of the steps pass within a moment: over time they would be one line."""
        time = self.history["time"][steps]
        whole, half = float(np.ptp(time)) if len(time) else 0.0, len(time) // 2
        moment = float((time[half:] - time[: len(time) - half]).min()) if half and self.has_dynamics else whole
        if moment >= MOMENT * whole:
            return self.times(steps)
        words = (shown(TIME, each, self.units, 3) for each in (moment, whole))
        return Abscissa(steps, self._numbers(steps), f"step (half of them within {' of '.join(words)})")

    def _numbers(self, steps: slice) -> Floats:
        return np.arange(len(self.history["time"]), dtype=float)[steps]

    @cached_property
    def noise(self) -> dict[str, float]:
        """Dimension -> what round-off may leave of a quantity: smaller values are zero in a picture."""
        points = np.concatenate([np.zeros((0, 2)), *(cell.reshape(-1, 2) for cell in self.rock or [])])
        extent = float(np.ptp(points, axis=0).max()) if len(points) else 0.0
        steps = np.diff(self.history["time"])
        length = SLIP_ROUND_OFF * extent
        stresses = [np.abs(values[np.isfinite(values)]).max(initial=0.0) for key, values in self.history.items()
                    if dimension_of(key) == STRESS]  # fmt: skip
        found = {LENGTH: length, STRESS: STRESS_ROUND_OFF * max(stresses, default=0.0), ENERGY: self.energy_noise}
        return found | {VELOCITY: length / float(np.median(steps[steps > 0.0]))} if np.any(steps > 0.0) else found

    def probes_with(self, quantity: str) -> list[str]:
        """Names of the probes that have a quantity, in the order of the file."""
        tail = f"/{quantity}"
        keys = (key for key in self.history if key.startswith("probe/") and key.endswith(tail))
        return [key[len("probe/") : -len(tail)] for key in keys]

    def probe(self, name: str, quantity: str) -> Floats:
        """(steps,) a probe's quantity; of a vector, its component along the largest of all steps."""
        values = self.history[f"probe/{name}/{quantity}"]
        if values.ndim == 1:
            return values
        flat = values.reshape(len(values), -1)
        largest = flat[int(np.linalg.norm(flat, axis=1).argmax())] if len(flat) else np.zeros(flat.shape[1])
        along = largest / (np.linalg.norm(largest) or 1.0)
        return np.asarray(flat @ along * (-1.0 if along[np.abs(along).argmax()] < 0.0 else 1.0))

    def first_events(self) -> list[dict[str, Any]]:
        """The events of slip that started first."""
        slips = [event for event in self.events if event["kind"] == "slip"]
        earliest = min((event["start"] for event in slips), default=0.0)
        return [event for event in slips if event["start"] == earliest]


def without_round_off(slip: Floats, points: Floats) -> Floats:
    """Sizes of slip, 0 where they are round-off of displacements in a domain that has these points (n, dim) [length]."""
    size = np.abs(slip)
    return np.where(size <= SLIP_ROUND_OFF * np.ptp(points, axis=0).max(), 0.0, size)


def load_run_data(folder: str | Path) -> RunData:
    """Read a run folder. Raises InputError if it has no history with a step in it."""
    folder = Path(folder)
    check_own(folder)
    history, attrs = read_history(folder / "history.h5"), read_attributes(folder / "history.h5")
    if not len(history.get("time", ())):
        raise InputError(f"{folder}: has no finished step; run it first")
    _check_sizes(folder / "history.h5", history)
    kind = history.get("step/kind", np.array([]))
    dynamic, found = np.flatnonzero(kind == _DYNAMIC), np.flatnonzero(kind == _EQUILIBRATE)
    start = (
        max(0, int(dynamic[0]) - 1) if len(dynamic) else int(found[-1]) if len(found) < len(kind) and len(found) else 0
    )
    events = read_events(folder / "events.csv") if (folder / "events.csv").exists() else []
    seen = {event["probe"]: (event["x"], event["y"]) for event in events if event["probe"]}
    return RunData(
        title=str(attrs.get("title") or folder.resolve().name),
        units={key: plain(unit) for key, unit in read_units(folder / "history.h5", attrs).items()},
        history=history,
        probes=_places(folder, attrs, "probes") or seen,
        wells=_places(folder, attrs, "wells"),
        events=events,
        rock=_rock(folder),
        fractures=load_fractures(folder, float(history["time"][start])),
        start=start,
        has_dynamics=bool(len(dynamic)),
        status=read_status(folder),
        energy_noise=_number(attrs.get("energy_noise")) * len(history["time"]),
        limit=last_limit(log_of(folder)),
        is_meshed=_is_meshed(folder),
    )


def _is_meshed(folder: Path) -> bool:
    """Whether the rock of a run has a mesh from the start: the plan may have left out that of the scene."""
    try:
        return has_cells(folder / "mesh.h5")
    except InputError:
        return True


def log_of(folder: Path) -> list[str]:
    """The lines of the log; none where it cannot be read."""
    try:
        return read_text(folder / "log.txt", "look at the file").splitlines()
    except InputError:
        return []


def _number(value: Any) -> float:
    """A number of the history's attributes; 0 for anything else, as earlier versions had none."""
    return float(value) if isinstance(value, int | float | np.number) and np.isfinite(value) else 0.0


def _places(folder: Path, attrs: dict[str, Any], key: str) -> dict[str, tuple[float, float]]:
    try:
        found = read_table(folder / "history.h5", key, attrs)
        places = {name: (float(at[0]), float(at[1])) for name, at in found.items()}
        _check_sizes(folder / "history.h5", {name: np.array(at) for name, at in places.items()})
        return places
    except (TypeError, ValueError, LookupError):
        raise InputError(
            f"{folder / 'history.h5'}: its attribute {key} holds no places; name the folder of a run"
        ) from None


def _rock(folder: Path) -> list[Floats] | None:
    if not (folder / "fields" / "rock_mesh.h5").exists():
        return None
    points, cells, _ = _drawn_mesh(folder, "rock")
    sizes = (cells >= 0).sum(axis=1)
    blocks = [points[cells[sizes == size, :size], :2] for size in np.unique(sizes)]
    return [cell for block in blocks for cell in block]


def load_fractures(folder: Path, start: float) -> FractureFields | None:
    """Fields of the fractures at a time ``start`` and the last; None where none were written. Raises InputError."""
    steps = list_steps(folder, "fractures")
    if not steps or not (folder / "fields" / "fractures_mesh.h5").exists():
        return None
    points, cells, attrs = _drawn_mesh(folder, "fractures")
    times = np.array([read_time(path) for _, path in steps])
    # The steps of a steady stage may share their time: the last of them is where the dynamics begin.
    first = max(0, int(np.searchsorted(times, start, side="right")) - 1)
    time, after, cell_data = read_step(steps[-1][1])
    before = read_step(steps[first][1])[1] if first < len(steps) - 1 else {}
    for path, data, rows in (
        (steps[-1][1], after, len(points)),
        (steps[-1][1], cell_data, len(cells)),
        (steps[first][1], before, len(points)),
    ):
        _check_rows(path, data, rows)
    fracture = np.asarray(cell_data.get("fracture", np.zeros(len(cells))), dtype=np.int64)
    highest = int(fracture.max(initial=-1)) + 1
    names = _names(folder, attrs) or [f"fracture {i + 1}" for i in range(highest)]
    begins, step = float(times[first]), steps[-1][0]
    return FractureFields(points[:, :2], cells[:, :2], fracture, names, before, after, begins, time, step)


def _largest(after: Floats, before: Floats | None) -> float:
    """Largest size of a field (n, ...), or of its change."""
    return float(np.nan_to_num(np.abs(after if before is None else after - before)).max())


def _drawn_mesh(folder: Path, name: str) -> tuple[Floats, NDArray[np.int64], dict[str, Any]]:
    found = read_mesh(folder, name)
    _check_sizes(folder / "fields" / f"{name}_mesh.h5", {"points": found[0]})
    return found


def _check_sizes(path: Path, arrays: dict[str, NDArray[Any]]) -> None:
    """Raise InputError where a number is too large for axes, which no run reaches."""
    for name, values in arrays.items():
        if np.any(np.isfinite(values) & (np.abs(values) > LARGEST)):
            raise InputError(
                f"{path}: {name} has values above {LARGEST:g}, too large for a picture; put back a copy of the file"
            )


def _check_rows(path: Path, data: dict[str, NDArray[Any]], rows: int) -> None:
    for name, values in data.items():
        if values.shape[:1] != (rows,) or (rows and not values.size):
            raise InputError(
                f"{path}: {name} has the shape {values.shape}, not {rows} rows; put back a copy of the file"
            )
    _check_sizes(path, data)


def _names(folder: Path, attrs: dict[str, Any]) -> list[str]:
    """Names of fractures in the mesh of the fields; none where it has none. Raises InputError for other values."""
    stored = attrs.get("fractures", attrs.get("names"))
    if not stored:
        return []
    try:
        found = json.loads(stored)
    except (ValueError, TypeError, RecursionError):
        found = None
    if isinstance(found, list) and all(isinstance(name, str) and not steers(name) for name in found):
        return found
    path = folder / "fields" / "fractures_mesh.h5"
    raise InputError(f"{path}: its fractures are no names; put back a copy of the file")
