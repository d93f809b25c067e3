"""Runs of the suite's scenes: each once a session, read on rank 0 and known to all ranks."""

from pathlib import Path
from types import SimpleNamespace

import pytest

from fracflow._petsc import MPI
from fracflow.output import read_events, read_history
from fracflow.scene.scene import load
from fracflow.simulation.run import run

MESHES = Path(__file__).parents[2] / "meshes"


@pytest.fixture(scope="session")
def ran(tmp_path_factory):
    """Function (scene, *overrides) -> history, events. Collective."""
    comm, known = MPI.COMM_WORLD, {}

    def once(scene, *overrides):
        key = (str(scene), *overrides)
        if key not in known:
            path = Path(scene) if Path(scene).is_absolute() else MESHES / scene / "scene.toml"
            folder = Path(comm.bcast(str(tmp_path_factory.mktemp("run")) if comm.rank == 0 else None)) / "out"
            run(load(path, ["output.pictures=false", *overrides]), folder, comm)
            found = None
            if comm.rank == 0:
                found = read_history(folder / "history.h5"), read_events(folder / "events.csv")
            history, events = comm.bcast(found)
            known[key] = SimpleNamespace(history=history, events=events)
        return known[key]

    return once
