"""Multigrid where joints slide: sliding.py [CELLS...] [--steps N] [--fractures N] [--seed N] [--unknowns N...] [--out DIR].

A network of 20 fractures (that of scripts/bench size; --fractures and --seed make others), stressed so that hundreds of
sections slide and some open as it is pumped, with so many triangles each, by LU of the whole and by multigrid: Newton and
Krylov iterations, and the CPU seconds and memory of a run in a process of its own. Then one coupled step of 1 to 200 closed
fractures, in rows of stiffnesses, apertures, their contrast and time steps: Krylov iterations of the worst linear solve. Exit
code 1 where a bar is missed: at most 30 Krylov iterations a Newton iteration, sections that slide as by LU, and no step halved
that LU does not halve.
"""

from __future__ import annotations

import argparse
import json
import shlex
import subprocess
import sys
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
import _network as network
import coupling
from size import machine

WAYS = {
    "lu": ["method.coupling=whole-lu"],
    "multigrid": ["method.rock_solver=multigrid"],
    "staggered": ["method.coupling=fixed-point", "method.fixed_point=added-storage", "method.rock_solver=multigrid"],
}
"""Ways to solve -> settings of the scene. The staggered cycle needs many more iterations, and has no bar on them."""
MOST = 30.0
"""Krylov iterations in a Newton iteration, the mean of a step; in one step with nothing but elastic joints, of a solve."""
COUNTS = ("newton", "krylov", "slipping", "open", "factorisations", "rejected")


def network_scene(cells: int, steps: int, folder: Path, fractures: int = 20, seed: int = 0) -> Path:
    """Write mesh and scene of the sliding network."""
    name = f"{cells}-{fractures}-{seed}"
    mesh, path = folder / f"network-{name}.msh", folder / f"slide-{name}.toml"
    if not mesh.exists():
        words = [sys.executable, network.__file__, *map(str, (cells, mesh, fractures, seed))]
        subprocess.run(words, check=True)
    text = network.SCENE.format(cells=cells, mesh=mesh.name)
    for old, new in (
        ('xx = "-20 MPa", yy = "-25 MPa"', 'xx = "-25 MPa", yy = "-25 MPa", xy = "8 MPa"'),
        ('"1 L/s"', '"200 L/s"'),
        ("friction_coefficient = 0.7", "friction_coefficient = 0.44"),
        ("steps = 1", f"steps = {steps}"),
    ):
        assert old in text, f"the network's scene has no {old}"
        text = text.replace(old, new)
    path.write_text(text, encoding="utf-8")
    return path


def worker(way: str, scene: str, out: str, result: str) -> None:
    """Run the network in one way; what came of it goes to a file."""
    import resource

    from fracflow.errors import InputError, SolveError
    from fracflow.output import read_history
    from fracflow.scene.scene import load
    from fracflow.simulation.run import run

    failure, read = "", load(Path(scene), ["output.pictures=false", *WAYS[way]])
    try:
        run(read, Path(out))
    except (InputError, SolveError) as error:
        failure = str(error)
    cpu, history = time.process_time(), read_history(Path(out) / "history.h5")
    counts = {key: history[f"step/{key}"].astype(int).tolist() for key in COUNTS if f"step/{key}" in history}
    end = sum(stage.time_step * stage.steps for stage in read.stage)
    facts = {
        "way": way,
        "reached": float(history["time"][-1]) / end,
        "cpu_s": round(cpu, 1),
        "peak_gb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20, 2),
        **counts,
        "failure": failure,
    }
    Path(result).write_text(json.dumps(facts), encoding="utf-8")


def run_network(scene: Path, cells: int, ways: tuple[str, ...], folder: Path, patience: float) -> list[dict[str, Any]]:
    """Run the network in several ways, each in a process of its own."""
    found = []
    for way in ways:
        result = folder / f"{way}.json"
        result.unlink(missing_ok=True)
        words = [sys.executable, __file__, "--worker", way, str(scene), str(folder / f"run-{way}"), str(result)]
        try:
            done = subprocess.run(words, timeout=patience, stdin=subprocess.DEVNULL, capture_output=True, text=True)
            last = done.stderr.strip().splitlines()[-1:] or [f"ended with {done.returncode}"]
        except subprocess.TimeoutExpired:
            last = [f"took more than {patience:g} s"]
        text = result.read_text(encoding="utf-8") if result.exists() else json.dumps({"way": way, "failure": last})
        found.append({"cells": cells} | json.loads(text))
        print(json.dumps(found[-1]), flush=True)
    return found


@dataclass(frozen=True)
class Row:
    """One step of fractures that lie apart, each with a well, which is closed to all else: stiffnesses [Pa/m], lengths [m]."""

    unknowns: int
    fractures: int = 10
    normal: float = 1e11
    shear: float = 1e11
    time_step: float = 1.0
    aperture: float = 1e-3
    contrast: float = 1.0
    """Of the widest to the narrowest aperture."""


def rows_of(unknowns: int) -> list[Row]:
    """All rows with so many unknowns: stiffnesses, apertures, contrasts, time steps, numbers of fractures."""
    row = Row(unknowns)
    stiff = [
        (1e7, 1e6),
        (1e7, 1e4),
        (1e9, 1e9),
        (1e11, 1e4),
        (1e12, 1e6),
        (1e13, 1e13),
        (1e13, 1e6),
        (1e15, 1e15),
        (1e15, 1e8),
    ]
    return [
        *(replace(row, normal=normal, shear=shear) for normal, shear in stiff),
        *(replace(row, aperture=aperture) for aperture in (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)),
        *(replace(row, contrast=contrast) for contrast in (1e2, 1e4, 1e6)),
        *(replace(row, fractures=n, time_step=dt) for n in (1, 10, 100, 200) for dt in (1e-3, 1.0, 1e3, 1e6, 1e9)),
        replace(row, fractures=100, shear=1e6),
    ]


def step_scene(row: Row) -> dict[str, Any]:
    """Fractures that lie apart in a square of rock, each turned another way, with a well at its start."""
    scene, extent, random = (
        coupling.scene_of(row.unknowns, "buried", drained=False),
        coupling.EXTENT,
        np.random.default_rng(1),
    )
    fractures = []
    for number in range(row.fractures):
        middle = (np.array(divmod(number, beside(row))) + 0.5) * extent / beside(row)
        angle = random.uniform(0.0, np.pi)
        half = 0.5 * long(row) * np.array([np.cos(angle), np.sin(angle)])
        fractures.append({"name": f"f{number}", "points": [(middle - half).tolist(), (middle + half).tolist()]})
    size = extent / (row.unknowns / 2) ** 0.5 * 1.07
    scene["geometry"] |= {"size": size, "cells": "triangles", "fracture": fractures}
    law = scene["fracture"].pop("fault")
    scene["fracture"]["default"] = law | {"normal_stiffness": row.normal, "shear_stiffness": row.shear}
    names = [each["name"] for each in fractures]
    scene["well"] = [{"name": f"in {n}", "at": {"fracture": n, "end": "start"}, "flow_rate": 0.0} for n in names]
    return scene


def beside(row: Row) -> int:
    """Fractures along a side of the square."""
    return int(np.ceil(row.fractures**0.5))


def long(row: Row) -> float:
    """Length of a fracture [m]."""
    return 0.84 * coupling.EXTENT / beside(row)


def apertures_of(operators: Any, row: Row) -> Any:
    """Initial apertures of the fractures, which differ by the contrast, in the shape of the flow's [m]."""
    joints, shape = operators.blocks.joints, operators.flow.aperture.shape
    of_fracture = row.aperture * row.contrast ** np.random.default_rng(3).uniform(-0.5, 0.5, len(joints.fractures))
    return np.broadcast_to(of_fracture[joints.fracture].reshape(-1, *[1] * (len(shape) - 1)), shape).copy()


def rate_of(row: Row, a1: float) -> float:
    """Rate of a well that opens its fracture by a tenth of its aperture, or by 1 MPa, as far as pressure comes in the step."""
    pressure = min(0.1 * row.normal * row.aperture, 1e6)
    conducts = row.aperture**3 / (12 * coupling.VISCOSITY)
    reach = max(np.sqrt(conducts * row.normal / a1), 2.0)
    if reach >= long(row):  # all of the fracture fills: more would part its walls by metres
        return float(pressure * a1 * long(row) / row.normal)
    return float(pressure * (conducts / reach + a1 * reach / row.normal))


def one_step(row: Row, ways: tuple[str, ...]) -> list[dict[str, Any]]:
    """Krylov iterations of one quasi-static step in several ways, on one rank."""
    from fracflow._petsc import MPI
    from fracflow.advance.initial_state import equilibrium_state
    from fracflow.errors import SolveError
    from fracflow.integrators import BackwardEuler
    from fracflow.reduction.prepare import prepare
    from fracflow.scene.scene import Scene
    from fracflow.solve import options
    from fracflow.solve.monolithic import Monolithic, WholeLU
    from fracflow.solve.problem import StepProblem
    from fracflow.solve.request import StepRequest, StepRule

    model = prepare(Scene.from_data(step_scene(row)), MPI.COMM_SELF)
    state, ops, found = equilibrium_state(model), model.operators, []
    film, rule = apertures_of(ops, row), StepRule(BackwardEuler().alphas(row.time_step))
    flow = replace(ops.flow, aperture=film, law=replace(ops.flow.law, aperture=film))
    for way in ways:
        options.set_defaults(model.scene.petsc, options.BY_MULTIGRID if way == "multigrid" else options.BY_FACTORS)
        solver = (WholeLU if way == "lu" else Monolithic)(model.scene, ops, model.loads)
        solves = coupling.watch(solver.newton)
        problem = StepProblem(
            replace(ops, flow=flow), state, StepRequest(row.time_step, row.time_step, {}, model.loads), rule
        )
        for well in model.loads.wells:
            problem.source.axpy(rate_of(row, rule.alphas.a1), well.vector)
        start, failure = time.process_time(), ""
        try:
            solver.solve(problem)
        except SolveError as error:
            failure = str(error)
        facts = {**asdict(row), "unknowns": ops.layout.total, "way": way, "newton": len(solves)}
        facts["krylov"] = max((count for count, _ in solves), default=0)
        facts |= {"cpu_s": round(time.process_time() - start, 2), "failure": failure}
        print(json.dumps(facts), flush=True)
        found.append(facts)
        problem.destroy()
        solver.destroy()
    return found


def missed(networks: list[dict[str, Any]], steps: list[dict[str, Any]]) -> list[str]:
    """The bars that were missed, in words."""
    words = [
        f"{row['way']}, {row.get('cells', row.get('unknowns'))}: {row['failure']}"
        for row in networks + steps
        if row["failure"]
    ]
    direct = {row["cells"]: row for row in networks if row["way"] == "lu" and not row["failure"]}
    for row in (row for row in networks if row["way"] != "lu" and not row["failure"]):
        most = max(krylov / newton for krylov, newton in zip(row["krylov"], row["newton"], strict=True) if newton)
        if most > MOST and row["way"] == "multigrid":
            words.append(
                f"{row['cells']} triangles: {most:.0f} Krylov iterations in a Newton iteration, more than {MOST:g}"
            )
        if (other := direct.get(row["cells"])) is not None and row["slipping"] != other["slipping"]:
            words.append(
                f"{row['cells']} triangles, {row['way']}: {row['slipping']} sections slide, by LU {other['slipping']}"
            )
        if other is not None and sum(row["rejected"]) > sum(other["rejected"]) and row["way"] == "multigrid":
            words.append(
                f"{row['cells']} triangles: {sum(row['rejected'])} steps halved, by LU {sum(other['rejected'])}"
            )
    words += [f"{row}: more than {MOST:g} iterations" for row in steps if row["krylov"] > MOST]
    return words


def main() -> int:
    """Run both parts and write one file; 1 where a bar was missed."""
    parser = argparse.ArgumentParser(prog="scripts/bench sliding", description=__doc__.splitlines()[0])
    parser.add_argument(
        "cells", nargs="*", type=int, default=[20_000], help="triangles of the network; 0 leaves it out"
    )
    parser.add_argument("--steps", type=int, default=5)
    parser.add_argument("--fractures", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0, help="0 has fractures at equal distances")
    parser.add_argument("--ways", nargs="*", choices=WAYS, default=["lu", "multigrid"])
    parser.add_argument("--unknowns", nargs="*", type=int, default=[10_000, 40_000], help="of the rows")
    parser.add_argument("--rows", nargs="*", type=int, help="numbers of rows, 0 the first; all if left out")
    parser.add_argument("--patience", type=float, default=1800.0, help="seconds of one run")
    parser.add_argument("--out", type=Path, default=Path("runs/bench/sliding"))
    given = parser.parse_args()
    folder, ways = given.out.resolve(), tuple(given.ways)
    folder.mkdir(parents=True, exist_ok=True)
    facts: dict[str, Any] = {"command": shlex.join(["scripts/bench", "sliding", *sys.argv[1:]]), **machine()}
    facts["network"] = [
        row
        for cells in given.cells
        if cells
        for scene in [network_scene(cells, given.steps, folder, given.fractures, given.seed)]
        for row in run_network(scene, cells, ways, folder, given.patience)
    ]
    rows = [row for n in given.unknowns for i, row in enumerate(rows_of(n)) if given.rows is None or i in given.rows]
    facts["step"] = [found for row in rows for found in one_step(row, tuple(w for w in ways if w != "staggered"))]
    facts["missed"] = missed(facts["network"], facts["step"])
    (folder / "sliding.json").write_text(json.dumps(facts, indent=1), encoding="utf-8")
    print("\n".join(facts["missed"]) or f"all within the bars: {folder / 'sliding.json'}")
    return int(bool(facts["missed"]))


if __name__ == "__main__":
    if sys.argv[1:2] == ["--worker"]:
        worker(*sys.argv[2:])
    else:
        sys.exit(main())
