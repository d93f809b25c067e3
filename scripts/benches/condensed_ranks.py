"""Condensed rock whose sections rank 0 solves for, against all ranks by ScaLAPACK: condensed_ranks.py [JOINTS ...] [--fluid].

The fault of ``scripts/bench condensed``, in a strip that is a quarter as high; with --fluid a well pumps at its end. Each run
has processes of its own. Time is that of the solves for jumps and pressures (FracSections), and memory the peak of each rank.
Exit code 1 where slip differs by more than 1e-10 of the largest.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from _launch import without_ranks
from condensed import RIVALS, scene_of

EQUAL = 1e-10
WAYS = {"rank 0": 10**9, "all ranks": 0}  # the fewest jumps that all ranks solve for
FLUID = {
    "fluid": {"viscosity": 1e-3, "specific_weight": 1.0},
    "well": [{"name": "in", "at": {"fracture": "fault", "end": "start"}, "flow_rate": [[0.0, 0.0], [1.0, 0.01]]}],
}


def worker(way: str, joints: str, steps: str, fluid: str, file: str) -> None:
    """Make all steps on the ranks of this run; write iterations, time, memory of each rank, and slip at the end."""
    from fracflow._petsc import MPI, PETSc
    from fracflow.advance.initial_state import equilibrium_state
    from fracflow.advance.stage import run_stage
    from fracflow.advance.step import Stepping, stepper_of
    from fracflow.reduction.prepare import prepare
    from fracflow.scene.scene import Scene
    from fracflow.solve.condensed import spread

    spread.FEWEST = WAYS[way]
    PETSc.Log.begin()
    wide, high = int(joints) * 11 // 10, int(joints) // 4
    data = scene_of(wide, int(joints), int(steps), RIVALS["condensed"]) | (FLUID if int(fluid) else {})
    data["geometry"]["domain"] = [0.0, 0.5 * (wide - high), wide, 0.5 * (wide + high)]
    scene, comm = Scene.from_data(data), MPI.COMM_WORLD
    model = prepare(scene, comm)
    stepping, newton = Stepping(model), 0
    state = stepping.enter(equilibrium_state(model), stepper_of(scene, scene.stage[0]), scene.stage[0].time_step or 0.0)
    for step in run_stage(stepping, state, 0, lambda line: None, {}):
        state, newton = step.state, newton + step.report.newton
    peak = int(next(line.split()[1] for line in Path("/proc/self/status").read_text().splitlines() if "VmHWM" in line))
    slid = comm.gather((model.operators.blocks.joints.ids, state.sections.strain.reshape(-1, 4)))
    found = comm.gather((PETSc.Log.Event("FracSections").getPerfInfo()["time"], peak / 2**20))
    if found is not None and slid is not None:
        ids, strain = (np.concatenate(each) for each in zip(*slid, strict=True))
        seconds, memory = zip(*found, strict=True)
        told = {"newton": newton, "seconds": max(seconds), "memory": memory, "slip": strain[np.argsort(ids)].tolist()}
        Path(file).write_text(json.dumps(told), encoding="utf-8")


def measure(way: str, given: argparse.Namespace, joints: int, folder: Path) -> dict[str, Any]:
    """All steps with sections solved for on rank 0, or on all ranks."""
    file = folder / "found.json"
    words = [sys.executable, __file__, "--worker", way, joints, given.steps, int(given.fluid), file]
    subprocess.run(["mpirun", "-n", str(given.ranks), *map(str, words)], check=True, env=without_ranks())
    result: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    return result


def main() -> int:
    """Measure and print; 1 where slip differs."""
    parser = argparse.ArgumentParser(prog="scripts/bench condensed_ranks", description=__doc__.splitlines()[0])
    parser.add_argument("joints", nargs="*", type=int, default=[100, 200, 400], help="of the fault; each has 4 jumps")
    parser.add_argument("--steps", type=int, default=10)
    parser.add_argument("--ranks", type=int, default=2)
    parser.add_argument("--fluid", action="store_true", help="pump fluid into the fault")
    given, worst = parser.parse_args(), 0.0
    for joints in given.joints:
        with tempfile.TemporaryDirectory() as folder:
            found = {way: measure(way, given, joints, Path(folder)) for way in WAYS}
        first, other = (np.array(run["slip"]) for run in found.values())
        worst = max(worst, apart := float(np.abs(first - other).max() / np.abs(first).max()))
        for way, run in found.items():
            memory = ", ".join(f"{each:.3f}" for each in run["memory"])
            print(
                f"{4 * joints} jumps, {way:9} {run['newton']} iterations, {run['seconds']:.2f} s, {memory} GB",
                flush=True,
            )
        print(f"{4 * joints} jumps, jumps differ by {apart:.1e} of the largest", flush=True)
    return int(worst > EQUAL)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--worker"]:
        worker(*sys.argv[2:])
    else:
        raise SystemExit(main())
