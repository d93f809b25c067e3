"""Changes of a scene that alter nothing but how it is written down, and how its results are read back."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from _meta_scenes import Case, Data, copied
from numpy.typing import NDArray

from fracflow.scene import units
from fracflow.scene.units import UnitSystem

Floats = NDArray[np.float64]
Random = np.random.Generator
SYSTEMS = ("ft-lbf-s", "mm-N-ms", "km-GN-min")
SHAKEN = 1e-13  # of every number given: some hundred times what arithmetic rounds off

WRITTEN = {
    "youngs_modulus": units.STRESS, "density": units.DENSITY, "normal_stiffness": units.STIFFNESS,
    "shear_stiffness": units.STIFFNESS, "aperture": units.LENGTH, "minimum_hydraulic_aperture": units.LENGTH,
    "cohesion": units.STRESS, "viscosity": units.VISCOSITY, "specific_weight": units.WEIGHT,
    "initial_pressure": units.STRESS, "compressibility": units.COMPRESSIBILITY, "flow_depth": units.LENGTH,
    "pressure": units.STRESS, "maximum_pressure": units.STRESS, "flow_rate": units.FLOW_RATE, "at": units.LENGTH,
    "xx": units.STRESS, "yy": units.STRESS, "zz": units.STRESS, "xy": units.STRESS, "x": units.LENGTH,
    "y": units.LENGTH, "time_step": units.TIME, "dynamic_time_step": units.TIME, "end": units.TIME,
}  # fmt: skip
"""Dimension of each key with a number that a scene here may have."""
PLAIN = (
    "poissons_ratio", "friction_coefficient", "stick_slip_ratio", "steps", "increment", "increment_per_step",
    "tolerance", "rho_infinity", "checkpoint_seconds", "pictures",
)  # fmt: skip


@dataclass(frozen=True)
class Back:
    """How results of a changed scene are read back.

    turn     (2, 2) how vectors were turned
    shift    (2,) how places were moved after that [length]
    faces    -1 where the top of a fracture has become its bottom, else 1
    along    -1 where slip and shear traction change sign
    flow     -1 where fractures run the other way
    system   units of the results
    """

    turn: Floats = field(default_factory=lambda: np.eye(2))
    shift: Floats = field(default_factory=lambda: np.zeros(2))
    faces: int = 1
    along: int = 1
    flow: int = 1
    system: UnitSystem = field(default_factory=lambda: UnitSystem.parse("SI"))


class Turn(NamedTuple):
    """A transformation: its name, which scenes it fits, what it makes of one."""

    name: str
    fits: Callable[[Case], bool]
    make: Callable[[Case, Random], tuple[Case, Back]]


def moved(case: Case, turn: Floats, shift: Floats) -> Case:
    """The scene turned or mirrored about the origin, and then shifted."""
    data = copied(case)
    stress = data["initial_stress"]
    tensor = turn @ np.array([[stress["xx"], stress["xy"]], [stress["xy"], stress["yy"]]]) @ turn.T
    stress |= {"xx": float(tensor[0, 0]), "yy": float(tensor[1, 1]), "xy": float(tensor[0, 1])}
    for part in (*data["probe"], *data.get("well", ())):
        if isinstance(part["at"], list):
            part["at"] = (turn @ part["at"] + shift).tolist()
    for support in data["support"]:
        if "displacement" in support:
            tables = support["displacement"]
            times, ways = np.array(tables["x"])[:, 0], np.array([tables[key] for key in ("x", "y")])[:, :, 1]
            support["displacement"] = {
                key: np.stack([times, values], axis=1).tolist()
                for key, values in zip(("x", "y"), turn @ ways, strict=True)
            }
    cells = case.cells if np.linalg.det(turn) > 0 else case.cells[:, ::-1]
    return Case(data, case.points @ turn.T + shift, cells, case.traces, case.sides, case.shared)


def _turned(case: Case, random: Random) -> tuple[Case, Back]:
    angle = random.uniform(0, 2 * np.pi)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    shift = random.uniform(-3, 3, 2) * np.ptp(case.points, axis=0)
    return moved(case, turn, shift), Back(turn, shift)


def _mirrored(case: Case, random: Random) -> tuple[Case, Back]:
    """Along a trace its left becomes its right: the top face is the image of the bottom."""
    turn = np.diag(random.permutation([-1.0, 1.0]))
    return moved(case, turn, np.zeros(2)), Back(turn, faces=-1, along=-1)


def _renumbered(case: Case, random: Random) -> tuple[Case, Back]:
    number = random.permutation(len(case.points))  # new number of each node
    points = np.empty_like(case.points)
    points[number] = case.points
    cells = random.permutation(number[case.cells])
    corner = (np.arange(3) + random.integers(0, 3, len(cells))[:, None]) % 3
    cells = np.take_along_axis(cells, corner, axis=1)
    traces = {name: random.permutation(number[edges]) for name, edges in case.traces.items()}
    sides = {name: random.permutation(number[edges]) for name, edges in case.sides.items()}
    return Case(case.data, points, cells, traces, sides, case.shared), Back()


def _reversed(case: Case, random: Random) -> tuple[Case, Back]:
    """Traces drawn the other way: s and n both turn round, so that slip and opening stay."""
    data = copied(case)
    for well in data.get("well", ()):
        if isinstance(well["at"], dict):
            well["at"]["end"] = {"start": "end", "end": "start"}[well["at"]["end"]]
    traces = {name: edges[:, ::-1] for name, edges in case.traces.items()}
    return Case(data, case.points, case.cells, traces, case.sides, case.shared), Back(faces=-1, flow=-1)


def _permuted(case: Case, random: Random) -> tuple[Case, Back]:
    """Fractures, wells, probes and sides of the mesh in another order."""

    def shuffled(parts: Any) -> Any:
        order = random.permutation(len(parts))
        if isinstance(parts, dict):
            keys = list(parts)
            return {keys[i]: parts[keys[i]] for i in order}
        return [parts[i] for i in order]

    data = copied(case)
    for key in ("fracture", "well", "probe"):  # of supports the first holds where they meet
        if key in data:
            data[key] = shuffled(data[key])
    traces, sides = shuffled(case.traces), shuffled(case.sides)
    return Case(data, case.points, case.cells, traces, sides, case.shared), Back()


def numbers(data: Data, change: Callable[[str, float], float], key: str = "") -> Any:
    """The same scene with each number changed; of tables in time the time has the key ``end``. Raises KeyError."""
    if isinstance(data, dict):
        return {name: numbers(value, change, name) for name, value in data.items()}
    if isinstance(data, list):
        if data and isinstance(data[0], list) and key != "at":  # a table in time
            return [[change("end", row[0]), change(key, row[1])] for row in data]
        return [numbers(value, change, key) for value in data]
    return change(key, data) if isinstance(data, int | float) and not isinstance(data, bool) else data


def _other_units(case: Case, random: Random) -> tuple[Case, Back]:
    system = UnitSystem.parse(str(random.choice(SYSTEMS)))

    def change(key: str, value: float) -> float:
        if key in PLAIN:
            return value
        return value / system.to_si(WRITTEN[key])

    data = numbers(copied(case), change) | {"units": system.name}
    points = case.points / system.to_si(units.LENGTH)
    return Case(data, points, case.cells, case.traces, case.sides, case.shared), Back(system=system)


def shaken(case: Case, random: Random) -> tuple[Case, Back]:
    """Every coordinate and every number that is measured, changed in its thirteenth digit."""

    def change(key: str, value: float) -> float:
        return value if key in PLAIN or key in TIMES else value * (1.0 + SHAKEN * random.uniform(-1, 1))

    data = numbers(copied(case), change)
    extent = float(np.ptp(case.points, axis=0).max())
    points = case.points + SHAKEN * extent * random.uniform(-1, 1, case.points.shape)
    return Case(data, points, case.cells, case.traces, case.sides, case.shared), Back()


TIMES = ("end", "time_step", "dynamic_time_step")  # clocks are not shaken: steps must end at the same times


def _has_tolerance(case: Case) -> bool:
    return "accuracy" in case.data


def _may_split(case: Case) -> bool:
    """A rule of the film that remembers the step before begins anew with each stage, as the schema says."""
    last = case.data["stage"][-1]
    film = case.data["method"].get("flow_integrator", "backward-euler")
    fits = last["kind"] == "dynamic" or (last["kind"] == "quasi-static" and film == "backward-euler")
    return fits and not _has_tolerance(case) and "then" not in last


def _split(case: Case, random: Random) -> tuple[Case, Back]:
    """The last stage as two; not at a bend of a side's motion, whose velocity there is that of the stage it belongs to."""
    data = copied(case)
    last = data["stage"].pop()
    start = sum(stage.get("end", 0.0) for stage in data["stage"])
    count = last["steps"] if "steps" in last else round((last["end"] - start) / last["time_step"])
    bends = {row[0] for part in data["support"] for table in part.get("displacement", {}).values() for row in table}
    ends = start + last["time_step"] * np.arange(1, count)
    may = [n for n, end in enumerate(ends, 1) if all(abs(end - bend) > 1e-6 * last["time_step"] for bend in bends)]
    first = int(random.choice(may))
    if "steps" in last:
        data["stage"] += [last | {"steps": first}, last | {"steps": count - first}]
    else:
        data["stage"] += [last | {"end": start + last["time_step"] * first}, last]
    return Case(data, case.points, case.cells, case.traces, case.sides, case.shared), Back()


def _by(**method: str) -> Callable[[Case, Random], tuple[Case, Back]]:
    def make(case: Case, random: Random) -> tuple[Case, Back]:
        data = copied(case)
        # by itself full locates all events of a step, which is another rule of stepping
        model = {"model": method["model"]} if "model" in method else {}
        data["method"] = {"events": "auto"} | data["method"] | {k: v for k, v in method.items() if k != "model"}
        return Case(data | model, case.points, case.cells, case.traces, case.sides, case.shared), Back()

    return make


def _not_yet(coupling: str) -> Callable[[Case], bool]:
    return lambda case: case.data["method"].get("coupling") != coupling


def always(case: Case) -> bool:
    """Any scene."""
    return True


TURNS = (
    Turn("turned and shifted", always, _turned),
    Turn("mirrored", always, _mirrored),
    Turn("renumbered", always, _renumbered),
    Turn("traces reversed", always, _reversed),
    Turn("fractures permuted", always, _permuted),
    Turn("other units", always, _other_units),
    Turn("stage split", _may_split, _split),
    Turn("model full", always, _by(model="full")),
    Turn("condensed", _not_yet("condensed"), _by(coupling="condensed")),
    Turn("whole", _not_yet("whole-lu"), _by(coupling="whole-lu")),
)


def fitting(case: Case) -> Iterator[Turn]:
    """Transformations that fit a scene."""
    yield from (turn for turn in TURNS if turn.fits(case))
