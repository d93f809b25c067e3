"""Time and memory of each part of a run, by the size of its mesh: size.py [CELLS...] [--ranks N] [--out DIR].

Runs the program itself on the network of _network.py, one quasi-static step, with a stopwatch around the functions below. CPU
seconds are those of rank 0, which reads, splits and writes, and of the processes it starts; where ranks work together they
include its waiting. A part's time is its own: without that of the parts inside it. Memory is the peak so far.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import platform
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

from _launch import without_ranks

sys.path.insert(0, str(Path(__file__).parent))
import _network as network
from _stopwatch import Stopwatch

SIZES = (10_000, 100_000, 1_000_000)
SOLVE = "PETSc's solve"
OF_STEP = ("Jacobian", "balances", SOLVE, "energy balance")  # parts of a step; others are done once, or write files
PARTS = {
    "read": ["mesh.read:open_msh"],
    "interpret": ["mesh.read:interpret"],
    "split": ["reduction.sliced:split"],
    "mesh by a process of its own": ["reduction.sliced:_read_on_root"],
    "place": ["reduction.sliced:place"],
    "partition": ["mesh.distribute:partition_cells"],
    "distribute": ["model.setup:distribute", "reduction.sliced:InFile.taken"],
    "assemble G K M B": ["model.setup:assemble", "model.setup:assemble_loads"],
    "start": ["simulation.run:equilibrium_state", "advance.step:Stepping.enter"],
    "Jacobian": ["solve.jacobian:JoinedMatrix.__init__", "solve.jacobian:JoinedMatrix.fill"],
    "balances": ["solve.newton:Newton._function", "solve.newton:Newton._pre_check"],
    SOLVE: ["solve.newton:Newton.solve"],
    "energy balance": ["advance.step:update_balance", "advance.step:accept"],
    "output": [
        "simulation.recorder:Recorder.__init__",
        "simulation.recorder:Recorder.record",
        "simulation.recorder:Recorder.last",
        "simulation.recorder:Recorder.finish",
    ],
    "checkpoint": ["simulation.recorder:Recorder.save"],
}
"""Part -> the functions it consists of, module:name."""


def worker(scene_file: str, folder: str, result: str, *overrides: str) -> None:
    """Run a scene under the stopwatch, on this rank of several; rank 0 writes what all found."""
    from fracflow._petsc import MPI, PETSc
    from fracflow.output import read_history
    from fracflow.scene.scene import load
    from fracflow.simulation.run import run

    comm = MPI.COMM_WORLD
    scene = load(scene_file, ["output.pictures=false", *overrides])
    watch = Stopwatch(PARTS)
    run(scene, folder, comm)
    watch.lap()
    found = comm.gather(watch.parts, root=0)
    if found is None:
        return
    history = read_history(Path(folder) / "history.h5")
    facts = {
        name: float(history[f"step/{name}"][-1])
        for name in ("newton", "krylov", "factorisations", "solid_residual", "flow_residual")
    }
    log = (Path(folder) / "log.txt").read_text(encoding="utf-8")
    sizes = next(line for line in log.splitlines() if " cells, " in line)
    facts["cells"] = int(sizes.partition(" cells, ")[0].split()[-1])
    versions = {"PETSc": ".".join(map(str, PETSc.Sys.getVersion())), "MPI": MPI.Get_library_version().split(",")[0]}
    text = json.dumps({"ranks": found, "facts": facts, "versions": versions, "sizes": sizes})
    Path(result).write_text(text, encoding="utf-8")


def measure(cells: int, ranks: int, out: Path, options: list[str], overrides: list[str]) -> dict[str, Any]:
    """Mesh, once, and run in processes of their own; what ``worker`` found."""
    mesh = out / f"network-{cells}.msh"
    if not mesh.exists():
        print(f"meshing {cells} triangles, once ...", flush=True)
        subprocess.run([sys.executable, network.__file__, str(cells), str(mesh)], check=True)
    scene = out / f"network-{cells}.toml"
    scene.write_text(network.SCENE.format(cells=cells, mesh=mesh.name), encoding="utf-8")
    result = out / f"network-{cells}.json"
    result.unlink(missing_ok=True)
    command = [sys.executable, __file__, "--worker", str(scene), str(out / f"run-{cells}"), str(result), *overrides]
    clean = without_ranks()
    subprocess.run(
        ["mpirun", "-n", str(ranks), *command], check=True, env=clean | {"PETSC_OPTIONS": shlex.join(options)}
    )
    return json.loads(result.read_text(encoding="utf-8"))


def rows_of(cells: int, found: dict[str, Any]) -> list[dict[str, Any]]:
    """A row for each part, for all outside the solve, and for the whole."""
    first = found["ranks"][0]
    total = {key: sum(part[key] for part in first.values()) for key in ("cpu", "wall")}
    outside = {key: total[key] - first[SOLVE][key] for key in total}
    last = {"memory": max(part["memory"] for part in first.values())}
    last["helper_memory"] = max(part["helper_memory"] for part in first.values())
    rows = [(name, part) for name, part in first.items()]
    rows += [("all outside the solve", outside | last), ("whole", total | last)]
    others = [max(part[name]["memory"] for part in found["ranks"][1:]) if found["ranks"][1:] else 0.0 for name in first]
    others += [max(others)] * 2
    return [
        {
            "asked": cells,
            "cells": found["facts"]["cells"],
            "part": name,
            "cpu_s": round(part["cpu"], 3),
            "wall_s": round(part["wall"], 3),
            "share": round(part["cpu"] / total["cpu"], 4),
            "rank0_GB": round(part["memory"], 3),
            "other_ranks_GB": round(other, 3),
            "helpers_GB": round(part["helper_memory"], 3),
        }
        for (name, part), other in zip(rows, others, strict=True)
    ]


def machine() -> dict[str, str]:
    """Where and with what this runs."""
    import numpy
    import scipy

    from fracflow import __version__

    lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines() if Path("/proc/cpuinfo").exists() else []
    model = next(
        (line.partition(":")[2].strip() for line in lines if line.startswith("model name")), platform.machine()
    )
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1024**3
    return {
        "machine": f"{os.cpu_count()} x {model}, {memory:.0f} GB, {platform.platform(terse=True)}",
        "versions": f"fracflow {__version__}, Python {platform.python_version()}, NumPy {numpy.__version__},"
        f" SciPy {scipy.__version__}",
    }


def outside_of_step(rows: list[dict[str, Any]]) -> float:
    """Share of the CPU time of the step itself, without set-up and files, that is not PETSc's solve [%]."""
    of_step = {row["part"]: row["cpu_s"] for row in rows if row["part"] in OF_STEP}
    return 100.0 * (1.0 - of_step[SOLVE] / sum(of_step.values()))


def show(cells: int, rows: list[dict[str, Any]], found: dict[str, Any]) -> None:
    """Print a table."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title=f"{rows[0]['cells']} triangles ({cells} asked for)", title_justify="left")
    for name in (
        "part",
        "CPU [s]",
        "wall [s]",
        "share",
        "peak, rank 0 [GB]",
        "other ranks [GB]",
        "Gmsh's process [GB]",
    ):
        table.add_column(name, justify="left" if name == "part" else "right")
    for row in rows:
        if row["part"] == "all outside the solve":
            table.add_section()
        table.add_row(
            row["part"], f"{row['cpu_s']:.2f}", f"{row['wall_s']:.2f}", f"{100 * row['share']:.1f} %",
            f"{row['rank0_GB']:.2f}", f"{row['other_ranks_GB']:.2f}", f"{row['helpers_GB']:.2f}",
        )  # fmt: skip
    console, facts = Console(width=None if sys.stdout.isatty() else 120), found["facts"]
    console.print(table)
    console.print(
        f"{found['sizes'].split(': ', 1)[-1]}\n{facts['newton']:.0f} Newton iterations, {facts['krylov']:.0f} Krylov,"
        f" {facts['factorisations']:.0f} factorisations; residuals {facts['solid_residual']:.1e} (solid),"
        f" {facts['flow_residual']:.1e} (flow)\n"
        f"{outside_of_step(rows):.1f} % of the CPU time of the step is outside the solve\n",
        highlight=False,
    )


def main() -> None:
    """Measure all sizes, print their tables and write one CSV."""
    parser = argparse.ArgumentParser(prog="scripts/bench size", description=__doc__.splitlines()[0])
    parser.add_argument("cells", nargs="*", type=int, default=SIZES, help="numbers of triangles")
    parser.add_argument("--ranks", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("runs/bench"), help="meshes, runs and size.csv")
    parser.add_argument("--petsc", default="", help="options for PETSc, as one string")
    parser.add_argument("--set", action="append", default=[], help="key=value of the scene, as for fracflow run")
    given = parser.parse_args()
    out = given.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    where, rows = machine(), []
    where["command"] = shlex.join(["scripts/bench", "size", *sys.argv[1:]])
    for cells in given.cells:
        found = measure(cells, given.ranks, out, shlex.split(given.petsc), given.set)
        new = rows_of(cells, found)
        show(cells, new, found)
        versions = where["versions"] + "".join(f", {name} {number}" for name, number in found["versions"].items())
        rows += [{**row, "ranks": given.ranks, **where, "versions": versions} for row in new]
        with (out / "size.csv").open("w", encoding="utf-8", newline="") as file:
            table = csv.DictWriter(file, list(rows[0]))
            table.writeheader()
            table.writerows(rows)
    print(f"{out / 'size.csv'}")


if __name__ == "__main__":
    if sys.argv[1:2] == ["--worker"]:
        worker(*sys.argv[2:])
    else:
        main()
