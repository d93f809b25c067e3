"""Krylov iterations of coupling = "monolithic": coupling.py [UNKNOWNS...] [--ranks N...] [--out DIR].

One time step by the program's own Newton method, into a fault at rest in a square of rock: apertures from 1e-1 to 1e-6
m, the fault buried or through-going, with a fixed pressure at its start or closed, so that only its walls can store the
fluid; steady flow, quasi-static and dynamic; blocks solved exactly (MUMPS) or, for the rock, by multigrid (BoomerAMG).
The worst linear solve of a step counts; its true relative residual |b - A x| / |b|, largest entries, is stated, in the
scaled unknowns. Exit code 1 where a bar is missed: at most 20 iterations with exact blocks, 30 with multigrid. Joints that
slide and open, other stiffnesses, contrasts and time steps are in scripts/bench sliding, with the bar of 30.
"""

from __future__ import annotations

import argparse
import csv
import itertools
import json
import shlex
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from _launch import without_ranks

sys.path.insert(0, str(Path(__file__).parent))
from size import machine

SIZES = (4_000, 40_000, 400_000)
APERTURES = tuple(10.0**-n for n in range(1, 7))
BLOCKS = {"exact": 20, "multigrid": 30}
"""Blocks -> most Krylov iterations of a linear solve."""
EXTENT, MODULUS, STIFFNESS, VISCOSITY = 640.0, 5e10, 1e11, 1e-3
STEPS = {"steady": 0.0, "quasi-static": 1.0, "dynamic": 0.01}
FAULTS = {"buried": (0.25, 0.75), "through-going": (0.0, 1.0)}


def scene_of(unknowns: int, fault: str, drained: bool) -> dict[str, Any]:
    """The scene of a case, its aperture apart."""
    low, high = (EXTENT * end for end in FAULTS[fault])
    middle = 0.5 * EXTENT
    wells: list[dict[str, Any]] = [{"name": "in", "at": {"fracture": "fault", "end": "end"}, "flow_rate": 0.0}]
    wells += [{"name": "out", "at": {"fracture": "fault", "end": "start"}, "pressure": 0.0}] if drained else []
    return {
        "geometry": {
            "domain": [0.0, 0.0, EXTENT, EXTENT], "size": EXTENT / (unknowns / 2) ** 0.5, "cells": "quads",
            "fracture": [{"name": "fault", "points": [[low, middle], [high, middle]]}],
        },
        "rock": {"rock": {"youngs_modulus": MODULUS, "poissons_ratio": 0.25, "density": 2700.0}},
        "fracture": {
            "fault": {"law": "linear", "normal_stiffness": STIFFNESS, "shear_stiffness": STIFFNESS, "aperture": 1e-3}
        },
        "fluid": {"viscosity": VISCOSITY, "specific_weight": 1e4},
        "support": [{"on": ["south", "north", "west", "east"]}],
        "well": wells,
        "stage": [{"kind": "quasi-static", "time_step": 1.0, "steps": 1}],
    }  # fmt: skip


def worker(unknowns: str, fault: str, drained: str, result: str, apertures: str, blocks: str) -> None:
    """Measure all cases of a fault on this rank of several; rank 0 writes them."""
    from fracflow._petsc import MPI, PETSc
    from fracflow.advance.initial_state import equilibrium_state
    from fracflow.reduction.prepare import prepare
    from fracflow.scene.scene import Scene

    comm, case = MPI.COMM_WORLD, {"fault": fault, "drained": json.loads(drained)}
    model = prepare(Scene.from_data(scene_of(int(unknowns), **case)), comm)
    state, found = equilibrium_state(model), []
    for name in json.loads(blocks):
        found += measure_model(model, state, json.loads(apertures), name, case)
    versions = {"PETSc": ".".join(map(str, PETSc.Sys.getVersion())), "MPI": MPI.Get_library_version().split(",")[0]}
    if comm.rank == 0:
        Path(result).write_text(json.dumps({"cases": found, "versions": versions}), encoding="utf-8")


def measure_model(model: Any, state: Any, apertures: list[float], blocks: str, case: dict[str, Any]) -> list[Any]:
    """All regimes and apertures of one model, its matrix and solvers kept."""
    import numpy as np

    from fracflow.errors import SolveError
    from fracflow.integrators import STEPPERS, BackwardEuler, Steady
    from fracflow.solve import options as defaults
    from fracflow.solve.monolithic import Monolithic
    from fracflow.solve.problem import StepProblem
    from fracflow.solve.request import StepRequest, StepRule

    kinds = {"steady": Steady(), "quasi-static": BackwardEuler(), "dynamic": STEPPERS["newmark"]()}
    sharp = {"monolithic_ksp_rtol": 1e-9}  # with either
    defaults.set_defaults(
        {**model.scene.petsc, **sharp},
        defaults.BY_MULTIGRID if blocks == "multigrid" else defaults.BY_FACTORS,
    )
    solver = Monolithic(model.scene, model.operators, model.loads)
    solves = watch(solver.newton)
    length = EXTENT * np.diff(FAULTS[case["fault"]])[0]
    found = []
    for (kind, stepper), aperture in itertools.product(kinds.items(), apertures):
        if kind == "steady" and not case["drained"]:
            continue
        film = np.full_like(model.operators.flow.aperture, aperture)
        flow = replace(model.operators.flow, aperture=film, law=replace(model.operators.flow.law, aperture=film))
        alphas = stepper.alphas(STEPS[kind] or 1.0)
        pressure = min(0.1 * STIFFNESS * aperture, 1e6)  # opens the fault by a tenth
        reach = np.sqrt(aperture**3 * STIFFNESS / (12 * VISCOSITY * alphas.a1)) if alphas.a1 else np.inf
        reach = np.clip(
            reach, EXTENT / (model.operators.layout.total / 2) ** 0.5, length
        )  # of the pressure in one step
        rate = pressure * (aperture**3 / (12 * VISCOSITY * reach) + alphas.a1 * reach / STIFFNESS)
        problem = StepProblem(
            replace(model.operators, flow=flow), state, StepRequest(1.0, 1.0, {}, model.loads), StepRule(alphas)
        )
        problem.source.axpy(rate, model.loads.wells[0].vector)
        solves.clear()
        start = time.perf_counter()
        try:
            solver.solve(problem)
            failure = ""
        except SolveError as error:
            failure = str(error)
        residual = problem.residual
        problem.destroy()
        found.append(
            {
                **case, "kind": kind, "aperture": aperture, "blocks": blocks, "unknowns": model.operators.layout.total,
                "ranks": model.operators.layout.comm.size, "newton": len(solves),
                "krylov": max((count for count, _ in solves), default=0),
                "true_residual": max((wrong for _, wrong in solves), default=0.0),
                "solid_residual": residual.solid, "flow_residual": residual.flow,
                "wall_s": round(time.perf_counter() - start, 3), "failure": failure,
            }
        )  # fmt: skip
    solver.destroy()
    return found


def watch(newton: Any) -> list[tuple[int, float]]:
    """A list that gets the Krylov iterations and the true relative residual of each linear solve from now on."""
    from fracflow.solve.linear import true_residual

    solves: list[tuple[int, float]] = []

    def look(unknowns: Any, step: Any) -> bool:
        # here the step solves J y = F, and nothing has shortened it yet
        relative, left = true_residual(newton.matrix.matrix, step, newton.snes.getFunction()[0])
        left.destroy()
        solves.append((newton.snes.getKSP().getIterationNumber(), relative))
        return bool(newton._pre_check(unknowns, step))

    newton.snes.setLineSearchPreCheck(look)
    return solves


def measure(unknowns: int, ranks: int, out: Path, apertures: list[float], blocks: list[str]) -> dict[str, Any]:
    """All cases of a size, each fault in processes of its own."""
    clean = without_ranks()
    cases, versions = [], {}
    for fault, drained in itertools.product(FAULTS, (True, False)):
        print(
            f"{unknowns}, {ranks} ranks: {fault}, {'drained' if drained else 'closed'} ...", file=sys.stderr, flush=True
        )
        result = out / f"coupling-{unknowns}-{ranks}-{fault}-{'drained' if drained else 'closed'}.json"
        result.unlink(missing_ok=True)
        given = [str(unknowns), fault, json.dumps(drained), str(result), json.dumps(apertures), json.dumps(blocks)]
        command = ["mpirun", "-n", str(ranks), sys.executable, __file__, "--worker", *given]
        subprocess.run(command, check=True, env=clean)
        found = json.loads(result.read_text(encoding="utf-8"))
        cases, versions = cases + found["cases"], found["versions"]
    return {"cases": cases, "versions": versions}


def is_missed(case: dict[str, Any]) -> bool:
    """Whether a case is over its bar, or did not converge."""
    return bool(case["failure"]) or case["krylov"] > BLOCKS[case["blocks"]]


def show(cases: list[dict[str, Any]], apertures: list[float]) -> None:
    """Print a table: a row for each kind of scene, iterations by aperture."""
    from rich.console import Console
    from rich.table import Table

    first = cases[0]
    title = f"{first['unknowns']} unknowns, {first['ranks']} ranks: Krylov iterations of the worst linear solve"
    table = Table(title=title, title_justify="left")
    for name in ("blocks", "stage", "fault", "fixed p"):
        table.add_column(name)
    for aperture in apertures:
        table.add_column(f"{aperture:.0e} m", justify="right")
    table.add_column("true residual", justify="right")
    table.add_column("[s]", justify="right")
    keys = ("blocks", "kind", "fault", "drained")
    for group, rows in itertools.groupby(cases, key=lambda case: tuple(case[key] for key in keys)):
        members = list(rows)
        counts = [
            f"[red]{c['krylov']}{'!' if c['failure'] else ''}[/red]" if is_missed(c) else str(c["krylov"])
            for c in members
        ]
        worst, seconds = max(c["true_residual"] for c in members), sum(c["wall_s"] for c in members)
        table.add_row(*map(str, group[:3]), "yes" if group[3] else "no", *counts, f"{worst:.1e}", f"{seconds:.1f}")
    console = Console(width=None if sys.stdout.isatty() else 140, highlight=False)
    console.print(table)
    for case in cases:
        if case["failure"]:
            console.print(
                f"! {case['blocks']}, {case['kind']}, {case['fault']}, {case['aperture']:.0e} m: {case['failure']}"
            )


def main() -> int:
    """Measure all sizes and ranks, print their tables and write one CSV; 1 where a bar is missed."""
    parser = argparse.ArgumentParser(prog="scripts/bench coupling", description=__doc__.splitlines()[0])
    parser.add_argument("unknowns", nargs="*", type=int, default=SIZES, help="numbers of displacement unknowns")
    parser.add_argument("--ranks", nargs="+", type=int, default=[1, 2])
    parser.add_argument("--apertures", nargs="+", type=float, default=APERTURES, help="in metres")
    parser.add_argument("--blocks", nargs="+", choices=BLOCKS, default=list(BLOCKS))
    parser.add_argument("--out", type=Path, default=Path("runs/bench"), help="folder of coupling.csv")
    given = parser.parse_args()
    out = given.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    where = {**machine(), "command": shlex.join(["scripts/bench", "coupling", *sys.argv[1:]])}
    rows: list[dict[str, Any]] = []
    for unknowns, ranks in itertools.product(given.unknowns, given.ranks):
        found = measure(unknowns, ranks, out, list(given.apertures), given.blocks)
        show(found["cases"], list(given.apertures))
        versions = where["versions"] + "".join(f", {name} {number}" for name, number in found["versions"].items())
        rows += [{**case, **where, "versions": versions} for case in found["cases"]]
        with (out / "coupling.csv").open("w", encoding="utf-8", newline="") as file:
            table = csv.DictWriter(file, list(rows[0]))
            table.writeheader()
            table.writerows(rows)
    missed = sum(map(is_missed, rows))
    for name, most in BLOCKS.items():
        counts = [row["krylov"] for row in rows if row["blocks"] == name]
        if counts:
            print(f"{name} blocks: at most {max(counts)} Krylov iterations, allowed {most}")
    print(f"{len(rows)} steps, {missed} over a bar; {out / 'coupling.csv'}")
    return 1 if missed else 0


if __name__ == "__main__":
    if sys.argv[1:2] == ["--worker"]:
        worker(*sys.argv[2:])
    else:
        raise SystemExit(main())
