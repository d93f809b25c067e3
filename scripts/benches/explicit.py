"""Explicit steps against memory and arithmetic: explicit.py [UNKNOWNS...] [--cells triangles quads] [--ranks N] [--out DIR].

With --rupture SIDE instead all of meshes/rupture on squares of that side: CPU seconds between its first state and its last.
With --sections FAULTS... instead the cost of a joint section in unknowns, by rocks with so many faults beside each other.
With --loads the south is held, and two loads on the north change in time.

A rupture of a fault between four absorbing sides, in rock of so many unknowns. Counted are CPU seconds of a rank between the
first and the last state on record, so that joints, sides, energies and history are in them; a state is on record every
--parts steps. Beside it stand, from the same process: the sweep through the rock alone; how fast it could be by its bytes and
the bandwidth of memory, by the triad a = b + s c; and how fast by its arithmetic, as it is where all its values stay in the
fastest memory. The lower of both bounds it.
"""

from __future__ import annotations

import argparse
import json
import shlex
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from size import machine

RUPTURE = Path(__file__).parents[2] / "meshes" / "rupture"
UNKNOWNS, CELLS = (1e5, 4e5, 1e6), ("triangles", "quads")
AREA = 40e3 * 24e3  # of the scene [m^2]
CACHED = 1e4  # unknowns whose values stay in the fastest memory
ASKED = 3e7  # unknown-steps per CPU second
MOST_OF_SECTION = 30.0  # unknowns of a rock with the fewest faults, whose steps cost as much as that of a section
EDGES = ((6.0, 70.0), (9.0, 78.0), (13.5, 70.0), (16.5, 81.6), (21.0, 70.0), (24.0, 62.0), (30.0, 70.0))
"""(km, MPa): up to where along the fault the shear stress is so much."""
FIRST = 2  # states on record that do not count


def scene_of(size: float, steps: int, faults: int = 1) -> dict[str, Any]:
    """Faults of 30 km at equal distances in 40 km by 24 km, each of which ruptures from a patch at its centre."""
    start, along, value = 0.0, [], []
    for end, stress in EDGES:
        along += [start * 1e3 + (2e-3 if start else 0.0), end * 1e3]
        value += [stress * 1e6] * 2
        start = end
    fault = {
        "law": "slip-weakening", "normal_stiffness": 1e12, "shear_stiffness": 1e12, "aperture": 1.0,
        "friction_coefficient": 0.677, "dynamic_friction_coefficient": 0.525, "slip_weakening_distance": 0.4,
        "initial_shear_traction": {"along": along, "value": value},
    }  # fmt: skip
    heights = {f"fault {i + 1}": 24e3 * ((i + 1) / (faults + 1) - 0.5) for i in range(faults)}
    return {
        "geometry": {
            "domain": [-20e3, -12e3, 20e3, 12e3], "size": size, "size_at_fractures": size, "growth": 0.3,
            "fracture": [{"name": name, "points": [[-15e3, y], [15e3, y]]} for name, y in heights.items()],
        },
        "rock": {"rock": {"youngs_modulus": 80.0986e9, "poissons_ratio": 0.2500222, "density": 2670.0}},
        "initial_stress": {"xx": -120e6, "yy": -120e6, "xy": 70e6, "unbalanced": "carried"},
        "fracture": dict.fromkeys(heights, fault),
        "absorbing": [{"on": ["west", "east", "south", "north"]}],
        "method": {"stepper": "explicit"},
        "output": {"pictures": False},
        "stage": [{"kind": "dynamic", "time_step": 2e-3 * size / 74.0, "steps": steps}],
    }  # fmt: skip


LOADED: dict[str, Any] = {
    "absorbing": [{"on": ["west", "east"]}],
    "support": [{"on": "south", "components": ["y"]}],
    "load": [
        {"on": ["north", "south"], "traction": "initial-stress"},
        {"on": ["north"], "traction": [[[0, 0], [0.5, 1e6], [1.0, -1e6], [2, 0]], 0]},
        {"on": ["north"], "pressure": [[0, 0], [1.5, 2e6]]},
    ],
}


def size_of(unknowns: float, cells: str) -> float:
    """Side of cells of a rock with about so many unknowns [m]."""
    of_one = 0.5 * np.sqrt(0.75) if cells == "triangles" else 1.0
    nodes_a_cell = 0.5 if cells == "triangles" else 1.0
    return float(np.sqrt(AREA / of_one * nodes_a_cell / (0.5 * unknowns)))


def prepared(unknowns: float, cells: str, faults: int = 1, loads: bool = False) -> Any:
    """The scene; its steps are as long as the critical one."""
    from fracflow._petsc import MPI
    from fracflow.reduction.prepare import prepare
    from fracflow.scene.scene import Scene

    data = scene_of(size_of(unknowns, cells), 1, faults) | (LOADED if loads else {})
    data["geometry"]["cells"] = cells
    return data, prepare(Scene.from_data(data), MPI.COMM_WORLD)


def best(call: Callable[[], Any], repeats: int) -> float:
    """CPU seconds of a call, the least of several rounds."""
    call()
    found = []
    for _ in range(5):
        began = time.process_time()
        for _ in range(repeats):
            call()
        found.append((time.process_time() - began) / repeats)
    return min(found)


def sweep(model: Any) -> tuple[float, float]:
    """CPU seconds of a sweep through a rock, and its bytes an unknown."""
    from fracflow.solve.leapfrog.rock import Cells, rock_of

    rock, count = rock_of(model.operators, model.scene, None, plain=True), model.operators.layout.solid_count
    rock.hold(np.zeros(count, dtype=bool), np.full(count, 1e9))
    rock.keep(np.zeros(0, np.int64))
    repeats = max(3, int(2e6 / model.operators.layout.solid_starts[-1]))  # the same on all ranks: each step sends
    seconds = best(lambda: rock.step(1e-6, 1e-6), repeats)
    moved = 8 * (2 + 2 + 2 + 0.5 + 1)  # u, v and f there and back, w, x; outer forces are 0 nearly everywhere
    block = model.operators.blocks.solid
    of_cells = sum(4 * k + 2 for k in (block.cells >= 0).sum(axis=1).tolist()) if isinstance(rock, Cells) else 0
    rock.destroy()
    return seconds, moved + of_cells / count


def triad(length: int = 10_000_000) -> float:
    """Bandwidth of memory [byte/s]; 0 where the loops are not compiled."""
    from fracflow.solve.leapfrog.compiled import address, library

    loops = library()
    if loops is None:
        return 0.0
    a, b, c = np.zeros(length), np.ones(length), np.full(length, 2.0)
    return 24.0 * length / best(lambda: loops.fracflow_triad(length, address(a), address(b), address(c), 3.0), 1)


@dataclass(frozen=True)
class Way:
    """Steps from state to state on record, states, runs of each rock of ``section``, and the folder of the run."""

    parts: int
    states: int
    turns: int
    folder: Path


def whole(data: dict[str, Any], step: float, way: Way, middle: Callable[[Any], Any] = np.mean) -> float:
    """CPU seconds of a ``step`` [s] with all that belongs to it, the mean over ranks of the ``middle`` of all states."""
    from fracflow._petsc import MPI
    from fracflow.scene.scene import Scene
    from fracflow.simulation.run import run

    comm, marks = MPI.COMM_WORLD, list[float]()
    data["stage"][0] |= {"time_step": way.parts * (1.0 - 1e-9) * step, "steps": way.states}
    run(Scene.from_data(data), way.folder, comm, progress=lambda step: marks.append(time.process_time()))
    return float(comm.allreduce(float(middle(np.diff(marks[FIRST - 1 :])))) / comm.size / way.parts)


def rupture(side: float, given: list[str], folder: Path) -> dict[str, Any]:
    """CPU seconds a rank of all steps of meshes/rupture, with what they put on record; ``given`` are KEY=VALUE of the scene."""
    from fracflow._petsc import MPI
    from fracflow.scene.scene import load
    from fracflow.simulation.run import run

    comm, marks, scene = MPI.COMM_WORLD, list[float](), folder / "scene"
    if comm.rank == 0:
        scene.mkdir(parents=True, exist_ok=True)
        for name in ("fault.geo", "scene.toml"):
            text = (RUPTURE / name).read_text(encoding="utf-8")
            (scene / name).write_text(text.replace("h = 100;", f"h = {side:g};"), encoding="utf-8")
    comm.barrier()
    asked = load(scene / "scene.toml", ["method.stepper=explicit", "output.pictures=false", *given])
    run(asked, folder / "run", comm, progress=lambda step: marks.append(time.process_time()))
    spent = comm.allreduce(marks[-1] - marks[0]) / comm.size
    steps = len(marks) - 1
    return {
        "side_m": side,
        "ranks": comm.size,
        "states": steps,
        "CPU_s": round(spent, 2),
        "state_ms": round(1e3 * spent / steps, 3),
    }


def section(unknowns: float, cells: str, faults: list[int], way: Way) -> dict[str, Any]:
    """Cost of a section in unknowns: what steps take beyond the sweep, by rocks with more and more faults.

    An unknown costs what it does in the sweep through the rock alone, and beside it what it does in a whole step of the rock
    with the fewest faults. Runs of the rocks take turns; the least time between states counts: others disturb it least.
    """
    from fracflow.solve.explicit import ExplicitModel

    models, scenes, critical = [], [], []
    for number in faults:
        data, model = prepared(unknowns, cells, number)
        explicit = ExplicitModel(model.scene, model.operators, model.loads)
        critical.append(explicit.critical)
        explicit.destroy()
        models.append(model)
        scenes.append(data)
    turns = [
        [
            (sweep(model)[0], whole(data, step, way, np.min))
            for model, data, step in zip(models, scenes, critical, strict=True)
        ]
        for _ in range(way.turns)
    ]
    alone, steps = np.min(turns, axis=0).T
    size = np.array([int(each.operators.layout.solid_starts[-1]) for each in models])
    sections = np.array([2 * each.operators.blocks.sizes.joints for each in models])
    of_unknown, of_step, beyond = alone[0] / size[0], steps[0] / size[0], steps - alone
    of_section = (beyond - beyond[0])[1:] / (sections - sections[0])[1:] + of_unknown  # of its walls it has one
    return {
        "cells": cells, "faults": faults, "unknowns": size.tolist(), "sections": sections.tolist(),
        "step_ms": (1e3 * steps).round(3).tolist(), "sweep_ms": (1e3 * alone).round(3).tolist(),
        "ns_of_section": (1e9 * of_section).round(1).tolist(),
        "ns_of_unknown": {"sweep": round(1e9 * of_unknown, 2), "step": round(1e9 * of_step, 2)},
        "section_in_unknowns": {
            "sweep": (of_section / of_unknown).round(1).tolist(), "step": (of_section / of_step).round(1).tolist(),
        },
    }  # fmt: skip


def measure(unknowns: float, cells: str, loads: bool, way: Way) -> dict[str, Any]:
    """All numbers of one rock."""
    from fracflow._petsc import MPI
    from fracflow.solve.explicit import ExplicitModel

    data, model = prepared(unknowns, cells, loads=loads)
    count = int(model.operators.layout.solid_starts[-1])
    sections = 2 * model.operators.blocks.sizes.joints
    alone, size = sweep(model)
    explicit = ExplicitModel(model.scene, model.operators, model.loads)
    critical = explicit.critical
    explicit.destroy()
    del model
    small = prepared(CACHED, cells)[1]
    cached = sweep(small)[0] / small.operators.layout.solid_count
    step, ranks = whole(data, critical, replace(way, turns=1)), MPI.COMM_WORLD.size
    by_memory, by_arithmetic = triad() / size, 1.0 / cached
    rate, bound = count / step / ranks, min(by_memory or np.inf, by_arithmetic)
    return {
        "cells": cells, "unknowns": count, "sections": sections, "ranks": ranks,
        "unknown_steps_per_CPU_s": float(f"{rate:.3g}"), "step_ms": round(1e3 * step, 3), "sweep_ms": round(1e3 * alone, 3),
        "sweep_rate": float(f"{count / alone / ranks:.3g}"), "bytes": round(size, 1),
        "triad_GB_s": round(1e-9 * by_memory * size, 1),
        "bound_by_memory": float(f"{by_memory:.3g}"), "bound_by_arithmetic": float(f"{by_arithmetic:.3g}"),
        "sweep_over_bound": round(count / alone / ranks / bound, 2), "step_over_bound": round(rate / bound, 2),
    }  # fmt: skip


def main() -> None:
    """Measure, print, write explicit.json; exit code 1 where a step is slower than is asked for."""
    parser = argparse.ArgumentParser(prog="scripts/bench explicit", description=__doc__.splitlines()[0])
    parser.add_argument("unknowns", nargs="*", type=float, default=UNKNOWNS)
    parser.add_argument("--cells", nargs="+", choices=CELLS, default=CELLS)
    parser.add_argument("--parts", type=int, default=10, help="steps from state to state on record")
    parser.add_argument("--states", type=int, default=8)
    parser.add_argument("--rupture", type=float, help="side of squares along the fault of meshes/rupture [m]")
    parser.add_argument("--set", action="append", default=[], help="KEY=VALUE of that scene")
    parser.add_argument(
        "--sections", nargs="+", type=int, default=[], help="faults of rocks that tell the cost of a section"
    )
    parser.add_argument("--loads", action="store_true", help="loads that change, and a support")
    parser.add_argument("--turns", type=int, default=3, help="runs of each of those rocks")
    parser.add_argument("--ranks", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("runs/bench/explicit"))
    given = parser.parse_args()
    if given.ranks > 1:
        words = [word for word in sys.argv[1:] if not word.startswith("--ranks")]
        at = sys.argv.index("--ranks") if "--ranks" in sys.argv else 0
        words = sys.argv[1:at] + sys.argv[at + 2 :] if at else words
        sys.exit(subprocess.run(["mpirun", "-n", str(given.ranks), sys.executable, __file__, *words]).returncode)
    from fracflow._petsc import MPI

    comm, slow = MPI.COMM_WORLD, False
    folder = given.out.resolve() / str(comm.size)
    folder.mkdir(parents=True, exist_ok=True)
    rows = []
    if given.rupture:
        rows.append(rupture(given.rupture, given.set, folder))
        if comm.rank == 0:
            print(json.dumps(rows[-1]), flush=True)
    way = Way(given.parts, max(given.states, FIRST + 1), given.turns, folder / "run")
    for cells in () if given.rupture else given.cells:
        for unknowns in given.unknowns:
            if given.sections:
                rows.append(section(unknowns, cells, sorted(given.sections), way))
                slow |= max(rows[-1]["section_in_unknowns"]["step"]) > MOST_OF_SECTION
            else:
                rows.append(measure(unknowns, cells, given.loads, way))
                slow |= rows[-1]["unknown_steps_per_CPU_s"] < ASKED and unknowns >= min(UNKNOWNS)
            if comm.rank == 0:
                print(json.dumps(rows[-1]), flush=True)
    if comm.rank == 0:
        facts = {"command": shlex.join(["scripts/bench", "explicit", *sys.argv[1:]]), **machine(), "rows": rows}
        (folder / "explicit.json").write_text(json.dumps(facts, indent=1), encoding="utf-8")
    sys.exit(int(slow))


if __name__ == "__main__":
    main()
