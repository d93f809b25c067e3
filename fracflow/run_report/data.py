"""The data of a run's report: all that its folder holds, in units a person would choose, and why the rest is missing."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fracflow.errors import InputError
from fracflow.mesh.data import SplitMesh
from fracflow.mesh.store import load_mesh
from fracflow.output.drawing.axes import power_of_ten, suited_unit
from fracflow.output.events import read_events
from fracflow.output.folder import MARKER, check_own
from fracflow.output.history import read_attributes, read_history, read_table, read_units
from fracflow.output.reader import LARGEST
from fracflow.output.status import Status, read_status
from fracflow.scene.scene import Scene, load
from fracflow.scene.units import TIME
from fracflow.storage.files import read_text, shown_plain

Floats = NDArray[np.float64]
T = TypeVar("T")

_COPY = "put back a copy of the file"
MOST_POINTS = 500  # of a line: more are closer than its pixels


def number(value: float, digits: int = 4) -> str:
    """A number to so many digits, with a power of ten where it is very large or small."""
    text = f"{value:.{digits - 1}e}"
    front, _, power = text.partition("e")
    if value == 0.0 or not math.isfinite(value) or -4 < int(power) < 5:
        text = f"{float(text):.{max(0, digits - 1 - int(power)) if math.isfinite(value) else 0}f}" if value else "0"
        text = text.rstrip("0").rstrip(".") if "." in text else text
    else:
        front = front.rstrip("0").rstrip(".") if "." in front else front
        text = f"{front}×{power_of_ten(int(power))}"
    return text.replace("-", "−")


@dataclass(frozen=True)
class Unit:
    """A unit that numbers of the run are shown in: their factor and its name."""

    factor: float
    name: str

    def label(self, word: str) -> str:
        """An axis label."""
        return f"{word} [{self.name}]" if self.name else word


@dataclass(frozen=True)
class Series:
    """A line of a chart: x and y (n,), and its look, "line", "dots" or "dash"."""

    name: str
    x: ArrayLike
    y: ArrayLike
    look: str = "line"

    def held(self) -> Series:
        """The same with each value held over the step that ends with it."""
        x, y = np.asarray(self.x, dtype=float), np.asarray(self.y, dtype=float)
        return replace(self, x=np.repeat(x, 2)[1:-1], y=np.repeat(y[1:], 2)) if len(x) > 1 else self


@dataclass(frozen=True)
class Chart:
    """A chart with the labels of its axes; ``span`` is what x reaches over at least."""

    title: str
    x: str
    y: str
    series: Sequence[Series]
    log_x: bool = False
    log_y: bool = False
    note: str = ""
    span: tuple[float, float] | None = None

    def as_record(self) -> dict[str, Any]:
        """For the page: points that are no numbers left out, digits that no eye sees too."""
        lines = []
        for one in self.series:
            x, y = thinned(np.asarray(one.x, dtype=float), np.asarray(one.y, dtype=float))
            lines.append({"name": one.name, "look": one.look, "x": rounded(x), "y": rounded(y)})
        axes: dict[str, Any] = {"x": self.x, "y": self.y, "logX": self.log_x, "logY": self.log_y}
        axes |= {"span": rounded(self.span)} if self.span else {}
        return {"title": self.title, **axes, "series": [line for line in lines if line["x"]]}

    @property
    def has_data(self) -> bool:
        """Whether any line has a point."""
        return any(line["x"] for line in self.as_record()["series"])


def thinned(x: Floats, y: Floats, most: int = MOST_POINTS) -> tuple[Floats, Floats]:
    """A line (n,) by the lowest and highest point of each of ``most`` parts of its length, its first and last point."""
    fits = np.isfinite(x) & np.isfinite(y) & (np.abs(x) < LARGEST) & (np.abs(y) < LARGEST)
    x, y = x[fits], y[fits]
    if len(x) <= 2 * most:
        return x, y
    place = np.floor((x - x.min()) / (np.ptp(x) or 1.0) * most * (1 - 1e-12)).astype(int)
    by_value = np.lexsort((y, place))
    edges = np.flatnonzero(np.diff(place[by_value], prepend=-1, append=-1))
    kept = np.unique(np.concatenate([[0, len(x) - 1], by_value[edges[:-1]], by_value[edges[1:] - 1]]))
    return x[kept], y[kept]


def rounded(values: ArrayLike) -> list[float]:
    """Numbers to six digits."""
    return [float(f"{value:.6g}") for value in np.asarray(values, dtype=float).tolist()]


@dataclass
class RunReport:
    """A run folder, read as far as it can be; ``faults`` are lines on what cannot.

    history  arrays (n, ...), without a step empty
    """

    folder: Path
    faults: list[str] = field(default_factory=list)
    history: dict[str, NDArray[Any]] = field(default_factory=dict)
    notes: dict[str, Any] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    wells: dict[str, tuple[float, float]] = field(default_factory=dict)
    probes: dict[str, tuple[float, float]] = field(default_factory=dict)
    scene: Scene | None = None
    scene_text: str = ""
    plan: list[dict[str, Any]] = field(default_factory=list)
    checks: list[dict[str, Any]] = field(default_factory=list)
    events: list[dict[str, Any]] = field(default_factory=list)
    mesh: SplitMesh | None = None
    log: list[str] = field(default_factory=list)
    status: Status = field(default_factory=Status)

    @property
    def title(self) -> str:
        """That of the scene, or the name of the folder."""
        own = self.scene.title if self.scene is not None else ""
        return shown_plain(str(self.notes.get("title") or own or self.folder.resolve().name))

    @cached_property
    def times(self) -> Floats:
        """(n,)."""
        return np.asarray(self.history.get("time", np.zeros(0)), dtype=float)

    @cached_property
    def settled(self) -> slice:
        """The states from the last one at the time the run began: a search that takes no time comes before it."""
        time = self.times
        return slice(int(np.flatnonzero(time == time[0])[-1]) if len(time) and np.ptp(time) > 0.0 else 0, None)

    @cached_property
    def clock(self) -> Unit:
        """The unit of time."""
        planned = max((float(stage.end) for stage in self.scene.stage if stage.end), default=0.0) if self.scene else 0.0
        return self.unit(TIME, float(self.times.max(initial=0.0)) or planned)

    @property
    def catalogue(self) -> list[dict[str, Any]]:
        """The rows of whole events."""
        return [event for event in self.events if event["kind"] == "event"]

    def unit(self, dimension: str, values: ArrayLike) -> Unit:
        """The unit that a person would choose for values of a dimension; the run's own where it is not SI."""
        sizes = np.abs(np.asarray(values, dtype=float))
        return Unit(*suited_unit(dimension, float(sizes[np.isfinite(sizes)].max(initial=0.0)), self.units))

    def shown(self, value: float | None, dimension: str, digits: int = 4) -> str:
        """A number with its unit."""
        if value is None or not math.isfinite(value):
            return "–"
        unit = self.unit(dimension, [value])
        return f"{number(value * unit.factor, digits)} {unit.name}".rstrip() if value else "0"

    def column(
        self, word: str, dimension: str, values: Sequence[float | None], digits: int = 4, unit: Unit | None = None
    ) -> tuple[str, list[str]]:
        """Head and cells of a column of numbers, in one unit that suits the largest, which the head has."""
        known = np.array([np.nan if value is None else value for value in values], dtype=float)
        unit = unit or self.unit(dimension, known)
        return unit.label(word), [number(unit.factor * each, digits) if np.isfinite(each) else "–" for each in known]

    def clock_text(self, time: float) -> str:
        """A time in the unit of the axes."""
        return f"{number(time * self.clock.factor)} {self.clock.name}".rstrip()

    @property
    def span(self) -> tuple[float, float] | None:
        """The time that has passed, in the unit of the axes."""
        time = self.times * self.clock.factor
        return (float(time[0]), float(time[-1])) if len(time) and time[-1] > time[0] else None

    def axis(self) -> tuple[Floats, str]:
        """Abscissa (s,) of the settled histories: time, or the number of the state if no time passes."""
        time = self.times[self.settled]
        if len(time) and np.ptp(time) > 0.0:
            return time * self.clock.factor, self.clock.label("time")
        return np.arange(len(self.times), dtype=float)[self.settled], "state"

    def over_time(
        self, title: str, word: str, dimension: str, lines: Mapping[str, NDArray[Any]], most: int = 8
    ) -> Chart:
        """A chart of histories (n,), at most so many: those that change most."""
        x, label = self.axis()
        cut = {name: np.asarray(values, dtype=float)[self.settled] for name, values in lines.items()}
        change = {name: float(np.ptp(v[np.isfinite(v)])) if np.isfinite(v).any() else 0.0 for name, v in cut.items()}
        chosen = sorted(cut, key=lambda name: -change[name])[:most]
        shown = {name: values for name, values in cut.items() if name in chosen}
        unit = self.unit(dimension, np.concatenate([np.zeros(1), *shown.values()]))
        more = f"The {most} of {len(cut)} that change most." if len(cut) > most else ""
        series = [Series(name, x, unit.factor * values) for name, values in shown.items()]
        return Chart(title, label, unit.label(word), series, note=more)

    def attempt(self, read: Callable[[], T], otherwise: Any) -> T:
        """The result of ``read``; where it raises InputError for a damaged file, ``otherwise`` and a line in ``faults``."""
        try:
            return read()
        except InputError as error:
            self.faults.append(shown_plain(" ".join(str(error).split())))
        result: T = otherwise
        return result


def read_run(folder: str | Path) -> RunReport:
    """Read a run folder, whatever it lacks. Raises InputError where it is none, or a link in it leads out of it."""
    run = RunReport(Path(folder))
    path = run.folder
    if not any((path / name).is_file() for name in (MARKER, "history.h5", "scene.toml")):
        raise InputError(f"{folder}: holds no run of fracflow; name the folder of one")
    check_own(path)
    run.status = read_status(path)
    if (path / "history.h5").is_file():
        history = run.attempt(lambda: read_history(path / "history.h5"), {})
        run.history = {name: np.asarray(values, dtype=float) for name, values in history.items()}
        run.notes = run.attempt(lambda: read_attributes(path / "history.h5"), {})
        run.units = run.attempt(lambda: read_units(path / "history.h5", run.notes), {})
        run.wells = run.attempt(lambda: _places(path, run.notes, "wells"), {})
        run.probes = run.attempt(lambda: _places(path, run.notes, "probes"), {})
    run.scene_text = run.attempt(lambda: read_text(path / "scene.toml", _COPY), "")
    if run.scene_text:
        run.scene = run.attempt(lambda: load(path / "scene.toml"), None)
    if run.scene is not None and not run.units:
        system = run.scene.unit_system
        run.units = {"length": system.length, "force": system.force, "time": system.time}
    if (path / "plan.json").is_file():
        run.plan, run.checks = run.attempt(lambda: _plan(path / "plan.json"), ([], []))
    if (path / "events.csv").is_file():
        run.events = run.attempt(lambda: read_events(path / "events.csv"), [])
    if (path / "mesh.h5").is_file():
        run.mesh = run.attempt(lambda: load_mesh(path / "mesh.h5"), None)
    if (path / "log.txt").is_file():
        log = run.attempt(lambda: read_text(path / "log.txt", "look at the file"), "")
        run.log = [shown_plain(line) for line in log.splitlines()]
    return run


def _places(folder: Path, notes: dict[str, Any], key: str) -> dict[str, tuple[float, float]]:
    file = folder / "history.h5"
    found = read_table(file, key, notes)
    try:
        places = {shown_plain(name): (float(at[0]), float(at[1])) for name, at in found.items()}
    except (TypeError, ValueError, LookupError):
        raise InputError(f"{file}: its attribute {key} holds no places; {_COPY}") from None
    return {name: at for name, at in places.items() if all(abs(each) < LARGEST for each in at)}


def _plan(path: Path) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    text = read_text(path, _COPY)
    try:
        found = json.loads(text)
        parts = [dict(row) for row in found["decisions"]], [dict(row) for row in found["card"]]
    except (TypeError, ValueError, LookupError, RecursionError):
        raise InputError(f"{path}: is no readable plan; {_COPY}") from None
    return parts
