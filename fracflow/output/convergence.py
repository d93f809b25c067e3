"""Comparison of levels of refinement: observed orders, estimated errors, and warnings where neither is reliable.

Of quantities q_0, q_1, q_2, each of half the mesh size and step, p = log2(|q_0 - q_1|/|q_1 - q_2|) is the order that was
observed, and |q_1 - q_2|/(2^p - 1) the error of the last (Richardson 1911; Roache 1998). That holds of an error c(t) h^p,
whose differences have one course in time, whatever the level. Where they have not, errors of mesh and steps cancel, or a
front is not resolved, and p is an accident. With two levels p is assumed: 1 where fractures have tips in rock (Strang
and Fix 1973), and of what derives from displacements, else the method's.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fracflow.output.events import read_events
from fracflow.output.export import unit_of, units_of_run
from fracflow.output.folder import to_json, write_atomic
from fracflow.output.history import read_history
from fracflow.scene.quantities import row_of

Floats = NDArray[np.float64]
Histories = dict[str, Floats]

ORDER_OF_MESH = 2.0
OF_SLOPES = OF_TIPS = 1.0  # the least of what derives from displacements, and of all where fractures end in rock
LATITUDE, ABOVE = 0.3, 0.6  # of observed orders below the least and above the highest that there is
LOWEST = min(OF_TIPS, OF_SLOPES) - LATITUDE  # slower falls give no order for an estimate of errors
JUMP = 0.6  # between successive orders
ALIKE = 0.95  # cosine of successive differences, as vectors over times: below it estimates may be any factor off
CHANGE_ROUND_OFF = 1e-9  # of the largest quantity of its kind: smaller differences are round-off
SAME_TIME = 1e-9  # of the time span
MOST_COMMON = 0.5  # of the coarsest level's times that must be everywhere, or all are interpolated
NO_RESULTS = ("residual", "residual_closed", "scheme")  # errors themselves


@dataclass(frozen=True)
class Row:
    """How a quantity converges.

    kind         "probe", "energy", "control" or "event"
    least        the least order that is expected of it, which is assumed where there are two levels
    change       largest since the start, of the finest level, in ``unit``, as are all that follow; 0 for round-off
    differences  rms of q_k - q_(k+1), level by level
    alike        cosine between the last two differences as vectors over times, 1 where they have one course; nan of two
                 levels
    order observed between the last three levels, inf where the last two agree; nan for two levels or no differences
    error        estimated, of the finest level; nan where there is no estimate
    warning      why order and error are unreliable; "" where they are reliable
    is_seen      whether differences are more than round-off
    unit         of the scene; "" where there is none
    """

    kind: str
    name: str
    least: float
    change: float
    differences: tuple[float, ...] = ()
    order: float = float("nan")
    error: float = float("nan")
    warning: str = ""
    is_seen: bool = True
    unit: str = ""
    alike: float = float("nan")

    @property
    def relative(self) -> float:
        """The error over the change since the start: what a quantity starts from does not make its error small."""
        return self.error / self.change if self.change > 0.0 else float("nan")


def compare(folders: Sequence[Path], order: int, has_tips: bool = False) -> list[Row]:
    """A row for each quantity of each probe, energy, control and first event of the runs, coarsest first.

    order     that of the rules in time
    has_tips  whether fractures end in rock

    Raises InputError for a folder without its run.
    """
    histories = [_by_time(read_history(folder / "history.h5")) for folder in folders]
    times = _common_times([history["time"] for history in histories])
    least = OF_TIPS if has_tips else min(float(order), ORDER_OF_MESH)
    units = units_of_run(folders[-1])
    rows = list(_sampled(histories, times, least, units))
    start, end = float(histories[-1]["time"][0]), float(histories[-1]["time"][-1])
    events = _events(folders, least, start, (end - start) or 1.0)
    return rows + [replace(row, unit=unit_of("time", units)) for row in events]


def judged(row: Row, scale: float) -> Row:
    """The row with order, error and warning from its differences; ``scale`` is the largest of its kind.

    An order between that of tips and the method's is no fault of the estimate, which goes by the order observed.
    """
    row, last = replace(row, change=row.change * (row.change > CHANGE_ROUND_OFF * scale)), row.differences[-1]
    if max(row.differences) <= CHANGE_ROUND_OFF * scale:
        return replace(row, error=last, is_seen=False)
    if len(row.differences) == 1:
        return replace(row, error=last / (2.0**row.least - 1.0))
    before = row.differences[-2]
    if not last < before:
        return replace(row, warning="differences do not fall")
    with np.errstate(divide="ignore"):
        *earlier, order = (-np.diff(np.log2(row.differences[-3:]))).tolist()
    row = replace(row, order=order, error=last**2 / (before - last))  # last/(2^p - 1)
    if order < LOWEST:
        return replace(row, warning=f"order below {LOWEST:g}: a jump, or not yet fine enough")
    if order > ORDER_OF_MESH + ABOVE:
        return replace(row, warning=f"order above {ORDER_OF_MESH:g}: coarser levels are not fine enough to show it")
    if earlier and not abs(order - earlier[0]) <= JUMP:
        return replace(row, warning="orders jump from level to level: not yet fine enough to show it")
    if row.alike < ALIKE:
        return replace(row, warning="differences of levels change their course: errors of mesh and steps may cancel")
    return row


def alike(steps: Sequence[Floats]) -> float:
    """Cosine between the last two of the differences (t, c) of levels, by time and component; nan where there are fewer."""
    if len(steps) < 2:
        return float("nan")
    before, last = (each.ravel() / (np.abs(each).max() or 1.0) for each in steps[-2:])
    sizes = float(np.linalg.norm(before) * np.linalg.norm(last))
    return float(before @ last) / sizes if sizes > 0.0 else 1.0


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


def _sampled(histories: list[Histories], times: Floats, least: float, units: Mapping[str, str]) -> Iterator[Row]:
    """Rows of what has a history; components of a vector are taken together."""
    finest = histories[-1]
    keys = [key for key in finest if key.startswith(("probe/", "energy/", "step/control/"))]
    keys = [key for key in keys if all(key in history for history in histories)]
    rows, sizes, changes = {}, {}, {}
    for key in keys:
        values = [_at(times, history["time"], history[key]) for history in histories]
        known = np.all([np.isfinite(each).all(axis=1) for each in values], axis=0)
        kind, _, name = key.removeprefix("step/").partition("/")
        if name in NO_RESULTS or not known.any():
            continue
        moved = [fine[known] - coarse[known] for coarse, fine in pairwise(values)]
        steps = tuple(_rms(each) for each in moved)
        place, _, quantity = name.rpartition("/")
        in_table = row_of(key)
        lowest = min(least, OF_SLOPES) if in_table is not None and in_table.of_slopes else least
        sizes[key] = max(_rms(each[known]) for each in values)
        changes[key] = [_change(each[known]) for each in values]
        row = Row(kind, f"{place} {quantity}".strip(), lowest, changes[key][-1], steps, unit=unit_of(key, units))
        rows[key] = replace(row, alike=alike(moved))
    kinds = {key: (row.kind, row.name.rpartition(" ")[2] if row.kind == "probe" else "") for key, row in rows.items()}
    for key, row in rows.items():
        scale = max(size for name, size in sizes.items() if kinds[name] == kinds[key])
        found, moves = judged(row, scale), np.array(changes[key]) > CHANGE_ROUND_OFF * scale
        if found.is_seen and not moves.all() and moves.any():
            found = replace(found, warning=f"no change at level {', '.join(map(str, np.flatnonzero(~moves)))}")
        yield found


def _at(times: Floats, known: Floats, values: Floats) -> Floats:
    """(times, components) by linear interpolation, which is exact at the known times."""
    columns = values.reshape(len(known), -1)
    return np.stack([np.interp(times, known, column) for column in columns.T], axis=1)


def _rms(values: Floats) -> float:
    """Root of the mean square over times of a vector's length."""
    return float(np.sqrt((values**2).sum(axis=1).mean()))


def _change(values: Floats) -> float:
    """Largest length of q(t) - q(t_0); of q itself where there is a single time."""
    return float(np.linalg.norm(values - values[0] * (len(values) > 1), axis=1).max())


def _events(folders: Sequence[Path], least: float, begin: float, span: float) -> Iterator[Row]:
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
        yield _times(f"{name} first", np.array([[min(found)] for found in starts]) - begin, least, span)
        everywhere = [key for key in levels[0] if key[:2] == (kind, fracture) and all(key in each for each in levels)]
        if len(everywhere) > 1:
            times = np.array([[first[key] for key in everywhere] for first in levels])
            yield _times(f"{name} at {len(everywhere)} places", times - begin, least, span)


def _times(name: str, times: Floats, least: float, span: float) -> Row:
    """Row of times (levels, places) since the start."""
    moved = np.diff(times, axis=0)
    steps = np.sqrt((moved**2).mean(axis=1))
    return judged(
        Row("event", name, least, float(times[-1].max()), tuple(steps.tolist()), alike=alike(list(moved))), span
    )


def write(rows: Sequence[Row], folder: Path, order: int, levels: Sequence[Path], has_tips: bool = False) -> list[Path]:
    """Write ``converge.csv`` and ``converge.json`` and return their paths; arguments as of ``compare``."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    steps = [f"difference_{k}_{k + 1}" for k in range(len(levels) - 1)]
    table.writerow(["kind", "name", "unit", "change", *steps, "order", "error", "error/change", "warning"])
    for row in rows:
        differences = row.differences or (np.nan,) * len(steps)
        last = (row.order, row.error, row.relative, row.warning)
        table.writerow([row.kind, row.name, row.unit, row.change, *differences, *last])
    write_atomic(folder / "converge.csv", text.getvalue())
    found = {
        "levels": [path.name for path in levels],
        "order_of_method": order,
        "has_tips_in_rock": has_tips,
        "order_is": "observed" if len(levels) > 2 else "assumed",
        "quantities": [vars(row) | {"error/change": row.relative} for row in rows],
    }
    write_atomic(folder / "converge.json", to_json(found, indent=2) + "\n")
    return [folder / "converge.csv", folder / "converge.json"]
