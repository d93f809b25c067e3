"""Unmeshed rock of many joints, by multipoles and with all entries: multipoles.py [JOINTS...] [--dense N] [--ranks N...].

Random fractures of 50 joints, which cross, in stress that makes some slide: a pump into one of them, and shear that rises far
away. Each size runs in a process of its own, by series of far walls and, up to ``--dense`` joints, with all entries. It prints
CPU seconds to set up and of a step, iterations, memory of the fullest rank, and slip where both ways or ranks differ.
Exit code 1 where a bar is missed: slips of both ways equal to 1e-6, those of ranks to 1e-10, energies closed to 1e-10.
With --out DIR the numbers are in DIR/multipoles.json, and drawn over the joints in DIR/multipoles.png.
"""

from __future__ import annotations

import argparse
import json
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from sheets import BLUE, GREEN, ORANGE, STYLE, Check, save, sheet

LENGTH = 50.0  # joints of 1 m along a fracture
APART = 0.6  # side of a square for one fracture, over its length
MPIRUN = ("mpirun",)
WAYS_EQUAL, RANKS_EQUAL, CLOSED = 1e-6, 1e-10, 1e-10


def scene_of(joints: int, steps: int, way: str) -> dict[str, Any]:
    """Fractures in a square, at random but for their number and length [m, Pa, s]."""
    draw, count = np.random.default_rng(joints), max(round(joints / LENGTH), 2)
    side = LENGTH * APART * count**0.5
    middle, angle = draw.uniform(0.0, side, (count, 2)), draw.uniform(0.0, np.pi, count)
    half = 0.5 * LENGTH * draw.uniform(0.6, 1.4, count)
    along = half[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    ends = np.stack([middle - along, middle + along], axis=1).round(3)
    first = int(np.abs(middle - 0.5 * side).sum(axis=1).argmin())
    return {
        "geometry": {
            "domain": "unbounded", "size_at_fractures": 1.0,
            "fracture": [{"name": f"f{i}", "points": points.tolist()} for i, points in enumerate(ends)],
        },
        "rock": {"rock": {"youngs_modulus": 50e9, "poissons_ratio": 0.25}},
        "initial_stress": {"xx": -8e6, "yy": -14e6, "zz": -10e6},
        "fluid": {"viscosity": 1e-3, "initial_pressure": 1e6, "compressibility": 4.5e-10},
        "fracture": {"default": {
            "normal_stiffness": 50e9, "shear_stiffness": 20e9, "aperture": 2e-4, "friction_coefficient": 0.4,
        }},
        "well": [{"name": "in", "at": {"fracture": f"f{first}", "fraction": 0.5}, "pressure": [[0, 1e6], [10.0 * steps, 6e6]]}],
        "load": [{"stress": {"xy": [[0, 0], [10.0 * steps, 1.5e6]]}}],
        "stage": [{"kind": "quasi-static", "time_step": 10.0, "steps": steps}],
        "output": {"pictures": False, "fields_every": steps},
        "method": {"rock_solver": way},
    }  # fmt: skip


def worker(file: str, folder: str) -> None:
    """Run a scene, and print what it took as JSON."""
    from _stopwatch import cpu_seconds, peak

    import fracflow
    from fracflow._petsc import MPI
    from fracflow.simulation import run as runs

    began, at = cpu_seconds(), {}
    go = runs._go

    def timed(*given: Any) -> Any:
        at["set up"] = cpu_seconds() - began
        return go(*given)

    runs._go = timed
    fracflow.run(fracflow.load(file), Path(folder))
    at["steps"] = cpu_seconds() - began - at["set up"]
    comm = MPI.COMM_WORLD
    memory, steps = comm.allreduce(peak(0), op=MPI.MAX), comm.allreduce(at["steps"])
    start = comm.allreduce(at["set up"])
    if comm.rank == 0:
        print("FOUND", json.dumps({"set up": start, "steps": steps, "memory": memory, "ranks": comm.size}))


def measured(joints: int, steps: int, way: str, ranks: int, folder: Path) -> dict[str, Any]:
    """One run in processes of its own: what it took, and its results."""
    from fracflow.output import read_history
    from fracflow.output.reader import load_fractures
    from fracflow.scene.toml import write_toml

    here = folder / f"{joints}-{way}-{ranks}"
    here.mkdir(parents=True)
    (here / "scene.toml").write_text(write_toml(scene_of(joints, steps, way)), encoding="utf-8")
    command = [sys.executable, __file__, "--worker", str(here / "scene.toml"), str(here / "run")]
    command = [*MPIRUN, "-n", str(ranks), *command] if ranks > 1 else command
    ran = subprocess.run(command, capture_output=True, text=True)
    line = next((each[6:] for each in ran.stdout.splitlines() if each.startswith("FOUND ")), None)
    if line is None:
        raise SystemExit(f"{joints} joints, {way}, {ranks} ranks:\n{ran.stdout[-2000:]}{ran.stderr[-2000:]}")
    history, fields = read_history(here / "run" / "history.h5"), load_fractures(here / "run", np.inf)
    assert fields is not None
    largest = max(np.abs(values).max() for key, values in history.items() if key.startswith("energy/"))
    return json.loads(line) | {
        "slip": fields.after["slip"], "joints": len(fields.cells),
        "open": float(np.abs(history["energy/residual"]).max() / largest),
        "newton": int(history["step/newton"].sum()), "krylov": int(history["step/krylov"].sum()),
        "factorisations": int(history["step/factorisations"].sum()), "sliding": int(history["step/slipping"].max()),
    }  # fmt: skip


def main() -> int:
    """Measure and print; 1 where a bar is missed."""
    parser = argparse.ArgumentParser(prog="scripts/bench multipoles", description=__doc__.splitlines()[0])
    parser.add_argument("joints", nargs="*", type=int, default=[500, 1000, 2000, 5000])
    parser.add_argument("--dense", type=int, default=2000, help="most joints that are run with all entries too")
    parser.add_argument("--ranks", type=int, nargs="*", default=[], help="run each size on so many ranks too")
    parser.add_argument("--steps", type=int, default=4)
    parser.add_argument("--out", type=Path, help="folder of multipoles.json and multipoles.png")
    given, checks, rows = parser.parse_args(), [], []
    print(
        "joints, way, ranks: CPU s to set up, of a step; Newton, Krylov, factorisations; GB; sections that slide",
        flush=True,
    )
    with tempfile.TemporaryDirectory() as folder:
        for joints in given.joints:
            runs = [("multipoles", ranks) for ranks in dict.fromkeys((1, *given.ranks))]
            first, runs = None, runs + ([("direct", 1)] if joints <= given.dense else [])
            for way, ranks in runs:
                found = measured(joints, given.steps, way, ranks, Path(folder))
                first = first or found
                apart = float(np.abs(found["slip"] - first["slip"]).max() / np.abs(first["slip"]).max())
                print(
                    f"{found['joints']}, {way}, {found['ranks']}: {found['set up']:.2f}, {found['steps'] / given.steps:.2f};"
                    f" {found['newton']}, {found['krylov']}, {found['factorisations']}; {found['memory']:.2f};"
                    f" {found['sliding']}; energies {found['open']:.1e}, slips apart {apart:.1e}",
                    flush=True,
                )
                kept = {key: value for key, value in found.items() if key != "slip"} | {"way": way, "apart": apart}
                rows.append(kept | {"step": found["steps"] / given.steps})
                bar = WAYS_EQUAL if way == "direct" else RANKS_EQUAL
                name = f"{found['joints']} joints, {way} on {ranks}"
                checks.append(Check(f"{name}, slips apart", apart, f"<= {bar:g}", apart <= bar))
                checks.append(Check(f"{name}, open energies", found["open"], f"<= {CLOSED:g}", found["open"] <= CLOSED))
    if given.out is not None:
        given.out.mkdir(parents=True, exist_ok=True)
        (given.out / "multipoles.json").write_text(json.dumps(rows, indent=1), encoding="utf-8")
        words = [*map(str, given.joints), "--dense", str(given.dense), "--steps", str(given.steps)]
        words += ["--ranks", *map(str, given.ranks)] if given.ranks else []
        draw(rows, given.out, shlex.join(["scripts/bench", "multipoles", *words]))
    return 0 if all(each.ok for each in checks) else 1


def draw(rows: Sequence[dict[str, Any]], folder: Path, command: str) -> None:
    """CPU seconds and memory over the joints, of each way and number of ranks, with the command that made them."""
    with matplotlib.rc_context(STYLE):
        figure, axes = sheet(
            "Rock that is not meshed: cost over the number of joints",
            "Random fractures that cross and slide. Dotted: in proportion to the joints.",
            [["cpu", "memory"]],
            (8.2, 3.6),
        )
        kinds = dict.fromkeys((row["way"], row["ranks"]) for row in rows)
        for (way, ranks), mark in zip(kinds, "os^vD", strict=False):
            here = [row for row in rows if (row["way"], row["ranks"]) == (way, ranks)]
            joints, of = [row["joints"] for row in here], "all entries" if way == "direct" else way
            who = f"{of}, {ranks} rank{'s' * (ranks > 1)}"
            for name, key, colour in (("set-up", "set up", BLUE), ("a step", "step", ORANGE)):
                label = f"{name}, {who}"
                axes["cpu"].loglog(joints, [row[key] for row in here], mark + "-", color=colour, label=label)
            axes["memory"].loglog(joints, [row["memory"] for row in here], mark + "-", color=GREEN, label=who)
        all_joints = np.array(sorted({row["joints"] for row in rows}), dtype=float)
        for name, key in (("cpu", "step"), ("memory", "memory")):
            first = next(row[key] for row in rows if row["joints"] == all_joints[0])
            axes[name].loglog(all_joints, first * all_joints / all_joints[0], ":", color="0.6", label="as the joints")
        axes["cpu"].set(xlabel="joints", title="CPU seconds of all ranks")
        axes["memory"].set(xlabel="joints", title="GB of the fullest rank")
        for axis in axes.values():
            axis.legend(fontsize=7.5, loc="upper left")
        save(figure, folder, "multipoles", command)


if __name__ == "__main__":
    if "--worker" in sys.argv:
        worker(*sys.argv[2:])
    else:
        sys.exit(main())
