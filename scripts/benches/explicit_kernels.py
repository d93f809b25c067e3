"""An explicit step against what memory allows: explicit_kernels.py [SIZE...] [--steps N] [--no-run] [--out DIR].

The rupture of a fault in rock of triangles SIZE metres wide (74 m: 4e5 unknowns). First the program's own explicit steps, one
by one as with a fluid, CPU seconds by part; then one product with its stiffness by PETSc, as the nodes are numbered and by
reverse Cuthill-McKee, by rows and by blocks; then whole steps in C (where there is a compiler): by rows, by blocks and by
cells, without a matrix; last the bandwidth of memory by the triad a = b + s c. The best of several rounds counts, in CPU
seconds of one rank.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sparse
from scipy.sparse.csgraph import reverse_cuthill_mckee

sys.path.insert(0, str(Path(__file__).parent))
from size import machine

EDGES = ((6.0, 70.0), (9.0, 78.0), (13.5, 70.0), (16.5, 81.6), (21.0, 70.0), (24.0, 62.0), (30.0, 70.0))
"""(km, MPa): up to where along the fault the shear stress is so much."""
FIRST = 3  # steps that count for nothing: factors and caches are made
ROUNDS, REPEATS = 6, 10


def scene_of(size: float, steps: int) -> dict[str, Any]:
    """A fault of 30 km in the middle of 40 km by 24 km, which ruptures from a patch at its centre."""
    start, along, value = 0.0, [], []
    for end, stress in EDGES:
        along += [start * 1e3 + (2e-3 if start else 0.0), end * 1e3]
        value += [stress * 1e6] * 2
        start = end
    fault = {
        "law": "slip-weakening", "normal_stiffness": 1e12, "shear_stiffness": 1e12, "aperture": 1.0,
        "friction_coefficient": 0.677, "dynamic_friction_coefficient": 0.525, "slip_weakening_distance": 0.4,
        "initial_shear_traction": {"along": along, "value": value},
    }  # fmt: skip
    return {
        "geometry": {
            "domain": [-20e3, -12e3, 20e3, 12e3], "size": size, "size_at_fractures": size, "growth": 0.3,
            "fracture": [{"name": "main", "points": [[-15e3, 0.0], [15e3, 0.0]]}],
        },
        "rock": {"rock": {"youngs_modulus": 80.0986e9, "poissons_ratio": 0.2500222, "density": 2670.0}},
        "initial_stress": {"xx": -120e6, "yy": -120e6, "xy": 70e6, "unbalanced": "carried"},
        "fracture": {"main": fault},
        "absorbing": [{"on": ["west", "east", "south", "north"]}],
        "method": {"stepper": "explicit"},
        "output": {"pictures": False},
        "stage": [{"kind": "dynamic", "time_step": 2e-3 * size / 74.0, "steps": steps}],
    }  # fmt: skip


def run_steps(size: float, steps: int, folder: Path) -> dict[str, Any]:
    """CPU seconds of a step by part: products and joints are parts of the coupling, the coupling of a step."""
    from fracflow.advance import explicit as in_a_row
    from fracflow.scene.scene import Scene
    from fracflow.simulation.run import run
    from fracflow.solve import explicit

    spent: dict[str, float] = {}
    marks: list[float] = []

    def timed(owner: Any, name: str, part: str) -> Callable[[], None]:
        old = getattr(owner, name)

        def call(*given: Any, **named: Any) -> Any:
            begin = time.process_time()
            result = old(*given, **named)
            spent[part] = spent.get(part, 0.0) + time.process_time() - begin
            return result

        setattr(owner, name, call)
        return lambda: setattr(owner, name, old)

    undo = [
        timed(explicit, "static_balance", "K u and joint forces"),
        timed(explicit.SectionSolver, "solve", "joints"),
        timed(explicit.ExplicitCoupling, "solve", "coupling"),
    ]
    inner, in_one_sweep, in_a_row.takes = explicit.ExplicitCoupling.solve, in_a_row.takes, lambda operators: False

    def marked(coupling: Any, problem: Any) -> Any:
        marks.append(time.process_time())
        if len(marks) == FIRST:
            spent.clear()
        return inner(coupling, problem)

    explicit.ExplicitCoupling.solve = marked
    try:
        run(Scene.from_data(scene_of(size, steps)), folder)
    finally:
        in_a_row.takes = in_one_sweep
        for back in reversed(undo):
            back()
    count = len(marks) - FIRST
    whole = (marks[-1] - marks[FIRST - 1]) / count
    parts = {part: round(1e3 * seconds / (count + 1), 3) for part, seconds in spent.items()}
    return {"step_ms": round(1e3 * whole, 3), "parts_ms": parts, "steps": count}


def best(call: Callable[[], Any]) -> float:
    """CPU seconds of a call, the least of several rounds."""
    call()
    found = []
    for _ in range(ROUNDS):
        begin = time.process_time()
        for _ in range(REPEATS):
            call()
        found.append((time.process_time() - begin) / REPEATS)
    return min(found)


def kernels(size: float) -> dict[str, Any]:
    """Milliseconds of products and steps with the stiffness of the scene, and the bandwidth of memory."""
    from fracflow._petsc import MPI, PETSc
    from fracflow.model.solid import elasticity
    from fracflow.reduction.prepare import prepare
    from fracflow.scene.scene import Scene

    scene = Scene.from_data(scene_of(size, 1))
    model = prepare(scene, MPI.COMM_SELF)
    ops = model.operators
    indptr, indices, values = ops.stiffness.getValuesCSR()
    count = len(indptr) - 1
    stiffness = sparse.csr_matrix((values, indices, indptr), shape=(count, count))
    found: dict[str, float] = {}
    graph = stiffness.tobsr((2, 2))
    graph = sparse.csr_matrix((np.ones(len(graph.indices)), graph.indices, graph.indptr))
    order = reverse_cuthill_mckee(graph, symmetric_mode=True)
    unknown = (2 * order[:, None] + [0, 1]).ravel()
    numbered = {"as numbered": stiffness, "Cuthill-McKee": stiffness[unknown][:, unknown].tocsr()}
    for numbering, matrix in numbered.items():
        matrix.sort_indices()
        rows = PETSc.Mat().createAIJ(matrix.shape, csr=_csr(matrix), comm=PETSc.COMM_SELF)
        square = matrix.tobsr((2, 2))
        square.sort_indices()
        by_blocks = PETSc.Mat().createBAIJ(matrix.shape, 2, csr=_csr(square), comm=PETSc.COMM_SELF)
        half = by_blocks.convert("sbaij", PETSc.Mat())
        x, y = rows.createVecs()
        x.setRandom()
        for kind, each in (("AIJ", rows), ("BAIJ(2)", by_blocks), ("SBAIJ(2)", half)):
            found[f"{kind}, {numbering}"] = best(lambda each=each, x=x, y=y: each.mult(x, y))
        for each in (rows, by_blocks, half, x, y):
            each.destroy()
    memory = 0.0
    library = compiled()
    if library is not None:
        block, moduli = ops.blocks.solid, elasticity(ops.blocks, scene)
        place = np.argsort(order)
        found |= in_c(library, numbered["Cuthill-McKee"], block.points[order], place[block.cells[:, :3]], moduli[0])
        memory = triad(library)
    return {"unknowns": count, "ms": {key: round(1e3 * each, 3) for key, each in found.items()}, "triad_GB_s": memory}


def _csr(matrix: Any) -> tuple[Any, Any, Any]:
    return matrix.indptr.astype(np.int32), matrix.indices.astype(np.int32), np.ascontiguousarray(matrix.data)


def compiled() -> Any:
    """The steps in C, or None without a compiler."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        return None
    folder = Path(tempfile.mkdtemp(prefix="explicit-kernels-"))
    try:
        made = folder / "kernels.so"
        words = [compiler, "-O3", "-march=native", "-shared", "-fPIC", "-o", str(made)]
        subprocess.run([*words, str(Path(__file__).with_suffix(".c"))], check=True)
        return ctypes.CDLL(str(made))
    finally:
        shutil.rmtree(folder)


def _pointer(values: np.ndarray) -> ctypes.c_void_p:
    return values.ctypes.data_as(ctypes.c_void_p)


def in_c(library: Any, matrix: Any, points: np.ndarray, cells: np.ndarray, moduli: np.ndarray) -> dict[str, float]:
    """CPU seconds of a step by rows, by blocks and by cells; all three must move alike."""
    count, random = matrix.shape[0], np.random.default_rng(0)
    start, step = random.standard_normal(count) * 1e-3, ctypes.c_double(1e-6)
    inverse = np.full(count, 1e-9)
    square = matrix.tobsr((2, 2))
    square.sort_indices()
    by_rows, by_blocks = _csr(matrix), _csr(square)
    cells = np.ascontiguousarray(cells[np.argsort(cells.min(axis=1))], dtype=np.int32)
    x, y = points[cells, 0], points[cells, 1]
    slope_x = np.stack([y[:, 1] - y[:, 2], y[:, 2] - y[:, 0]], axis=1)
    slope_y = np.stack([x[:, 2] - x[:, 1], x[:, 0] - x[:, 2]], axis=1)
    twice = slope_x[:, 0] * slope_y[:, 1] - slope_x[:, 1] * slope_y[:, 0]
    slopes = np.ascontiguousarray(np.concatenate([slope_x, slope_y], axis=1) / np.sqrt(2.0 * twice)[:, None])
    lame, shear, force = ctypes.c_double(moduli[0, 1]), ctypes.c_double(moduli[2, 2]), np.zeros(count)
    moved, found = {}, {}

    def steps(u: np.ndarray, v: np.ndarray) -> dict[str, Callable[[], None]]:
        u_, v_, w = _pointer(u), _pointer(v), _pointer(inverse)
        wide = (*map(_pointer, by_rows), u_, v_, w, step)
        square = (*map(_pointer, by_blocks), u_, v_, w, step)
        loose = (_pointer(cells), _pointer(slopes), lame, shear, u_, v_, _pointer(force), w, step)
        return {
            "C, by rows": lambda: library.rows(count, *wide),
            "C, by blocks": lambda: library.blocks(count // 2, *square),
            "C, by cells": lambda: library.cells(len(cells), count // 2, *loose),
        }

    for name in steps(start, start):
        u, v = start.copy(), np.zeros(count)
        steps(u, v)[name]()
        moved[name] = v.copy()
        found[name] = best(steps(u, v)[name])
    size = np.abs(moved["C, by rows"]).max()
    assert all(np.abs(each - moved["C, by rows"]).max() < 1e-9 * size for each in moved.values()), "kernels differ"
    return found


def triad(library: Any, length: int = 10_000_000) -> float:
    """Bandwidth of memory [GB/s] by the triad a = b + s c."""
    a, b, c = np.zeros(length), np.ones(length), np.full(length, 2.0)
    seconds = best(lambda: library.triad(length, _pointer(a), _pointer(b), _pointer(c), ctypes.c_double(3.0)))
    return round(24e-9 * length / seconds, 2)


def main() -> None:
    """Measure all sizes and write one file."""
    parser = argparse.ArgumentParser(prog="scripts/bench explicit_kernels", description=__doc__.splitlines()[0])
    parser.add_argument("sizes", nargs="*", type=float, default=[149.0], help="of cells [m]")
    parser.add_argument("--steps", type=int, default=30)
    parser.add_argument("--no-run", action="store_true", help="kernels only")
    parser.add_argument("--out", type=Path, default=Path("runs/bench/explicit_kernels"))
    given = parser.parse_args()
    folder = given.out.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    facts: dict[str, Any] = {"command": shlex.join(["scripts/bench", "explicit_kernels", *sys.argv[1:]]), **machine()}
    for size in given.sizes:
        found = kernels(size)
        if not given.no_run:
            found |= run_steps(size, max(given.steps, FIRST + 2), folder / f"run-{size:g}")
            found["unknown_steps_per_s"] = float(f"{1e3 * found['unknowns'] / found['step_ms']:.3g}")
        facts[f"{size:g} m"] = found
        print(json.dumps(found, indent=1), flush=True)
    (folder / "explicit_kernels.json").write_text(json.dumps(facts, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
