"""events.csv: when and where fractures slipped or opened; of stages auto also a row for each event as a whole.

Contact chatters where fracture nodes open and close from step to step, unlike in any wave that the steps resolve.
"""

from __future__ import annotations

import csv
import io
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import monotonic
from time import process_time as time_of_process
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fracflow.errors import InputError
from fracflow.output.folder import write_atomic
from fracflow.scene.quantities import component_names, magnitude, one_less, with_components
from fracflow.storage.files import read_text, steers

OF_EVENTS = (
    "sections", "length", "mean_slip", "stress_drop", "moment", "magnitude", "radiated", "dissipated", "dropped",
    "unclosed", "injected",
)  # fmt: skip
"""Columns that only rows of kind "event" have; their place is the fastest section as they begin, their slip the largest."""
_NUMBERS = ("x", "y", "start", "end", "slip", "peak_slip_rate")
_BEFORE = ("kind", "fracture", "node", "probe", *_NUMBERS, *OF_EVENTS)  # version 0.1.0
LATEST = "start_latest"
"""Until when what slips or opens may have begun: ``start`` where that instant was found, else the end of its step."""
COLUMNS = (*_BEFORE, LATEST)
_KINDS = ("open", "slip")

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]


@dataclass(frozen=True)
class FractureNodes:
    """Where each fracture node is.

    fracture  (n,)  name of the fracture
    node      (n,)  number of the node in the scene's mesh
    x, y      (n,)  coordinates [length]
    probe     (n,)  name of the probe there, "" for none
    """

    fracture: Sequence[str]
    node: NDArray[np.int64]
    x: Floats
    y: Floats
    probe: Sequence[str]


@dataclass
class _Running:
    """Events of one kind now under way: row (n,), -1 at a node that has none, slip (n, dim-1) before, peak rate (n,)."""

    row: NDArray[np.int64]
    slip_before: Floats
    peak_rate: Floats


SHARE = 100.0  # times the CPU that writing the file took lie between two such times, once that was ``LONG`` in all
LONG = 0.01  # [s]


class EventLog:
    """Log of events: one is a fracture node from its first slipping (or open) section to none.

    path          the CSV file, rewritten as a whole when an event starts or ends. Once that has taken long, it may be behind:
                  ``SHARE`` times as long lie between; after the last step it has all
    nodes         static table of the n fracture nodes
    plastic_slip  (n, dim-1) before the first update; zero if not given [length]
    tangents      dim-1
    """

    def __init__(
        self, path: str | Path, nodes: FractureNodes, plastic_slip: Floats | None = None, tangents: int = 1
    ) -> None:
        self._shape = (len(nodes.node), tangents)
        self.path = Path(path)
        self.nodes = nodes
        self.rows: list[dict[str, Any]] = []
        self._lines: dict[int, str] = {}  # of rows that have ended, which stay as they are
        self._spent = self._rest = self._written = 0.0
        self._is_behind = False
        self._plastic_slip = np.zeros(self._shape) if plastic_slip is None else self._vectors(plastic_slip)
        count = len(nodes.node)
        self._running = {kind: _Running(np.full(count, -1), np.zeros(self._shape), np.zeros(count)) for kind in _KINDS}
        self._write()

    def update(
        self,
        time: float,
        sliding: Flags,
        is_open: Flags,
        plastic_slip: Floats,
        slip_rate: Floats,
        began: float | None = None,
    ) -> bool:
        """Record one accepted step; return whether an event started or ended.

        time          at the end of the step [time]
        began         earliest time at which its slip or opening may have begun, ``time`` if not given [time]
        sliding       (n,) whether any section at the node slides
        is_open       (n,) whether any section at the node is open
        plastic_slip  (n, dim-1) signed, top minus bottom [length]
        slip_rate     (n, dim-1) signed [length/time]
        """
        changed, plastic_slip, speed = False, self._vectors(plastic_slip), magnitude(self._vectors(slip_rate))
        began = time if began is None else began
        starts: list[tuple[int, str]] = []
        for kind, now in (("slip", np.asarray(sliding, bool)), ("open", np.asarray(is_open, bool))):
            running = self._running[kind]
            was = running.row >= 0
            running.peak_rate = np.where(was | now, np.fmax(running.peak_rate, speed), 0.0)
            starts += [(int(i), kind) for i in np.flatnonzero(now & ~was)]
            for i in np.flatnonzero(was & ~now):
                self._measure(kind, int(i), plastic_slip)
                self.rows[running.row[i]]["end"] = float(time)
                running.row[i], running.peak_rate[i], changed = -1, 0.0, True
        for i, kind in sorted(starts, key=lambda start: (self.nodes.node[start[0]], start)):
            self._start(kind, i, began, time)
        self._plastic_slip = plastic_slip
        changed = changed or bool(starts)
        self._is_behind = self._is_behind or changed
        if self._is_behind and monotonic() - self._written >= self._rest:
            self._write()
        return changed

    def _vectors(self, values: ArrayLike) -> Floats:
        """Values at the nodes as (n, dim-1), a copy."""
        return np.array(values, dtype=float).reshape(self._shape)

    def add(self, event: Mapping[str, Any]) -> None:
        """A row of kind "event" from ``Catalogue``: ``place`` is the row of a node in the table of nodes."""
        self.rows.append(self._of(event))
        self._write()

    def close(self, unfinished: Mapping[str, Any] | None = None) -> None:
        """Write the file with the latest slip of events under way, and the row of an ``unfinished`` event.

        That row is not stored in a checkpoint: a restarted run replaces it.
        """
        self._write([self._of(unfinished)] if unfinished is not None else [])

    def _of(self, event: Mapping[str, Any]) -> dict[str, Any]:
        return {"kind": "event", **self._place(event["place"])} | {k: v for k, v in event.items() if k != "place"}

    def memory(self) -> dict[str, Any]:
        """Its data for a checkpoint, as plain lists."""
        running = {
            kind: {
                "row": found.row.tolist(),
                "slip_before": one_less(found.slip_before).tolist(),
                "peak_rate": found.peak_rate.tolist(),
            }
            for kind, found in self._running.items()
        }
        return {"rows": self.rows, "plastic_slip": one_less(self._plastic_slip).tolist(), "running": running}

    def remember(self, memory: Mapping[str, Any]) -> None:
        """Go on from what ``memory`` gave."""
        self.rows, self._lines = [dict(row) for row in memory["rows"]], {}
        self._plastic_slip = self._vectors(memory["plastic_slip"])
        for kind, found in memory["running"].items():
            row, peak_rate = np.array(found["row"], dtype=np.int64), np.array(found["peak_rate"], dtype=float)
            self._running[kind] = _Running(row, self._vectors(found["slip_before"]), peak_rate)
        self._write()

    def _start(self, kind: str, i: int, began: float, latest: float) -> None:
        running = self._running[kind]
        running.row[i], running.slip_before[i] = len(self.rows), self._plastic_slip[i]
        since = {"start": float(began), LATEST: float(latest), "end": None, "peak_slip_rate": 0.0}
        none = with_components("slip", np.zeros(self._shape[1]))
        self.rows.append({"kind": kind, **self._place(i), **since, **none})

    def _place(self, i: int) -> dict[str, Any]:
        nodes = self.nodes
        at = {"fracture": nodes.fracture[i], "node": int(nodes.node[i]), "probe": nodes.probe[i]}
        return {**at, "x": float(nodes.x[i]), "y": float(nodes.y[i])}

    def _measure(self, kind: str, i: int, plastic_slip: Floats) -> None:
        running = self._running[kind]
        row = self.rows[running.row[i]]
        row.update(with_components("slip", plastic_slip[i] - running.slip_before[i]))
        row["peak_slip_rate"] = float(running.peak_rate[i])

    def _write(self, besides: Sequence[dict[str, Any]] = ()) -> None:
        began = time_of_process()
        for kind, running in self._running.items():
            for i in np.flatnonzero(running.row >= 0):
                self._measure(kind, int(i), self._plastic_slip)
        text = io.StringIO()
        table = csv.DictWriter(text, columns_of(self._shape[1]), lineterminator="\n")
        table.writeheader()
        under_way = {int(i) for running in self._running.values() for i in running.row}
        for number, row in enumerate(self.rows):
            if number in self._lines:
                text.write(self._lines[number])
                continue
            begin = text.tell()
            table.writerow(row)
            if number not in under_way:
                self._lines[number] = text.getvalue()[begin:]
        table.writerows(besides)
        write_atomic(self.path, text.getvalue())
        self._written, self._is_behind = monotonic(), False
        spent = time_of_process() - began
        self._spent += spent
        self._rest = SHARE * spent if self._spent > LONG else 0.0


def columns_of(tangents: int) -> tuple[str, ...]:
    """Heads of the columns of a file whose slip has so many components."""
    slip = component_names("slip", "shear", tangents)
    return tuple(name for head in COLUMNS for name in (slip if head == "slip" else [head]))


def read_events(path: str | Path) -> list[dict[str, Any]]:
    """Read events.csv: one dict an event, numbers as numbers, None for ``end`` while it is under way and where there is none.

    A file of version 0.1.0 has no ``start_latest``: None. Raises InputError if the file is missing, has other columns, or a
    row that no run writes.
    """
    table = csv.reader(io.StringIO(read_text(Path(path), "name an events.csv of a run"), newline=""))
    rows: list[dict[str, Any]] = []
    try:
        heads = tuple(next(table, ()))
        if heads not in (COLUMNS, columns_of(2), _BEFORE):
            raise InputError(f"{path}: columns are {', '.join(heads)[:200]}, should be {', '.join(COLUMNS)}")
        rows.extend(_typed(row, heads) for row in table if row)
    except (ValueError, csv.Error) as error:
        raise InputError(f"{path}: row {len(rows) + 1} is no event ({error}); put back a copy of the file") from None
    return rows


def _typed(row: list[str], heads: Sequence[str]) -> dict[str, Any]:
    if any(steers(word) for word in row):
        raise ValueError("control characters")
    heads = [*dict.fromkeys((*heads, LATEST))]
    texts = dict(zip(heads, [*row, *[""] * (len(heads) - len(row))], strict=True))
    numbers = [name for name in texts if name not in ("kind", "fracture", "node", "probe")]
    lacking = {name for name in ("end", *OF_EVENTS, LATEST) if not texts[name]}
    found = {name: None if name in lacking else float(texts[name]) for name in numbers}
    return {**texts, **found, "node": int(texts["node"])}


STEPS = 20  # of a stage that are looked at together
CHANGES = 6  # of a node within them: a resolved contact would not open and close three times


class Chatter:
    """Counts how often each of the nodes, given by the names of their fractures, opens and closes; one report a stage."""

    def __init__(self, fractures: Sequence[str]) -> None:
        self._fractures = list(fractures)
        self._stage, self._is_reported = -1, False
        self._before: NDArray[np.bool_] | None = None
        self._changes: deque[NDArray[np.bool_]] = deque(maxlen=STEPS)

    def update(self, stage: int, is_open: NDArray[np.bool_]) -> str:
        """Count a step of a stage with the nodes (n,) that are open at its end; a line to report, mostly empty."""
        if stage != self._stage:
            self._stage, self._is_reported = stage, False
            self._changes.clear()
        if self._before is not None:
            self._changes.append(is_open != self._before)
        self._before = is_open.copy()
        if self._is_reported or not len(is_open) or not self._changes:
            return ""
        counts = np.sum(np.array(self._changes), axis=0)
        worst = int(np.argmax(counts))
        if counts[worst] < CHANGES:
            return ""
        self._is_reported = True
        return (
            f"contact opened and closed {counts[worst]} times in {len(self._changes)} steps on {self._fractures[worst]}"
        )
