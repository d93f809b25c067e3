"""Runs of the two programs from the inputs in peers/: an environment with the wheel of OpenGeoSys, files in, answers out."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from string import Template

import meshio
import numpy as np
from _launch import without_ranks
from _peers_cases import Found, Problem
from _peers_grids import write_msh, write_vtu
from grids import Floats

from fracflow.output.fields import list_steps, read_mesh, read_step

ROOT = Path(__file__).parents[2]
INPUTS = Path(__file__).parent / "peers"
WHEEL = "ogs==6.5.9"


@dataclass(frozen=True)
class Cost:
    """CPU time of a process and its children, user and system [s], and its peak memory [MB]."""

    seconds: float
    memory: float


class Failed(Exception):
    """A program that did not end well; the last lines that it printed."""


def environment(folder: Path) -> Path:
    """The program ``ogs`` of the wheel, in a virtual environment made once. Raises CalledProcessError."""
    program = folder / "bin" / "ogs"
    if not program.exists():
        print(f"installing {WHEEL} into {folder}, once ...", flush=True)
        subprocess.run([sys.executable, "-m", "venv", "--clear", str(folder)], check=True)
        pip = [
            str(folder / "bin" / "python"),
            "-m",
            "pip",
            "install",
            "-q",
            "--disable-pip-version-check",
            "--no-input",
        ]
        subprocess.run([*pip, WHEEL], check=True, stdin=subprocess.DEVNULL)
    return program


def measured(command: list[str], folder: Path) -> Cost:
    """Run a command alone, on one thread. Raises Failed."""
    # Python that may not keep what it compiles would compile all of fracflow again in every run
    clean = without_ranks("PYTHONDONTWRITEBYTECODE")
    with (folder / "said.txt").open("w", encoding="utf-8") as said:
        child = subprocess.Popen(
            command, cwd=folder, stdin=subprocess.DEVNULL, stdout=said, stderr=subprocess.STDOUT,
            env=clean | {"OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)},
        )  # fmt: skip
        _, status, used = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode:
        lines = (folder / "said.txt").read_text(encoding="utf-8", errors="replace").strip().splitlines()
        raise Failed(f"exit code {child.returncode}: " + " | ".join(lines[-4:]))
    return Cost(used.ru_utime + used.ru_stime, used.ru_maxrss / 1024.0)


def filled(name: str, values: Mapping[str, object], path: Path) -> None:
    """Write an input of peers/ with its numbers."""
    text = Template((INPUTS / name).read_text(encoding="utf-8")).substitute(values)
    path.write_text(text, encoding="utf-8")


def prepare_fracflow(problem: Problem, options: Mapping[str, object], folder: Path) -> list[str]:
    """Write mesh and scene; the command that runs them."""
    folder.mkdir(parents=True, exist_ok=True)
    names = {"fracture": "crack"} | {side: side for side in problem.sides}
    write_msh(problem.made, folder / "mesh.msh", names, dict(problem.points))
    filled(f"{problem.name}.toml", {**problem.values, **options}, folder / "scene.toml")
    return [sys.executable, "-m", "fracflow", "run", "scene.toml", "-o", "run"]


def prepare_ogs(problem: Problem, options: Mapping[str, object], folder: Path, program: Path) -> list[str]:
    """Write meshes and project; the command that runs them."""
    (folder / "run").mkdir(parents=True, exist_ok=True)
    chosen = {"order": 1, "solver": "SparseLU", "preconditioner": "NONE", "dry_rock": "true", **options}
    chosen["integration"] = 2 if chosen["order"] == 1 else 3
    write_vtu(problem.made, folder, int(str(chosen["order"])), dict(problem.points))
    filled(f"{problem.name}.prj", {**problem.values, **chosen}, folder / "project.prj")
    return [str(program), "-l", "warn", "-o", "run", "project.prj"]


def _towards_plus(values: Floats) -> Floats:
    return values if values.sum() >= 0.0 else -values


def read_fracflow(folder: Path) -> Found:
    """The last state on the fracture."""
    points, _, _ = read_mesh(folder / "run", "fractures")
    _, fields, _ = read_step(list_steps(folder / "run", "fractures")[-1][1])
    along = np.linalg.norm(points[:, :2] - points[0, :2], axis=1).reshape(-1, 2)
    slip, opening = (_towards_plus(np.asarray(fields[key]).reshape(-1, 2)) for key in ("slip", "opening"))
    pressure = np.asarray(fields["pressure"]).reshape(-1, 2) if "pressure" in fields else np.zeros_like(along)
    return Found(along, slip, opening, pressure)


def read_ogs(folder: Path, steps: int) -> Found:
    """The same of OpenGeoSys."""
    mesh = meshio.read(folder / "run" / f"end_{steps}.vtu")
    edges = next(block.data for block in mesh.cells if block.type.startswith("line"))
    start, span = mesh.points[edges[0, 0], :2], np.ptp(mesh.points[edges[:, :2].ravel(), :2], axis=0)
    tangent = span / np.linalg.norm(span)
    along = (mesh.points[edges, :2] - start) @ tangent
    jump = mesh.point_data["displacement_jump1"][edges, :2]
    pressure = np.asarray(mesh.point_data.get("pressure", np.zeros(len(mesh.points)))).ravel()[edges[:, :2]]
    normal = np.array([-tangent[1], tangent[0]])
    return Found(along, _towards_plus(jump @ tangent), _towards_plus(jump @ normal), pressure)
