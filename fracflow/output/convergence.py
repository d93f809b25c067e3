"""What levels of refinement tell about each other: observed orders, estimated errors, and where neither can be trusted.

Of quantities q_0, q_1, q_2, each of half the mesh size and step, p = log2(|q_0 - q_1|/|q_1 - q_2|) is the order that was
observed, and |q_1 - q_2|/(2^p - 1) the error of the last (Richardson 1911; Roache 1998).
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fracflow.output.events import read_events
from fracflow.output.folder import to_json, write_atomic
from fracflow.output.history import read_history

Floats = NDArray[np.float64]
Histories = dict[str, Floats]

ORDER_OF_MESH = 2.0
OF_GRADIENTS = 1.0  # the least that quantities have which derive from displacements
GRADIENTS = ("strain", "stress", "shear_traction", "normal_traction", "strength", "flow_rate")
LATITUDE, ABOVE = 0.3, 0.6  # of observed orders below the least and above the highest that a method has
ROUND_OFF = 1e-9  # of the largest quantity of its kind: smaller differences tell nothing
SAME_TIME = 1e-9  # of the time span
MOST_COMMON = 0.5  # of the coarsest level's times that must be everywhere, or all are interpolated
NO_RESULTS = ("residual", "residual_closed")


@dataclass(frozen=True)
class Row:
    """How a quantity converges.

    kind         "probe", "energy", "control" or "event"
    least        the least order that its method has
    size         rms of the finest level over common times, in the scene's units, as are all that follow
    differences  rms of q_k - q_(k+1), level by level
    order        observed between the last three levels; of two levels, and where there is nothing to observe, nan
    error        estimated, of the finest level; nan where there is no estimate
    warning      why order and error are not to be trusted; "" where they are
    is_seen      whether differences are more than round-off
    """

    kind: str
    name: str
    least: float
    size: float
    differences: tuple[float, ...] = ()
    order: float = float("nan")
    error: float = float("nan")
    warning: str = ""
    is_seen: bool = True

    @property
    def relative(self) -> float:
        """The error over the size."""
        return self.error / self.size if self.size > 0.0 else float("nan")


def compare(folders: Sequence[Path], order: int) -> list[Row]:
    """A row for each quantity of each probe, energy, control and first event of the runs, coarsest first.

    order  that of the rules in time. Raises InputError for a folder without its run.
    """
    histories = [_by_time(read_history(folder / "history.h5")) for folder in folders]
    times = _common_times([history["time"] for history in histories])
    least = min(float(order), ORDER_OF_MESH)
    rows = list(_sampled(histories, times, least))
    span = float(np.ptp(histories[-1]["time"])) or 1.0
    return rows + list(_events(folders, least, span))


def judged(row: Row, scale: float) -> Row:
    """The row with order, error and warning from its differences; ``scale`` is the largest of its kind."""
    last = row.differences[-1]
    if max(row.differences) <= ROUND_OFF * scale:
        return replace(row, error=last, is_seen=False)
    if len(row.differences) == 1:
        return replace(row, error=last / (2.0**row.least - 1.0))
    before = row.differences[-2]
    if not last < before:
        return replace(row, warning="differences do not fall")
    if last == 0.0:
        return replace(row, error=0.0)
    order = float(np.log2(before / last))
    row = replace(row, order=order, error=last / (2.0**order - 1.0))
    least = min(row.least, OF_GRADIENTS) if row.name.rpartition(" ")[2] in GRADIENTS else row.least
    if order < least - LATITUDE:
        return replace(row, warning=f"order below {least:g}: a jump, a singularity, or not yet fine enough")
    if order > ORDER_OF_MESH + ABOVE:
        return replace(row, warning=f"order above {ORDER_OF_MESH:g}: coarser levels are not fine enough to tell")
    return row


def _by_time(history: Histories) -> Histories:
    """The last record of each time; those of a search share theirs."""
    time = history["time"]
    last = np.flatnonzero(np.append(np.diff(time) > 0.0, True))
    return {key: np.asarray(values[last], dtype=float) for key, values in history.items()}


def _common_times(times: list[Floats]) -> Floats:
    """The coarsest level's times that all have; all of them up to the first end where few are."""
    coarsest, end = times[0], min(time[-1] for time in times)
    near = SAME_TIME * (float(np.ptp(coarsest)) or 1.0)
    within = coarsest[coarsest <= end + near]
    shared = np.ones(len(within), dtype=bool)
    for time in times[1:]:
        at = np.clip(np.searchsorted(time, within), 1, max(len(time) - 1, 1))
        nearest = np.minimum(np.abs(time[at - 1] - within), np.abs(time[np.minimum(at, len(time) - 1)] - within))
        shared &= nearest <= near
    return within[shared] if shared.mean() >= MOST_COMMON else within


def _sampled(histories: list[Histories], times: Floats, least: float) -> Iterator[Row]:
    """Rows of what has a history; components of a vector are taken together."""
    finest = histories[-1]
    keys = [key for key in finest if key.startswith(("probe/", "energy/", "step/control/"))]
    keys = [key for key in keys if all(key in history for history in histories)]
    rows = {}
    for key in keys:
        values = [_at(times, history["time"], history[key]) for history in histories]
        known = np.all([np.isfinite(each).all(axis=1) for each in values], axis=0)
        kind, _, name = key.removeprefix("step/").partition("/")
        if name in NO_RESULTS or not known.any():
            continue
        steps = tuple(_rms(fine[known] - coarse[known]) for coarse, fine in pairwise(values))
        place, _, quantity = name.rpartition("/")
        rows[key] = Row(kind, f"{place} {quantity}".strip(), least, _rms(values[-1][known]), steps)
    kinds = {key: (row.kind, row.name.rpartition(" ")[2] if row.kind == "probe" else "") for key, row in rows.items()}
    for key, row in rows.items():
        yield judged(row, max(other.size for name, other in rows.items() if kinds[name] == kinds[key]))


def _at(times: Floats, known: Floats, values: Floats) -> Floats:
    """(times, components) by linear interpolation, which is exact at the known times."""
    columns = values.reshape(len(known), -1)
    return np.stack([np.interp(times, known, column) for column in columns.T], axis=1)


def _rms(values: Floats) -> float:
    """Root of the mean square over times of a vector's length."""
    return float(np.sqrt((values**2).sum(axis=1).mean()))


def _events(folders: Sequence[Path], least: float, span: float) -> Iterator[Row]:
    """Rows of the first slip and opening of each fracture, and of those at all places that the coarsest level has."""
    levels = []
    for folder in folders:
        first: dict[tuple[str, str, float, float], float] = {}
        for event in read_events(folder / "events.csv"):
            first.setdefault((event["kind"], event["fracture"], event["x"], event["y"]), event["start"])
        levels.append(first)
    kinds = sorted({key[:2] for first in levels for key in first})
    for kind, fracture in kinds:
        name = f"{fracture} {'slips' if kind == 'slip' else 'opens'}"
        starts = [[start for key, start in first.items() if key[:2] == (kind, fracture)] for first in levels]
        absent = [str(level) for level, found in enumerate(starts) if not found]
        if absent:
            yield Row("event", name, least, np.nan, warning=f"not at level {', '.join(absent)}")
            continue
        yield _times(f"{name} first", np.array([[min(found)] for found in starts]), least, span)
        everywhere = [key for key in levels[0] if key[:2] == (kind, fracture) and all(key in each for each in levels)]
        if len(everywhere) > 1:
            times = np.array([[first[key] for key in everywhere] for first in levels])
            yield _times(f"{name} at {len(everywhere)} places", times, least, span)


def _times(name: str, times: Floats, least: float, span: float) -> Row:
    """Row of times (levels, places)."""
    rms = np.sqrt((times**2).mean(axis=1))
    steps = np.sqrt((np.diff(times, axis=0) ** 2).mean(axis=1))
    return judged(Row("event", name, least, float(rms[-1]), tuple(steps.tolist())), span)


def write(rows: Sequence[Row], folder: Path, order: int, levels: Sequence[Path]) -> list[Path]:
    """Write ``converge.csv`` and ``converge.json`` and return their paths."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    steps = [f"difference_{k}_{k + 1}" for k in range(len(levels) - 1)]
    table.writerow(["kind", "name", "size", *steps, "order", "error", "relative_error", "warning"])
    for row in rows:
        differences = row.differences or (np.nan,) * len(steps)
        table.writerow([row.kind, row.name, row.size, *differences, row.order, row.error, row.relative, row.warning])
    write_atomic(folder / "converge.csv", text.getvalue())
    found = {
        "levels": [path.name for path in levels],
        "order_of_method": order,
        "order_is": "observed" if len(levels) > 2 else "assumed",
        "quantities": [vars(row) | {"relative_error": row.relative} for row in rows],
    }
    write_atomic(folder / "converge.json", to_json(found, indent=2) + "\n")
    return [folder / "converge.csv", folder / "converge.json"]
