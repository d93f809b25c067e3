"""Results of one scene written down in two ways, beside each other, over sizes that follow from what is given."""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from _meta_scenes import Case
from _meta_turns import Back
from numpy.typing import NDArray

from fracflow.scene import units
from fracflow.scene.quantities import probed

Arrays = dict[str, NDArray[Any]]
Differences = dict[str, float]
DIMENSIONS = {name: row.dimension for name, row in probed().items()}
VECTORS, TENSORS, ALONG = (
    [name for name, row in probed().items() if row.kind == kind] for kind in ("vector", "tensor", "shear")
)
ONE_PAIR = VECTORS  # of walls: where fractures meet there are several
SAME_TIME = 1e-7  # of the run
LEAST_BOOK = 1e-4  # of the natural energy: where nothing moves, the books hold round-off


@dataclass(frozen=True)
class Record:
    """The results of a run: exit code, message, histories, events, seconds."""

    code: int
    message: str = ""
    history: Arrays = field(default_factory=dict)
    events: list[dict[str, Any]] = field(default_factory=list)
    seconds: float = 0.0


def sizes(case: Case) -> dict[str, float]:
    """Natural size of each quantity, in SI, from what the scene is given.

    A traction is what the rock carries or what is pumped or moved; a jump what it does to the springs of a joint and to
    rock as wide as the domain; a flow what it drives through the widest fracture; a velocity what a wave of it moves.
    """
    data = case.data
    rock, fractures = data["rock"]["rock"], data["fracture"].values()
    extent = float(np.ptp(case.points, axis=0).max())
    young, density = rock["youngs_modulus"], rock["density"]
    moved = [row[1] for s in data["support"] for table in s.get("displacement", {}).values() for row in table]
    pumped = [
        row[1] for well in data.get("well", ()) if isinstance(well.get("pressure"), list) for row in well["pressure"]
    ]
    pumped += [well["maximum_pressure"] for well in data.get("well", ()) if "maximum_pressure" in well]
    stress = max(
        1e5,
        *(abs(data["initial_stress"][key]) for key in ("xx", "yy", "zz", "xy")),
        *(table["cohesion"] for table in fractures),
        *map(abs, pumped),
        *(abs(value) * young / extent for value in moved),
    )
    jump = stress * (1.0 / min(table["shear_stiffness"] for table in fractures) + extent / young)
    step = min(stage.get("dynamic_time_step", stage.get("time_step", math.inf)) for stage in data["stage"])
    speed = math.sqrt(young / density)
    velocity = max(stress / (density * speed), jump / step if math.isfinite(step) else 0.0)
    found = {
        units.LENGTH: jump,
        units.STRESS: stress,
        units.VELOCITY: velocity,
        units.ACCELERATION: velocity * max(speed / extent, 1.0 / step if math.isfinite(step) else 0.0),
        units.PLAIN: stress / young,
        "energy": stress * jump * extent,
    }
    if "fluid" in data:
        wide = max(table["aperture"] for table in fractures) + jump
        found["head"] = stress / data["fluid"]["specific_weight"]
        found[units.FLOW_RATE] = wide**3 / (12.0 * data["fluid"]["viscosity"]) * stress / extent
    return found


def read_back(record: Record, back: Back) -> Arrays:
    """Histories as the untransformed scene has them: energies, and probes as ``NAME/QUANTITY``; in SI."""
    system, turn = back.system, back.turn
    found: Arrays = {"time": record.history["time"] * system.to_si(units.TIME)}
    for key, values in record.history.items():
        if key.startswith("energy/"):
            found[key] = values * system.to_si(units.LINE_FORCE) * system.to_si(units.LENGTH)
        if not key.startswith("probe/"):
            continue
        place, quantity = key.removeprefix("probe/").rsplit("/", 1)
        values = values * system.to_si(DIMENSIONS[quantity])
        if quantity in VECTORS:
            values = values @ turn  # its inverse is its transpose
        elif quantity in TENSORS:
            tensor = np.stack([values[:, [0, 3]], values[:, [3, 1]]], axis=1)
            plane = turn.T @ tensor @ turn
            values = np.stack([plane[:, 0, 0], plane[:, 1, 1], values[:, 2], plane[:, 0, 1]], axis=1)
        elif quantity in ALONG:
            values = values * back.along
        elif quantity == "flow_rate":
            values = values * back.flow
        if back.faces < 0 and not place.startswith("rock"):
            if quantity in ("velocity", "acceleration"):
                continue  # of the other face
            quantity = {"displacement": "displacement_bottom", "displacement_bottom": "displacement"}.get(
                quantity, quantity
            )
        found[f"{place}/{quantity}"] = values
    return found


def _rows(one: NDArray[Any], other: NDArray[Any], slack: float) -> tuple[NDArray[Any], NDArray[Any]]:
    """Rows of two runs that stand for the same instant: all of them, else the last at each time that both have."""
    if len(one) == len(other) and np.all(np.abs(one - other) <= slack):
        return np.arange(len(one)), np.arange(len(one))
    ends = np.flatnonzero(np.append(np.diff(one) > slack, True))
    at = np.searchsorted(other, one[ends] + slack) - 1
    same = (at >= 0) & (np.abs(other[at] - one[ends]) <= slack)
    return ends[same], at[same]


def differences(case: Case, base: Record, other: Record, back: Back) -> Differences:
    """Largest difference of each quantity over its natural size; "missing" is infinite where there is nothing to compare."""
    natural, found = sizes(case), defaultdict[str, float](float)
    one, two = read_back(base, Back()), read_back(other, back)
    last = float(one["time"][-1]) or 1.0
    here, there = _rows(one["time"], two["time"], SAME_TIME * last)
    if len(here) < 0.4 * min(len(one["time"]), len(two["time"])):
        found["missing"] = math.inf
        return found
    found["time"] = float(np.abs(one["time"][here] - two["time"][there]).max() / last)
    for key, values in one.items():
        place, _, quantity = key.rpartition("/")
        if quantity == "time" or (place in case.shared and quantity in ONE_PAIR):
            continue
        if key not in two:
            if back.faces > 0 or quantity not in ("velocity", "acceleration"):
                found["missing"] = math.inf
            continue
        size = (
            natural["energy"]
            if place == "energy"
            else natural[quantity if quantity == "head" else DIMENSIONS[quantity]]
        )
        gap = np.abs(values[here] - two[key][there])
        gap = gap[np.isfinite(gap)]  # what is no number is counted by itself
        name = "energy" if place == "energy" else quantity
        found[name] = max(found[name], float(gap.max(initial=0.0)) / size)
    _compare_events(case, base, other, back, natural, last, found)
    return found


def _compare_events(
    case: Case, base: Record, other: Record, back: Back, natural: dict[str, float], last: float, found: Differences
) -> None:
    """Events by what, where and how often; one too many counts by its slip, beside the largest."""
    one, two = (_by_place(record.events, way, case) for record, way in ((base, Back()), (other, back)))
    for key in one.keys() | two.keys():
        rows, others = one.get(key, []), two.get(key, [])
        for row in (*rows[len(others) :], *others[len(rows) :]):
            size = abs(row["slip"]) / natural[units.LENGTH] if key[0] != "open" else 1.0
            found[f"{key[0]} more"] = max(found[f"{key[0]} more"], size)
        for row, its in zip(rows, others, strict=False):
            for column, size in (
                ("start", last), ("end", last), ("slip", natural[units.LENGTH]), ("peak_slip_rate", natural[units.VELOCITY]),
            ):  # fmt: skip
                if row[column] is None or its[column] is None:
                    gap = 0.0 if row[column] is its[column] else math.inf
                else:
                    gap = abs(row[column] - its[column]) / size
                name = f"{key[0]} {column}"
                found[name] = max(found[name], gap)


def _by_place(events: list[dict[str, Any]], back: Back, case: Case) -> dict[tuple[Any, ...], list[dict[str, Any]]]:
    """Rows of events in SI, by kind and node of the untransformed scene; of whole events by kind alone."""
    system, found = back.system, defaultdict[tuple[Any, ...], list[dict[str, Any]]](list)
    dimension = {"start": units.TIME, "end": units.TIME, "slip": units.LENGTH, "peak_slip_rate": units.VELOCITY}
    for row in events:
        place = (np.array([row["x"], row["y"]]) * system.to_si(units.LENGTH) - back.shift) @ back.turn
        node = int(np.argmin(np.linalg.norm(case.points - place, axis=1)))
        values = {k: None if row[k] is None else row[k] * system.to_si(v) for k, v in dimension.items()}
        values["slip"] *= back.along
        found[("event",) if row["kind"] == "event" else (row["kind"], row["fracture"], node)].append(values)
    return found


def open_books(record: Record, case: Case, back: Back) -> float:
    """The residual of the energy balance over their largest entry."""
    books = {key: values for key, values in read_back(record, back).items() if key.startswith("energy/")}
    largest = max(np.nanmax(np.abs(v), initial=0.0) for k, v in books.items() if not k.startswith("energy/residual"))
    return float(np.nanmax(np.abs(books["energy/residual"])) / max(largest, LEAST_BOOK * sizes(case)["energy"]))


def not_numbers(record: Record) -> list[str]:
    """Histories that hold something that is no number."""
    told = (key for key in record.history if key.startswith(("energy/", "probe/")))
    return [key for key in told if not np.all(np.isfinite(record.history[key]))]
