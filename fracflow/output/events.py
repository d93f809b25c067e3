"""events.csv: when and where fractures slipped or opened; of stages auto also a row for each event as a whole.

Contact chatters where fracture nodes open and close from step to step, unlike in any wave that the steps resolve.
"""

from __future__ import annotations

import csv
import io
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import isnan
from pathlib import Path
from time import monotonic
from time import process_time as time_of_process
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fracflow.errors import InputError
from fracflow.scene.quantities import component_names, magnitude
from fracflow.storage.files import fresh, read_text, replacing, steers

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
_WHOLE = len(_KINDS)  # number of the kind of a whole event
_OF_PLACE = ("kind", "fracture", "node", "probe", "x", "y")

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


class _Rows:
    """Rows of events.csv as columns, some 50 bytes each; those of whole events have a mapping besides."""

    def __init__(self, tangents: int) -> None:
        numbers = [(name, "f8") for name in ("start", LATEST, "end", "peak_slip_rate")]
        self._columns = np.zeros(0, [("kind", "i1"), ("place", "i4"), *numbers, ("slip", "f8", (tangents,))])
        self._count = 0
        self.whole: dict[int, dict[str, Any]] = {}

    def __len__(self) -> int:
        return self._count

    @property
    def columns(self) -> NDArray[Any]:
        """Columns (n,) by their names: number of the kind, row in the table of nodes; NaN stands for none."""
        return self._columns[: self._count]

    def add(self, count: int) -> NDArray[Any]:
        """The columns (count,) of as many more rows, to be filled."""
        self._count += count
        if self._count > len(self._columns):
            more = np.zeros(max(self._count, 2 * len(self._columns)) - len(self._columns), self._columns.dtype)
            self._columns = np.concatenate([self._columns, more])
        return self._columns[self._count - count : self._count]

    def table(self) -> Floats:
        """All columns (n, 6 + dim-1) as numbers."""
        found = self.columns
        return np.column_stack([found[name] for name in found.dtype.names or ()]).astype(float)

    def restore(self, table: Floats) -> None:
        """Add the rows of a ``table``. Raises ValueError for one of another shape."""
        into, at = self.add(len(table)), 0
        for name in into.dtype.names or ():
            width = int(np.prod(into.dtype[name].shape, dtype=np.int64))
            into[name] = table[:, at : at + width].reshape(into[name].shape)
            at += width


SHARE = 100.0  # times the CPU that writing the file took lie between two such times, once that was ``LONG`` in all
LONG = 0.01  # [s]
_ROWS_AT_ONCE = 1000


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
        self._rows = _Rows(tangents)
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
        starts = []
        for kind, now in (("slip", np.asarray(sliding, bool)), ("open", np.asarray(is_open, bool))):
            running = self._running[kind]
            was = running.row >= 0
            running.peak_rate = np.where(was | now, np.fmax(running.peak_rate, speed), 0.0)
            starts += [(kind, np.flatnonzero(now & ~was))]
            if len(ends := np.flatnonzero(was & ~now)):
                self._measure(running, ends, plastic_slip)
                self._rows.columns["end"][running.row[ends]] = time
                running.row[ends], running.peak_rate[ends], changed = -1, 0.0, True
        changed = changed or any(len(places) for _, places in starts)
        self._start(starts, began, time)
        self._plastic_slip = plastic_slip
        self._is_behind = self._is_behind or changed
        if self._is_behind and monotonic() - self._written >= self._rest:
            self._write()
        return changed

    def _vectors(self, values: ArrayLike) -> Floats:
        """Values at the nodes as (n, dim-1), a copy."""
        return np.array(values, dtype=float).reshape(self._shape)

    def add(self, event: Mapping[str, Any]) -> None:
        """A row of kind "event" from ``Catalogue``: ``place`` is the row of a node in the table of nodes."""
        self._add_whole(event)
        self._write()

    def _add_whole(self, event: Mapping[str, Any]) -> None:
        self._rows.whole[len(self._rows)] = dict(event)
        self._rows.add(1)[0] = (_WHOLE, event["place"], *[np.nan] * 4, np.full(self._shape[1], np.nan))

    def close(self, unfinished: Mapping[str, Any] | None = None) -> None:
        """Write the file with the latest slip of events under way, and the row of an ``unfinished`` event.

        That row is not stored in a checkpoint: a restarted run replaces it.
        """
        self._write([] if unfinished is None else [unfinished])

    def memory(self) -> dict[str, Any]:
        """Its data for a checkpoint: arrays ``rows`` and ``nodes`` of numbers, and mappings of whole events."""
        of_kinds = [
            part for running in self._running.values() for part in (running.row, running.slip_before, running.peak_rate)
        ]
        nodes = np.column_stack([self._plastic_slip, *of_kinds]).astype(float)
        return {"rows": self._measured().table(), "nodes": nodes, "whole": list(self._rows.whole.items())}

    def remember(self, memory: Mapping[str, Any]) -> None:
        """Go on from what ``memory`` gave, or its rows as lists of mappings, as earlier versions kept them."""
        self._rows = _Rows(self._shape[1])
        if "nodes" in memory:
            self._rows.restore(memory["rows"])
            self._rows.whole = {int(number): dict(event) for number, event in memory["whole"]}
            width = self._shape[1]
            slip, *parts = np.split(memory["nodes"], np.cumsum([width, *(1, width, 1) * 2])[:-1], axis=1)
            for kind, found in zip(_KINDS, (parts[:3], parts[3:]), strict=True):
                row, before, peak = found
                self._running[kind] = _Running(row[:, 0].astype(np.int64), self._vectors(before), peak[:, 0].copy())
        else:
            slip = memory["plastic_slip"]
            self._restore_mappings(memory["rows"])
            for kind, old in memory["running"].items():
                row, peak = np.array(old["row"], dtype=np.int64), np.array(old["peak_rate"], dtype=float)
                self._running[kind] = _Running(row, self._vectors(old["slip_before"]), peak)
        self._plastic_slip = self._vectors(slip)
        self._write()

    def _restore_mappings(self, rows: Sequence[Mapping[str, Any]]) -> None:
        nodes, slips = self.nodes, component_names("slip", "shear", self._shape[1])
        places = {key: place for place, key in enumerate(zip(nodes.fracture, nodes.node.tolist(), strict=True))}
        for row in rows:
            place = places[row["fracture"], row["node"]]
            if row["kind"] not in _KINDS:
                self._add_whole({**{name: row[name] for name in row if name not in _OF_PLACE}, "place": place})
                continue
            times = [np.nan if row.get(name) is None else row[name] for name in ("start", LATEST, "end")]
            slip = [row[name] for name in slips]
            self._rows.add(1)[0] = (_KINDS.index(row["kind"]), place, *times, row["peak_slip_rate"], slip)

    def _start(self, starts: Sequence[tuple[str, NDArray[np.int64]]], began: float, latest: float) -> None:
        """Rows for nodes (k,) of each kind, in the order of the nodes of the mesh."""
        kind = np.repeat([_KINDS.index(name) for name, _ in starts], [len(places) for _, places in starts])
        place = np.concatenate([places for _, places in starts])
        order = np.lexsort((kind, place, self.nodes.node[place]))
        first, rows = len(self._rows), self._rows.add(len(order))
        rows["kind"], rows["place"], rows["start"], rows[LATEST], rows["end"] = (
            kind[order], place[order], began, latest, np.nan,
        )  # fmt: skip
        for number, name in enumerate(_KINDS):
            running, here = self._running[name], np.flatnonzero(rows["kind"] == number)
            there = rows["place"][here]
            running.row[there], running.slip_before[there] = first + here, self._plastic_slip[there]

    def _measured(self) -> _Rows:
        """The rows, with the latest slip of events under way."""
        for running in self._running.values():
            self._measure(running, np.flatnonzero(running.row >= 0), self._plastic_slip)
        return self._rows

    def _measure(self, running: _Running, places: NDArray[np.int64], plastic_slip: Floats) -> None:
        rows = running.row[places]
        self._rows.columns["slip"][rows] = plastic_slip[places] - running.slip_before[places]
        self._rows.columns["peak_slip_rate"][rows] = running.peak_rate[places]

    def rows(self, unfinished: Sequence[Mapping[str, Any]] = ()) -> Iterator[dict[str, Any]]:
        """The rows with the latest slip as mappings, one by one, and behind them those of ``unfinished`` events."""
        heads = columns_of(self._shape[1])
        for row in self._values(unfinished):
            yield dict(zip(heads, row, strict=True))

    def _values(self, unfinished: Sequence[Mapping[str, Any]] = ()) -> Iterator[list[Any]]:
        """The values of each row in the order of the columns of the file."""
        nodes, rows, none = self.nodes, self._measured(), [None] * len(OF_EVENTS)
        for first in range(0, len(rows), _ROWS_AT_ONCE):
            part = rows.columns[first : first + _ROWS_AT_ONCE]
            place = part["place"]
            numbers = (nodes.node, nodes.x, nodes.y)
            at = [each[place].tolist() for each in numbers]
            start, latest, end = (
                [None if isnan(t) else t for t in part[key].tolist()] for key in ("start", LATEST, "end")
            )
            values = zip(part["kind"].tolist(), place.tolist(), *at, start, latest, end,
                part["slip"].tolist(), part["peak_slip_rate"].tolist(), strict=True)  # fmt: skip
            for number, (kind, i, node, x, y, starts, until, ends, slip, peak) in enumerate(values, first):
                if kind == _WHOLE:
                    yield self._of(rows.whole[number])
                    continue
                where = [_KINDS[kind], nodes.fracture[i], node, nodes.probe[i], x, y]
                yield [*where, starts, ends, *slip, peak, *none, until]
        yield from map(self._of, unfinished)

    def _of(self, event: Mapping[str, Any]) -> list[Any]:
        nodes, i = self.nodes, event["place"]
        at = {"fracture": nodes.fracture[i], "node": int(nodes.node[i]), "probe": nodes.probe[i]}
        row = {"kind": "event", **at, "x": float(nodes.x[i]), "y": float(nodes.y[i]), **event}
        return [row.get(name) for name in columns_of(self._shape[1])]

    def _write(self, unfinished: Sequence[Mapping[str, Any]] = ()) -> None:
        began = time_of_process()
        with replacing(self.path) as part, fresh(part).open("w", encoding="utf-8", newline="") as file:
            table = csv.writer(file, lineterminator="\n")
            table.writerow(columns_of(self._shape[1]))
            table.writerows(self._values(unfinished))
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
