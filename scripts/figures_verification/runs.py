"""Runs of small scenes through the public interface, in folders that are gone afterwards."""

from __future__ import annotations

import shutil
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import fracflow
from fracflow._petsc import MPI
from fracflow.advance.instability import LimitPoint
from fracflow.output import list_steps, read_history, read_mesh, read_step

Floats = NDArray[np.float64]
Data = dict[str, NDArray[Any]]


class Field(NamedTuple):
    """State of the fractures at a time: points (n, 2), values at them and at the pieces (m, 2) between them."""

    time: float
    points: Floats
    point: Data
    pieces: NDArray[np.int64]
    cell: Data


class Found(NamedTuple):
    """Histories by key, the fractures at each state that was written, and the CPU seconds of this rank's run."""

    history: Data
    fractures: list[Field]
    seconds: float

    def probe(self, name: str, quantity: str) -> NDArray[Any]:
        """History (n, ...) of a probe."""
        return self.history[f"probe/{name}/{quantity}"]

    @property
    def open_books(self) -> float:
        """Largest residual of the energy balance over their largest entry."""
        largest = max(np.abs(v).max() for k, v in self.history.items() if k.startswith("energy/"))
        return float(np.abs(self.history["energy/residual"]).max() / largest)


def solve(scene: str | Path, *settings: str, mesh: str = "", may_stop: bool = False) -> Found:
    """Run the scene of a file, or of a text whose mesh is ``mesh.msh`` or ``mesh.geo``. Collective.

    may_stop  it may end at a limit point; else that raises LimitPoint
    """
    comm = MPI.COMM_WORLD
    folder = Path(comm.bcast(tempfile.mkdtemp(prefix="verification-") if comm.rank == 0 else None))
    try:
        if isinstance(scene, str):
            if comm.rank == 0:
                name = "mesh.msh" if mesh.startswith("$MeshFormat") else "mesh.geo"
                (folder / name).write_text(mesh, encoding="utf-8")
                table = f'\n[mesh]\nfile = "{name}"\n' if mesh else ""
                (folder / "scene.toml").write_text(scene + table, encoding="utf-8")
            comm.barrier()
            scene = folder / "scene.toml"
        loaded = fracflow.load(scene, ["output.pictures=false", *settings])
        start = time.process_time()
        try:
            fracflow.run(loaded, folder / "run")
        except LimitPoint:
            if not may_stop:
                raise
        seconds = time.process_time() - start
        ran = folder / "run"
        found = Found(read_history(ran / "history.h5"), fractures_of(ran), seconds) if comm.rank == 0 else None
        return comm.bcast(found)
    finally:
        comm.barrier()
        if comm.rank == 0:
            shutil.rmtree(folder, ignore_errors=True)


def fractures_of(folder: Path) -> list[Field]:
    """The fractures in each state that a run has written."""
    if not list_steps(folder, "fractures"):
        return []
    points, pieces, _ = read_mesh(folder, "fractures")
    states = [read_step(path) for _, path in list_steps(folder, "fractures")]
    return [Field(time, points[:, :2], point, pieces, cell) for time, point, cell in states]
