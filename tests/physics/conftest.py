"""Small scenes written in the tests themselves, run through the public interface."""

import h5py
import numpy as np
import pytest

from fracflow._petsc import MPI
from fracflow.output import read_events, read_history
from fracflow.scene.scene import load
from fracflow.simulation.run import run
from fracflow.solve.leapfrog.in_a_row import StepsInARow

ROCK = """
[output]
pictures = false
[rock.rock]
youngs_modulus = "10 GPa"
poissons_ratio = 0.25
density = 2500
"""
JOINT = """
[fracture.default]
normal_stiffness = "50 GPa/m"
shear_stiffness = "20 GPa/m"
aperture = "1 mm"
friction_angle_deg = 30
"""
HELD = (
    ROCK
    + """
rigid = true
[fluid]
viscosity = 1e-3
[[support]]
on = "rock"
components = ["x", "y", "rotation"]
[[stage]]
kind = "steady"
time_step = 1
steps = 1
"""
)
"""A rigid rock that does not move, and fluid whose flow is steady."""


class Ran:
    """History and events of a run on all ranks; ``fields`` is the last state of a family, on all ranks too."""

    def __init__(self, history, events, fields):
        self.history, self.events, self.fields = history, events, fields

    def probe(self, name, quantity):
        return self.history[f"probe/{name}/{quantity}"]

    def closes(self, limit=1e-10):
        largest = max(np.abs(v).max() for k, v in self.history.items() if k.startswith("energy/"))
        return np.abs(self.history["energy/residual"]).max() <= limit * largest


@pytest.fixture
def run_scene(shared_tmp):
    """Function (text of a scene, *overrides) -> Ran. Collective."""
    comm, count = MPI.COMM_WORLD, [0]

    def once(text, *overrides):
        count[0] += 1
        file = shared_tmp / f"scene{count[0]}.toml"
        if comm.rank == 0:
            file.write_text(text, encoding="utf-8")
        comm.barrier()
        folder = shared_tmp / f"run{count[0]}"
        run(load(file, list(overrides)), folder, comm)
        found = None
        if comm.rank == 0:
            fields = {}
            for family in ("rock", "fractures"):
                last = sorted((folder / "fields").glob(f"{family}_0*.h5"))[-1]
                with h5py.File(last) as f:
                    fields[family] = {
                        key: item[()] for part in ("point", "cell") for key, item in f.get(part, {}).items()
                    }
            found = read_history(folder / "history.h5"), read_events(folder / "events.csv"), fields
        return Ran(*comm.bcast(found))

    return once


@pytest.fixture
def taken(monkeypatch):
    """How many steps loops are to take in a row, and how many they do, each time."""
    found, take = [], StepsInARow.take

    def counted(self, held, base, beside, ahead):
        row = take(self, held, base, beside, ahead)
        found.append((ahead.left, row.done if row is not None else 0))
        return row

    monkeypatch.setattr(StepsInARow, "take", counted)
    return found
