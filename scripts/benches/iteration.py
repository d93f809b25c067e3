"""CPU of a Newton iteration by its parts, at 1.2e3 nodes: the first three minutes of Task B of ``figures benchmarks``.

    scripts/bench iteration [SCENE] [--cells N] [--ranks N] [--repeats N] [--set KEY=VALUE] [--out DIR]
                            [--most SECONDS] [--outside SHARE]

Runs the program itself with a stopwatch around the functions below; a part's time is its own, without that of the parts inside
it. Milliseconds are those of rank 0 for each iteration of Newton's method, accepted or not; on several ranks they include its
waiting. Of several runs the one with the least is shown. PETSc's own share is divided as the wall times of its log are. With
--cells the scene is five steps of the network of ``size``. Exit 1 where an iteration, with all that belongs to a step but for
its record, takes more than --most, or what is outside PETSc more than the share --outside of it.
"""

from __future__ import annotations

import argparse
import csv
import json
import subprocess
import sys
import tempfile
from pathlib import Path

from _launch import without_ranks

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(1, str(Path(__file__).parents[1]))
import _network as network
from _stopwatch import Stopwatch

STAGE = 'stage = [{name = "test", kind = "quasi-static", time_step = 3, steps = 60}]'
PETSC = "PETSc"
OF_ITERATION = {
    "joint laws": ["solve.problem:StepProblem.evaluate_joints"],
    "balance of the flow": ["solve.problem:StepProblem._flow_balance"],
    "balance of the rock": ["solve.problem:StepProblem.evaluate"],
    "sizes of residuals": ["solve.problem:StepProblem._measure"],
    "matrix": ["solve.jacobian:JoinedMatrix.fill"],
    "line search, held conductances": ["solve.newton:Newton._search", "solve.newton:Newton._hold_conductances"],
    "checks": ["solve.newton:Newton._pre_check", "solve.newton:Newton._converged", "solve.newton:Newton._floats"],
    "unknowns to and from PETSc": ["solve.newton:Newton._function", "solve.newton:Newton._jacobian"],
    PETSC: ["solve.newton:Newton.solve"],
}
OF_STEP = {
    "beginning and end of steps": ["advance.step:SingleStep.advance"],
    "ways to advance": ["advance.substeps:Substepped.advance"],
    "record": ["simulation.recorder:Recorder.record", "simulation.recorder:Recorder.save"],
}
"""Part -> the functions it consists of, module:name."""
EVENTS = {"factorisation": ("MatLUFactorSym", "MatLUFactorNum", "MatLUFactor"), "solve": ("MatSolve",)}
EVALUATIONS = "evaluations of an iteration"


def worker(scene: str, folder: str, result: str, *overrides: str) -> None:
    """Run a scene under the stopwatch; rank 0 writes milliseconds an iteration, by part."""
    from fracflow._petsc import MPI, PETSc, logged
    from fracflow.scene.scene import load
    from fracflow.simulation.run import run

    given = load(scene, ["output.pictures=false", *overrides])
    PETSc.Log.begin()
    watch = Stopwatch(OF_ITERATION | OF_STEP)
    totals = run(given, folder, MPI.COMM_WORLD)
    watch.lap()
    if MPI.COMM_WORLD.rank:
        return
    made = totals.counts["newton"] + totals.counts["wasted"]
    each = {name: 1e3 * watch.parts[name]["cpu"] / made for name in (*OF_ITERATION, *OF_STEP)}
    spent = {name: sum(logged(event, "time") for event in events) for name, events in EVENTS.items()}
    wall, cpu = watch.parts[PETSC]["wall"], each.pop(PETSC)
    parts = {f"{PETSC}: {name}": cpu * seconds / wall for name, seconds in spent.items()}
    rest = {f"{PETSC}: all else": cpu - sum(parts.values())}
    facts = {"iterations": made, "factorisations": totals.factored, EVALUATIONS: totals.evaluations / made}
    Path(result).write_text(json.dumps({"parts": parts | rest | each, "facts": facts}), encoding="utf-8")


def measure(scene: Path, ranks: int, overrides: list[str]) -> dict[str, dict[str, float]]:
    """One run in processes of its own; what ``worker`` found."""
    clean = without_ranks()
    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder) / "result.json"
        command = [sys.executable, __file__, "--worker", str(scene), f"{folder}/run", str(result), *overrides]
        subprocess.run(["mpirun", "-n", str(ranks), *command][3 * (ranks == 1) :], check=True, env=clean)
        return json.loads(result.read_text(encoding="utf-8"))


def main() -> None:
    """Measure, print and judge."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", nargs="?", type=Path, help="a scene in place of Task B")
    parser.add_argument("--ranks", type=int, default=1)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--set", action="append", default=[], help="key=value of the scene, as for fracflow run")
    parser.add_argument("--cells", type=int, help="triangles of a network in its place")
    parser.add_argument("--most", type=float, help="CPU seconds of an iteration; .015 of Task B")
    parser.add_argument("--outside", type=float, default=1.0, help="share outside PETSc")
    parser.add_argument("--out", type=Path, help="for iteration.csv")
    given = parser.parse_args()
    from figures_benchmarks.cases import task_b

    with tempfile.TemporaryDirectory() as folder:
        scene, overrides = given.scene or Path(folder) / "scene.toml", given.set
        if given.cells:
            make = [sys.executable, network.__file__, str(given.cells), f"{folder}/network.msh"]
            subprocess.run(make, check=True)
            scene.write_text(network.SCENE.format(cells=given.cells, mesh="network.msh"), encoding="utf-8")
            overrides = ["stage.0.steps=5", *overrides]
        elif given.scene is None:
            scene.write_text(f"{STAGE}\n{task_b.scene()}", encoding="utf-8")
            given.most = given.most or 0.015
        runs = [measure(scene.resolve(), given.ranks, overrides) for _ in range(given.repeats)]
    found = min(runs, key=lambda run: sum(run["parts"].values()))
    parts, facts = found["parts"], found["facts"]
    inside = [name for name in parts if name not in OF_STEP]
    newton, step = sum(parts[name] for name in inside), sum(parts.values()) - parts["record"]
    outside = step - sum(parts[name] for name in inside if name.startswith(PETSC))
    rows = [*((name, parts[name]) for name in inside), ("an iteration of Newton's method", newton)]
    rows += [*((name, parts[name]) for name in OF_STEP), ("all of a step but its record", step)]
    rows += [("of it outside PETSc", outside)]
    for name, value in rows:
        print(f"{name:34s} {value:8.3f} ms {100.0 * value / step:6.1f} %")
    print(", ".join(f"{value:.5g} {name}" for name, value in facts.items()))
    if given.out is not None:
        given.out.mkdir(parents=True, exist_ok=True)
        with (given.out / "iteration.csv").open("w", encoding="utf-8", newline="") as file:
            table = csv.writer(file)
            table.writerow(("part", "cpu_ms", "ranks"))
            table.writerows((name, f"{value:.4f}", given.ranks) for name, value in [*rows, *facts.items()])
    sys.exit(outside > given.outside * step or (given.most is not None and step > 1e3 * given.most))


if __name__ == "__main__":
    if sys.argv[1:2] == ["--worker"]:
        worker(*sys.argv[2:])
    else:
        main()
