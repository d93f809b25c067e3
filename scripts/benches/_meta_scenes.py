"""Random small scenes: loops, T's, ends on the boundary, apertures of 1e-9 beside 1e-3, stiff joints, wells, events."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any

import numpy as np
from grids import msh
from numpy.typing import NDArray

from fracflow.mesh.read import GeometrySpec, build_mesh

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Data = dict[str, Any]

WIDTH, HEIGHT = 10.0, 8.0
NETWORKS: dict[str, list[list[list[float]]]] = {
    "one": [[[3, 3.3], [7, 4.8]]],
    "bent": [[[2.5, 3.2], [5, 4.5], [7.3, 3.6]]],
    "cross": [[[3, 3], [7, 5]], [[4, 5.5], [6, 2.5]]],
    "T": [[[2.5, 4], [7.5, 4]], [[5, 4], [6, 6.2]]],
    "parallel": [[[3, 3.7], [7, 3.7]], [[3.4, 4.6], [7.2, 4.6]]],
    "loop": [[[3.5, 3], [6.5, 3], [5, 5.5], [3.5, 3]]],
    "loop of three": [[[3.2, 2.9], [6.9, 3.3]], [[6.4, 2.6], [4.6, 5.8]], [[3.3, 2.4], [5.4, 5.9]]],
    "boundary": [[[0, 3], [5, 4.5]]],
    "through": [[[0, 2.6], [10, 5.4]], [[4.2, 5.6], [5.6, 2.3]]],
    "two": [[[2, 3], [5, 3.5]], [[5.5, 4.5], [8, 5.5]]],
    "near tips": [[[2, 4], [4.7, 4]], [[5.3, 4.1], [8, 4.4]]],
    "many": [[[2, 2.2], [8, 5.8]], [[2.2, 5.6], [7.7, 2.4]], [[5, 1.5], [5.3, 6.8]]],
}
ON_THE_BOUNDARY = ("boundary", "through")
STAGES = ("quasi-static", "dynamic", "mixed", "auto", "incipient")
EVERY_SIDE = ["west", "east", "south", "north"]


@dataclass(frozen=True)
class Case:
    """A scene with its mesh.

    data    the scene without ``mesh``, in its own units
    points  (n, 2) coordinates [length]
    cells   (m, 3) triangles
    traces  fracture -> (k, 2) edges, each along its trace
    sides   side -> (k, 2) edges
    shared  places where fractures meet: probes there have several pairs of walls to choose from
    """

    data: Data
    points: Floats
    cells: Ints
    traces: dict[str, Ints]
    sides: dict[str, Ints]
    shared: frozenset[str] = frozenset()

    def mesh_text(self) -> str:
        """The mesh in Gmsh's format 2.2; fractures and sides in the order they have here."""
        blocks = [("rock", self.cells), *self.traces.items(), *self.sides.items()]
        return msh(self.points, blocks)


def draw(seed: int) -> Case:
    """A random scene; the same for the same seed."""
    random = np.random.default_rng(seed)
    kind = str(random.choice(list(NETWORKS)))
    traces = [np.array(points, dtype=float) for points in NETWORKS[kind]]
    if kind not in ON_THE_BOUNDARY:
        angle, middle = random.uniform(0, 2 * np.pi), np.array([WIDTH, HEIGHT]) / 2
        turn = random.uniform(0.8, 1.0) * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        traces = [middle + (points - [5.0, 4.0]) @ turn.T for points in traces]
    scale = float(random.choice([1.0, 1.0, 30.0]))
    corners = scale * np.array([[0, 0], [WIDTH, 0], [WIDTH, HEIGHT], [0, HEIGHT]])
    names = [f"f{i}" for i in range(len(traces))]
    spec = GeometrySpec(
        corners,
        tuple((name, scale * points) for name, points in zip(names, traces, strict=True)),
        scale * float(random.choice([2.0, 2.5])),
        scale * float(random.choice([0.8, 1.1])),
    )
    raw = build_mesh(spec)
    edges = {name: raw.fracture_facets[raw.fracture_of == i] for i, name in enumerate(raw.fractures)}
    sides = {name: raw.side_facets[raw.side_of == i] for i, name in enumerate(raw.sides)}
    bare = Case({}, raw.points, raw.cells[:, :3], edges, sides)
    data = _material(random, kind, names, scale)
    _drive(random, data, [scale * points for points in traces], scale)
    probes, shared = _probes(random, bare)
    data["probe"] = probes
    _steps(random, data, scale)
    return Case(data, bare.points, bare.cells, edges, sides, shared)


def _material(random: np.random.Generator, kind: str, names: list[str], scale: float) -> Data:
    """Rock, fractures and the stress in them."""
    normal = float(10.0 ** random.choice([9, 10, 11, 13])) / scale
    friction = float(random.choice([0.0, 0.1, 0.6, 0.6, 0.6, 0.6]))
    press = float(random.choice([1e5, 1e6, 5e6, 5e6, 2e7]))  # without any, walls touch by round-off
    stress = {"xx": -press, "yy": -press, "zz": -press, "xy": 0.0}
    if friction > 0.3:
        stress |= {"xx": -press * float(random.uniform(0.8, 1.3)), "xy": press * float(random.uniform(-0.4, 0.4))}
    fractures = {}
    for name in names:
        aperture = float(random.choice([1e-9, 1e-5, 1e-4, 1e-3])) if random.random() < 0.5 else 2e-4
        fractures[name] = {
            "normal_stiffness": normal,
            "shear_stiffness": normal * float(random.uniform(0.2, 1.0)),
            "aperture": aperture,
            "friction_coefficient": friction,
            "cohesion": float(random.choice([0.0, 0.0, 1e5])),
            "stick_slip_ratio": float(random.choice([1.0, 0.9, 0.7])),
        }
    if random.random() < 0.25:
        for table in fractures.values():
            table["minimum_hydraulic_aperture"] = 1e-5
    rock = {
        "youngs_modulus": float(10.0 ** random.uniform(9, 11)),
        "poissons_ratio": float(random.choice([0.0, 0.25, 0.45])),
        "density": 2700.0,
    }
    return {"title": kind, "rock": {"rock": rock}, "initial_stress": stress, "fracture": fractures, "method": {}}


def _drive(random: np.random.Generator, data: Data, traces: list[Floats], scale: float) -> None:
    """The wells or the side that drive a scene."""
    press = max(abs(data["initial_stress"]["yy"]), 1e5)
    unit = scale if random.random() < 0.5 else 1.0  # of time: tables run over two of them
    data["end"] = 2.0 * unit
    held = {"on": EVERY_SIDE}
    if random.random() < 0.25:
        most = float(random.choice([1e-5, 1e-4, -1e-4])) * scale * WIDTH * press / 5e6
        moved = {
            "x": [[0.0, 0.0], [unit, most], [2 * unit, most]],
            "y": [[0.0, 0.0], [unit, -most / 3], [2 * unit, most / 2]],
        }
        data["support"] = [{"on": ["west", "east", "south"]}, {"on": ["north"], "displacement": moved}]
        return
    data["support"] = [held]
    start = float(random.choice([0.0, 0.2])) * press
    data["fluid"] = {"viscosity": 1e-3, "specific_weight": 9810.0, "initial_pressure": start, "flow_depth": 1.0}
    data["fluid"]["compressibility"] = float(random.choice([0.0, 0.0, 1e-9]))
    data["method"]["flow_integrator"] = str(random.choice(["backward-euler", "bdf2", "trapezoid"]))
    top = start + float(random.choice([0.5, 0.8, 0.95, 1.2])) * press
    is_loop = len(traces[0]) == 4
    well: Data = {"name": "w", "at": {"fracture": "f0", "end": "start"}}
    if is_loop:
        well["at"] = traces[0][0].tolist()
    is_wide = data["fracture"]["f0"]["aperture"] >= 1e-4  # a rate through less takes pressures that no rock bears
    if is_wide and random.random() < 0.4:  # a lone fracture would be raised to the top by this
        length = np.linalg.norm(np.diff(traces[0], axis=0), axis=1).sum()
        rate = (top - start) * float(length) / data["fracture"]["f0"]["normal_stiffness"] / unit
        well["flow_rate"] = [[0.0, 0.0], [unit, rate], [2 * unit, rate]]
        if random.random() < 0.3:
            well["maximum_pressure"] = top
    elif random.random() < 0.3:
        well["pressure"] = [[0.0, start], [0.6 * unit, top], [2 * unit, 0.3 * top]]
    else:
        well["pressure"] = [[0.0, start], [unit, top], [2 * unit, top]]
    data["well"] = [well]
    last = len(traces) - 1
    if last and len(traces[last]) < 4 and random.random() < 0.5:
        data["well"].append({"name": "out", "at": {"fracture": f"f{last}", "end": "end"}, "pressure": "initial"})


def _probes(random: np.random.Generator, bare: Case) -> tuple[list[Data], frozenset[str]]:
    """Two probes on each fracture, one where fractures meet, three in the rock; all at nodes."""
    probes, shared = [], []
    count = np.zeros(len(bare.points), dtype=int)
    for edges in bare.traces.values():
        count[np.unique(edges)] += 1
    for name, edges in bare.traces.items():
        nodes = np.unique(edges)
        alone = random.permutation(nodes[count[nodes] == 1])[:2]
        meets = nodes[count[nodes] > 1][:1]
        for node in (*alone, *meets):
            title = f"{name} at {node}"
            probes.append({"name": title, "at": bare.points[node].tolist(), "on": name})
            shared += [title] if count[node] > 1 else []
    inside = np.setdiff1d(np.flatnonzero(count == 0), np.unique(np.concatenate(list(bare.sides.values()))))
    for node in random.permutation(inside)[:3]:
        probes.append({"name": f"rock at {node}", "at": bare.points[node].tolist(), "on": "rock"})
    return probes, frozenset(shared)


def _steps(random: np.random.Generator, data: Data, scale: float) -> None:
    """Stages, what they are solved by, how accurate."""
    method, end = data["method"], data.pop("end")
    fine = 1e-4 * scale  # [s]; what a wave takes through some cells of the softest rock
    kind = str(random.choice(STAGES, p=[0.4, 0.2, 0.15, 0.15, 0.1]))
    if kind == "incipient" and "flow_rate" not in data.get("well", [{}])[0]:
        kind = "quasi-static"
    step = end / float(random.choice([6, 10]))
    if kind == "quasi-static":
        data["stage"] = [{"kind": "quasi-static", "time_step": step, "end": end}]
    elif kind == "mixed":
        data["stage"] = [
            {"kind": "quasi-static", "time_step": step, "end": end / 2},
            {"kind": "dynamic", "time_step": 10 * fine, "steps": 6},
        ]
    elif kind == "dynamic":
        short = random.random() < 0.6  # else about as slow as a stage without inertia
        _hurry(data, 8 * fine / end if short else 1.0)
        data["stage"] = [{"kind": "dynamic", "time_step": fine if short else step, "steps": 12 if short else 10}]
        if random.random() < 0.3 and "displacement" not in data["support"][-1]:
            data["support"], data["absorbing"] = [{"on": EVERY_SIDE[:2]}], [{"on": EVERY_SIDE[2:]}]
    elif kind == "auto":
        data["stage"] = [{"kind": "auto", "time_step": step, "end": end, "dynamic_time_step": 20 * fine}]
        method |= {"stepper": "generalised-alpha", "rho_infinity": 0.3}
    else:
        well = data["well"][0]
        rate = well["flow_rate"][1][1]
        well |= {"flow_rate": rate, "control": "pump"}
        well.pop("maximum_pressure", None)
        if len(data["well"]) == 1:
            data["well"].append({"name": "out", "at": {"fracture": "f0", "end": "end"}, "pressure": "initial"})
            if isinstance(well["at"], list):
                data["well"].pop()
        data["control"] = {"pump": {"increment": 0.1}}
        data["stage"] = [
            {"kind": "steady", "until": "incipient", "control": "pump"},
            {
                "kind": "dynamic", "time_step": 10 * fine, "steps": 6, "control": "pump",
                "increment_per_step": 0.05, "then": "hold",
            },
        ]  # fmt: skip
    if random.random() < 0.3:
        method["coupling"] = str(random.choice(["condensed", "monolithic", "whole-lu"]))
    if random.random() < 0.2 and kind in ("quasi-static", "dynamic", "mixed"):
        data["accuracy"] = {"tolerance": 1e-2}
    data["output"] = {"pictures": False, "checkpoint_seconds": 1e6}


def _hurry(data: Data, factor: float) -> None:
    """Tables in time run so much shorter."""
    tables = [well[key] for well in data.get("well", ()) for key in ("pressure", "flow_rate") if key in well]
    tables += [table for support in data["support"] for table in support.get("displacement", {}).values()]
    for table in tables:
        for row in table if isinstance(table, list) else ():
            row[0] *= factor


def twin(case: Case, data: Data) -> Case:
    """The same mesh with another scene."""
    return Case(data, case.points, case.cells, case.traces, case.sides, case.shared)


def copied(case: Case) -> Data:
    """The scene, to be changed."""
    return copy.deepcopy(case.data)
