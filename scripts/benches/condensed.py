"""The rock condensed to its joints against Newton's method on all unknowns: condensed.py [CELLS] [JOINTS] [STEPS] [--out DIR].

A fault in a square of CELLS x CELLS cells is near its strength, and past it in the middle: slip runs out from there, stops,
and starts again as waves pass. The same dynamic steps by coupling = "condensed" and by full and modified Newton, each in a
process of its own; CPU seconds are those of the steps, with all matrices and factors that they need. Exit code 1 where a bar
is missed: at least 4 times less CPU than the better of both, displacements equal to 1e-10 of the largest, of full Newton; of
modified Newton, whose iterations converge slowly, to 1e-8.
"""

from __future__ import annotations

import argparse
import json
import resource
import shlex
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from _launch import without_ranks

sys.path.insert(0, str(Path(__file__).parents[1]))
from sheets import Check, judge, write_csv

RIVALS = {
    "newton": {"newton": "newton", "coupling": "monolithic"},
    "modified": {"newton": "modified"},
    "condensed": {"coupling": "condensed"},
}
FASTER, EQUAL, EQUAL_MODIFIED = 4.0, 1e-10, 1e-8
AROUND = 3.0  # the break-even is foreseen within this factor


def scene_of(cells: int, joints: int, steps: int, method: dict[str, str]) -> dict[str, Any]:
    """A fault of ``joints`` joints in the middle, its shear stress by place; sizes are of a cell, E and density 1."""
    first, patch, middle, edge = 0.5 * (cells - joints), joints / 8.0, 0.5 * joints, 1e-6
    along = [0.0, middle - patch, middle - patch + edge, middle + patch - edge, middle + patch, joints]
    fault = {
        "normal_stiffness": 10.0, "shear_stiffness": 2.0, "aperture": 1.0, "friction_coefficient": 0.5,
        "initial_shear_traction": {"along": along, "value": [0.495, 0.495, 0.7, 0.7, 0.495, 0.495]},
    }  # fmt: skip
    return {
        "units": "none",
        "geometry": {
            "domain": [0.0, 0.0, cells, cells], "size": 1.0, "cells": "quads",
            "fracture": [{"name": "fault", "points": [[first, 0.5 * cells], [first + joints, 0.5 * cells]]}],
        },
        "rock": {"rock": {"youngs_modulus": 1.0, "poissons_ratio": 0.25, "density": 1.0}},
        "initial_stress": {"yy": -1.0, "xx": -1.0, "xy": 0.495, "unbalanced": "carried"},
        "fracture": {"fault": fault},
        "absorbing": [{"on": ["south", "north", "west", "east"]}],
        "method": {"events": "at-step-ends", "contact": "lumped", **method},
        "stage": [{"kind": "dynamic", "time_step": 0.5, "steps": steps}],
    }  # fmt: skip


def worker(name: str, cells: str, joints: str, steps: str, folder: str) -> None:
    """Make all steps by one method; write CPU seconds, iterations and sliding sections by step, and the displacements."""
    from fracflow._petsc import MPI
    from fracflow.advance.initial_state import equilibrium_state
    from fracflow.advance.stage import run_stage
    from fracflow.advance.step import Stepping, stepper_of
    from fracflow.errors import SolveError
    from fracflow.reduction.prepare import prepare
    from fracflow.scene.scene import Scene

    scene = Scene.from_data(scene_of(int(cells), int(joints), int(steps), RIVALS[name]))
    model = prepare(scene, MPI.COMM_SELF)
    stepping, begun = Stepping(model), time.process_time()
    state = stepping.enter(equilibrium_state(model), stepper_of(scene, scene.stage[0]), scene.stage[0].time_step or 0.0)
    found: dict[str, Any] = {"cpu": [], "newton": [], "factorisations": [], "sliding": [], "failure": ""}
    moved = np.lib.format.open_memmap(
        Path(folder) / f"{name}.npy", "w+", np.float64, (int(steps), model.operators.layout.solid_count)
    )
    try:
        for number, step in enumerate(run_stage(stepping, state, 0, lambda line: None, {})):
            moved[number] = step.state.motion.displacement.getArray(readonly=True)
            found["cpu"].append(time.process_time() - begun)
            found["newton"].append(step.report.newton)
            found["factorisations"].append(step.report.factorisations)
            found["sliding"].append(int(step.state.sections.is_sliding.sum()))
    except SolveError as error:
        found["failure"] = str(error)
    joints_here = model.operators.joints
    found |= {"unknowns": model.operators.layout.total, "jumps": len(joints_here.weights) * joints_here.dim}
    found["memory_GB"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024**2
    (Path(folder) / f"{name}.json").write_text(json.dumps(found), encoding="utf-8")


def measure(name: str, cells: int, joints: int, steps: int, folder: Path) -> dict[str, Any]:
    """All steps by one method, in a process of its own."""
    print(f"{name} ...", file=sys.stderr, flush=True)
    given = [name, str(cells), str(joints), str(steps), str(folder)]
    clean = without_ranks()
    subprocess.run([sys.executable, __file__, "--worker", *given], check=True, env=clean)
    result: dict[str, Any] = json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))
    return result


def difference(folder: Path, name: str) -> float:
    """Largest difference of displacements from those of full Newton, over the largest of them, of all steps."""
    found, wanted = (np.load(folder / f"{each}.npy", mmap_mode="r") for each in (name, "newton"))
    pairs = zip(found, wanted, strict=True)
    return float(max(np.abs(one - other).max() for one, other in pairs) / np.abs(wanted).max())


def main() -> int:
    """Measure, print and write one CSV; 1 where a bar is missed."""
    from fracflow.solve.condensed_cost import break_even

    parser = argparse.ArgumentParser(prog="scripts/bench condensed", description=__doc__.splitlines()[0])
    parser.add_argument("cells", nargs="?", type=int, default=224, help="of a side of the square")
    parser.add_argument("joints", nargs="?", type=int, default=200, help="of the fault; each has 4 jumps")
    parser.add_argument("steps", nargs="?", type=int, default=100)
    parser.add_argument("--out", type=Path, default=Path("runs/bench"), help="folder of condensed.csv")
    parser.add_argument(
        "--faster", type=float, default=FASTER, help="bar: times less CPU than the better rival; 0: no bar on time"
    )
    given = parser.parse_args()
    folder = given.out.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    found = {name: measure(name, given.cells, given.joints, given.steps, folder) for name in RIVALS}
    mine, whole = found["condensed"], {name: run for name, run in found.items() if not run["failure"]}
    for name, run in found.items():
        cost = f"{run['cpu'][-1]:.1f} CPU s" if name in whole else f"failed: {run['failure']}"
        print(
            f"{name:10} {cost}, {sum(run['newton'])} Newton iterations, {sum(run['factorisations'])} factorisations,"
            f" {run['memory_GB']:.2f} GB"
        )
    slid = sum(count > 0 for count in found["newton"]["sliding"])
    print(f"{mine['unknowns']} displacements, {mine['jumps']} jumps; sections slide in {slid} of {given.steps} steps")
    best = min((run["cpu"][-1] for name, run in whole.items() if name != "condensed"), default=np.nan)
    ratio = best / mine["cpu"][-1] if "condensed" in whole else 0.0
    checks = [Check("CPU of the better rival over condensed", ratio, f">= {given.faster:g}", ratio >= given.faster)]
    for name, bar in (("condensed", EQUAL), ("modified", EQUAL_MODIFIED)):
        if name in whole and "newton" in whole:
            apart = difference(folder, name)
            checks.append(Check(f"displacements, {name} against Newton", apart, f"<= {bar:g}", apart <= bar))
    iterations = float(np.mean(found["newton"]["newton"]))
    predicted = break_even(mine["unknowns"], mine["jumps"], iterations)
    steps = min(len(run["cpu"]) for run in (mine, found["newton"]))
    pays = np.flatnonzero(np.array(mine["cpu"][:steps]) <= np.array(found["newton"]["cpu"][:steps]))
    measured = float(pays[0] + 1) if len(pays) else np.inf
    print(f"break-even at {iterations:.2f} iterations a step: {measured:g} steps measured, {predicted:g} foreseen")
    near = predicted / AROUND <= measured <= predicted * AROUND
    checks.append(Check("break-even, steps", measured, f"{predicted:g} foreseen, within {AROUND:g} times", near))
    columns = {
        f"{name}_{key}": np.array(run[key]) for name, run in found.items() for key in ("cpu", "newton", "sliding")
    }
    write_csv(folder, "condensed", columns, [shlex.join(["scripts/bench", "condensed", *sys.argv[1:]])])
    return judge(checks, folder)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--worker"]:
        worker(*sys.argv[2:])
    else:
        raise SystemExit(main())
