"""Multigrid where joints slide: sliding_multigrid.py [CELLS] [--ways WAY...] [--unknowns N...] [--normal K] [--shear K...].

A network of 20 fractures (that of scripts/bench size), stressed so that hundreds of sections slide as it is pumped, by LU of
the whole, by exact blocks and by multigrid in the place of the rock's: how much of the time is reached, Newton and Krylov
iterations, CPU seconds of a run in a process of its own. Then one coupled step of ten fractures that are stiff across and soft
along: Krylov iterations of the worst linear solve by the same ways, and by LU of a strip along the joints around multigrid.
CELLS 0 leaves the network out. There are no bars: it shows where multigrid stands.
"""

from __future__ import annotations

import argparse
import json
import shlex
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
import _network as network
import coupling
from _strip import NAME, Strip
from size import machine

SOLID = "monolithic_fieldsplit_solid_pc"
WAYS: dict[str, tuple[str, bool, dict[str, str]]] = {
    "lu": ("whole-lu", False, {}),
    "exact": ("monolithic", False, {}),
    "multigrid": ("monolithic", True, {}),
    "strip": ("monolithic", True, {f"{SOLID}_type": "python", f"{SOLID}_python_type": NAME}),
}
"""Way -> coupling, whether multigrid, and options of PETSc."""
COUNTS = ("newton", "krylov", "slipping", "factorisations")


def network_scene(cells: int, steps: int, folder: Path) -> Path:
    """Write mesh and scene of the sliding network."""
    mesh, path = folder / f"network-{cells}.msh", folder / f"slide-{cells}.toml"
    if not mesh.exists():
        subprocess.run([sys.executable, network.__file__, str(cells), str(mesh)], check=True)
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
    from fracflow.errors import InputError, SolveError
    from fracflow.output import read_history
    from fracflow.scene.scene import load
    from fracflow.simulation.run import run
    from fracflow.solve import options

    name, is_multigrid, _ = WAYS[way]
    if is_multigrid:
        options.MULTIGRID_FROM = 0
    failure = ""
    read = load(Path(scene), ["output.pictures=false", *([] if is_multigrid else [f'method.coupling="{name}"'])])
    try:
        run(read, Path(out))
    except (InputError, SolveError) as error:
        failure = str(error)
    cpu, history = time.process_time(), read_history(Path(out) / "history.h5")
    counts = {key: history[f"step/{key}"].astype(int).tolist() for key in COUNTS}
    end = sum(stage.time_step * stage.steps for stage in read.stage)
    facts = {
        "way": way,
        "reached": float(history["time"][-1]) / end,
        "cpu_s": round(cpu, 1),
        **counts,
        "failure": failure,
    }
    Path(result).write_text(json.dumps(facts), encoding="utf-8")


def run_network(cells: int, steps: int, ways: list[str], folder: Path, patience: float) -> list[dict[str, Any]]:
    """Run the network in several ways, each in a process of its own."""
    scene, found = network_scene(cells, steps, folder), []
    for way in (way for way in ways if way != "strip"):  # an option of Python's is none that a scene may give
        result = folder / f"{way}.json"
        result.unlink(missing_ok=True)
        words = [sys.executable, __file__, "--worker", way, str(scene), str(folder / f"run-{way}"), str(result)]
        try:
            done = subprocess.run(words, timeout=patience, stdin=subprocess.DEVNULL, capture_output=True, text=True)
            last = done.stderr.strip().splitlines()[-1:]
        except subprocess.TimeoutExpired:
            last = [f"took more than {patience:g} s"]
        text = result.read_text(encoding="utf-8") if result.exists() else json.dumps({"way": way, "failure": last})
        found.append(json.loads(text))
        print(json.dumps(found[-1]), flush=True)
    return found


def step_scene(unknowns: int, normal: float, shear: float) -> dict[str, Any]:
    """Ten fractures that lie apart in a square of rock, each turned another way, with a well at its start."""
    scene, extent, random = (
        coupling.scene_of(unknowns, "buried", drained=False),
        coupling.EXTENT,
        np.random.default_rng(1),
    )
    wide, fractures = extent / 4.0, []
    for number in range(10):
        middle = (np.array(divmod(number, 4)) + 0.5) * wide
        angle = random.uniform(0.0, np.pi)
        half = 0.42 * wide * np.array([np.cos(angle), np.sin(angle)])
        fractures.append({"name": f"f{number}", "points": [(middle - half).tolist(), (middle + half).tolist()]})
    size = extent / (unknowns / 2) ** 0.5 * 1.07
    scene["geometry"] |= {"size": size, "cells": "triangles", "fracture": fractures}
    law = scene["fracture"].pop("fault")
    scene["fracture"]["default"] = law | {"normal_stiffness": normal, "shear_stiffness": shear}
    names = [each["name"] for each in fractures]
    scene["well"] = [{"name": f"in {n}", "at": {"fracture": n, "end": "start"}, "flow_rate": 0.0} for n in names]
    return scene


def one_step(unknowns: int, normal: float, shear: float, ways: list[str]) -> list[dict[str, Any]]:
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

    model = prepare(Scene.from_data(step_scene(unknowns, normal, shear)), MPI.COMM_SELF)
    state, ops, found = equilibrium_state(model), model.operators, []
    block, joints = ops.blocks.solid, ops.blocks.joints
    Strip.walls = np.unique(block.unknown[np.concatenate([joints.bottom.ravel(), joints.top.ravel()])])
    rule, aperture = StepRule(BackwardEuler().alphas(1.0)), 1e-3
    pressure = min(0.1 * normal * aperture, 1e6)
    reach = np.clip(np.sqrt(aperture**3 * normal / (12 * coupling.VISCOSITY * rule.alphas.a1)), 2.0, 300.0)
    rate = pressure * (aperture**3 / (12 * coupling.VISCOSITY * reach) + rule.alphas.a1 * reach / normal)
    for way in ways:
        name, is_multigrid, more = WAYS[way]
        options.set_defaults({**model.scene.petsc, **more}, options.MULTIGRID_FROM if is_multigrid else 0)
        solver = (WholeLU if name == "whole-lu" else Monolithic)(model.scene, ops, model.loads)
        solves = coupling.watch(solver.newton)
        problem = StepProblem(replace(ops), state, StepRequest(1.0, 1.0, {}, model.loads), rule)
        for well in model.loads.wells:
            problem.source.axpy(rate, well.vector)
        start, failure = time.process_time(), ""
        try:
            solver.solve(problem)
        except SolveError as error:
            failure = str(error)
        facts = {"unknowns": ops.layout.total, "normal": normal, "shear": shear, "way": way, "newton": len(solves)}
        facts["krylov"] = max((count for count, _ in solves), default=0)
        facts |= {"cpu_s": round(time.process_time() - start, 2), "failure": failure}
        print(json.dumps(facts), flush=True)
        found.append(facts)
        problem.destroy()
        solver.destroy()
    return found


def main() -> None:
    """Run both parts and write one file."""
    parser = argparse.ArgumentParser(prog="scripts/bench sliding_multigrid", description=__doc__.splitlines()[0])
    parser.add_argument("cells", nargs="?", type=int, default=20_000, help="triangles of the network; 0 leaves it out")
    parser.add_argument("--steps", type=int, default=5)
    parser.add_argument("--ways", nargs="*", choices=WAYS, default=list(WAYS))
    parser.add_argument("--unknowns", nargs="*", type=int, default=[10_000, 40_000])
    parser.add_argument("--normal", type=float, default=1e11, help="normal stiffness in the step [Pa/m]")
    parser.add_argument("--shear", nargs="*", type=float, default=[1e11, 1e6], help="shear stiffnesses [Pa/m]")
    parser.add_argument("--patience", type=float, default=1800.0, help="seconds of one run")
    parser.add_argument("--out", type=Path, default=Path("runs/bench/sliding_multigrid"))
    given = parser.parse_args()
    folder = given.out.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    facts: dict[str, Any] = {"command": shlex.join(["scripts/bench", "sliding_multigrid", *sys.argv[1:]]), **machine()}
    facts["network"] = run_network(given.cells, given.steps, given.ways, folder, given.patience) if given.cells else []
    facts["step"] = [
        row for n in given.unknowns for shear in given.shear for row in one_step(n, given.normal, shear, given.ways)
    ]
    (folder / "sliding_multigrid.json").write_text(json.dumps(facts, indent=1), encoding="utf-8")


if __name__ == "__main__":
    if sys.argv[1:2] == ["--worker"]:
        worker(*sys.argv[2:])
    else:
        main()
