"""The choice of ``rock_solver = "auto"`` held against runs: rock_solver.py [CELLS...] [--space UNKNOWNS...] [--ranks N].

The sliding network of scripts/bench sliding by LU and by multigrid, each in a process of its own: CPU seconds of PETSc's solve
in a Newton iteration, and the largest memory. With --space the sliding planes of scripts/bench sliding_3d, too. Beside them
stands what fracflow/solve/rock_cost.py says. On several ranks seconds are of the slowest, and memory is of all. Exit code 1
where a bar is missed: time over that of LU off by more than 1.5 times, memory by more than 1.2 times, or a choice that takes
more than 1.5 times the time of the other.
"""

from __future__ import annotations

import argparse
import json
import resource
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))
import sliding
from _stopwatch import Stopwatch
from size import machine

WAYS = ("lu", "multigrid")
OFF, MEMORY_OFF, LEAST = 1.5, 1.2, 1e4
"""Bars, and unknowns from which on times are judged: below, parts that do not grow count."""
SOLVE, BESIDES = "linear solves", ["solve.problem:StepProblem.evaluate", "solve.jacobian:JoinedMatrix.fill"]
"""Functions inside Newton's method that are no linear solve."""


def worker(way: str, scene: str, out: str, result: str) -> None:
    """Run the network in one way under the stopwatch."""
    from fracflow._petsc import MPI
    from fracflow.output import read_history
    from fracflow.scene.scene import load
    from fracflow.simulation.run import run

    choice = {"lu": "direct", "multigrid": "multigrid"}[way]
    watch = Stopwatch({SOLVE: ["solve.newton:Newton.solve"], "besides": BESIDES})
    settings = ["output.pictures=false", f"method.rock_solver={choice}", "method.coupling=auto"]
    run(load(Path(scene), settings), Path(out))
    watch.lap()
    seconds = MPI.COMM_WORLD.reduce(watch.parts[SOLVE]["cpu"], op=MPI.MAX)
    peak = MPI.COMM_WORLD.reduce(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024.0)
    if MPI.COMM_WORLD.rank:
        return
    history = read_history(Path(out) / "history.h5")
    facts = {key: int(history[f"step/{key}"].sum()) for key in ("newton", "krylov", "factorisations")}
    facts["slipping"] = int(history["step/slipping"][-1])
    facts["cpu_s"], facts["peak"] = seconds, peak
    Path(result).write_text(json.dumps(facts), encoding="utf-8")


def in_plane(cells: int, given: argparse.Namespace, folder: Path) -> dict[str, Any]:
    """The network with so many triangles, by both."""
    from fracflow.mesh.cut_mesh import sizes_of
    from fracflow.mesh.store import load_mesh

    scene, found = sliding.network_scene(cells, given.steps, folder), {"dim": 2, "ranks": given.ranks}
    launcher = ["mpirun", "-n", str(given.ranks)] if given.ranks > 1 else []
    for way in WAYS:
        result, out = folder / f"{way}.json", folder / f"run-{way}"
        words = [*launcher, sys.executable, __file__, "--worker", way, str(scene), str(out), str(result)]
        done = subprocess.run(words, stdin=subprocess.DEVNULL, capture_output=True, text=True)
        if done.returncode:
            sys.exit(f"{shlex.join(words)}\n{done.stdout}{done.stderr}")
        facts = json.loads(result.read_text(encoding="utf-8"))
        found["unknowns"] = 2 * sizes_of(load_mesh(out / "mesh.h5"))[1]
        found["krylov"] = facts["krylov"] / facts["newton"] if way == "multigrid" else None
        found |= {f"{way}_s": facts["cpu_s"] / facts["newton"], f"{way}_bytes": facts["peak"]}
    return found


def in_space(unknowns: int, folder: Path) -> dict[str, Any]:
    """Sliding planes with so many unknowns, by both."""
    program = Path(__file__).with_name("sliding_3d.py")
    words = [sys.executable, str(program), str(unknowns), "--solve", *WAYS, "--out", str(folder / "space")]
    facts = json.loads(subprocess.run(words, check=True, capture_output=True, text=True).stdout)
    seconds = {f"{way}_s": facts[way]["set_up_cpu_s"] + facts[way]["solve_cpu_s"] for way in WAYS}
    return {"dim": 3, "ranks": 1, "unknowns": facts["unknowns"], "krylov": facts["multigrid"]["krylov"], **seconds}


def judged(row: dict[str, Any]) -> dict[str, Any]:
    """A row with what the model says, and the bars that it misses."""
    from fracflow.scene.method import Method
    from fracflow.solve import rock_cost as model

    n, dim = row["unknowns"], row["dim"]
    shares = {"lu": model.direct(n, dim), "multigrid": model.multigrid(n, dim, row["krylov"])}
    said, ratio = shares["multigrid"].seconds / shares["lu"].seconds, row["multigrid_s"] / row["lu_s"]
    taken = "multigrid" if model.RockChoice.of(Method(), n, dim=dim).by_multigrid else "lu"
    other = {"multigrid": "lu", "lu": "multigrid"}[taken]
    row |= {"ratio": ratio, "ratio_said": said, "krylov_said": model.iterations(n, dim), "auto": taken, "missed": []}
    for way, cost in shares.items():
        row[f"{way}_said_s"] = cost.seconds
        if (used := row.get(f"{way}_bytes")) is not None:
            expected = cost.bytes + model.PROGRAM * (row["ranks"] - 1)
            row[f"{way}_said_bytes"] = expected
            if not 1.0 / MEMORY_OFF <= used / expected <= MEMORY_OFF:
                row["missed"].append(f"{way} took {used / 1e9:.2f} GB, said {expected / 1e9:.2f}")
    if n >= LEAST and not 1.0 / OFF <= ratio / said <= OFF:
        row["missed"].append(f"multigrid took {ratio:.2f} times the time of LU, said {said:.2f}")
    if row[f"{taken}_s"] > OFF * row[f"{other}_s"]:
        row["missed"].append(
            f"auto takes {taken}, which took {row[f'{taken}_s'] / row[f'{other}_s']:.2f} times the other"
        )
    return row


def main() -> int:
    """Measure, print and judge; 1 where a bar is missed."""
    parser = argparse.ArgumentParser(prog="scripts/bench rock_solver", description=__doc__.splitlines()[0])
    parser.add_argument("cells", nargs="*", type=int, default=[20_000, 80_000], help="triangles of the network")
    parser.add_argument("--space", nargs="*", type=int, default=[], help="unknowns of the sliding planes")
    parser.add_argument("--steps", type=int, default=2)
    parser.add_argument("--ranks", type=int, default=1, help="of the network")
    parser.add_argument("--out", type=Path, default=Path("runs/bench/rock_solver"))
    given = parser.parse_args()
    folder = given.out.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    rows = [judged(in_plane(cells, given, folder)) for cells in given.cells if cells]
    rows += [judged(in_space(unknowns, folder)) for unknowns in given.space]
    for row in rows:
        print(json.dumps({key: round(v, 3) if isinstance(v, float) else v for key, v in row.items()}), flush=True)
    facts = {"command": shlex.join(["scripts/bench", "rock_solver", *sys.argv[1:]]), **machine(), "rows": rows}
    (folder / "rock_solver.json").write_text(json.dumps(facts, indent=1), encoding="utf-8")
    return int(any(row["missed"] for row in rows))


if __name__ == "__main__":
    if sys.argv[1:2] == ["--worker"]:
        worker(*sys.argv[2:])
    else:
        sys.exit(main())
