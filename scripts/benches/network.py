"""Networks of up to a million pressures: network.py [PRESSURES...] [--kinds KIND...] [--steps S...] [--ranks N] [--out DIR].

A square grid of edges, some of which are fractures, in rigid rock that is held: so all that is solved for are pressures. Long
fractures run from side to side, joined by every twentieth column, so that the network is nearly a line. A random one has each
edge at a probability of 0.6: a graph in the plane, with thousands of parts that nothing drains. A plane has all edges, as the
pressures of a fracture in space have. Conductances differ by 1e9. One well pumps, another holds its pressure.

The program makes one step of each length from rest, by the solver that it chooses, in a process of its own: CPU, iterations,
memory. Then packages factor the matrix of the pressures alone: CPU, numbers in the factors, and the backward error
|Ax - b| / (|A| |x| + |b|), row by row, for a random right side. Exit code 1 where a step fails, where it takes over MOST
iterations of Newton's method or over KRYLOV Krylov iterations in each, where a backward error is over ROUND_OFF, or where
factors hold over FILL numbers a pressure. The last two bars hold the package by which the program factors so many unknowns,
which is "by" in the output; others are shown beside it.
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
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[1]))
from grids import Ints, edges_of, msh, quads_of, rims

APERTURES = {"narrow": 1e-5, "middle": 1e-3, "wide": 1e-2}  # [m]
EVERY, SHARE = 20, 0.6  # columns that join long fractures; edges that are fractures in a random network
KINDS = ("long", "random", "plane")
PACKAGES = ("mumps", "umfpack", "petsc")
ALONE = 1.0  # length of the step whose matrix packages factor [s]
MOST, KRYLOV, ROUND_OFF, FILL = 8, 30, 1e-10, 60.0


def edges_in(pressures: int, kind: str) -> dict[str, Ints]:
    """Edges (., 2) of the fractures, by group of aperture, row by row at random; from node to node of the grid."""
    count, random = round(pressures**0.5), np.random.default_rng(0)
    node = np.arange((count + 2) ** 2).reshape(count + 2, count + 2)
    edges = [
        np.stack(ends, axis=-1) for ends in ((node[1:-1, :-1], node[1:-1, 1:]), (node[:-1, 1:-1].T, node[1:, 1:-1].T))
    ]
    is_there = [
        np.ones(edges[0].shape[:2], dtype=bool),
        (np.arange(count) % EVERY == 0)[:, None] & (edges[1][..., 0] >= 0),
    ]
    if kind != "long":
        share = SHARE if kind == "random" else 1.0
        is_there = [random.random(each.shape[:2]) < share for each in edges]
    groups = [np.broadcast_to(random.integers(0, len(APERTURES), count)[:, None], each.shape[:2]) for each in edges]
    parts = list(zip(edges, is_there, groups, strict=True))
    return {
        name: np.concatenate([each[there & (group == number)] for each, there, group in parts])
        for number, name in enumerate(APERTURES)
    }


def write(pressures: int, kind: str, folder: Path) -> Path:
    """Write mesh and scene: rigid rock that is held, a fluid that is compressed, two wells in the largest part."""
    from fracflow.scene.scene import Scene

    count, fractures = round(pressures**0.5), edges_in(pressures, kind)
    node, axis = np.arange((count + 2) ** 2).reshape(count + 2, count + 2), np.arange(count + 2.0)
    points = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    sides = [(name, edges_of(nodes)) for name, nodes in rims(node).items()]
    file, path = folder / f"{kind}-{pressures}.msh", folder / f"{kind}-{pressures}.toml"
    file.write_text(msh(points, [("rock", quads_of(node)), *sides, *fractures.items()]), encoding="utf-8")
    edges = np.concatenate(list(fractures.values()))
    _, label = connected_components(
        coo_matrix((np.ones(len(edges)), edges.T), shape=(node.size, node.size)), directed=False
    )
    largest = np.flatnonzero(label == np.bincount(label).argmax())
    source, sink = points[largest[len(largest) // 2]].tolist(), points[largest[0]].tolist()
    law = {"law": "linear", "normal_stiffness": 1e10, "shear_stiffness": 1e10}
    scene = {
        "mesh": {"file": file.name},
        "rock": {"rock": {"rigid": True, "density": 2700.0}},
        "support": [{"on": ["rock"], "components": ["x", "y", "rotation"]}],
        "fracture": {
            "default": law | {"aperture": APERTURES["middle"]},
            **{name: {"aperture": aperture} for name, aperture in APERTURES.items()},
        },
        "fluid": {"viscosity": 1e-3, "specific_weight": 1e4, "compressibility": 5e-10},
        "well": [{"name": "in", "at": source, "flow_rate": 1e-9}, {"name": "out", "at": sink, "pressure": 0.0}],
        "stage": [{"kind": "quasi-static", "time_step": 1.0, "steps": 1}],
    }
    path.write_text(Scene.from_data(scene, path).dump_toml(), encoding="utf-8")
    return path


def worker(kind: str, path: Path, steps: list[float], result: Path) -> None:
    """Steps and factorisations of one network on all ranks; what came of it goes to a file. Collective."""
    from fracflow._petsc import MPI, PETSc
    from fracflow.advance.initial_state import equilibrium_state
    from fracflow.advance.step import Stepping
    from fracflow.integrators import BackwardEuler
    from fracflow.mesh.graph import components
    from fracflow.reduction.prepare import prepare
    from fracflow.scene.scene import load
    from fracflow.solve import options
    from fracflow.solve.request import StepRequest
    from fracflow.solve.rock_cost import rock_choice

    comm = MPI.COMM_WORLD
    begin = time.process_time()
    model = prepare(load(path), comm)
    layout, found = model.operators.layout, list[dict[str, Any]]()
    rock = rock_choice(model.scene, comm, int(layout.solid_starts[-1]))
    options.set_defaults(model.scene.petsc, rock, comm.size)
    state, stepping = equilibrium_state(model), Stepping(model)
    facts = {
        "kind": kind,
        "pressures": int(layout.flow_starts[-1]),
        "ranks": comm.size,
        "solver": "multigrid" if rock.by_multigrid else "LU",
        "by": PETSc.Options().getString("whole-lu_pc_factor_mat_solver_type"),
        "sets_up_cpu_s": cpu_of_all(begin, comm),
    }
    if model.mesh is not None:
        joints = model.mesh.joint_flow
        facts["parts"] = int(components(joints[:, 0], joints[:, 1], len(model.mesh.flow_origin)).max()) + 1
    for dt in steps:
        begin = time.process_time()
        request = StepRequest(dt, dt, {}, stepping.model.loads)
        new, report = stepping.step(state, request, BackwardEuler())
        left = max(report.flow_residual, report.solid_residual)
        found.append({"dt": dt, "newton": report.newton, "krylov": report.krylov, "residual": left})
        found[-1]["cpu_s"] = cpu_of_all(begin, comm)
        new.destroy()
    facts["gb"] = round(comm.allreduce(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20), 2)
    stepping.destroy()
    matrix = pressure_matrix(model, state, ALONE)
    facts["alone"] = [alone(matrix, package) for package in (PACKAGES if comm.size == 1 else PACKAGES[:1])]
    matrix.destroy()
    if comm.rank == 0:
        result.write_text(json.dumps(facts | {"step": found}), encoding="utf-8")


def cpu_of_all(begin: float, comm: Any) -> float:
    """CPU s of all ranks since each had used ``begin``. Collective."""
    return round(float(comm.allreduce(time.process_time() - begin)), 2)


def pressure_matrix(model: Any, state: Any, dt: float) -> Any:
    """The matrix of the pressures in a step from a state, with the walls held. Collective."""
    from fracflow.integrators import BackwardEuler
    from fracflow.solve.jacobian import JoinedMatrix
    from fracflow.solve.problem import StepProblem
    from fracflow.solve.request import StepRequest, StepRule

    rule = StepRule(BackwardEuler().alphas(dt))
    problem = StepProblem(model.operators, state, StepRequest(dt, dt, {}, model.loads), rule)
    problem.evaluate()
    whole = JoinedMatrix(model.operators, model.loads)
    whole.fill(problem.alphas, problem.sections.tangent, problem.conduction, problem.flow_scale())
    solid, flow = whole.layout.index_sets()
    matrix = whole.matrix.createSubMatrix(flow, flow)
    for each in (solid, flow, whole, problem):
        each.destroy()
    return matrix


def alone(matrix: Any, package: str) -> dict[str, Any]:
    """Factors of a matrix by a package, and a solve for a random right side. Collective."""
    from fracflow._petsc import PETSc

    comm = matrix.getComm().tompi4py()
    given, solution = matrix.createVecs()
    given.setArray(np.random.default_rng(comm.rank).standard_normal(given.getLocalSize()))
    solver = PETSc.KSP().create(comm=comm)
    solver.setOperators(matrix)
    solver.setType("preonly")
    solver.getPC().setType("lu")
    solver.getPC().setFactorSolverType(package)
    begin = time.process_time()
    solver.setUp()
    facts: dict[str, Any] = {"package": package, "factors_cpu_s": cpu_of_all(begin, comm)}
    begin = time.process_time()
    solver.solve(given, solution)
    facts["solves_cpu_s"] = cpu_of_all(begin, comm)
    left, sizes = given.duplicate(), given.duplicate()
    matrix.mult(solution, left)
    left.axpy(-1.0, given)
    solution.abs()
    starts, columns, values = matrix.getValuesCSR()
    absolute = PETSc.Mat().createAIJ(matrix.getSizes(), csr=(starts, columns, np.abs(values)), comm=matrix.getComm())
    absolute.mult(solution, sizes)
    given.abs()
    sizes.axpy(1.0, given)
    left.pointwiseDivide(left, sizes)
    facts["backward_error"] = float(left.norm(PETSc.NormType.INFINITY))
    factors, unknowns = solver.getPC().getFactorMatrix(), matrix.getSize()[0]
    if package != "umfpack":  # which does not tell
        held = factors.getMumpsInfog(29) if package == "mumps" else factors.getInfo()["nz_used"]
        facts["numbers_a_pressure"] = round((held if held >= 0 else -1e6 * held) / unknowns, 1)  # below 0: in millions
    for each in (left, sizes, absolute, given, solution, solver):
        each.destroy()
    return facts


def missed(found: list[dict[str, Any]]) -> list[str]:
    """The bars that were missed, in words."""
    words = []
    for row in found:
        name = f"{row['kind']}, {row['pressures']} pressures"
        words += [f"{name}: {row['failure']}"] if "failure" in row else []
        for step in row.get("step", []):
            if step["newton"] > MOST:
                words.append(f"{name}, dt = {step['dt']:g}: {step['newton']} iterations, more than {MOST}")
            if step["krylov"] > KRYLOV * step["newton"]:
                words.append(f"{name}, dt = {step['dt']:g}: {step['krylov']} Krylov iterations in {step['newton']}")
        for each in (each for each in row.get("alone", []) if each["package"] == row["by"]):
            if not each["backward_error"] <= ROUND_OFF:
                words.append(f"{name}, {each['package']}: a backward error of {each['backward_error']:.1e}")
            if each.get("numbers_a_pressure", 0.0) > FILL:
                words.append(f"{name}, {each['package']}: {each['numbers_a_pressure']} numbers a pressure")
    return words


def main() -> int:
    """Run all networks and write one file; 1 where a bar was missed."""
    parser = argparse.ArgumentParser(prog="scripts/bench network", description=__doc__.splitlines()[0])
    parser.add_argument("pressures", nargs="*", type=int, default=[10_000, 100_000])
    parser.add_argument("--kinds", nargs="*", choices=KINDS, default=["long", "random"])
    parser.add_argument("--steps", nargs="*", type=float, default=[1e-3, 1.0, 1e3, 1e6, 1e9], help="lengths [s]")
    parser.add_argument("--ranks", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("runs/bench/network"))
    given = parser.parse_args()
    folder, found = given.out.resolve(), []
    folder.mkdir(parents=True, exist_ok=True)
    from size import machine

    for pressures in given.pressures:
        for kind in given.kinds:
            path, result = write(pressures, kind, folder), folder / "worker.json"
            result.unlink(missing_ok=True)
            words = [__file__, "--worker", kind, path, result, *given.steps]
            launcher = ["mpirun", "-n", str(given.ranks)] if given.ranks > 1 else []
            done = subprocess.run([*launcher, sys.executable, *map(str, words)], capture_output=True, text=True)
            facts = {
                "kind": kind,
                "pressures": pressures,
                "failure": done.stderr.strip().splitlines()[-1:] or [f"ended with {done.returncode}"],
            }
            found.append(json.loads(result.read_text(encoding="utf-8")) if result.exists() else facts)
            path.with_suffix(".msh").unlink()
            print(json.dumps(found[-1]), flush=True)
    facts = {"command": shlex.join(["scripts/bench", "network", *sys.argv[1:]]), **machine()}
    facts |= {"network": found, "missed": missed(found)}
    (folder / "network.json").write_text(json.dumps(facts, indent=1), encoding="utf-8")
    print("\n".join(facts["missed"]) or f"all within the bars: {folder / 'network.json'}")
    return int(bool(facts["missed"]))


if __name__ == "__main__":
    if sys.argv[1:2] == ["--worker"]:
        worker(sys.argv[2], Path(sys.argv[3]), [float(dt) for dt in sys.argv[5:]], Path(sys.argv[4]))
    else:
        sys.exit(main())
