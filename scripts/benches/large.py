"""Time and memory of each part of a large run: [CELLS...] [--fractures N] [--refine N] [--saved] [--ranks N...] [--ways W...].

The network of _network.py, meshed by Gmsh with so many triangles, which the ranks cut N times in four. Explicit steps of a
network that begins to slide between absorbing sides are stopped half way and resumed. One quasi-static step with sliding is
solved by multigrid, or by LU (direct). Each is a run of its own on each number of ranks, with a stopwatch around the functions
below. CPU seconds are the mean over ranks, with their waiting; --samples adds those of each rank without it. Memory is the peak
of each rank so far, VmHWM, of which the last is fitted by c + a N/P + b N, for N cells on P ranks. With --saved the mesh is one
that ``fracflow mesh`` has split and saved. Where it is large, and --refine 0, ranks take slices of it.
"""

from __future__ import annotations

import argparse
import json
import shlex
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

from _launch import without_ranks

sys.path.insert(0, str(Path(__file__).parent))
import _network as network
from _samples import sampled, seconds
from _stopwatch import REST, Stopwatch
from size import machine

CELLS, RANKS = (25_000, 100_000), (1, 2, 4)
WAYS = ("explicit", "resume", "quasi-static", "direct")
SPEED = 4714.0  # of waves of compression in the scene's rock [m/s]
COURANT = 0.03  # of a step that is one explicit step
SCENES = {
    "explicit": (
        ('xx = "-20 MPa", yy = "-25 MPa"', 'unbalanced = "carried", xx = "-25 MPa", yy = "-25 MPa", xy = "8 MPa"'),
        ("support", "absorbing"),
        ("friction_coefficient = 0.7", "friction_coefficient = 0.3"),
        ('kind = "quasi-static", time_step = "60 s", steps = 1', 'kind = "dynamic", time_step = {step}, steps = {steps}'),
    ),
    "quasi-static": (
        ('xx = "-20 MPa", yy = "-25 MPa"', 'xx = "-25 MPa", yy = "-25 MPa", xy = "8 MPa"'),
        ('"1 L/s"', '"200 L/s"'),
        ("friction_coefficient = 0.7", "friction_coefficient = 0.44"),
    ),
}  # fmt: skip
SCENES["direct"] = SCENES["quasi-static"]
METHODS = {
    "explicit": 'method.stepper = "explicit"',
    "quasi-static": 'method.rock_solver = "multigrid"',
    "direct": 'method.coupling = "whole-lu"',
}
PARTS = {
    "mesh": ["reduction.sliced:_read_on_root", "model.setup:near_mesh", "reduction.sliced:load_mesh"],
    "places and checks": [
        "reduction.sliced:place",
        "reduction.prepare:unresolved",
        "reduction.prepare:unconnected_wells",
        "simulation.files:pre_run_checks",
    ],
    "distribution": ["model.setup:distribute", "reduction.sliced:InFile.taken"],
    "assembly": ["model.setup:assemble", "model.setup:with_terms", "model.setup:assemble_loads"],
    "initial state": [
        "simulation.run:refuse_imbalance",
        "simulation.run:planned",
        "simulation.run:equilibrium_state",
        "simulation.run:restore_state",
        "advance.step:Stepping.enter",
    ],
    "steps": ["simulation.run:_steps"],
    "history": ["simulation.recorder:Recorder.__init__", "simulation.recorder:Recorder.record"],
    "fields": ["simulation.recorder:Recorder._fields"],
    "checkpoint": ["simulation.recorder:Recorder.save"],
}
"""Part -> the functions it consists of, module:name."""


def scene_of(way: str, mesh: Path, cells: int, refine: int, steps: int) -> str:
    """Text of the scene of a way on a mesh of so many cells."""
    text = network.SCENE.format(cells=cells, mesh=mesh.name)
    if way == "explicit":  # without fluid, whose steps are implicit
        fluid, support, well, stage = (text.index(f"{key} = ") for key in ("fluid", "support", "well", "stage"))
        text = text[:fluid] + text[support:well] + text[stage:]
    for old, new in SCENES[way]:
        assert old in text, f"the network's scene has no {old}"
        text = text.replace(old, new)
    size = (network.EXTENT**2 / network.SHAPE / cells) ** 0.5 / 2**refine
    text = text.replace("{step}", f"{COURANT * size / SPEED:.3g}").replace("{steps}", str(steps))
    return text.replace(
        f'mesh.file = "{mesh.name}"', f'{METHODS[way]}\nmesh = {{file = "{mesh.name}", refine = {refine}}}'
    )


def worker(way: str, scene: str, folder: str, stop: int, result: str) -> None:
    """Run or resume under the stopwatch, on this rank of several; rank 0 writes what all found."""
    from fracflow._petsc import MPI
    from fracflow.errors import Interrupted
    from fracflow.output import read_history
    from fracflow.scene.scene import load
    from fracflow.simulation.run import resume, run

    comm, watch, made = MPI.COMM_WORLD, Stopwatch(PARTS), [0]

    def stops(step: object) -> None:
        made[0] += 1
        if made[0] == stop:
            signal.raise_signal(signal.SIGTERM)

    try:
        if way == "resume":
            resume(folder, comm)
        else:
            run(load(scene, ["output.pictures=false"]), folder, comm, progress=stops)
    except Interrupted:
        pass
    watch.lap()
    found = comm.gather(watch.parts, root=0)
    if found is not None:
        history = read_history(Path(folder) / "history.h5")
        log = (Path(folder) / "log.txt").read_text(encoding="utf-8").splitlines()
        sizes = next(line for line in log if " cells, " in line).partition(": ")[2].split()
        facts = {"cells": int(sizes[0]), "nodes": int(sizes[2]), "steps": len(history["time"]) - 1}
        facts |= {key: float(history[f"step/{key}"].sum()) for key in ("newton", "krylov") if f"step/{key}" in history}
        facts["slipping"] = int(history["step/slipping"][-1])
        Path(result).write_text(json.dumps(facts | {"ranks": found}), encoding="utf-8")


def measure(way: str, scene: Path, ranks: int, stop: int, out: Path, samples: bool = False) -> dict[str, Any]:
    """Run a way in processes of its own; what ``worker`` found, and samples of each rank."""
    folder, result = out / f"run-{scene.stem}-{ranks}", out / f"{scene.stem}-{way}-{ranks}.json"
    result.unlink(missing_ok=True)
    words = [sys.executable, __file__, "--worker", way, str(scene), str(folder), str(stop), str(result)]
    taken = result.with_suffix(".perf")
    words = sampled(words, taken) if samples else words
    clean = without_ranks()
    subprocess.run(["mpirun", "--oversubscribe", "-n", str(ranks), *words], check=True, env=clean)
    return json.loads(result.read_text(encoding="utf-8")) | ({"samples": seconds(taken, ranks)} if samples else {})


def saved(mesh: Path, cells: int, out: Path) -> Path:
    """The mesh as ``fracflow mesh`` splits and saves it."""
    kept, scene = mesh.with_suffix(".h5"), out / f"saved-{cells}.toml"
    if not kept.exists():
        scene.write_text(scene_of("explicit", mesh, cells, 0, 1), encoding="utf-8")
        words = [sys.executable, "-m", "fracflow", "mesh", str(scene), "-o", str(kept)]
        subprocess.run(words, check=True, stdout=subprocess.DEVNULL)
    return kept


def rows_of(way: str, ranks: int, found: dict[str, Any]) -> list[dict[str, Any]]:
    """A row for each part that took time, and one for the whole."""
    parts = {name: [rank[name] for rank in found["ranks"]] for name in (*PARTS, REST)}
    parts["whole"] = [
        {"cpu": sum(each["cpu"] for each in rank.values()), "memory": max(each["memory"] for each in rank.values())}
        for rank in found["ranks"]
    ]
    rows = []
    for name, each in parts.items():
        memory, cpu = [rank["memory"] for rank in each], [rank["cpu"] for rank in each]
        if max(memory) > 0.0:
            row = {
                "way": way,
                "cells": found["cells"],
                "ranks": ranks,
                "part": name,
                "cpu_s": round(sum(cpu) / ranks, 2),
            }
            mean = sum(memory) / ranks
            rows.append(
                row | {"rank0_GB": round(memory[0], 3), "mean_GB": round(mean, 3), "ratio": round(memory[0] / mean, 3)}
            )
    return rows


def fitted(rows: list[dict[str, Any]]) -> dict[str, dict[str, float]]:
    """Way -> c [GB] and a, b [bytes a cell] of the peaks of rank 0, by least squares; none of too few runs."""
    import numpy as np

    found = {}
    for way in {row["way"] for row in rows}:
        whole = [row for row in rows if row["way"] == way and row["part"] == "whole"]
        table = np.array([[1.0, row["cells"] / row["ranks"], row["cells"]] for row in whole])
        if np.linalg.matrix_rank(table / table.max(axis=0)) == 3:
            c, a, b = np.linalg.lstsq(table, np.array([row["rank0_GB"] for row in whole]) * 2**30, rcond=None)[0]
            found[way] = {"c_GB": round(c / 2**30, 3), "a": round(a), "b": round(b)}
    return found


def main() -> None:
    """Measure all, print a line for each part, and write large.json."""
    parser = argparse.ArgumentParser(prog="scripts/bench large", description=__doc__.splitlines()[0])
    parser.add_argument("cells", nargs="*", type=int, default=CELLS, help="numbers of triangles of the coarse mesh")
    parser.add_argument("--fractures", type=int, default=20, help="how many of them: more make more joints")
    parser.add_argument("--refine", type=int, default=1, help="how often the ranks cut each cell in four")
    parser.add_argument("--saved", action="store_true", help="let ranks read the mesh as fracflow mesh has saved it")
    parser.add_argument("--ranks", type=int, nargs="+", default=RANKS)
    parser.add_argument("--ways", nargs="+", choices=WAYS, default=WAYS[:3])
    parser.add_argument("--samples", action="store_true", help="CPU seconds of each rank without its waiting, by perf")
    parser.add_argument("--steps", type=int, default=20, help="explicit steps, of which half are made after the resume")
    parser.add_argument("--out", type=Path, default=Path("runs/bench/large"))
    given = parser.parse_args()
    out, rows = given.out.resolve(), []
    out.mkdir(parents=True, exist_ok=True)
    for cells in given.cells:
        several = "" if given.fractures == 20 else f"-{given.fractures}"
        mesh = out / f"network-{cells}{several}.msh"
        if not mesh.exists():
            subprocess.run([sys.executable, network.__file__, str(cells), str(mesh), str(given.fractures)], check=True)
        mesh = saved(mesh, cells, out) if given.saved else mesh
        for ranks in given.ranks:
            for way in given.ways:
                kind = "explicit" if way == "resume" else way
                scene = out / f"{kind}-{cells}{several}-{given.refine}{mesh.suffix.replace('.', '-')}.toml"
                scene.write_text(scene_of(kind, mesh, cells, given.refine, given.steps), encoding="utf-8")
                found = measure(way, scene, ranks, given.steps // 2 + 1 if way == "explicit" else 0, out, given.samples)
                new = rows_of(way, ranks, found)
                for row in new:
                    print(json.dumps(row), flush=True)
                rows += new
                facts = {key: value for key, value in found.items() if key != "ranks"}
                print(json.dumps({"way": way} | facts), flush=True)
        command = shlex.join(["scripts/bench", "large", *sys.argv[1:]])
        record = {"command": command, **machine(), "fit": fitted(rows), "rows": rows}
        (out / "large.json").write_text(json.dumps(record, indent=1), encoding="utf-8")
    print(json.dumps(fitted(rows)))


if __name__ == "__main__":
    if sys.argv[1:2] == ["--worker"]:
        worker(sys.argv[2], sys.argv[3], sys.argv[4], int(sys.argv[5]), sys.argv[6])
    else:
        main()
